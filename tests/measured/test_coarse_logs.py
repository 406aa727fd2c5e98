"""Logs whose rows are further apart than the controller's samples: no narrow interval that misses the truth."""

import warnings

import numpy as np
import pytest
from helpers.refusals import assert_refused
from helpers.simulated_logs import add_noise, ar1_noise, make_valve_log, random_walk, valve_flows

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.logs.columns import ColumnSpec
from fastcoil.measured import thresholds, valve_problem
from fastcoil.measured.part import fitting_mask
from fastcoil.measured.valve_problem import ValveProblem, Verdict, judge_interval

pytestmark = pytest.mark.kernel


def simulate_trend(preset, interval, seed, backlash, hours, **changed):
    """Command and flow of a simulated loop on a stepped day, a row every ``interval`` s, noise of 0.02 kg/s."""
    rng = np.random.default_rng(seed)
    loop = fc.Loop.preset(preset).assign(backlash=backlash, **changed)
    ds = fc.simulate(loop, fc.paper_day(hours=hours, seed=seed), traces=["command", "m_w"], n_jobs=1)
    rows = slice(1800 + seed % interval, None, interval)
    command, flow = ds["command"].values[rows], ds["m_w"].values[rows]
    return make_valve_log(command, np.maximum(flow + ar1_noise(rng, flow.size, 0.02), 1e-3), float(interval))


def solve_problem(log):
    """The problem of a log without a shift, and its solution."""
    data = read_checked_log(log, ColumnSpec(required=("command", "m_w"), measured=("m_w",)))
    problem = ValveProblem(data, fitting_mask(data, 1.0))
    return problem, problem.solve()


@pytest.fixture(scope="module")
def coarse():
    """A walk of which every third row is logged: what turns between the rows is not seen."""
    rng = np.random.default_rng(31)
    command = random_walk(rng, n=1800, largest=0.1)
    return solve_problem(make_valve_log(command[::3], add_noise(rng, valve_flows(command), 0.01)[::3]))


@pytest.mark.parametrize(
    ("share", "per_share", "why"),
    [(0.2, 0.6, "is possible"), (0.5, 3.0, "is possible"), (0.51, 0.6, "not identified: rows are 60 s apart")],
)
def test_unseen_motion_widens_the_interval_unless_the_command_holds(monkeypatch, coarse, share, per_share, why):
    assert valve_problem._motion_share(*coarse) > 0.2
    monkeypatch.setattr(valve_problem, "_motion_share", lambda *_: share)
    monkeypatch.setattr(thresholds, "ALLOWANCE_PER_MOTION_SHARE", per_share)
    allowed, held = judge_interval(*coarse, False), judge_interval(*coarse, True)
    assert held == (coarse[1].interval, "", "")
    assert allowed.interval[0] <= held.interval[0] < held.interval[1] <= allowed.interval[1]
    assert (allowed.interval == held.interval) == (share > 0.5)
    for words in (why, "rows are 60 s apart", "--hold command"):
        assert words in allowed.why


def test_the_fit_has_the_wider_interval(monkeypatch):
    rng = np.random.default_rng(33)
    log = make_valve_log(command := random_walk(rng, n=80), add_noise(rng, valve_flows(command), 0.01))
    narrow = fc.fit_valve(log, lag=0, holds="command")
    low, high = narrow.intervals["backlash"]
    wider = Verdict((low - 0.01, high + 0.01), "", "so")
    monkeypatch.setattr("fastcoil.measured.fit_valve.judge_interval", lambda *_: wider)
    wide = fc.fit_valve(log, lag=0)
    assert wide.intervals["backlash"] == tuple(wide.profile.attrs["interval_95"]) == wider.interval
    ratio = wide.standard_errors["backlash"] / narrow.standard_errors["backlash"]
    assert ratio == pytest.approx((high - low + 0.02) / (high - low))
    assert "so" in wide.notes
    assert_refused("holds", "choice", fc.fit_valve, log, holds="m_w")


@pytest.mark.full
def test_intervals_of_coarse_closed_loop_logs_hold_the_truth_where_the_backlash_is_identified():
    """36 fresh loops, 1, 5 and 15 min: of those identified, at most 15 % miss; without the allowance most do."""
    missed, n_identified = {True: 0, False: 0}, 0
    for k in range(36):
        rng = np.random.default_rng(8100 + k)
        interval, preset = (60, 300, 900)[k % 3], ("paper_like", "paper_like_fast", "lbnl", "g36")[k % 4]
        kp, ti = float(fc.Loop.preset(preset)["kp"]), float(fc.Loop.preset(preset)["ti"])
        changed = {"kp": kp * rng.uniform(0.5, 1.3), "ti": ti * rng.uniform(0.7, 1.8)}
        backlash = float(rng.choice([0.0, 0.03, 0.06, 0.1]))
        log = simulate_trend(preset, interval, 8100 + k, backlash, 8 if interval == 60 else 48, **changed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            fit = fc.fit_valve(log, split=1.0)
            without_allowance = fc.fit_valve(log, split=1.0, holds="command")
        for result, has_allowance in ((fit, True), (without_allowance, False)):
            if "backlash" in result.parameters:
                low, high = result.intervals["backlash"]
                missed[has_allowance] += not low <= backlash <= high
        n_identified += "backlash" in fit.parameters
    print(n_identified, missed)
    assert n_identified >= 8
    assert missed[True] <= 0.15 * n_identified
    assert missed[False] > 2 * missed[True]
