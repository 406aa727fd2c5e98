"""Metrics over hours with pauses, and of runs without a block, a window or a counted second."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.engine import metrics
from fastcoil.model.engine.metrics import make_schedule
from fastcoil.model.metric_table import METRICS, TRACES

pytestmark = pytest.mark.kernel

WARM_UP = 1000
N_SECONDS = 9400
SECONDS = np.arange(N_SECONDS)
IS_OFF = ((SECONDS >= 3333) & (SECONDS < 3500)) | (SECONDS >= N_SECONDS - 30)
LOOPS = {
    "cooling": {"learning_step": 0.01, "learning_interval": 600.0, "noise_std": 0.02, "backlash_estimate": 0.03},
    "heating": {"action": "heating", "kp": 0.004, "ti": 30.0, "sample_time": 15.0, "C_w": 12.0, "stroke_time": 60.0},
    "open loop": {"air_march": "quasistatic"},
}


@pytest.mark.parametrize("name", LOOPS)
def test_every_metric_is_that_of_the_whole_record(name, run_reference):
    """``reference`` computes them from its traces, the kernel from sums."""
    boundary = fc.paper_day(hours=N_SECONDS / 3600, seed=3)
    series = {key: values[0] for key, values in boundary.series.items()} | {"enabled": np.where(IS_OFF, 0, 1)}
    if name == "heating":
        series |= {"T_w_in": 50.0, "T_a_in": 12.0, "T_set": boundary.series["T_set"][0] + 8.0}
    day = fc.Boundary(**series, day=3)
    command = 0.5 + 0.4 * np.sin(SECONDS / 300.0) if name == "open loop" else None
    loop, options = fc.Loop(**LOOPS[name]), {"warm_up": WARM_UP, "command": command}
    ds = fc.simulate(loop, day, **options)
    _, expected = run_reference(loop, day, **options)
    for metric in METRICS:
        assert float(ds[metric]) == pytest.approx(expected[metric], rel=1e-9, abs=1e-9, nan_ok=True), metric
    assert name == "open loop" or float(ds.switch_frequency) > 0.0
    assert 0.0 < float(ds.share_off) < 1.0
    assert float(ds.coil_energy) > 0.0


def test_a_run_too_short_for_a_block_or_a_window_has_no_such_metric():
    ds = fc.simulate(fc.Loop(), fc.paper_day(hours=550 / 3600), warm_up=0)
    missing = {name for name in METRICS if np.isnan(ds[name])}
    learner = {"learn_time_reached", "learn_time_confirmed", "learn_time_first_down", "estimate_first_down"}
    estimators = learner | {"time_identified", "size_error", "half_periods", "half_period_spread"}
    settled = {"rmse_settled", "settled_range", "hunting_swing", "hunting_period", "swing_regularity", "hunts"}
    assert missing == estimators | settled | {"switch_frequency", "coil_peak_power"}


@pytest.mark.parametrize(
    ("periods", "period", "regularity"),
    [([], np.nan, np.nan), ([400] * 7, 400.0, 1.0), ([300, 500] * 5, 400.0, 0.0), ([400] * 9 + [700] * 9, 550.0, 0.95)],
)
def test_the_period_of_a_swing_is_the_mean_time_between_its_turns(periods, period, regularity):
    """Open loop, and the waves begin while nothing counts yet: the first ends the lead."""
    waves = [0.45 + 0.2 * np.sin(2 * np.pi * np.arange(p) / p) for p in [400, *periods, 400]] if periods else []
    command = np.concatenate([np.full(1800, 0.45), *waves, np.full(600, 0.45)])
    ds = fc.simulate(fc.Loop(), fc.constant_day(hours=command.size / 3600), command=command, warm_up=1500)
    assert float(ds.hunting_period) == pytest.approx(period, nan_ok=True, abs=40)
    assert float(ds.swing_regularity) == pytest.approx(regularity, nan_ok=True, abs=0.2)


@pytest.mark.parametrize(("step", "reversals"), [(1e-6, 119), (1e-8, 119), (1e-11, 0)])
def test_a_stem_reverses_at_every_movement_above_round_off(step, reversals):
    command = 0.5 + step * np.resize([0.0] * 30 + [1.0] * 30, 3600)
    ds = fc.simulate(fc.Loop(backlash=0.0), fc.constant_day(hours=1), command=command, warm_up=0)
    assert float(ds.reversals) == pytest.approx(reversals, abs=2)


def test_metrics_of_a_run_that_never_counts_are_missing_or_zero():
    day = fc.constant_day(hours=1)
    never = fc.Boundary(**{name: values[0] for name, values in day.series.items()} | {"enabled": np.zeros(3600)})
    ds = fc.simulate(fc.Loop(), never)
    assert int(ds.status) == 0
    assert np.isnan(ds.rmse)
    assert all(ds[name] == 0.0 for name in ("iae", "stem_travel", "coil_energy", "water_volume", "condensate"))


def test_metrics_do_not_depend_on_the_traces():
    day = fc.paper_day(hours=0.5, seed=1)
    plain = fc.simulate(fc.Loop(), day, warm_up=100)
    traced = fc.simulate(fc.Loop(), day, warm_up=100, traces=list(TRACES), trace_interval=7)
    assert traced[list(METRICS)].identical(plain[list(METRICS)].assign_attrs(traced.attrs))


def seconds_with_flag(schedule, flag):
    return np.flatnonzero(schedule.flags & flag).tolist()


def test_schedule_of_a_small_day():
    T_set = np.where(np.arange(4000) < 1500, 14.0, 13.0)
    enabled = np.ones(4000)
    enabled[3000] = 0.0
    schedule = make_schedule(T_set, enabled, 100)
    counted = [*range(100, 3000), *range(3001, 4000)]
    settled = [*range(600, 1500), *range(2100, 3000), *range(3601, 4000)]
    assert seconds_with_flag(schedule, metrics.IS_COUNTED) == counted
    assert seconds_with_flag(schedule, metrics.IS_SETTLED) == settled
    assert seconds_with_flag(schedule, metrics.WINDOW_STARTS) == [600, 2100, 3601]
    assert seconds_with_flag(schedule, metrics.WINDOW_ENDS) == [1499, 2999, 3999]
    # blocks 100-699, 700-1299, ... 3100-3699; that of second 3000 does not count
    assert seconds_with_flag(schedule, metrics.IN_SWITCH_BLOCK) == [*range(100, 2500), *range(3100, 3700)]
    assert seconds_with_flag(schedule, metrics.IN_PEAK_BLOCK) == [*range(100, 2800)]
    assert seconds_with_flag(schedule, metrics.PEAK_BLOCK_ENDS) == [999, 1899, 2799]
    assert seconds_with_flag(schedule, metrics.IN_ESTIMATE_WINDOW) == counted
    numbers = (schedule.n_counted, schedule.n_settled, schedule.n_windows)
    assert numbers == (len(counted), len(settled), 3)
    assert (schedule.n_switch_blocks, schedule.n_peak_blocks) == (5, 3)


def test_estimate_window_is_the_last_two_hours():
    schedule = make_schedule(np.full(9000, 14.0), np.ones(9000), 100)
    assert seconds_with_flag(schedule, metrics.IN_ESTIMATE_WINDOW) == list(range(1800, 9000))
    assert schedule.n_estimate == 7200
