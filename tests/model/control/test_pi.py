"""The PI law, its clamps, and the promise that a PI is an inverse with estimate 0."""

import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st

import fastcoil as fc
from fastcoil.model.control import clipped, desired_opening, integrated

ERRORS = st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=50)
TUNINGS = [(0.03, 8.0, 30.0), (0.018, 30.0, 15.0), (0.05, 600.0, 5.0), (0.0, 10.0, 1.0), (5.0, 0.1, 60.0)]


def sampled(errors, kp, ti, sample_time):
    """(u, integral) at every controller sample."""
    integral, found = 0.0, []
    for e in errors:
        integral = integrated(integral, e, kp * sample_time / ti)
        found.append((desired_opening(e, integral, kp), integral))
    return found


@given(ERRORS, st.sampled_from(TUNINGS))
def test_equals_the_references(errors, tuning):
    integral = 0.0
    for e, found in zip(errors, sampled(errors, *tuning), strict=True):
        u, integral = reference.pi_controller(e, integral, *tuning)
        assert found == (u, integral)


def test_integral_is_added_to_before_use():
    ((u, integral),) = sampled([2.0], 0.03, 8.0, 30.0)
    assert integral == pytest.approx(0.225)
    assert u == pytest.approx(0.06 + 0.225)


def test_clamped_integral_does_not_wind_up():
    u = [u for u, _ in sampled([10.0] * 1000 + [-1.0, -1.0], 0.03, 8.0, 30.0)]
    assert u[999] == 1.0
    assert u[1000] == pytest.approx(1.0 - 0.03 - 0.1125)
    assert u[1001] == pytest.approx(1.0 - 0.03 - 0.2250)


def test_clipped():
    assert [clipped(x) for x in (-0.1, 0.0, 0.3, 1.0, 1.1, np.inf, -np.inf)] == [0.0, 0.0, 0.3, 1.0, 1.0, 1.0, 0.0]
    assert np.isnan(clipped(np.nan))


@pytest.mark.kernel
@pytest.mark.parametrize("sample_time", [1.0, 30.0])
def test_inverse_with_estimate_0_is_the_plain_pi_to_the_bit(short, sample_time):
    loop = fc.Loop(backlash_estimate=0.0, buffer=0.0, sample_time=sample_time, kp=0.02, ti=20.0)
    names = ["command", "position", "opening", "T_sup", "T_w", "power"]
    closed = fc.simulate(loop, short, traces=["u", *names], warm_up=60)
    u = closed.u.values
    np.testing.assert_array_equal(closed.command.values, u)
    opened = fc.simulate(loop, short, command=u, traces=names, warm_up=60)
    for name in names:
        np.testing.assert_array_equal(opened[name].values, closed[name].values, err_msg=name)
    assert np.ptp(u) > 0.1


@pytest.mark.kernel
@pytest.mark.filterwarnings("ignore:action = 'heating', but the water")
def test_heating_mirrors_the_sign_of_the_error(short):
    cooling = fc.simulate(fc.Loop(), short, traces=["u", "T_measured"], warm_up=60)
    heating = fc.simulate(fc.Loop(action="heating"), short, traces=["u", "T_measured"], warm_up=60)
    first = float(cooling.T_measured[0]) - float(short.series["T_set"][0, 0])
    assert first > 0.0
    assert float(cooling.u[0]) == pytest.approx(first * (0.03 + 0.03 * 30 / 8))
    assert float(heating.u[0]) == 0.0
