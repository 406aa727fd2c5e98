"""The PI law, its clamps, and the promise that a PI is an inverse with estimate 0."""

import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st

import fastcoil as fc
from fastcoil.model.control import clip01, desired_opening, integral_part

ERRORS = st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=50)
TUNINGS = [(0.03, 8.0, 30.0), (0.018, 30.0, 15.0), (0.05, 600.0, 5.0), (0.0, 10.0, 1.0), (5.0, 0.1, 60.0)]


def pi_samples(errors, kp, ti, sample_time):
    """(u, integral) at every controller sample."""
    integral, samples = 0.0, []
    for e in errors:
        integral = integral_part(integral, e, kp * sample_time / ti)
        samples.append((desired_opening(e, integral, kp), integral))
    return samples


@given(ERRORS, st.sampled_from(TUNINGS))
def test_equals_the_references(errors, tuning):
    integral = 0.0
    for e, sample in zip(errors, pi_samples(errors, *tuning), strict=True):
        u, integral = reference.pi_controller(e, integral, *tuning)
        assert sample == (u, integral)


def test_integral_is_added_to_before_use():
    ((u, integral),) = pi_samples([2.0], 0.03, 8.0, 30.0)
    assert integral == pytest.approx(0.225)
    assert u == pytest.approx(0.06 + 0.225)


def test_clamped_integral_does_not_wind_up():
    u = [u for u, _ in pi_samples([10.0] * 1000 + [-1.0, -1.0], 0.03, 8.0, 30.0)]
    assert u[999] == 1.0
    assert u[1000] == pytest.approx(1.0 - 0.03 - 0.1125)
    assert u[1001] == pytest.approx(1.0 - 0.03 - 0.2250)


def test_clipped():
    assert [clip01(x) for x in (-0.1, 0.0, 0.3, 1.0, 1.1, np.inf, -np.inf)] == [0.0, 0.0, 0.3, 1.0, 1.0, 1.0, 0.0]
    assert np.isnan(clip01(np.nan))


@pytest.mark.kernel
@pytest.mark.parametrize("sample_time", [1.0, 30.0])
def test_inverse_with_estimate_0_is_the_plain_pi_to_the_bit(half_hour_day, sample_time):
    loop = fc.Loop(backlash_estimate=0.0, buffer=0.0, sample_time=sample_time, kp=0.02, ti=20.0)
    names = ["command", "position", "opening", "T_sup", "T_w", "power"]
    closed = fc.simulate(loop, half_hour_day, traces=["u", *names], warm_up=60)
    u = closed.u.values
    np.testing.assert_array_equal(closed.command.values, u)
    opened = fc.simulate(loop, half_hour_day, command=u, traces=names, warm_up=60)
    for name in names:
        np.testing.assert_array_equal(opened[name].values, closed[name].values, err_msg=name)
    assert np.ptp(u) > 0.1


@pytest.mark.kernel
@pytest.mark.filterwarnings("ignore:action = 'heating', but the water")
def test_heating_mirrors_the_sign_of_the_error(half_hour_day):
    cooling = fc.simulate(fc.Loop(), half_hour_day, traces=["u", "T_measured"], warm_up=60)
    heating = fc.simulate(fc.Loop(action="heating"), half_hour_day, traces=["u", "T_measured"], warm_up=60)
    first = float(cooling.T_measured[0]) - float(half_hour_day.series["T_set"][0, 0])
    assert first > 0.0
    assert float(cooling.u[0]) == pytest.approx(first * (0.03 + 0.03 * 30 / 8))
    assert float(heating.u[0]) == 0.0
