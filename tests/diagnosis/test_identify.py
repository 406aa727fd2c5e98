"""Backlash from a trend log: found where the log can tell it, never claimed where it cannot."""

import numpy as np
import pytest

from fastcoil.diagnosis.identify import CANDIDATES, GOOD, _held, _is_provoked, _judged, identify_backlash
from fastcoil.diagnosis.likelihood import Likelihood
from fastcoil.diagnosis.motion import motor_positions, openings, turns

INTERVAL = 10.0


def plant(command, backlash, noise=0.01, seed=0, gain=-20.0, tau=90.0, stroke_time=90.0):
    """A first-order plant behind motor and play, written here step by step."""
    draw = np.random.default_rng(seed)
    position = q = float(command[0])
    q *= 1.0 - backlash
    T, drift, found = 24.0 + gain * q / (1.0 - backlash), 0.0, []
    for target in command:
        found.append(T + noise * draw.standard_normal())
        step = INTERVAL / stroke_time
        position += min(max(target - position, -step), step)
        q = min(max(q, position - backlash), position)
        drift += 0.002 * draw.standard_normal()
        T += (24.0 + drift + gain * q / (1.0 - backlash) - T) * INTERVAL / tau
    return np.array(found)


def steps(hours=6, seed=1):
    """A command that steps up and down every 10 min, and set-points that say so."""
    draw = np.random.default_rng(seed)
    levels = draw.uniform(0.2, 0.8, hours * 6)
    command = np.repeat(levels, int(600 / INTERVAL))
    return command, 24.0 - 20.0 * command


@pytest.mark.parametrize("backlash", [0.0, 0.02, 0.063, 0.15])
def test_the_true_backlash_is_found_claimed_and_covered(backlash):
    command, T_set = steps()
    found = identify_backlash(command, plant(command, backlash), INTERVAL, T_set)
    assert found.identified
    assert not found.reason
    assert found.backlash == pytest.approx(backlash, abs=0.005)
    assert found.low <= backlash <= found.high
    assert found.probability.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("stroke_time", [None, 45.0, 0.0])
def test_the_stroke_time_need_not_be_known(stroke_time):
    command, T_set = steps()
    found = identify_backlash(command, plant(command, 0.05, stroke_time=60.0), INTERVAL, T_set, stroke_time=stroke_time)
    assert found.identified
    assert found.backlash == pytest.approx(0.05, abs=0.01)


def test_resolution_of_command_and_sensor_does_no_harm():
    command, T_set = steps()
    command, T = np.round(command, 2), np.round(plant(np.round(command, 2), 0.06), 1)
    found = identify_backlash(command, T, INTERVAL, T_set)
    assert found.identified
    assert found.backlash == pytest.approx(0.06, abs=0.012)


def test_gaps_and_times_off_are_left_out():
    command, T_set = steps()
    T = plant(command, 0.08)
    enabled = np.ones(T.size, bool)
    enabled[700:900] = False
    T[700:900] = 35.0  # the fan stands still
    T[300:305] = np.nan
    command[1200:1203] = np.nan
    found = identify_backlash(command, T, INTERVAL, T_set, enabled=enabled)
    assert found.identified
    assert found.backlash == pytest.approx(0.08, abs=0.01)
    assert not identify_backlash(command, T, INTERVAL, T_set, enabled=np.zeros(T.size, bool)).identified


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"interval": 60.0}, "every 30 s or faster"),
        ({"command": np.linspace(0.2, 0.8, 2160)}, "never turns back"),
        ({"command": np.full(2160, 0.5)}, "never turns back"),
        ({"temperature": np.full(2160, 14.0)}, "too little"),
        ({"temperature": np.full(2160, np.nan)}, "no sample"),
    ],
)
def test_what_cannot_tell_says_why(change, says):
    command, T_set = steps()
    given = {"command": command, "temperature": plant(command, 0.05), "interval": INTERVAL, "T_set": T_set} | change
    found = identify_backlash(**given)
    assert not found.identified
    assert says in found.reason
    assert (found.low, found.high) == (0.0, 0.25)


