"""What every hour of a log was like: made-up logs of each state, at several intervals; what the headline says."""

import numpy as np
import pytest
import xarray as xr
from helpers.loop_logs import make_loop_log
from helpers.sentences import assert_worded

import fastcoil as fc
from fastcoil.measured.triage import HOURLY_VARIABLES, STATES

pytestmark = pytest.mark.kernel

INTERVALS = (10.0, 60.0, 300.0, 900.0)


def make_log(interval=60.0, hours=10.0, T_a_in=None, enabled=None, **signals):
    """A cooling log of constants or functions of hours: command 0.4, T_sup = T_set = 14 °C, unless given."""
    time = np.arange(0.0, hours * 3600.0, interval)
    noise = np.random.default_rng(1).normal(0.0, 0.03, time.size)
    values = {"command": 0.4, "T_sup": 14.0, "T_set": 14.0} | signals
    values |= {name: signal for name, signal in (("T_a_in", T_a_in), ("enabled", enabled)) if signal is not None}
    units = {"command": "1", "enabled": "1"}
    log = xr.Dataset(coords={"elapsed_time": ("elapsed_time", time, {"units": "s"})})
    for name, signal in values.items():
        series = np.broadcast_to(signal(time / 3600.0) if callable(signal) else signal, time.shape)
        series = series + noise if name == "T_sup" else np.clip(series, 0.0, 1.0) if name == "command" else series
        log[name] = ("elapsed_time", series.astype(float), {"units": units.get(name, "degC")})
    return log


def hour_states(diagnosis):
    return diagnosis.triage.state.values.tolist()


def sine_wave(size, minutes, about=14.0, late=0.0):
    return lambda h: about + size * np.sin(2.0 * np.pi * (60.0 * h - late) / minutes)


@pytest.mark.parametrize("interval", INTERVALS)
def test_a_good_loop_is_in_control_and_has_no_warnings(interval):
    diagnosis = fc.diagnose(make_loop_log(hours=10.0, steps=False, interval=interval), stroke_time=90.0)
    assert not diagnosis.warnings
    assert set(hour_states(diagnosis)) <= {"in control", "holding"}
    assert diagnosis.summary()[1] == diagnosis.headline
    assert_worded(diagnosis.headline)
    assert bool(diagnosis.triage.log_limits.values[3]) == (interval > 60.0)


FAULTS = {
    "no water": ({"command": 1.0, "T_sup": 19.2}, "open, not met"),
    "stuck shut": ({"command": 1.0, "T_sup": 19.2, "T_a_in": 19.5}, "not responding"),
    "shut": ({"command": 0.0, "T_sup": 8.0}, "shut"),
    "leak": ({"command": 0.0, "T_sup": 8.0, "T_a_in": 16.0}, "not responding"),
    "leak, air changes": ({"command": 0.0, "T_sup": sine_wave(2, 360, 8), "T_a_in": sine_wave(2, 360, 16)},
                          "not responding"),
    "tight, fan heat": ({"command": 0.0, "T_sup": 8.0, "T_a_in": 7.0}, "shut"),
    "stuck half open": ({"command": lambda h: 0.3 + 0.3 * (h % 2.0), "T_sup": 16.5, "T_a_in": 25.0}, "not responding"),
    "by hand": ({"T_sup": 17.0}, "off set-point"),
    "heating, no water": ({"command": 1.0, "T_sup": 9.0, "T_a_in": 8.6}, "not responding"),
}  # fmt: skip


