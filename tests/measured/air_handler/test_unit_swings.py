"""Swings of an air handler: whose they are, when, how large, and why; gains of a PI recovered from its own command."""

import numpy as np
import pytest
from helpers.air_handler_logs import kinds_of, make_unit_log

import fastcoil as fc
from fastcoil.logs.air_handler import read_air_handler
from fastcoil.measured.air_handler.hunting import recover_gains
from fastcoil.measured.air_handler.series import AirHandlerSeries
from fastcoil.measured.grid import resample_log
from fastcoil.measured.swings import find_swings

MINUTES = 15.0


def wave(size, minutes=MINUTES, first=9.0, last=16.0, late=0.0):
    """A sine between two hours of each day, 0 elsewhere."""

    def signal(h):
        is_in = (h % 24 >= first) & (h % 24 < last)
        return np.where(is_in, size * np.sin(2.0 * np.pi * (60.0 * h - late) / minutes), 0.0)

    return signal


def series_of(frame):
    data, _ = read_air_handler(fc.read_log(frame))
    return AirHandlerSeries(data.name, resample_log(data)[0], data.start)


def test_hunting_is_named_with_its_valve_times_size_and_rhythm():
    [finding] = fc.inspect(make_unit_log(1.0, cooling=lambda h: 0.4 + wave(0.15)(h))).findings
    assert (finding.component, finding.kind) == ("cooling valve", "hunt")
    assert finding.size == pytest.approx(0.15 * 14.0, rel=0.1)
    [(first, last)] = finding.windows
    assert abs(first - np.datetime64("2026-03-02T09:00")) <= np.timedelta64(15, "m")
    assert abs(last - np.datetime64("2026-03-02T16:00")) <= np.timedelta64(15, "m")
    assert "every 15 min" in finding.text
    assert "9:00–16:00" in finding.text


def test_a_swing_on_a_moving_set_point_is_hunting_where_the_valve_makes_it():
    T_set = lambda h: 14.0 + 3.0 * np.sin(h / 4.0)  # noqa: E731
    log = make_unit_log(1.0, cooling=lambda h: 0.3 - 0.2 * np.sin(h / 4.0) + wave(0.15)(h), T_set=T_set)
    assert ("cooling valve", "hunt") in kinds_of(fc.inspect(log))


def test_a_set_point_that_swings_is_named_and_not_the_valve():
    T_set = lambda h: 14.0 + wave(2.0, 45.0)(h)  # noqa: E731
    log = make_unit_log(1.0, cooling=lambda h: (18.0 - T_set(h)) / 14.0, T_set=T_set)
    assert kinds_of(fc.inspect(log)) == [("set-point", "set_point_swings")]


def test_a_swing_that_no_valve_makes_comes_from_air_or_water():
    air = make_unit_log(1.0, cooling=0.3, T_mixed=lambda h: 18.0 + wave(1.5)(h))
    assert kinds_of(fc.inspect(air)) == [("entering air", "swings")]
    water = make_unit_log(1.0, cooling=0.3)
    water["AHU-3 Supply Air Temp"] += wave(1.5)(np.arange(1440) / 60.0)
    assert kinds_of(fc.inspect(water)) == [("water", "swings")]


def test_hunting_beside_a_valve_that_passes_is_blamed_on_that_valve():
    log = make_unit_log(1.0, heating=lambda h: 0.2 + wave(0.12)(h), leak=(0.6, 0.0))
    findings = {finding.kind: finding for finding in fc.inspect(log).findings}
    assert findings["hunt"].component == "heating valve"
    assert findings["hunt"].cause == "other_valve"
    assert findings["leak"].component == "cooling valve"


def test_a_valve_that_shuts_in_every_cycle_has_too_high_a_gain_at_that_load():
    log = make_unit_log(1.0, cooling=lambda h: np.maximum(0.05 + wave(0.3)(h), 0.0))
    [finding] = fc.inspect(log).findings
    assert finding.cause == "load"
    assert "shuts in 100 % of the cycles" in finding.action


def test_swings_below_the_usual_command_alone_are_of_the_load():
    # calm at 60 % by day, swinging at 30 % in the evening
    cooling = lambda h: np.where(h % 24 < 14, 0.6, 0.3) + wave(0.15, first=14.0, last=23.0)(h)  # noqa: E731
    [finding] = fc.inspect(make_unit_log(2.0, cooling=cooling)).findings
    assert finding.cause == "load"
    assert "half hours" in finding.action


@pytest.mark.parametrize(
    ("kp", "ti", "cause"), [(0.05, 1500.0, "gain"), (0.02, 30.0, "integral_or_gap"), (0.01, 10.0, "integral")]
)
def test_the_gains_of_a_pi_are_recovered_from_its_command(kp, ti, cause):
    """u = kp (e + integral of e over Ti) of a sine of 15 min, in closed form."""
    omega, size = 2.0 * np.pi / (60.0 * MINUTES), 1.5
    seconds = 60.0 * np.arange(1440)
    e = size * np.sin(omega * seconds)
    u = 0.5 + kp * (e - size / (ti * omega) * np.cos(omega * seconds))
    log = make_unit_log(1.0, noise=0.0, T_set=14.0)
    log["AHU-3 Supply Air Temp"], log["AHU-3 CHW Valve"] = 14.0 + e, u
    series = series_of(log)
    [window] = find_swings(series.T_sup, series.on, series.interval)
    assert recover_gains(series, "cooling", window) == pytest.approx((kp, ti), rel=0.05)
    assert [finding.cause for finding in fc.inspect(log).findings if finding.kind == "hunt"] == [cause]


def test_gains_are_not_recovered_from_a_command_that_does_not_answer_the_error():
    log = make_unit_log(1.0, noise=0.0, T_set=14.0)
    hours = np.arange(1440) / 60.0
    log["AHU-3 Supply Air Temp"] = 14.0 + wave(1.5, first=0.0, last=24.0)(hours)
    log["AHU-3 CHW Valve"] = 0.5 + wave(0.2, 13.0, first=0.0, last=24.0)(hours)
    series = series_of(log)
    [window] = find_swings(series.T_sup, series.on, series.interval)
    assert recover_gains(series, "cooling", window) is None
