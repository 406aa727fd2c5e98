"""What can be changed in the learner's reference: a mean that leaves the start-up out, and an error beside it."""

import numpy as np
import pytest

import fastcoil as fc

INTERVAL_S = 900
LEARNER = {"learning_step": 0.01, "learning_interval": float(INTERVAL_S), "noise_std": 0.02}
NO_CHATTER = {"learning_floor": 1e6}
"""No number of switches is chatter."""


def estimate_per_interval(ds):
    """The estimate in every interval."""
    return ds.estimate.values[::INTERVAL_S]


@pytest.mark.kernel
def test_an_averaged_reference_leaves_the_start_up_out_and_then_every_interval_is_judged_by_it(working_day):
    loop = fc.Loop(**LEARNER, learning_reference=3, learning_ratio=1.5)
    ds = fc.simulate(loop, working_day, traces=["estimate", "mode"])
    turns = np.flatnonzero(np.diff(ds["mode"].values)) + 1
    switches = np.histogram(turns, np.arange(0, working_day.n_steps + 1, INTERVAL_S))[0]
    reference = switches[1:4].mean()
    x, expected = 0.0, [0.0, 0.0, 0.0, 0.0]
    for n in (reference, *switches[4:-1]):
        x = max(x - 0.01, 0.0) if n > 1.5 * reference else x + 0.01
        expected.append(x)
    np.testing.assert_allclose(estimate_per_interval(ds), expected, atol=1e-12)
    assert np.diff(expected).min() < 0.0
    assert switches[0] != reference


@pytest.mark.kernel
def test_an_error_above_that_of_the_reference_steps_down_though_nothing_chatters():
    still = fc.constant_day(hours=4)
    loop = fc.Loop.preset("lbnl").assign(**LEARNER, **NO_CHATTER, backlash=0.0, learning_reference=2)
    without_error = fc.simulate(loop, still, traces=["estimate"])
    assert np.all(np.diff(estimate_per_interval(without_error)[3:]) > 0.0)
    ds = fc.simulate(loop.assign(learning_error_ratio=1.5), still, traces=["estimate", "T_measured"])
    e = ds.T_measured.values[::15] - 14.0
    rms = np.sqrt((e.reshape(-1, INTERVAL_S // 15) ** 2).mean(axis=1))
    down = np.diff(estimate_per_interval(ds)) < 0.0
    reference = np.sqrt((rms[1:3] ** 2).mean())
    np.testing.assert_array_equal(down[3:], (rms[3:-1] > 1.5 * reference) & (estimate_per_interval(ds)[3:-1] > 0.0))
    assert down.any()
    assert float(ds.rmse_settled) < 0.5 * float(without_error.rmse_settled)


@pytest.mark.kernel
def test_a_set_point_step_or_a_start_is_no_error_of_the_estimate():
    """The valve has no backlash and the estimate stays: what is left of the error is settled, so nothing steps down."""
    n = 4 * 3600
    T_set = np.where(np.arange(n) < 2 * 3600, 14.0, 17.0)
    enabled = np.abs(np.arange(n) - 3 * 3600) > 300
    quiet = {name: series[0] for name, series in fc.constant_day(hours=4).series.items()}
    loop = fc.Loop.preset("lbnl").assign(**LEARNER, **NO_CHATTER, backlash=0.0, learning_cap=1e-6, learning_reference=2)
    days = fc.Boundary(**quiet | {"T_set": T_set, "enabled": enabled})
    ds = fc.simulate(loop.assign(learning_error_ratio=2.0), days)
    assert np.isnan(float(ds.learn_time_first_down))


@pytest.mark.kernel
def test_an_interval_that_ends_in_a_valve_test_is_taken_behind_it_whatever_the_neighbours_do():
    loop = fc.Loop.preset("lbnl").assign(**LEARNER | {"learning_interval": 600.0}, backlash=0.05, sample_time=5)
    with_test = {"test": fc.ValveTest(start=2400, minutes=15), "traces": ["estimate"], "warm_up": 0}
    alone = fc.simulate(loop, fc.paper_day(hours=2, seed=5), **with_test)["estimate"].values
    for name, values in {"learning_early_trip": [0, 1], "sample_time": [5, 7]}.items():
        ds = fc.simulate(loop.assign(**{name: values}), fc.paper_day(hours=2, seed=5), **with_test)
        assert np.array_equal(ds["estimate"].isel({name: 0}).values, alone)
    assert alone[3304] == alone[2400] != alone[3305]


@pytest.mark.kernel
def test_a_learner_that_looks_at_its_error_changes_no_bit_of_its_neighbours(one_hour_day):
    cases = {"learning_reference": [0, 1, 1], "learning_error_ratio": [0.0, 0.0, 0.8], "sample_time": [30, 7, 11]}
    shared = {"learning_step": 0.01, "learning_interval": 600.0, "noise_std": 0.02, **NO_CHATTER}
    together = fc.simulate(fc.Loop(**shared, **{n: ("case", v) for n, v in cases.items()}), one_hour_day, warm_up=600)
    for k in range(3):
        alone = fc.simulate(fc.Loop(**shared, **{n: v[k] for n, v in cases.items()}), one_hour_day, warm_up=600)
        for name in ("rmse", "estimate_final", "motor_travel"):
            assert float(alone[name]) == float(together[name].isel(case=k)), (k, name)