@pytest.mark.parametrize("interval", INTERVALS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_has_its_state_and_its_sentence(fault, interval):
    signals, state = FAULTS[fault]
    diagnosis = fc.diagnose(make_log(interval, **signals))
    assert set(hour_states(diagnosis)[1:]) == {state}
    assert bool(diagnosis.warnings) == (state != "shut")
    assert (diagnosis.triage.attrs["cools"] == -1.0) == fault.startswith("heating")
    assert_worded(diagnosis.headline)


@pytest.mark.parametrize("interval", INTERVALS)
@pytest.mark.parametrize("by", ["enabled", "T_set"])
def test_hours_in_which_the_plant_is_off_do_not_count(interval, by):
    log = make_log(interval, hours=24.0, T_sup=lambda h: np.where((h >= 6) & (h < 18), 14.0, 24.0))
    is_running = (log.elapsed_time >= 6 * 3600.0) & (log.elapsed_time < 18 * 3600.0)
    column = is_running.astype(float) if by == "enabled" else log.T_set.where(is_running)
    log = log.assign({by: column.assign_attrs(units={"enabled": "1", "T_set": "degC"}[by])})
    diagnosis = fc.diagnose(fc.read_log(log, drop=by == "T_set"))
    assert hour_states(diagnosis) == ["off"] * 6 + ["holding"] * 12 + ["off"] * 6
    assert diagnosis.headline.startswith("12 of 12 h in control")
    assert not diagnosis.warnings


def test_a_start_up_is_no_fault_and_ends_when_the_set_point_is_met():
    log = make_log(hours=12.0, enabled=lambda h: (h >= 5.0) * 1.0, command=lambda h: np.where(h < 5.75, 1.0, 0.4),
                  T_sup=lambda h: np.where(h < 5.75, 20.0, 14.0))  # fmt: skip
    diagnosis = fc.diagnose(log)
    assert hour_states(diagnosis) == ["off"] * 5 + ["start-up"] + ["holding"] * 6
    assert not diagnosis.warnings


@pytest.mark.parametrize(("interval", "minutes"), [(10.0, 12.0), (60.0, 12.0), (300.0, 40.0), (900.0, 80.0)])
def test_a_swing_has_its_size_and_period(interval, minutes):
    command = sine_wave(0.2, minutes, 0.5, minutes / 6)
    diagnosis = fc.diagnose(make_log(interval, T_sup=sine_wave(1.6, minutes), command=command))
    assert set(hour_states(diagnosis)) == {"swinging"}
    assert diagnosis.headline.startswith("10 of 10 h: T_sup swings ± 1.")
    assert f"K about every {minutes:.0f} min" in diagnosis.headline or interval == 900.0
    assert float(diagnosis.triage.swing.median()) == pytest.approx(3.2, rel=0.15)
    assert float(diagnosis.triage.period.median()) == pytest.approx(60.0 * minutes, rel=0.1)
    assert "unevenly" not in diagnosis.headline


def test_a_loop_from_end_to_end_swings_and_is_not_saturated_in_a_coarse_log():
    diagnosis = fc.diagnose(make_loop_log(hours=8.0, kp=0.09, ti=15.0, steps=False, interval=300.0))
    assert set(hour_states(diagnosis)) == {"swinging"}
    assert " min or faster" in diagnosis.headline


def test_an_uneven_swing_is_told_as_one():
    walk = np.cumsum(np.random.default_rng(2).uniform(4.0, 24.0, 600)) / 60.0

    def T(h):
        k = np.searchsorted(walk, h)
        return 14.0 + 1.5 * np.where(k % 2, 1.0, -1.0)

    assert "unevenly" in fc.diagnose(make_log(T_sup=T, command=sine_wave(0.2, 30.0, 0.5))).headline


def test_a_command_that_stays_shut_against_a_call_is_named():
    def command(h):
        return np.where(h < 3.0, 0.4 + 0.1 * np.sin(20.0 * h), 0.0)

    locked = fc.diagnose(make_log(command=command, T_sup=lambda h: np.where(h < 3.0, 14 + np.sin(20 * h + 0.5), 18.0)))
    assert hour_states(locked)[4:] == ["shut, not met"] * 6
    assert_worded(locked.headline)


def test_without_a_set_point_swings_and_ends_still_show():
    diagnosis = fc.diagnose(make_log(T_sup=sine_wave(1.0, 15.0), command=sine_wave(0.2, 15.0, 0.5)).drop_vars("T_set"))
    assert "T_sup swings ± 1 K about every 15 min" in diagnosis.headline
    assert "T_set is not logged" in diagnosis.triage.log_limits.values[0]
    assert np.isnan(diagnosis.triage.error).all()
    calm = fc.diagnose(make_log().drop_vars("T_set"))
    assert "no fault found; without T_set the control error is unknown" in calm.headline


def test_a_clock_that_is_set_back_to_before_the_first_sample_gives_hours_before_it():
    log = make_log(hours=4.0)
    seconds = log.elapsed_time + np.where(log.elapsed_time < 2 * 3600.0, 10 * 3600.0, 0.0)
    log = log.assign_coords(elapsed_time=("elapsed_time", seconds.values, {"units": "s"}))
    diagnosis = fc.diagnose(fc.read_log(log, jumps="split"))
    assert diagnosis.triage.hour.values.tolist() == [-8, -7, 0, 1]
    assert hour_states(diagnosis) == ["holding"] * 4


def test_the_table_has_units_and_the_hours_of_every_log():
    swinging = make_log(hours=4.0, T_sup=sine_wave(1.6, 12.0), command=sine_wave(0.2, 12.0, 0.5))
    diagnosis = fc.diagnose([make_log(hours=5.5), swinging])
    table = diagnosis.triage
    assert table.hour.values.tolist() == list(range(10))
    assert hour_states(diagnosis) == ["holding"] * 6 + ["swinging"] * 4
    assert set(hour_states(diagnosis)) <= set(STATES)
    assert diagnosis.headline.endswith("on 1 of 2 days (day 2).")
    for name in HOURLY_VARIABLES:
        assert table[name].dims == ("hour",)
        assert table[name].attrs.keys() == {"units", "long_name"}
    assert len(diagnosis.plot().axes) == 5
    assert "Hour by hour" in [axes.get_title(loc="left") for axes in diagnosis.plot().axes]
