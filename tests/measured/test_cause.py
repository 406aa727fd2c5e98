"""The steps to a cause: what is calm, what swings alone, what is not trusted."""

import numpy as np
import pytest
from helpers.loop_logs import make_loop_log
from helpers.sentences import assert_worded

from fastcoil.measured.cause import PriorEvidence, judge_cause, undisturbed_loop
from fastcoil.measured.diagnose import _withhold_doubtful
from fastcoil.measured.fitted_loop import FittedLoop, Outcome, fit_loop_model
from fastcoil.measured.grid import Grid
from fastcoil.measured.identify import CANDIDATES, Identification
from fastcoil.measured.measures import measure_loop

IDENTIFIED = Identification(0.08, 0.07, 0.09, True, "", np.full(CANDIDATES.size, 1.0 / CANDIDATES.size))


def simulate_grid(**options):
    log = make_loop_log(**options)
    values = {str(name): log[name].values for name in log.data_vars}
    return Grid(10.0, log.elapsed_time.values, values, np.ones(log.sizes["elapsed_time"], bool), 0.0)


def fit_model(grid, backlash):
    values = grid.values
    return fit_loop_model(values["command"], values["T_sup"], values["T_set"], 10.0, backlash, 90.0, 15.0, grid.on)


@pytest.fixture(scope="module")
def restless():
    """It swings from end to end."""
    grid = simulate_grid(kp=0.08, ti=20.0)
    return grid, measure_loop(grid, 90.0)


@pytest.fixture(scope="module")
def forced():
    """The air outside swings."""
    grid = simulate_grid(backlash=0.02, swing=1.5, period=400.0)
    return grid, measure_loop(grid, 90.0)


def test_only_what_is_settled_counts_for_the_swing(restless):
    grid, measures = restless
    changed = np.flatnonzero(np.diff(grid.values["T_set"])) + 1
    assert changed.size >= 6
    assert not any(measures.calm[k : k + 59].any() for k in changed)
    assert measures.calm.any()


def test_a_command_that_swings_from_end_to_end_needs_no_model_to_blame_the_tuning(restless, forced):
    assert judge_cause(restless[1], "no model", PriorEvidence(False)).name == "tuning"
    wide = restless[1]._replace(command_swing=0.9)
    assert judge_cause(wide, "no model", PriorEvidence(True)).name == "tuning"
    assert judge_cause(wide, "no model", PriorEvidence(True, is_measured=True)).name == "unknown"
    assert judge_cause(forced[1], "no model", PriorEvidence(False)).name == "unknown"


def test_no_size_is_claimed_where_the_command_swings_over_most_of_the_stroke(restless, forced):
    doubted = _withhold_doubtful(IDENTIFIED, *restless)
    assert not doubted.identified
    assert (doubted.low, doubted.high) == (0.0, CANDIDATES[-1])
    assert "raise Ti until the loop is calm" in doubted.reason
    for swing, is_claimed in ((0.38, True), (0.42, False)):
        grid, measures = restless
        assert _withhold_doubtful(IDENTIFIED, grid, measures._replace(command_swing=swing)).identified is is_claimed
    assert _withhold_doubtful(IDENTIFIED, *forced) is IDENTIFIED
    wide = _withhold_doubtful(IDENTIFIED._replace(low=0.0, high=0.2), *forced)
    assert (wide.identified, wide.high) == (False, 0.2)
    coarse = _withhold_doubtful(IDENTIFIED, forced[0]._replace(increment=0.1), forced[1])
    assert "logged when it has changed" in coarse.reason


