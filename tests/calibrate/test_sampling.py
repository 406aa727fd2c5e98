"""Logs whose rows are further apart than the controller's samples: no narrow interval that misses the truth."""

import warnings

import numpy as np
import pytest
from helpers.simulated_logs import flows, log_of, noise, noisy, walk

import fastcoil as fc
from fastcoil.calibrate import sampling
from fastcoil.calibrate.closed_loop import Bias

pytestmark = pytest.mark.kernel


def trend(preset, interval, seed, backlash, hours, **changed):
    """Command and flow of a simulated loop on a stepped day, a row every ``interval`` s, noise of 0.02 kg/s."""
    rng = np.random.default_rng(seed)
    loop = fc.Loop.preset(preset).assign(backlash=backlash, **changed)
    ds = fc.simulate(loop, fc.paper_day(hours=hours, seed=seed), traces=["command", "m_w"], n_jobs=1)
    rows = slice(1800 + seed % interval, None, interval)
    command, flow = ds["command"].values[rows], ds["m_w"].values[rows]
    return log_of(command, np.maximum(flow + noise(rng, flow.size, 0.02), 1e-3), float(interval))


@pytest.fixture(scope="module")
def coarse():
    """A walk whose rows are every third of those that moved the valve: what turns between them is not logged."""
    rng = np.random.default_rng(31)
    command = walk(rng, n=900, largest=0.1)
    return log_of(command[::3], noisy(rng, flows(command), 0.01)[::3])


def with_bias(monkeypatch, log, bias, **options):
    """The fit of a log if the simulated loops say this."""
    calls = []

    def found(*arguments):
        calls.append(arguments)
        return bias

    monkeypatch.setattr(sampling, "bias_of", found)
    return fc.fit_valve(log, split=1.0, lag=0, **options), len(calls)


@pytest.mark.parametrize(
    ("bias", "identified", "words"),
    [
        (Bias(0.03, 0.05, (0.7, 1.0)), True, "show 0.7 to 1 of theirs; the interval of the backlash allows for that"),
        (Bias(0.01, 0.2, (0.3, 1.0)), False, "a backlash of 0.01 to 0.2 may lie behind the"),
        (Bias(np.nan, np.nan, (np.nan, np.nan)), False, "no simulated loop with this valve moves as this log does"),
    ],
)
def test_what_such_loops_show_widens_the_interval_or_leaves_nothing_identified(
    monkeypatch, coarse, bias, identified, words
):
    monkeypatch.setattr(sampling, "_besides_noise", lambda *_: 0.6)
    fit, n_calls = with_bias(monkeypatch, coarse, bias)
    assert n_calls == 1
    assert ("backlash" in fit.parameters) == identified, fit.held
    said = [note for note in fit.notes if "60 s apart" in note] if identified else [fit.held["backlash"]]
    assert words in said[0]
    assert "--hold command" in said[0]
    if not np.isnan(bias.low):
        low, high = fit.profile.attrs["interval_95"]
        assert low <= bias.low
        assert high >= bias.high
    if identified:
        assert fit.standard_errors["backlash"] > 0.25 * (bias.high - bias.low) / 2.1


def test_a_command_that_holds_from_row_to_row_needs_no_such_allowance(monkeypatch, coarse):
    allowed, _ = with_bias(monkeypatch, coarse, Bias(0.01, 0.2, (0.3, 1.0)))
    held, n_calls = with_bias(monkeypatch, coarse, Bias(0.01, 0.2, (0.3, 1.0)), holds="command")
    assert n_calls == 0
    assert "backlash" in held.parameters
    assert np.ptp(allowed.profile.attrs["interval_95"]) > 1.2 * np.ptp(held.profile.attrs["interval_95"])
    with pytest.raises(fc.InputError, match="holds = 'm_w': choose 'command'"):
        fc.fit_valve(coarse, holds="m_w")


def test_steps_that_are_logged_whole_are_taken_as_they_are(monkeypatch):
    rng = np.random.default_rng(32)
    for command in (walk(rng, n=300), np.repeat(walk(rng, n=60), 5)):
        log = log_of(command, noisy(rng, flows(command), 0.02))
        fit, n_calls = with_bias(monkeypatch, log, None)
        assert n_calls == 0
        assert fit.intervals["backlash"] == fc.fit_valve(log, split=1.0, lag=0, holds="command").intervals["backlash"]


@pytest.mark.full
def test_a_loop_logged_at_10_s_is_right_and_at_15_min_not_identified():
    fine = fc.fit_valve(trend("lbnl", 10, 41, 0.09, 8), split=1.0)
    assert fine.parameters["backlash"] == pytest.approx(0.09, abs=0.003)
    for interval, preset in ((900, "lbnl"), (300, "paper_like"), (60, "paper_like")):
        fit = fc.fit_valve(trend(preset, interval, 42, 0.09, 8 if interval < 300 else 48), split=1.0)
        low, high = fit.profile.attrs["interval_95"]
        if "backlash" in fit.parameters:
            assert low <= 0.09 <= high, (interval, preset)
        else:
            assert f"rows are {interval} s apart" in fit.held["backlash"]


@pytest.mark.full
def test_intervals_of_coarse_closed_loop_logs_hold_the_truth_where_the_backlash_is_identified():
    """36 fresh loops, 1, 5 and 15 min: of those identified, at most 15 % miss; without the allowance most do."""
    missed = {True: 0, False: 0}
    n_identified = 0
    for k in range(36):
        rng = np.random.default_rng(8100 + k)
        interval, preset = (60, 300, 900)[k % 3], ("paper_like", "paper_like_fast", "lbnl", "g36")[k % 4]
        kp, ti = float(fc.Loop.preset(preset)["kp"]), float(fc.Loop.preset(preset)["ti"])
        changed = {"kp": kp * rng.uniform(0.5, 1.3), "ti": ti * rng.uniform(0.7, 1.8)}
        backlash = float(rng.choice([0.0, 0.03, 0.06, 0.1]))
        log = trend(preset, interval, 8100 + k, backlash, 8 if interval == 60 else 48, **changed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            fit = fc.fit_valve(log, split=1.0)
            plain = fc.fit_valve(log, split=1.0, holds="command")
        for found, allowed in ((fit, True), (plain, False)):
            if "backlash" in found.parameters:
                low, high = found.intervals["backlash"]
                missed[allowed] += not low <= backlash <= high
        n_identified += "backlash" in fit.parameters
    print(n_identified, missed)
    assert n_identified >= 8
    assert missed[True] <= 0.15 * n_identified
    assert missed[False] > 2 * missed[True]
