"""Reduction to first order, and SIMC: closed forms, and what the loops do with its gains."""

import numpy as np
import pytest
from helpers.first_order_plants import first_order_plants
from helpers.linear_loops import LINEAR_LOOPS, plants_at

import fastcoil as fc
from fastcoil.design.linearise import first_order, margins_of, simc

LAG, DELAY, GAIN = 80.0, 12, -20.0


def closed_form(ts, tau=0.0, gap=0.0, delay=DELAY):
    """A plant of first order with delay, as the theory has it, and the columns that go with it."""
    columns = {"sample_time": ts, "sensor_time_constant": tau, "kp": 0.02, "ti": 60.0, "backlash": gap}
    whole = {name: np.array([float(v)]) for name, v in columns.items()} | {"action": np.array(["cooling"])}
    return whole, first_order_plants(GAIN, LAG, delay)


def test_a_first_order_plant_with_delay_is_found_as_it_is_and_a_sensor_is_part_of_it():
    """Two lags in a row: their sum, and about the smaller one's half as delay."""
    bare, seen = first_order(*closed_form(ts=1)), first_order(*closed_form(ts=1, tau=20.0))
    assert (bare.lag[0], bare.delay[0]) == (pytest.approx(LAG, rel=1e-4), pytest.approx(DELAY, abs=0.01))
    assert LAG < seen.lag[0] < LAG + 20.0
    assert seen.lag[0] + seen.delay[0] == pytest.approx(bare.lag[0] + bare.delay[0] + 20.0, rel=0.03)


@pytest.mark.parametrize("gap", [0.0, 0.1])
@pytest.mark.parametrize(("ts", "delay"), [(1, 12), (10, 12), (60, 12), (4, 3)])
def test_simc_counts_half_a_sample_time_as_dead_time_and_the_stroke_behind_the_gap(ts, delay, gap):
    """With the short delay, SIMC shortens ti."""
    columns, plants = closed_form(ts, gap=gap, delay=delay)
    model = first_order(columns, plants)
    K, dead = -GAIN / (1.0 - gap), delay + 0.5 * ts
    gains = simc(columns, plants, model)
    assert gains.kp[0] == pytest.approx(LAG / (2.0 * K * dead), rel=2e-3)
    assert gains.ti[0] == pytest.approx(min(LAG, 8.0 * dead), rel=2e-3)


@pytest.mark.parametrize("gap", [0.0, 0.2])
def test_ultimate_gain_and_period_are_those_of_the_textbook_plant(gap):
    """A P controller, sampled every second: phase -(ω (delay + 1/2) + atan(ω lag)) = -π, K Ku = √(1 + (ω lag)²).

    The step-invariant delay of 12 s is 12 whole samples.
    """
    columns, plants = closed_form(ts=1, gap=gap)
    w = np.linspace(0.05, 0.2, 200001)
    ultimate = w[np.argmin(np.abs(w * (DELAY + 0.5) + np.arctan(w * LAG) - np.pi))]
    margins = margins_of(columns, plants)
    assert margins.ultimate_period[0] == pytest.approx(2.0 * np.pi / ultimate, rel=2e-3)
    assert margins.ultimate_gain[0] == pytest.approx(np.hypot(1.0, ultimate * LAG) * (1.0 - gap) / -GAIN, rel=2e-3)


@pytest.mark.kernel
def test_simc_makes_a_loop_that_follows_a_set_point_without_hunting():
    """Simulated, in every kind of loop, without a gap."""
    for name, (loop, entering) in LINEAR_LOOPS.items():
        ideal = loop.assign(backlash=0.0, stroke_time=0.0)
        T_set = np.full(5400, entering.get("T_set", 14.0))
        T_set[2700:] += 0.5
        day = fc.constant_day(1.5, **entering | {"T_set": T_set})
        linear = fc.linearise(ideal, day, at=0)
        tuned = ideal.assign(kp=float(linear.kp_simc), ti=float(linear.ti_simc))
        margins = margins_of(*plants_at(tuned, fc.constant_day(0.6, **entering)))
        assert (margins.gain_margin > 1.3).all(), name
        T = fc.simulate(tuned, day, traces=["T_sup"], warm_up=1800, n_jobs=1).T_sup.values - T_set
        assert np.abs(T[-300:]).max() < 0.02, name