def test_no_relation_between_command_and_temperature_is_not_claimed():
    command, T_set = steps()
    claimed = [
        identify_backlash(command, 14.0 + np.cumsum(draw.normal(0, 0.02, command.size)), INTERVAL, T_set).identified
        for draw in map(np.random.default_rng, range(20))
    ]
    assert sum(claimed) <= 1


def test_a_stuck_stem_under_a_command_that_follows_the_temperature_is_not_called_good():
    """The temperature wanders by itself; the command follows its noise and drift, the stem never moves."""
    for seed in range(8):
        draw = np.random.default_rng(seed)
        true = 14.0 + np.convolve(np.cumsum(draw.normal(0, 0.01, 2400)), np.ones(30) / 30, "same")[:2160]
        T = true + draw.normal(0, 0.03, true.size)
        command = np.clip(0.5 + 0.03 * (T - T.mean()) + 0.0005 * np.cumsum(T - T.mean()), 0.0, 1.0)
        found = identify_backlash(command, T, INTERVAL, np.full(T.size, 14.0))
        assert not (found.identified and found.backlash <= GOOD)
        assert not identify_backlash(command, T, INTERVAL).identified


def test_openings_are_those_of_the_play_operator():
    command = np.random.default_rng(3).uniform(0, 1, 400)
    positions = motor_positions(command, 0.1)
    assert np.all(np.abs(np.diff(positions)) <= 0.1 + 1e-12)
    candidates = np.array([0.0, 0.07])
    found = openings(positions, candidates)
    q = positions[0] - 0.035
    for k, position in enumerate(positions):
        q = min(max(q, position - 0.07), position)
        assert found[k, 1] == pytest.approx(q / 0.93, abs=1e-12)
    np.testing.assert_array_equal(found[:, 0], positions)


def test_turns_count_what_comes_back_by_more_than_asked():
    assert turns(np.array([0.0, 0.5, 0.3, 0.6, 0.599, 0.7]), 0.01) == 2
    assert turns(np.linspace(0.0, 1.0, 50), 0.01) == 0


def test_a_good_valve_is_claimed_only_if_something_else_than_the_temperature_moved_the_command():
    sharp = -((CANDIDATES / 0.001) ** 2)
    found = {provoked: _judged(Likelihood(sharp, sharp, 900), provoked) for provoked in (True, False)}
    assert found[True].identified
    assert not found[False].identified
    assert "stuck stem" in found[False].reason
    assert (found[False].low, found[False].high) == (0.0, 0.25)
    worn = -(((CANDIDATES - 0.08) / 0.001) ** 2)
    assert _judged(Likelihood(sharp, worn, 900), provoked=False).backlash == pytest.approx(0.08)


def test_set_points_or_jumps_of_the_command_provoke_and_one_start_up_does_not():
    command, T_set = steps()
    good = np.ones(command.size, bool)
    noise = np.random.default_rng(1).normal(0, 0.002, command.size)
    assert _is_provoked(noise, good, T_set, INTERVAL)
    assert not _is_provoked(noise, good, np.full(command.size, 14.0), INTERVAL)
    twenty_minutes = np.repeat(command, 2)[: command.size]
    assert _is_provoked(twenty_minutes + noise, good, None, INTERVAL)
    start_up = np.where(np.arange(command.size) < 3, 0.0, 0.5) + noise
    assert not _is_provoked(start_up, good, None, INTERVAL)


def test_a_missing_command_is_the_last_before_it():
    given = np.array([np.nan, 0.2, np.nan, np.nan, 0.4, np.nan])
    np.testing.assert_array_equal(_held(given), [0.2, 0.2, 0.2, 0.2, 0.4, 0.4])