def test_a_loop_by_itself_has_its_drift_but_neither_noise_nor_the_swing(forced):
    grid, measures = forced
    loop = fit_model(grid, 0.02)
    day, step = loop.day, loop.plant.step
    shaken = day.disturbance + 1.5 * np.sin(2 * np.pi * np.arange(day.noise.size) * step / measures.swing.period)
    noisy = loop._replace(day=day._replace(disturbance=shaken, noise=day.noise + 0.1))
    quiet = undisturbed_loop(noisy, measures.swing).day
    assert np.abs(quiet.disturbance - day.disturbance)[shaken.size // 4 : -shaken.size // 4].max() < 0.3
    assert not quiet.noise.any()
    np.testing.assert_array_equal(undisturbed_loop(noisy, measures.swing, noise=True).day.noise, day.noise + 0.1)


@pytest.mark.parametrize(
    ("with_gap", "without", "cause"),
    [
        (True, True, "tuning"),
        (True, False, "backlash"),
        (False, False, "disturbance"),
        (1.0, False, "unknown"),
        (1.25, False, "unknown"),
    ],
)
def test_the_cause_follows_from_what_the_fitted_loop_does_alone(forced, monkeypatch, with_gap, without, cause):
    """A number: it hunts with that factor on its gain only."""
    grid, measures = forced
    swing = measures.swing

    def replay_with(self, backlash, kp=1.0, *_):
        hunts = without if backlash == 0.0 else with_gap if isinstance(with_gap, bool) else kp == with_gap
        return Outcome(1.0, 0.5 * swing.peak_to_peak, swing.period, 1.0, 1.0, hunts)

    monkeypatch.setattr(FittedLoop, "replay_with", replay_with)
    loop = fit_model(grid, 0.02)._replace(doubt="")
    verdict = judge_cause(measures, loop, PriorEvidence(True))
    assert verdict.name == cause
    assert_worded(verdict.because)
    if cause == "tuning":
        doubted = judge_cause(measures, loop._replace(doubt="it does not reproduce the log"), PriorEvidence(True))
        assert doubted.name == "unknown"
        assert_worded(doubted.because)


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({}, "backlash"),
        ({"without": 1.4}, "unknown"),
        ({"without": 1.5}, "backlash"),
        ({"size": 0.7}, "unknown"),
        ({"size": 0.7, "is_own_swing": True}, "backlash"),
        ({"size": 0.7, "is_identified": True}, "backlash"),
        ({"share": 0.1, "is_identified": True}, "unknown"),
        ({"explained": 0.8, "is_identified": True}, "backlash"),
        ({"explained": 0.8, "size": 0.9, "is_identified": True}, "unknown"),
        ({"outside": 1.8, "is_identified": True}, "backlash"),
        ({"outside": 2.2, "is_identified": True}, "unknown"),
        ({"outside": 2.2, "is_own_swing": True}, "backlash"),
        ({"share": 0.1, "is_own_swing": True}, "unknown"),
        ({"share": 0.1, "is_identified": True, "is_measured": True}, "backlash"),
    ],
)
def test_a_gap_is_blamed_where_the_model_is_clear_and_nothing_speaks_for_more(restless, monkeypatch, changes, cause):
    """Of the model: the factor on its gain at which it hunts without its gap, and the size of its swing.

    size, outside: swings of model and disturbance over that of the log; share: of the command's swing that the gap is.
    """
    case: dict = {"without": None, "size": 1.0, "share": 0.5, "explained": 1.0, "outside": 0.0} | changes
    grid, measures = restless
    swing, loop = measures.swing, fit_model(grid, 0.05)
    plant = loop.plant._replace(explained=case["explained"])
    loop = loop._replace(backlash=case["share"] * measures.command_swing, plant=plant)
    time = np.arange(loop.day.disturbance.size) * loop.plant.step
    wave = 0.5 * case["outside"] * swing.peak_to_peak * np.sin(2 * np.pi * time / swing.period)
    loop = loop._replace(day=loop.day._replace(disturbance=wave))

    def replay_with(self, backlash, kp=1.0, *_):
        hunts = backlash > 0.0 or kp == case["without"]
        return Outcome(1.0, 0.5 * case["size"] * swing.peak_to_peak, swing.period, 1.0, 1.0, hunts)

    monkeypatch.setattr(FittedLoop, "replay_with", replay_with)
    for name in ("LARGEST_GAP_SWING", "LARGEST_MEASURED_GAP_SWING"):
        monkeypatch.setattr(f"fastcoil.measured.thresholds.{name}", 2.0)
    verdict = judge_cause(measures, loop, PriorEvidence(*(case.get(name, False) for name in PriorEvidence._fields)))
    assert verdict.name == cause
    assert_worded(verdict.because)


def test_a_model_that_explains_nearly_nothing_gives_no_cause(forced):
    grid, measures = forced
    loop = fit_model(grid, 0.02)
    verdict = judge_cause(measures, loop._replace(plant=loop.plant._replace(explained=0.04)), PriorEvidence(True))
    assert verdict.name == "unknown"
    assert "4 %" in verdict.because


def judge_noisy_swing(amplitude, noise, *, T_set=True, pieces=False):
    """What is said of a loop whose temperature swings every 4 min under noise: of 6 h, the set-point held."""
    n = 2160
    swing = amplitude * np.sin(2 * np.pi * np.arange(n) / 24)
    T = 14.0 + swing + noise * np.random.default_rng(3).standard_normal(n)
    values = {"command": 0.5 + 0.02 * swing, "T_sup": T} | ({"T_set": np.full(n, 14.0)} if T_set else {})
    on = np.arange(n) % 40 > 0 if pieces else np.ones(n, bool)
    measures = measure_loop(Grid(10.0, 10.0 * np.arange(n), values, on, 0.0), 90.0)
    return judge_cause(measures, "no model", PriorEvidence(False)), measures.swing


def test_a_wide_swing_that_is_not_even_enough_is_not_called_calm():
    verdict, swing = judge_noisy_swing(0.7, 0.8)
    assert not swing.is_regular
    assert verdict.name == "unknown"
    assert "too irregular" in verdict.because
    assert judge_noisy_swing(0.07, 0.08)[0].name == "none"
