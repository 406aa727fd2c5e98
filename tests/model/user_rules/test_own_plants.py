"""``@fc.plant``: a plant of the user in place of the coil, against formulas by hand."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from helpers.refusals import assert_refused
from helpers.rules import by_error, first_order, make_parameters

import fastcoil as fc

pytestmark = pytest.mark.kernel
LAG, COOLING = 120.0, 20.0


@pytest.fixture
def responses():
    loop = fc.Loop(plant=first_order, dead_time=[0, 7, 45], backlash=[0.0, 0.1], kp=0.02, ti=120.0, sample_time=10)
    return fc.simulate(loop, fc.paper_day(hours=1), traces=["T_sup", "opening", "T_w_out", "T_c"], warm_up=600)


def test_a_first_order_plant_with_dead_time_is_its_recursion_to_the_last_bits(responses):
    T_a_in = fc.paper_day(hours=1).series["T_a_in"][0]
    for dead_time in responses.dead_time.values:
        for opening, T_sup in zip(
            responses.opening.sel(dead_time=dead_time).values,
            responses.T_sup.sel(dead_time=dead_time).values,
            strict=True,
        ):
            T, expected = 20.0, []
            for t in range(T_sup.size):
                k = t - 1 - int(dead_time)
                T += (T_a_in[t] - COOLING * (opening[k] if k >= 0 else 0.0) - T) / LAG
                expected.append(T)
            np.testing.assert_allclose(T_sup, expected, rtol=0.0, atol=1e-9)


def test_what_only_a_coil_has_is_nan(responses):
    for name in (
        "coil_energy",
        "coil_peak_power",
        "condensate",
        "frost_time",
        "freeze_time",
        "reheat_energy",
        "T_w_out",
        "T_c",
    ):
        assert responses[name].isnull().all(), name
    assert (responses.status == 0).all()
    assert responses.water_volume.notnull().all()


def test_plants_and_coils_beside_one_another_keep_their_bits():
    loop, day = fc.Loop.preset("lbnl"), fc.paper_day(hours=0.5)
    both = fc.simulate(loop.assign(plant=["coil", first_order]), day, warm_up=600)
    for plant in ("coil", first_order):
        alone = fc.simulate(loop.assign(plant=plant), day, warm_up=600)
        np.testing.assert_array_equal(both.rmse.sel(plant=getattr(plant, "name", plant)), alone.rmse)


def test_a_day_goes_on_where_the_one_before_ended():
    loop = fc.Loop(plant=first_order, dead_time=45, noise_std=0.02, sample_time=10)
    whole = fc.paper_day(hours=1)
    halves = fc.Boundary(**{name: values.reshape(2, 1800) for name, values in whole.series.items()}, day=[1, 2])
    options = {"traces": ["T_sup"], "warm_up": 600, "n_jobs": 1}
    one = fc.simulate(loop, whole.assign(day=1), **options).T_sup.values
    two = fc.simulate(loop, halves, carry_over=True, **options).T_sup.values
    np.testing.assert_array_equal(two.ravel(), one.ravel())


def test_theory_has_the_frequency_response_of_the_recursion():
    """It is z^-(1 + d) b/(1 - a z^-1) with a = 1 - 1/lag and b = -cooling/lag, at z = e^(jω)."""
    day = fc.constant_day(hours=1, T_a_in=25.0, T_set=15.0)
    w = np.array([1e-3, 1e-2, 5e-2])
    loop = fc.Loop(plant=first_order, dead_time=[0, 30], backlash=0.0, kp=0.02, ti=120.0, sample_time=10)
    linear, z = fc.linearise(loop, day, frequency=w), np.exp(1j * w)
    for k, dead_time in enumerate((0, 30)):
        P = -COOLING / LAG * z ** -(1.0 + dead_time) / (1.0 - (1.0 - 1.0 / LAG) / z)
        np.testing.assert_allclose(linear.plant_magnitude.values[k], np.abs(P), rtol=1e-8)
        np.testing.assert_allclose(linear.plant_phase.values[k], np.degrees(np.unwrap(np.angle(P))), atol=1e-6)
    np.testing.assert_allclose(linear.opening, (25.0 - 15.0) / COOLING, atol=1e-9)
    np.testing.assert_allclose(linear.gain, -COOLING, rtol=1e-6)


def test_theory_and_simulation_agree_on_which_gains_hunt():
    day = fc.constant_day(hours=6, T_a_in=25.0, T_set=15.0)
    loop = fc.Loop(plant=first_order, dead_time=30, kp=[0.02, 0.1], ti=[20.0, 240.0], sample_time=10)
    predicted, simulated = fc.limit_cycle(loop, day), fc.simulate(loop, day, warm_up=7200)
    np.testing.assert_array_equal(predicted.hunts, simulated.hunts)
    assert set(np.unique(predicted.hunts)) == {0.0, 1.0}


def test_explain_speaks_of_a_plant():
    loop = fc.Loop(plant=first_order, dead_time=30, kp=0.06, ti=40.0, sample_time=10)
    text = str(fc.explain(loop, fc.constant_day(hours=2, T_a_in=25.0, T_set=15.0)))
    assert "coil" not in text
    assert "too fast for the plant" in text
    assert "  plant " in text


class Clock(NamedTuple):
    seconds: float = 0.0


def test_a_plant_that_never_rests_is_simulated_alone():
    @fc.plant(make_parameters(rise=0.1), Clock)
    def drifting(now, p, memory):
        return 20.0 + math.sin(0.01 * memory.seconds), Clock(memory.seconds + 1.0)

    day = fc.constant_day(hours=1)
    assert np.isnan(fc.linearise(fc.Loop(plant=drifting), day).gain)
    assert fc.simulate(fc.Loop(plant=drifting), day).status == 0


def test_what_does_not_fit_a_plant_is_refused():
    day = fc.constant_day(hours=1)
    assert_refused("dead_time", "conflict", fc.simulate, fc.Loop(dead_time=5), day)
    assert_refused("plant", "choice", fc.Loop, plant="damper")
    assert_refused("plant", "conflict", fc.Loop, plant=by_error)
