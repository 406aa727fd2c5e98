"""The self-learning rule of section 3.3: one update, and the staircases it climbs."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.estimators import learner
from fastcoil.model.metric_table import LEARNING_STATUS_MEANINGS

STEP = 0.007
LEARNING_LOOP = {"learning_step": STEP, "learning_interval": 600.0}


def test_chatters_above_the_ratio_of_the_reference_or_the_floor():
    assert [bool(learner.is_chatter(f, 4.0, 2.0, 0.0)) for f in (8.0, 8.1)] == [False, True]
    assert [bool(learner.is_chatter(f, 1.0, 2.0, 3.0)) for f in (5.9, 6.1)] == [False, True]
    assert [bool(learner.is_chatter(f, 0.0, 2.0, 0.0)) for f in (0.0, 0.1)] == [False, True]


def test_next_estimate_steps_within_start_and_cap():
    up = [learner.next_estimate(x_hat, STEP, False, 0.007, 0.25) for x_hat in (0.014, 0.245, 0.25)]
    down = [learner.next_estimate(x_hat, STEP, True, 0.007, 0.25) for x_hat in (0.014, 0.010, 0.007)]
    assert up == pytest.approx([0.021, 0.25, 0.25], abs=1e-16)
    assert down == pytest.approx([0.007, 0.007, 0.007], abs=1e-16)


def run_learner(loop, day, **options):
    """Metrics, and the estimate at the first second of every interval."""
    loop = fc.Loop(**loop)
    ds = fc.simulate(loop, day, traces=["estimate", "mode"], **options)
    interval = int(loop["learning_interval"])
    assert np.all(np.diff(ds.estimate.values)[np.arange(1, day.n_steps) % interval != 0] == 0.0)
    return ds, ds.estimate.values[::interval]


@pytest.fixture(scope="module")
def paper_staircase(working_day):
    return run_learner({"learning_step": STEP, "backlash_estimate": STEP}, working_day)


@pytest.mark.kernel
def test_paper_rule_reaches_7_percent_after_4_h_30_and_confirms_after_5_h_30(paper_staircase):
    ds, stairs = paper_staircase
    assert (float(ds.learn_time_reached), float(ds.learn_time_confirmed)) == (4.5 * 3600, 5.5 * 3600)
    assert float(ds.learn_time_first_down) == 5.5 * 3600
    assert float(ds.estimate_first_down) == pytest.approx(0.07, abs=1e-15)
    np.testing.assert_allclose(stairs[:11], STEP * np.arange(1, 12), atol=1e-15)


@pytest.mark.kernel
def test_paper_rule_hunts_for_ever_between_the_backlash_and_one_step_more(paper_staircase):
    ds, stairs = paper_staircase
    np.testing.assert_allclose(stairs[10:], [0.077, 0.07, 0.077, 0.07, 0.077, 0.07], atol=1e-15)
    assert float(ds.estimate_final) == pytest.approx(0.07, abs=1e-15)
    assert float(ds.estimate_settled) == pytest.approx(0.0735, abs=1e-12)


@pytest.mark.kernel
def test_a_quiet_loop_runs_upward_to_the_cap():
    quiet = {"kp": 0.005, "ti": 200.0, "sample_time": 5.0, **LEARNING_LOOP, "learning_cap": 0.03}
    ds, stairs = run_learner(quiet, fc.constant_day(hours=2))
    settled = ds["mode"].values[1200:]
    assert np.all(settled == settled[0])
    np.testing.assert_allclose(stairs, np.minimum(STEP * np.arange(12), 0.03), atol=1e-15)
    assert np.isnan(ds.learn_time_reached)
    assert np.isnan(ds.learn_time_first_down)


@pytest.mark.kernel
def test_the_floor_lets_the_estimate_rise_where_the_ratio_would_not(one_hour_day):
    strict = {**LEARNING_LOOP, "backlash_estimate": 0.02, "learning_ratio": 1e-3}
    ds, stairs = run_learner(strict, one_hour_day, warm_up=600)
    # never below its start, whatever the switches say
    assert np.all(stairs == 0.02)
    assert float(ds.learn_time_first_down) == 600.0
    _, stairs = run_learner({**strict, "learning_floor": 1e6}, one_hour_day, warm_up=600)
    np.testing.assert_allclose(stairs, 0.02 + STEP * np.arange(6), atol=1e-15)


@pytest.mark.kernel
def test_after_a_first_interval_without_switches_any_switch_is_chatter(one_hour_day):
    series = {name: values[0] for name, values in one_hour_day.series.items()}
    late = fc.Boundary(**series | {"enabled": np.arange(3600) >= 600})
    _, stairs = run_learner(LEARNING_LOOP, late, warm_up=600)
    np.testing.assert_allclose(stairs, [0.0, STEP, 0.0, 0.0, 0.0, 0.0], atol=1e-15)


def test_an_interval_is_evidence_unless_it_is_quiet_or_no_reference():
    assert learner.classify_interval(0.0, 0.0, -1.0, 30.0, 0.0, 1.0) == learner.EVIDENCE_ENOUGH
    assert learner.classify_interval(0.0, 0.0, -1.0, 30.0, 1.0, 1.0) == learner.EVIDENCE_QUIET
    assert learner.classify_interval(0.0, 0.0, 3.0, 30.0, 1.0, 1.0) == learner.EVIDENCE_QUIET
    assert learner.classify_interval(1.0, 0.3, -1.0, 30.0, 1.0, 1.0) == learner.EVIDENCE_ENOUGH
    # at a sample time of 30 s there are 20 samples, and at most 20 switches, in 10 min
    assert learner.classify_interval(60.0, 20.0, -1.0, 30.0, 0.0, 1.0) == learner.EVIDENCE_ENOUGH
    assert learner.classify_interval(24.0, 8.0, -1.0, 30.0, 0.0, 0.4) == learner.EVIDENCE_ENOUGH
    assert learner.classify_interval(25.0, 8.4, -1.0, 30.0, 0.0, 0.4) == learner.EVIDENCE_UNMEASURABLE
    assert learner.classify_interval(25.0, 8.4, 2.0, 30.0, 0.0, 0.4) == learner.EVIDENCE_ENOUGH


@pytest.mark.kernel
def test_with_a_hold_a_quiet_loop_stays_where_it_is_and_says_so():
    quiet = {"kp": 0.005, "ti": 200.0, "sample_time": 5.0, **LEARNING_LOOP, "learning_min_switches": 1.0}
    # switches on the way to the set point are over after ten minutes
    ds, stairs = run_learner(quiet, fc.constant_day(hours=2))
    assert stairs[-1] <= 3 * STEP
    assert np.all(stairs[4:] == stairs[4])
    still, stairs = run_learner({**quiet, "learning_min_switches": 1e6}, fc.constant_day(hours=2))
    assert np.all(stairs == 0.0)
    assert LEARNING_STATUS_MEANINGS[int(still.learning_status)] == "no_evidence"
    assert int(still.status) == 0


@pytest.mark.kernel
def test_an_early_trip_does_not_wait_for_the_end_of_the_interval(working_day):
    slow = {"learning_step": 0.02, "backlash_estimate": 0.02, "learning_interval": 3600.0}
    late, early = (fc.simulate(fc.Loop(**slow, learning_early_trip=k), working_day) for k in (0, 1))
    assert float(late.learn_time_first_down) % 3600 == 0
    assert float(early.learn_time_first_down) % 3600 != 0
    assert float(early.learn_time_first_down) % 30 == 0
    assert float(early.learn_time_first_down) < float(late.learn_time_first_down)
    assert float(early.estimate_first_down) == float(late.estimate_first_down)


@pytest.mark.kernel
def test_a_growing_step_climbs_in_powers_of_two_and_then_halves(working_day):
    loop = {"learning_step": 0.005, "learning_interval": 600.0, "learning_growth": 2.0, "learning_shrink": 0.5}
    ds = fc.simulate(fc.Loop(**loop), working_day, traces=["estimate"], trace_interval=600)
    moves = np.diff(ds.estimate.values)
    first_down = int(np.argmax(moves < 0.0))
    np.testing.assert_allclose(moves[:first_down], 0.005 * 2.0 ** np.arange(first_down), atol=1e-15)
    assert -moves[first_down] == pytest.approx(moves[first_down - 1])
    downs = -moves[moves < -1e-12]
    np.testing.assert_allclose(downs, downs[0] * 0.5 ** np.arange(downs.size), rtol=1e-6)
    assert abs(float(ds.estimate_final) - 0.07) < 0.01


@pytest.mark.kernel
def test_the_final_factor_acts_once_where_learning_stops(working_day):
    loop = fc.Loop(learning_step=STEP, backlash_estimate=STEP, learning_stop="first_step_down", learning_final=0.95)
    ds = fc.simulate(loop, working_day)
    assert float(ds.estimate_final) == 0.95 * float(ds.estimate_first_down)
    assert LEARNING_STATUS_MEANINGS[int(ds.learning_status)] == "stopped"


@pytest.mark.kernel
def test_the_status_of_learning_has_cf_flags_and_is_off_without_it(one_hour_day):
    ds = fc.simulate(fc.Loop(), one_hour_day)
    assert ds.learning_status.attrs["flag_meanings"].split() == list(LEARNING_STATUS_MEANINGS)
    assert ds.learning_status.attrs["flag_values"].tolist() == list(range(len(LEARNING_STATUS_MEANINGS)))
    assert float(ds.learning_status) == 0.0
    open_loop = fc.simulate(fc.Loop(**LEARNING_LOOP), one_hour_day, command=np.full(3600, 0.5))
    assert float(open_loop.learning_status) == 0.0
