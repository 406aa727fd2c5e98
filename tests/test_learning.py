"""The self-learning rule of section 3.3: one update, and the staircases it climbs."""

import numpy as np
import pytest

from fastcoil.control.learning import chatters, switch_frequency, updated

STEP = 0.007
RESTLESS = {"learning_step": STEP, "learning_interval": 600.0}


def test_switch_frequency_is_per_10_minutes():
    assert switch_frequency(12.0, 1800.0) == 4.0
    assert switch_frequency(12.0, 600.0) == 12.0


@pytest.mark.parametrize(
    ("f", "f_ref", "ratio", "floor", "expected"),
    [
        (8.0, 4.0, 2.0, 0.0, False),
        (8.1, 4.0, 2.0, 0.0, True),
        (5.9, 1.0, 2.0, 3.0, False),
        (6.1, 1.0, 2.0, 3.0, True),
        (0.0, 0.0, 2.0, 0.0, False),
        (0.1, 0.0, 2.0, 0.0, True),
    ],
)
def test_chatters_above_the_ratio_of_the_reference_or_the_floor(f, f_ref, ratio, floor, expected):
    assert bool(chatters(f, f_ref, ratio, floor)) is expected


@pytest.mark.parametrize(
    ("x_hat", "down", "expected"),
    [
        (0.014, False, 0.021),
        (0.014, True, 0.007),
        (0.010, True, 0.007),
        (0.007, True, 0.007),
        (0.245, False, 0.25),
        (0.25, False, 0.25),
    ],
)
def test_updated_steps_within_start_and_cap(x_hat, down, expected):
    assert updated(x_hat, STEP, down, 0.007, 0.25) == pytest.approx(expected, abs=1e-16)


def learned(loop, day, **options):
    """Metrics, and the estimate at the first second of every interval."""
    import fastcoil as fc

    loop = fc.Loop(**loop)
    ds = fc.simulate(loop, day, traces=["estimate", "mode"], **options)
    interval = int(loop["learning_interval"])
    assert np.all(np.diff(ds.estimate.values)[np.arange(1, day.n_steps) % interval != 0] == 0.0)
    return ds, ds.estimate.values[::interval]


@pytest.fixture(scope="module")
def paper_staircase(working_day):
    return learned({"learning_step": STEP, "backlash_estimate": STEP}, working_day)


@pytest.mark.kernel
def test_paper_rule_reaches_7_percent_after_4_h_30_and_confirms_after_5_h_30(paper_staircase):
    ds, stairs = paper_staircase
    assert (float(ds.learn_time_reached), float(ds.learn_time_confirmed)) == (4.5 * 3600, 5.5 * 3600)
    assert float(ds.learn_time_first_down) == 5.5 * 3600
    assert float(ds.estimate_first_down) == pytest.approx(0.07, abs=1e-15)
    np.testing.assert_allclose(stairs[:11], STEP * np.arange(1, 12), atol=1e-15)


@pytest.mark.kernel
def test_paper_rule_hunts_for_ever_between_the_size_and_one_step_more(paper_staircase):
    ds, stairs = paper_staircase
    np.testing.assert_allclose(stairs[10:], [0.077, 0.07, 0.077, 0.07, 0.077, 0.07], atol=1e-15)
    assert float(ds.estimate_final) == pytest.approx(0.07, abs=1e-15)
    assert float(ds.estimate_settled) == pytest.approx(0.0735, abs=1e-12)


@pytest.mark.kernel
def test_a_start_at_0_takes_one_interval_more(working_day):
    ds, stairs = learned({"learning_step": STEP}, working_day)
    assert (float(ds.learn_time_reached), float(ds.learn_time_confirmed)) == (5.0 * 3600, 6.0 * 3600)
    np.testing.assert_allclose(stairs[:12], STEP * np.arange(12), atol=1e-15)


@pytest.mark.kernel
def test_half_the_interval_takes_half_the_time(working_day):
    ds, _ = learned({"learning_step": STEP, "backlash_estimate": STEP, "learning_interval": 900.0}, working_day)
    assert (float(ds.learn_time_reached), float(ds.learn_time_confirmed)) == (2.25 * 3600, 2.75 * 3600)


@pytest.mark.kernel
def test_first_step_down_ends_the_learning_when_told_so(working_day, paper_staircase):
    ds, stairs = learned(
        {"learning_step": STEP, "backlash_estimate": STEP, "learning_stop": "first_step_down"}, working_day
    )
    np.testing.assert_array_equal(stairs[:12], paper_staircase[1][:12])
    assert np.all(stairs[11:] == stairs[11])
    assert float(ds.estimate_settled) == pytest.approx(0.07, rel=1e-12)
    assert float(ds.learn_time_confirmed) == 5.5 * 3600


@pytest.mark.kernel
def test_a_quiet_loop_runs_upward_to_the_cap():
    import fastcoil as fc

    quiet = {"kp": 0.005, "ti": 200.0, "sample_time": 5.0, **RESTLESS, "learning_cap": 0.03}
    ds, stairs = learned(quiet, fc.constant_day(hours=2))
    settled = ds["mode"].values[1200:]
    assert np.all(settled == settled[0])
    np.testing.assert_allclose(stairs, np.minimum(STEP * np.arange(12), 0.03), atol=1e-15)
    assert np.isnan(ds.learn_time_reached)
    assert np.isnan(ds.learn_time_first_down)


@pytest.mark.kernel
def test_the_floor_lets_the_estimate_rise_where_the_ratio_would_not(hour):
    strict = {**RESTLESS, "backlash_estimate": 0.02, "learning_ratio": 1e-3}
    ds, stairs = learned(strict, hour, warm_up=600)
    # never below its start, whatever the switches say
    assert np.all(stairs == 0.02)
    assert float(ds.learn_time_first_down) == 600.0
    _, stairs = learned({**strict, "learning_floor": 1e6}, hour, warm_up=600)
    np.testing.assert_allclose(stairs, 0.02 + STEP * np.arange(6), atol=1e-15)


@pytest.mark.kernel
def test_the_reference_is_the_first_interval_which_steps_too(hour):
    """With ratio 1 the first frequency never exceeds itself, so the first update goes up."""
    _, stairs = learned({**RESTLESS, "learning_ratio": 1.0}, hour, warm_up=600)
    assert stairs[1] == STEP


@pytest.mark.kernel
def test_after_a_first_interval_without_switches_any_switch_is_chatter(hour):
    import fastcoil as fc

    series = {name: values[0] for name, values in hour.series.items()}
    late = fc.Boundary(**series | {"enabled": np.arange(3600) >= 600})
    _, stairs = learned(RESTLESS, late, warm_up=600)
    np.testing.assert_allclose(stairs, [0.0, STEP, 0.0, 0.0, 0.0, 0.0], atol=1e-15)


@pytest.mark.kernel
def test_a_learner_that_may_not_step_is_the_fixed_inverse(hour):
    import fastcoil as fc

    fixed = fc.simulate(fc.Loop(backlash_estimate=0.04), hour, traces=["T_sup"], warm_up=600)
    capped = fc.simulate(
        fc.Loop(**RESTLESS, backlash_estimate=0.04, learning_cap=0.04), hour, traces=["T_sup"], warm_up=600
    )
    np.testing.assert_array_equal(fixed.T_sup.values, capped.T_sup.values)
