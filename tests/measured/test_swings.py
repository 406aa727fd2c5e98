"""Swings with their clock times: closed forms of sines on still and moving set-points, steps and ramps."""

import numpy as np
import pytest

from fastcoil.measured.air_handler.hunting import blame_swing
from fastcoil.measured.air_handler.series import AirHandlerSeries
from fastcoil.measured.clock import describe_times
from fastcoil.measured.grid import Grid
from fastcoil.measured.swings import find_swings, judge_gains

INTERVAL = 60.0
TIME = np.arange(0.0, 10 * 3600.0, INTERVAL)
GOOD = np.ones(TIME.size, dtype=bool)


def sine(size, period, first=2.0, last=8.0):
    """A sine between two hours, 0 before and after."""
    hours = TIME / 3600.0
    return np.where((hours >= first) & (hours < last), size * np.sin(2.0 * np.pi * TIME / period), 0.0)


@pytest.mark.parametrize("minutes", [8.0, 15.0, 48.0])
def test_a_sine_is_found_with_its_size_period_and_times(minutes):
    [window] = find_swings(15.0 + sine(1.5, 60.0 * minutes), GOOD, INTERVAL)
    assert window.peak_to_peak == pytest.approx(3.0, rel=0.12)
    assert window.period == pytest.approx(60.0 * minutes, rel=0.05)
    assert TIME[window.first] / 3600.0 == pytest.approx(2.0, abs=0.5 * minutes / 60.0)
    assert TIME[window.end - 1] / 3600.0 == pytest.approx(8.0, abs=0.5 * minutes / 60.0)


def test_a_swing_on_a_moving_set_point_is_found():
    T = 20.0 - 4.0 * np.sin(2.0 * np.pi * TIME / 36000.0) + sine(1.5, 900.0)
    [window] = find_swings(T, GOOD, INTERVAL)
    assert window.peak_to_peak == pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize("T", [
    15.0 + 3.0 * (TIME > 3600.0) - 5.0 * (TIME > 20000.0),  # steps
    15.0 + TIME / 3600.0,  # a ramp
    15.0 + sine(0.6, 1200.0),  # as much as loads and mixing make
    15.0 + sine(3.0, 1200.0, 2.0, 2.9),  # fewer than three cycles
    15.0 + np.random.default_rng(2).normal(0.0, 0.1, TIME.size),
], ids=["steps", "ramp", "small", "short", "noise"])  # fmt: skip
def test_what_is_no_swing_is_not_called_one(T):
    assert find_swings(T, GOOD, INTERVAL) == []


def test_a_pause_of_the_log_ends_a_swing():
    good = (TIME < 4.9 * 3600.0) | (TIME > 5.1 * 3600.0)
    assert len(find_swings(15.0 + sine(1.5, 900.0), good, INTERVAL)) == 2


def blame(T, command, T_set=np.nan):
    series = {"T_sup": T, "cooling_command": command, "T_set": np.broadcast_to(T_set, T.shape)}
    unit = AirHandlerSeries("", Grid(INTERVAL, TIME, series, GOOD, 0.0), None)
    return [blame_swing(unit, window) for window in find_swings(T, GOOD, INTERVAL)]


def test_a_swing_is_the_valves_only_where_its_command_moves_with_it():
    T, late = 15.0 + sine(1.5, 900.0), 200.0
    follows = 0.4 + 0.1 * sine(1.0, 900.0)
    assert blame(T, follows) == ["cooling"]
    for command in (np.full(TIME.size, 0.4), 0.4 + 0.1 * sine(1.0, 120.0), 0.4 + TIME / 1e5):
        assert blame(T, command) == ["water"]
    assert blame(T, follows, 15.0 + 1.4 * np.sin(2.0 * np.pi * (TIME - late) / 900.0)) == [""]


def test_a_swing_that_is_sampled_too_rarely_is_found_on_demand():
    T, good = (15.0 + sine(1.5, 1000.0))[::11], GOOD[::11]
    assert find_swings(T, good, 660.0) == []
    [window] = find_swings(T, good, 660.0, fewest_samples=0.0)
    assert window.peak_to_peak == pytest.approx(3.0, rel=0.2)


def test_the_integral_is_blamed_where_it_prevails_at_the_period():
    fault = judge_gains(0.02, 10.0, 1800.0)  # 1800 / (2 pi 10) = 29 times the proportional action
    assert (fault.cause, fault.kp, fault.ti) == ("integral", 0.02, 450.0)
    fault = judge_gains(0.02, 90.0, 1800.0)  # 3.2 times: a gap of the valve may do it as well
    assert (fault.cause, fault.kp, fault.ti) == ("integral_or_gap", 0.02, 450.0)
    fault = judge_gains(0.08, 1900.0, 3000.0)  # 0.25 times
    assert (fault.cause, fault.kp, fault.ti) == ("gain", 0.04, 1900.0)
    assert judge_gains(0.04, 150.0, 900.0).cause == "unknown"  # 0.95 times


def test_times_are_clock_times_of_a_day_and_days_of_many():
    start = np.datetime64("2026-03-30T06:00:00")
    assert describe_times([(0.0, 3500.0), (7200.0, 64800.0)], start, 1) == "6:00–7:00, 8:00–24:00"
    spans = [(0.0, 3600.0), (86400.0, 90000.0), (3 * 86400.0, 3 * 86400.0 + 60.0)]
    assert describe_times(spans, start, 9) == "on 3 of 9 days (03-30, 31; 04-02)"
    assert describe_times([(900.0, 5400.0)], None, 1) == "0.25 h–1.5 h"
    assert (
        describe_times([(0.0, 600.0), (1200.0, 3600.0)], start, 1) == "6:00–7:00"
    )  # a short pause is not worth saying
