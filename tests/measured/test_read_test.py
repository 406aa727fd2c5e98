"""``fc.read_test``: the gap, the plant and the cause from the log of a valve test, and what it refuses."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.full import full_except
from helpers.loop_logs import make_loop_log
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.measured.cause import CAUSE_DISTURBANCE, CAUSE_NONE, CAUSE_TUNING, Cause, revise_after_hold, stops_on_hold
from fastcoil.measured.measures import NO_SWING, Measures, Swing
from fastcoil.measured.read_test import rests_as_in_test, stem_places

pytestmark = pytest.mark.kernel
START, MINUTES, STEP = 5400, 30, 10
LOOP = {"kp": 0.03, "ti": 60.0, "sample_time": 5, "stroke_time": 90.0, "noise_std": 0.02}


@pytest.fixture(scope="module")
def logs():
    """Logs of three loops under test, by the size of their gap."""
    day = fc.Boundary(**{**fc.paper_day(hours=3, seed=3).series, "T_set": 14.0}).isel(0)
    loop = fc.Loop.preset("lbnl").assign(**LOOP, backlash=[0.0, 0.03, 0.08])
    test = fc.ValveTest(start=START, minutes=MINUTES)
    ds = fc.simulate(loop, day, test=test, traces=["command", "T_measured", "test"], trace_interval=STEP)
    ds["T_set"] = ("elapsed_time", np.full(ds.sizes["elapsed_time"], 14.0), {"units": "degC"})
    return {float(size): ds.sel(backlash=size) for size in ds.backlash.values}


@pytest.fixture(scope="module")
def readings(logs):
    return cache(lambda size: fc.read_test(logs[size], stroke_time=90))


@pytest.fixture(scope="module")
def reading(readings):
    return readings(0.08)


@pytest.fixture(scope="module")
def early(logs):
    """What is read in the first four minutes of a test."""
    return fc.read_test(logs[0.08], between=(START, START + 240))


@pytest.mark.parametrize("size", full_except([0.0, 0.03, 0.08], [0.0, 0.08]))
def test_the_gap_is_right_and_its_interval_holds_it(readings, size):
    r = readings(size)
    assert r.identified
    assert r.reason == ""
    assert abs(r.backlash - size) <= max(0.2 * size, 0.01)
    assert r.interval[0] <= size <= r.interval[1] < size + 0.03
    assert float(r.profile.probability.sum()) == pytest.approx(1.0)


@pytest.mark.parametrize("size", full_except([0.0, 0.03, 0.08], [0.08]))
def test_gain_and_lag_are_those_of_the_plant(readings, size):
    """Of a step of the valve in open loop, where the test has it, with the air and water of its middle."""
    r = readings(size)
    day = fc.paper_day(hours=3, seed=3)
    still = {name: np.full(3600, values[0, START + 900]) for name, values in day.series.items()}
    steps = np.where(np.arange(3600) < 1800, 0.26, 0.30)
    loop = fc.Loop.preset("lbnl").assign(backlash=0.0, stroke_time=0.0)
    T = fc.simulate(loop, fc.Boundary(**still), command=steps, traces=["T_measured"], warm_up=60).T_measured.values
    lag = float(np.trapezoid(T[1799:] - T[-1])) / (T[1799] - T[-1])
    assert r.gain == pytest.approx((T[-1] - T[1799]) / 0.04, rel=0.3)
    assert r.lag + r.dead_time == pytest.approx(lag, rel=0.3)


def test_a_csv_file_and_the_time_of_the_test_give_the_same(logs, reading, tmp_path):
    log = logs[0.08]
    table = np.stack([log.elapsed_time, log.command, log.T_measured, log.T_set], axis=1)
    path = tmp_path / "log.csv"
    head = "elapsed_time [s],command [1],T_sup [degC],T_set [degC]"
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.9g")
    test_times = log.elapsed_time.values[log.test.values > 0]
    of_file = fc.read_test(path, stroke_time=90, between=(float(test_times[0]), float(test_times[-1])))
    assert (of_file.backlash, of_file.interval) == (reading.backlash, reading.interval)


def test_a_log_without_a_readable_test_is_refused(logs):
    log = logs[0.08]
    assert_refused("between", "missing", fc.read_test, log.drop_vars("test"))
    assert_refused("test", "data", fc.read_test, log.assign(test=0 * log.test))
    assert_refused("log", "time", fc.read_test, log.isel(elapsed_time=slice(None, None, 3)))
    assert_refused("T_sup", "data", fc.read_test, log.assign(T_measured=log.T_measured * 0.0 + 14.0))
    assert_refused("stroke_time", "value", fc.read_test, log, -1)
    for between, code in (((6000, 5000), "value"), ((5400, 90000), "value"), ((5401, 5409), "data"), (5, "type")):
        assert_refused("between", code, fc.read_test, log, between=between)


@pytest.mark.parametrize("gains", [(0.03, 15.0), (0.06, 12.0)])
def test_a_stretch_of_a_hunting_loop_is_no_test(gains):
    """Neither is one in which the command rests at an end of the stroke."""
    log = make_loop_log(hours=2, kp=gains[0], ti=gains[1])
    log["command"] = log.command.round(3)
    assert_refused("between", "data", fc.read_test, log, between=(600, 1800))


def test_the_steps_of_a_technician_are_a_test():
    """2.1 % of the stroke every 30 s, and holds of two minutes; the position of the motor jitters."""
    ramp = np.repeat(0.021 * np.arange(1, 6), 3)
    once = np.concatenate([ramp, np.full(12, ramp[-1]), ramp[-1] - ramp, np.zeros(12)])
    command = 0.4 + np.concatenate([np.zeros(6), once, once])
    assert rests_as_in_test(command, 10.0)
    assert rests_as_in_test(command + 0.0004 * np.random.default_rng(1).uniform(-1.0, 1.0, command.size), 10.0)
    assert rests_as_in_test(command[:12], 10.0)
    assert not rests_as_in_test(command[6:18], 10.0)


def test_a_test_without_a_hold_says_nothing_of_it(logs):
    """The start is given late, after the first hold."""
    log = logs[0.08]
    r = fc.read_test(log, stroke_time=90, between=(START + 100, START + 60 * MINUTES))
    assert np.isnan(r.held_swing) or "while the command was held" in r.summary()[2]
    assert not any("nan" in line for line in r.summary())
    assert not any("nan" in line for line in replace(r, held_swing=np.nan).summary())


def test_a_test_that_shows_nothing_is_not_identified_and_says_why(logs, early):
    log = logs[0.08]
    assert not early.identified
    assert "does not reverse" in early.reason
    holes = log.T_measured.where(np.arange(log.sizes["elapsed_time"]) % 8 != 0)
    holes[START // STEP] = np.nan
    torn = fc.read_test(fc.read_log(log.assign(T_measured=holes), drop=True), stroke_time=90)
    assert np.isfinite(torn.signals["model"]).any()
    tested_times = log.elapsed_time.values[log.test.values > 0]
    assert set(torn.signals.elapsed_time.values[torn.signals["test"].values == 1.0]) == set(tested_times)
    assert not torn.identified
    assert "of the temperatures are missing" in torn.reason


def test_a_temperature_that_does_not_belong_to_the_command_is_not_identified(logs, monkeypatch):
    monkeypatch.setattr("fastcoil.measured.read_test._LIKELIHOOD_RANGE", 0.1)  # nothing is likely: all of it takes long
    log = logs[0.08]
    r = fc.read_test(log.assign(T_measured=log.T_measured.copy(data=log.T_measured.values[::-1])), stroke_time=90)
    assert not r.identified
    assert r.reason


def delay_command(log, seconds):
    """A log whose command is logged so many seconds after the temperature, or before it."""
    rows = np.clip(np.arange(log.sizes["elapsed_time"]) - seconds // STEP, 0, log.sizes["elapsed_time"] - 1)
    return log.assign({name: log[name].copy(data=log[name].values[rows]) for name in ("command", "test")})


@pytest.mark.parametrize(
    ("seconds", "order"), [pytest.param(60, "after", marks=pytest.mark.full), (120, "after"), (-90, "before")]
)
def test_two_clocks_are_found_out_and_allowed_for(logs, seconds, order):
    r = fc.read_test(delay_command(logs[0.08], seconds), stroke_time=90)
    assert r.identified
    assert abs(r.backlash - 0.08) <= 0.016
    assert any(f"s {order} the temperature" in note for note in r.notes)


def test_clocks_that_are_minutes_apart_are_refused(logs, reading):
    r = fc.read_test(delay_command(logs[0.08], 180), stroke_time=90)
    assert not r.identified
    assert "logged minutes apart" in r.reason
    assert not any("the command seems" in note for note in reading.notes)


def test_a_test_with_a_hole_in_its_log_is_one_test(logs):
    log = logs[0.08]
    rows = np.arange(log.sizes["elapsed_time"])
    r = fc.read_test(fc.read_log(log.isel(elapsed_time=(rows < 600) | (rows >= 605)), drop=True), stroke_time=90)
    assert r.minutes == pytest.approx(30.0, abs=0.5)
    assert not any("tests" in note for note in r.notes)


def test_of_several_tests_the_last_is_read(logs, reading):
    log = logs[0.08]
    test = log.test.where((log.elapsed_time < 1000) | (log.elapsed_time > 1200), 1.0)
    r = fc.read_test(log.assign(test=test), stroke_time=90)
    assert (r.backlash, r.interval) == (reading.backlash, reading.interval)
    assert any("the log has 2 tests" in note for note in r.notes)


def test_toml_gives_the_gap_to_a_study_only_if_it_is_identified(early, reading, tmp_path):
    assert f"[loop]\nbacklash = {reading.backlash}" in reading.to_toml(tmp_path / "gap.toml")
    (tmp_path / "study.toml").write_text('[loop]\ninclude = ["gap.toml"]\nkp = 0.02\n')
    from fastcoil.study.file.spec import read_study

    assert read_study(tmp_path / "study.toml").included_parameters["backlash"] == reading.backlash
    assert "\nbacklash = " not in early.to_toml().partition("[fit]")[0]


def test_diagnose_takes_the_gap_of_a_test(logs, reading):
    d = fc.diagnose(logs[0.08].drop_vars("test"), stroke_time=90, test=reading)
    assert (d.backlash, d.interval, d.identified) == (reading.backlash, reading.interval, True)
    assert_refused("test", "type", fc.diagnose, logs[0.08], test="gap.toml")


def make_measures(peak_to_peak, period):
    return Measures(np.ones(1, bool), Swing(period, 5.0, 0.9, peak_to_peak, 20.0), np.zeros(1), 0.1, {}, "")


def test_what_remains_of_a_swing_while_the_command_is_held_tells_where_it_comes_from():
    swings = make_measures(1.0, 400.0)
    assert revise_after_hold(Cause(CAUSE_TUNING, ""), swings, 0.7, 450.0).name == CAUSE_DISTURBANCE
    assert revise_after_hold(Cause(CAUSE_TUNING, ""), swings, 0.1, 450.0).name == CAUSE_TUNING
    assert revise_after_hold(Cause(CAUSE_DISTURBANCE, ""), swings, 0.1, 450.0).name == CAUSE_TUNING
    assert revise_after_hold(Cause(CAUSE_DISTURBANCE, ""), swings, 0.1, 30.0).name == CAUSE_DISTURBANCE
    assert stops_on_hold(swings, 0.1, 450.0)
    assert not stops_on_hold(swings, 0.7, 450.0)
    assert not stops_on_hold(swings, 0.1, 250.0)
    assert not stops_on_hold(swings, np.nan, 450.0)
    calm = swings._replace(swing=NO_SWING)
    assert revise_after_hold(Cause(CAUSE_NONE, ""), calm, 0.5, 450.0).name == CAUSE_DISTURBANCE
    assert revise_after_hold(Cause(CAUSE_NONE, ""), calm, 0.1, 450.0).name == CAUSE_NONE
    assert revise_after_hold(Cause(CAUSE_TUNING, ""), swings, np.nan, 0.0).name == CAUSE_TUNING


def test_stems_follow_the_play_operator():
    positions = 0.5 + 0.3 * np.sin(np.arange(200) / 15.0)
    gaps = np.array([0.0, 0.05, 0.2])
    starts = np.maximum(positions[0] - gaps, 0.0)
    places = stem_places(positions, gaps, starts)
    for k, gap in enumerate(gaps):
        q = starts[k]
        for position, place in zip(positions, places[:, k], strict=True):
            q = position if q > position else position - gap if q < position - gap else q
            assert place == q
