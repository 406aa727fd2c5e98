"""The loop fitted to a log: its controller, its plant, and what its day would have been otherwise."""

import math

import numpy as np
import pytest

from fastcoil.measured import thresholds
from fastcoil.measured.fitted_loop import FittedLoop, Replay, ReplayInputs, evaluate_replay, fit_loop_model, what_if
from fastcoil.measured.fitted_plant import recover_pi

INTERVAL, STROKE = 15.0, 90.0


def simulate_day(
    hours=4, backlash=0.08, kp=0.03, ti=80.0, every=15, noise=0.01, sign=1.0, estimate=0.0, seed=3, swing=1.5,
    by_hand_from=math.inf,
):  # fmt: skip
    """A loop second by second, written here on its own: PI, inverse, motor, play, two lags, a drifting load.

    by_hand_from: s, from which on a triangle of ten minutes moves the valve in place of the controller.
    """
    draw = np.random.default_rng(seed)
    n = hours * 3600
    set_points = np.repeat(14.5 + draw.uniform(-swing, swing, hours * 2), 1800)
    load = np.cumsum(draw.normal(0.0, 0.003, n // 10)).repeat(10)
    white = draw.normal(0.0, noise, n)
    position = q = u = u_ext = command = integral = 0.5
    q *= 1.0 - backlash
    mode, metal, T = 1.0, 0.5, 24.0 - 18.0 * 0.5 * sign
    temperatures, commands, travel, errors = [], [], 0.0, []
    for t in range(n):
        y = T + load[t] + white[t]
        if t % every == 0:
            e = sign * (y - set_points[t])
            integral = min(max(integral + kp * every / ti * e, 0.0), 1.0)
            u = min(max(kp * e + integral, 0.0), 1.0)
            is_turning = mode * (u - u_ext) < -0.002
            mode = -mode if is_turning else mode
            if is_turning or mode * (u - u_ext) > 0.0:
                u_ext = u
                command = min(max((1.0 - estimate) * u + estimate * (mode > 0.0), 0.0), 1.0)
            command = u if estimate == 0.0 else command
        if t >= by_hand_from:
            command = 0.5 + 0.1 * (abs((t - by_hand_from) % 600 / 150 - 2.0) - 1.0)
        temperatures.append(y)
        commands.append(command)
        errors.append(T + load[t] - set_points[t])
        before = position
        position += min(max(command - position, -1.0 / STROKE), 1.0 / STROKE)
        travel += abs(position - before) * (t >= 1800)
        q = min(max(q, position - backlash), position)
        metal += (q / (1.0 - backlash) - metal) / 40.0
        T += (24.0 - 18.0 * metal * sign - 9.0 * (1.0 - sign) - T) / 20.0
    at = slice(None, None, int(INTERVAL))
    log = np.array(commands)[at], np.array(temperatures)[at], set_points[at]
    return log, float(np.sqrt(np.mean(np.square(errors[1800:])))), travel / (n - 1800) * 86400


@pytest.fixture(scope="module")
def logged():
    return simulate_day()


@pytest.fixture(scope="module")
def fitted(logged):
    fitted_loop = fit_loop_model(*logged[0], INTERVAL, 0.08, STROKE)
    assert isinstance(fitted_loop, FittedLoop)
    return fitted_loop


def test_controller_and_plant_are_found(fitted):
    assert fitted.pi.kp == pytest.approx(0.03, rel=0.03)
    assert fitted.pi.ti == pytest.approx(80.0, rel=0.03)
    assert fitted.pi.sample_time == 15.0
    assert fitted.plant.gain == pytest.approx(-18.0, rel=0.15)
    assert sum(fitted.plant.lags) + fitted.plant.delay * fitted.plant.step == pytest.approx(60.0, abs=12.0)
    assert fitted.pi.explained > 0.99
    assert 0.0 < fitted.plant.explained < 1.0


@pytest.mark.parametrize(
    ("changed", "truly"),
    [
        ({}, {}),
        ({"backlash": 0.0}, {"backlash": 0.0}),
        ({"kp_factor": 0.5}, {"kp": 0.015}),
        ({"ti_factor": 2.0}, {"ti": 160.0}),
        ({"estimate": 0.076, "buffer": 0.002}, {"estimate": 0.076}),
    ],
    ids=["as it is", "no gap", "half kp", "twice ti", "inverse"],
)
def test_what_is_foretold_is_what_happens(fitted, changed, truly):
    """On the same day of the loop simulated here; the log itself is repeated."""
    _, rmse, travel = simulate_day(**truly)
    outcome = what_if(fitted, **changed)
    assert outcome.rmse == pytest.approx(rmse, rel=0.1)
    assert outcome.travel_per_day == pytest.approx(travel, rel=0.15)
    assert not outcome.hunts


def test_a_loop_that_hunts_is_foretold_to_stop_with_a_slower_controller():
    log, rmse, travel = simulate_day(kp=0.05, ti=11.0, backlash=0.1)
    fitted_loop = fit_loop_model(*log, INTERVAL, 0.1, STROKE)
    as_it_is = what_if(fitted_loop)
    assert as_it_is.hunts
    assert as_it_is.rmse == pytest.approx(rmse, rel=0.1)
    assert as_it_is.travel_per_day == pytest.approx(travel, rel=0.1)
    assert 150.0 < as_it_is.period < 300.0
    calm = what_if(fitted_loop, kp_factor=0.5, ti_factor=5.0)
    _, rmse, travel = simulate_day(kp=0.025, ti=55.0, backlash=0.1)
    assert not calm.hunts
    assert calm.rmse == pytest.approx(rmse, rel=0.15)
    assert calm.travel_per_day == pytest.approx(travel, rel=0.3)
    assert travel < 0.2 * as_it_is.travel_per_day


def test_a_heating_loop_is_told_by_its_controller():
    log, rmse, _ = simulate_day(sign=-1.0)
    fitted_loop = fit_loop_model(*log, INTERVAL, 0.08, STROKE)
    assert fitted_loop.plant.gain > 0.0
    assert fitted_loop.pi.kp == pytest.approx(-0.03, rel=0.03)
    assert what_if(fitted_loop).rmse == pytest.approx(rmse, rel=0.1)


def test_missing_samples_and_a_plant_that_is_off_are_left_out(logged, fitted):
    command, T, T_set = (series.copy() for series in logged[0])
    T[100], command[300:303] = np.nan, np.nan
    enabled = np.ones(T.size, bool)
    enabled[600:700] = False
    T[600:700], command[600:700] = 21.0, 0.0
    fitted_loop = fit_loop_model(command, T, T_set, INTERVAL, 0.08, STROKE, enabled=enabled)
    assert fitted_loop.pi.kp == pytest.approx(fitted.pi.kp, rel=0.05)
    assert what_if(fitted_loop).rmse == pytest.approx(what_if(fitted).rmse, rel=0.2)


def test_where_the_valve_is_moved_by_hand_the_log_tells_of_the_plant_only():
    first = round(3 * 3600 / INTERVAL)
    (command, T, T_set), *_ = simulate_day(swing=0.0, backlash=0.0, by_hand_from=3 * 3600)
    before = fit_loop_model(command[:first], T[:first], T_set[:first], INTERVAL, 0.0, STROKE)
    fitted_loop = fit_loop_model(command, T, T_set, INTERVAL, 0.0, STROKE, by_hand=np.arange(T.size) >= first)
    assert fitted_loop.pi == before.pi
    assert fitted_loop.plant.gain == pytest.approx(-18.0, rel=0.1)
    assert abs(fitted_loop.plant.gain + 18.0) < abs(before.plant.gain + 18.0)
    by_hand = np.arange(fitted_loop.day.is_automatic.size) >= first * fitted_loop.plant.per_sample
    assert not fitted_loop.day.is_automatic[by_hand].any()
    assert fitted_loop.day.is_automatic[~by_hand][: -fitted_loop.plant.per_sample].all()
    assert isinstance(fit_loop_model(command[first:], T[first:], T_set[first:], INTERVAL, 0.0, STROKE), str)


def test_a_command_that_is_not_the_pi_s_is_refused(logged):
    command, T, T_set = logged[0]
    assert "no sample" in fit_loop_model(command, np.full(T.size, np.nan), T_set, INTERVAL, 0.08, STROKE)
    assert "changes only 0 times" in fit_loop_model(np.full(T.size, 0.4), T, T_set, INTERVAL, 0.08, STROKE)
    assert "every 60 s" in fit_loop_model(command, T, T_set, 60.0, 0.08, STROKE)
    walk = 0.5 + 0.3 * np.sin(np.arange(T.size) / 9.0)
    assert "another control law" in fit_loop_model(walk, T, T_set, INTERVAL, 0.08, STROKE)
    inverse, _, _ = simulate_day(estimate=0.076)
    assert "an inverse" in fit_loop_model(*inverse, INTERVAL, 0.08, STROKE)


@pytest.mark.parametrize("bound", ["LARGEST_ERROR_LOG_RATIO", "LARGEST_TRAVEL_LOG_RATIO"])
def test_a_replay_that_does_not_repeat_the_log_is_refused(logged, monkeypatch, bound):
    monkeypatch.setattr(thresholds, bound, 0.0)
    assert "does not reproduce the log" in fit_loop_model(*logged[0], INTERVAL, 0.08, STROKE).doubt


@pytest.mark.parametrize(("every", "estimate"), [(5, 7.5), (30, 30.0)])
def test_a_controller_may_sample_faster_or_slower_than_the_log(every, estimate):
    """Faster ones show no sample time of theirs; given it, kp and ti are theirs."""
    (command, T, T_set), _, _ = simulate_day(every=every, hours=3, noise=0.002)
    good = np.ones(T.size, bool)
    pi = recover_pi(command, T, T_set, INTERVAL, good, None)
    assert pi.sample_time == estimate
    pi = recover_pi(command, T, T_set, INTERVAL, good, float(every))
    assert pi.kp == pytest.approx(0.03, rel=0.04)
    assert pi.ti == pytest.approx(80.0, rel=0.04)


def test_noise_is_told_from_a_drift():
    draw = np.random.default_rng(5)
    walk, white = np.cumsum(draw.normal(0.0, 0.01, 4000)), draw.normal(0.0, 0.05, 4000)
    smooth, level = remove_noise(walk + white, np.ones(4000, bool))
    assert level == pytest.approx(0.05, rel=0.1)
    assert np.std(smooth - walk) < 0.4 * 0.05
    assert remove_noise(walk, np.ones(4000, bool))[1] < 0.006


def test_outcome_has_the_meanings_of_the_metrics():
    n, step = 7200, 5.0
    t = np.arange(n) * step
    T_set = np.where(t < 18000.0, 14.0, 15.0)
    error = 0.3 * np.sin(2.0 * math.pi * t / 250.0)
    opening = 0.5 + 0.05 * np.sin(2.0 * math.pi * t / 250.0)
    log = ReplayInputs(np.zeros(n), np.zeros(n), T_set, opening, np.ones(n, bool))
    outcome = evaluate_replay(Replay(T_set + error, opening, opening, opening), log, step)
    assert outcome.rmse == pytest.approx(0.3 / math.sqrt(2.0), rel=1e-3)
    assert outcome.amplitude == pytest.approx(0.3, rel=1e-2)
    assert outcome.period == pytest.approx(250.0, rel=0.02)
    assert outcome.travel_per_day == pytest.approx(0.2 * 86400 / 250.0, rel=0.02)
    assert outcome.reversals_per_day == pytest.approx(2 * 86400 / 250.0, rel=0.02)
    assert outcome.hunts
    assert not evaluate_replay(Replay(T_set + 0.15 * error, opening, opening, opening), log, step).hunts


def test_a_verdict_that_turns_on_a_little_gain_is_a_sentence(fitted, monkeypatch):
    """Between a kp at which the loop is calm and one at which it hunts lies one of which nothing is said."""
    factors = np.geomspace(0.5, 5.0, 9)
    outcomes = [what_if(fitted, kp_factor=factor, ti_factor=0.3) for factor in factors]
    kinds = ["a sentence" if isinstance(outcome, str) else outcome.hunts for outcome in outcomes]
    assert kinds[0] is False
    assert kinds[-1] is True
    assert "a sentence" in kinds
    monkeypatch.setattr(thresholds, "LARGEST_ERROR_RATIO", 1e9)
    factor = float(factors[kinds.index("a sentence")])
    assert "whether the loop hunts" in what_if(fitted, kp_factor=factor, ti_factor=0.3)
    monkeypatch.setattr(thresholds, "LARGEST_ERROR_RATIO", 1.0)
    assert "decides between control errors of" in what_if(fitted, kp_factor=0.5)
