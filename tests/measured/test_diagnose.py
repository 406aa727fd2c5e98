"""``fc.diagnose`` from log to answer: backlash, cause, words, TOML, page; and why it has none."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from helpers.full import full_except
from helpers.loop_logs import make_loop_log, write_log
from helpers.refusals import assert_mistakes, assert_refused
from helpers.sentences import assert_worded
from helpers.shared_data import measured_file

import fastcoil as fc
from fastcoil.cli.main import main
from fastcoil.measured import cause
from fastcoil.measured.diagnose import note_stroke_time
from fastcoil.measured.fitted_loop import Outcome
from fastcoil.study.file.tables import parse_toml

pytestmark = pytest.mark.kernel

BACKLASH = 0.08


@pytest.fixture(scope="module")
def log():
    return make_loop_log(backlash=BACKLASH)


@pytest.fixture(scope="module")
def coarse(log):
    """A sample every 10 min, without set-point."""
    return fc.diagnose(log.drop_vars("T_set").isel(elapsed_time=slice(None, None, 60)))


@pytest.fixture(scope="module")
def diagnosis(log):
    return fc.diagnose(log, stroke_time=90.0)


def test_the_backlash_of_a_calm_loop_is_identified_with_its_interval_and_profile_and_it_has_no_cause(diagnosis):
    assert diagnosis.identified
    assert not diagnosis.reason
    assert diagnosis.backlash == pytest.approx(BACKLASH, abs=0.01)
    assert diagnosis.interval[0] <= BACKLASH <= diagnosis.interval[1]
    assert float(diagnosis.profile.probability.sum()) == pytest.approx(1.0)
    assert float(diagnosis.profile.probability.idxmax()) == diagnosis.backlash
    assert (diagnosis.cause, diagnosis.hunts) == ("none", False)
    assert any(line.startswith("This loop does not hunt; the settled RMS error is ") for line in diagnosis.summary())


def test_the_controller_is_found_again_and_the_predictions_say_what_the_gap_is_worth(diagnosis, log):
    assert float(diagnosis.indices.kp) == pytest.approx(0.02, rel=0.05)
    assert float(diagnosis.indices.ti) == pytest.approx(90.0, rel=0.05)
    assert diagnosis.indices.ti.attrs["units"] == "s"
    assert float(diagnosis.indices.plant_gain) == pytest.approx(-20.0, rel=0.25)
    strokes = 6 * np.abs(np.diff(log.command)).sum()  # of 4 h, a day; the motor keeps up with most of them
    assert 0.8 * strokes < float(diagnosis.indices.motor_travel) < strokes
    rmse = diagnosis.predictions.rmse
    assert float(rmse.sel(case="no_gap")) < float(rmse.sel(case="half_gap")) < float(rmse.sel(case="as_found"))


def test_a_loop_that_swings_from_end_to_end_is_blamed_on_its_tuning_and_no_size_is_claimed():
    result = fc.diagnose(make_loop_log(kp=0.08, ti=20.0), stroke_time=90.0)
    assert (result.cause, result.hunts, result.identified) == ("tuning", True, False)
    assert any("caused by the tuning" in line for line in result.summary())


def test_a_loop_whose_air_swings_is_blamed_on_a_disturbance():
    result = fc.diagnose(make_loop_log(backlash=0.02, swing=1.5, period=400.0), stroke_time=90.0)
    assert result.cause == "disturbance"
    assert float(result.indices.period) == pytest.approx(400.0, rel=0.05)
    assert result.advice.reason == "Leave the gains: the swing comes from outside the loop."


def test_a_loop_that_would_stand_still_without_its_gap_is_blamed_on_the_valve_with_advice_on_its_gains():
    log = make_loop_log(kp=0.04, ti=18.0, backlash=0.06)
    result = fc.diagnose(log, stroke_time=90.0)
    assert result.cause == "backlash"
    assert result.identified
    assert result.backlash == pytest.approx(0.06, abs=0.01)
    kp, ti = (float(result.predictions[name].sel(case="simc")) for name in ("kp", "ti"))
    assert kp <= 0.041, "no larger kp than that of a loop that hunts"
    assert ti > 36.0
    assert (result.advice.kp, result.advice.ti) == (kp, ti)
    assert result.advice.reason.startswith(f"Do this: kp {kp:g} 1/K, ti {ti:g} s: RMSE ")
    lines = result.summary()
    now = next(k for k, line in enumerate(lines) if line.startswith("Controller: kp 0.0"))
    assert lines[now + 1] == result.advice.reason
    table = lines[lines.index(next(line for line in lines if line.startswith("Predicted for a day:"))) :]
    shown = ["Now", f"With kp {kp:g} 1/K, ti {ti:g} s", "With half the gap", "With a backlash inverse"]
    assert [row.split(": ")[0] for row in table[1:6]] == [*shown, "Without the gap"], "what is not predicted comes last"
    now = result.predictions.sel(case="as_found")
    error, travel, reversals = f"{now.rmse:.2g} K", f"{now.travel_per_day:.0f} strokes", f"{now.reversals_per_day:.0f}"
    assert table[1].split() == ["Now:", *error.split(), *travel.split(), reversals, "reversals", "hunts"]
    assert table[5].startswith("Without the gap: not predicted: ")
    with_gains = fc.diagnose(log, stroke_time=90.0, kp=0.05, ti=20.0)
    assert (float(with_gains.indices.kp), float(with_gains.indices.ti)) == (0.05, 20.0)
    assert with_gains.backlash == result.backlash


def test_a_prediction_that_contradicts_the_cause_is_withheld(monkeypatch):
    """Without the gap the loop is calm, but what is left of its swing in the disturbances of the log goes on."""
    monkeypatch.setattr(cause, "what_if", lambda *_, **__: Outcome(0.5, 0.4, 300.0, 50.0, 500.0, hunts=True))
    result = fc.diagnose(make_loop_log(kp=0.03, ti=15.0), stroke_time=90.0)
    assert result.cause == "backlash"
    assert "disturbances of the log hide" in str(result.predictions.doubt.sel(case="no_gap").values)
    assert np.isnan(result.predictions.hunts.sel(case="no_gap"))
    assert result.predictions.hunts.sel(case="half_gap") == 1.0


def test_where_the_gain_decides_on_the_cause_the_loop_without_its_gap_is_not_predicted(monkeypatch):
    unsure = cause.Cause(cause.CAUSE_UNKNOWN, cause.GAIN_DECIDES)
    monkeypatch.setattr("fastcoil.measured.diagnose.judge_cause", lambda *_: unsure)
    result = fc.diagnose(make_loop_log(kp=0.03, ti=15.0), stroke_time=90.0)
    (line,) = (line for line in result.summary() if line.startswith("Without the gap:"))
    assert line == f"Without the gap: not predicted: {cause.GAIN_DECIDES}"
    assert np.isfinite(result.predictions.rmse.sel(case="as_found"))


def log_on_two_clocks(rows, **settings):
    """A log of a loop that hunts, whose command is logged so many rows late."""
    log = make_loop_log(kp=0.03, ti=15.0, **settings)
    n, k = log.sizes["elapsed_time"], np.arange(abs(rows), log.sizes["elapsed_time"] - abs(rows))
    assert 0 <= k[0] - rows <= k[-1] - rows < n
    moved = log.isel(elapsed_time=k)
    return moved.assign(command=moved.command.copy(data=log.command.values[k - rows].round(3)))


@pytest.mark.parametrize("rows", full_except([-3, -2, -1, 1, 2, 3], [-3, 1]))
def test_a_command_on_another_clock_changes_neither_gap_nor_gains(rows):
    """The answers of a loop that hunts come back with its period: over minutes, they fit several clocks."""
    result = fc.diagnose(log_on_two_clocks(rows), stroke_time=90.0)
    assert float(result.indices.kp) == pytest.approx(0.03, rel=0.05)
    assert float(result.indices.ti) == pytest.approx(15.0, rel=0.05)
    assert not result.identified or result.interval[0] <= BACKLASH <= result.interval[1]
    when = f"{10 * abs(rows)} s {'earlier' if rows > 0 else 'later'} than the command, which was corrected"
    assert any(when in note for note in result.notes)


def test_clocks_that_agree_are_left_and_a_lag_that_is_given_stays(monkeypatch):
    """Neither does a swing over the whole stroke look like another clock."""
    for settings in ({"kp": 0.03, "ti": 15.0}, {"kp": 0.06, "ti": 12.0}):
        result = fc.diagnose(make_loop_log(**settings), stroke_time=90.0)
        assert not any("which was corrected" in note for note in result.notes)
        assert float(result.indices.kp) == pytest.approx(settings["kp"], rel=0.05)
    monkeypatch.setattr("fastcoil.measured.diagnose._find_lag", None)
    given = fc.diagnose(log_on_two_clocks(-3), stroke_time=90.0, lag=30.0)
    assert float(given.indices.kp) == pytest.approx(0.03, rel=0.05)


@pytest.mark.parametrize(("stroke_time", "is_noted"), [(1.5, True), (900.0, True), (0.0, False), (10.0, False)])
def test_a_stroke_time_in_minutes_is_noted(coarse, stroke_time, is_noted):
    notes = note_stroke_time(stroke_time)
    assert bool(notes) is is_noted
    assert_worded(*notes)
    assert note_stroke_time(None)[0] in coarse.notes


def test_without_a_set_point_the_backlash_is_found_and_what_is_missing_is_said(log):
    result = fc.diagnose(log.drop_vars("T_set"), stroke_time=90.0, sample_time=5.0)
    assert any("the controller one every 5 s" in note for note in result.notes)
    assert result.backlash == pytest.approx(BACKLASH, abs=0.01)
    assert result.predictions is None
    assert np.isnan(result.indices.error_rms)
    assert any("without a set-point" in note for note in result.notes)


def test_a_temperature_logged_at_changes_of_a_third_of_a_kelvin_is_not_trusted(log):
    T, kept = log.T_sup.values, [0]
    for k in range(T.size):
        if abs(T[k] - T[kept[-1]]) >= 0.3:
            kept.append(k)
    coarse = T[np.array(kept)[np.searchsorted(kept, np.arange(T.size), side="right") - 1]]
    assert not fc.diagnose(log.assign(T_sup=log.T_sup.copy(data=coarse)), stroke_time=90.0).identified


def test_days_that_are_given_in_another_order_are_read_in_that_of_their_dates(tmp_path):
    paths = []
    for day, kp in enumerate((0.02, 0.04)):
        frame = make_loop_log(hours=3.0, kp=kp, ti=18.0).to_dataframe().reset_index(drop=True)
        frame.insert(0, "timestamp", pd.date_range(f"2026-03-{10 + day} 08:00", periods=len(frame), freq="10s"))
        paths.append(tmp_path / f"day{day}.csv")
        frame.to_csv(paths[-1], index=False)
    units = {"command": "1", "T_sup": "degC", "T_set": "degC"}
    first, again = (
        fc.diagnose([fc.read_log(path, units=units) for path in order], stroke_time=90.0)
        for order in (paths, paths[::-1])
    )
    assert (np.diff(again.signals.elapsed_time) > 0.0).all()
    xr.testing.assert_identical(again.triage, first.triage)
    assert again.headline == first.headline


def test_a_log_that_is_too_coarse_or_too_short_says_so_instead_of_claiming(log, coarse):
    assert (coarse.identified, coarse.cause) == (False, "unknown")
    assert "every 600 s" in coarse.reason
    short = fc.diagnose(log.isel(elapsed_time=slice(0, 120)))
    assert (short.identified, short.cause) == (False, "unknown")
    assert "at a constant set-point" in short.because


def test_the_toml_can_be_included_and_holds_a_backlash_only_if_it_is_identified(diagnosis, coarse, tmp_path):
    tables = parse_toml(diagnosis.to_toml(tmp_path / "diagnosis.toml"), "diagnosis.toml")
    controller = {name: float(diagnosis.indices[name]) for name in ("kp", "ti", "sample_time")}
    expected = {"backlash": diagnosis.backlash, "stroke_time": 90.0, **controller}
    assert tables["loop"] == pytest.approx(expected, rel=1e-3)
    assert tables["fit"]["interval_95"]["backlash"] == list(diagnosis.interval)
    assert set(tables) == {"loop", "fit"}
    study = tmp_path / "study.toml"
    study.write_text('[loop]\npreset = "lbnl"\ninclude = ["diagnosis.toml"]\n[boundary]\nhours = 1\nseed = 1\n')
    from fastcoil.study.file.spec import read_study

    assert read_study(study).plan.n_scenarios == 1
    coarse.to_toml(tmp_path / "diagnosis.toml")
    assert_refused("include", "data", read_study, study)
    study.write_text(study.read_text().replace("[loop]", "[loop]\nbacklash = 0.05"))
    assert read_study(study).plan.layout.loop["backlash"] == 0.05
    assert_refused("path", "path", diagnosis.to_toml, tmp_path / "absent" / "d.toml")


def test_a_command_to_100_without_a_unit_is_told_to_be_per_cent(log, tmp_path):
    path = write_log(log, tmp_path / "log.csv")
    path.write_text(path.read_text().replace("command [%]", "command"))
    assert_refused("command", "unit", fc.diagnose, path)


def test_mistakes_are_told_together_before_the_log_is_read():
    mistakes = [("log", "type"), ("stroke_time", "value"), ("sample_time", "value"), ("ti", "missing")]
    assert_mistakes(mistakes, fc.diagnose, 5, -1.0, 0.0, kp=0.05)
    assert_refused("sample_time", "value", fc.diagnose, "log.csv", sample_time=1e-300)
    assert_refused("kp", "value", fc.diagnose, "log.csv", kp=-1.0, ti=20.0)
    assert_refused("log", "missing", fc.diagnose, [])


def test_the_command_prints_the_answer_and_writes_what_is_asked(log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_log(log, tmp_path / "log.csv")
    completed = CliRunner().invoke(main, ["diagnose", "log.csv", "--stroke-time", "90"])
    assert completed.exit_code == 0, completed.output
    assert "Gap: 8 % of the stroke" in completed.output
    assert {path.name for path in tmp_path.iterdir()} == {"log.csv"}


@pytest.mark.full
def test_the_loop_that_hunts_at_lbnl_is_told_as_found():
    """It hardly has backlash, and swings every half hour."""
    columns = {"elapsed_time": "time_s", "command": "valve_command_pct", "T_sup": "T_sup_C", "T_set": "T_sup_set_C"}
    units = {"elapsed_time": "s", "command": "%", "T_sup": "degC", "T_set": "degC"}
    result = fc.diagnose(fc.read_log(measured_file("b33_ahu2_5s.csv"), columns=columns, units=units))
    assert not (result.identified and result.backlash > 0.03)
    assert result.hunts
    assert result.cause != "backlash"
    assert float(result.indices.period) == pytest.approx(1800.0, rel=0.05)
    assert float(result.indices.kp) == pytest.approx(0.018, rel=0.05)
    assert float(result.indices.ti) == pytest.approx(30.0, rel=0.05)
