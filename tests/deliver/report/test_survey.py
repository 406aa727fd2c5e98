"""``fc.survey``: many valves ranked by their control error, as a Dataset, a page and a table; bad logs stop nothing."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from helpers.commands import assert_command_refused, fastcoil
from helpers.loop_logs import make_loop_log, write_log
from helpers.pages import Page
from helpers.processes import living_descendants, wait_for
from helpers.refusals import assert_mistakes, assert_refused

import fastcoil as fc
from fastcoil.base.text import escape_formulas
from fastcoil.deliver.report.survey import ranked_rows

pytestmark = pytest.mark.kernel

ORDER = ["worn", "a/AHU", "b/AHU", "blind", "bad", "empty"]


@pytest.fixture(scope="module")
def building(tmp_path_factory):
    """Six logs in two folders: a loop that hunts, a worn valve and a good one of one name, and three with flaws."""
    root = tmp_path_factory.mktemp("building")
    for name in "ab":
        (root / name).mkdir()
    worn = make_loop_log(hours=3, kp=0.04, ti=18.0, backlash=0.06)
    write_log(worn, root / "a" / "worn.csv")
    write_log(make_loop_log(hours=3), root / "a" / "AHU.csv")
    write_log(make_loop_log(hours=3, backlash=0.0, kp=0.03, seed=2), root / "b" / "AHU.csv")
    write_log(worn, root / "blind.csv")
    text = (root / "blind.csv").read_text().replace("T_set", "other").splitlines()
    (root / "b" / "blind.csv").write_text("\n".join(line.rpartition(",")[0] for line in text))
    (root / "blind.csv").unlink()
    (root / "a" / "empty.csv").write_text("")
    (root / "b" / "bad.csv").write_text("elapsed_time [s],command [%],T_sup [degC]\n0,5,14\n10,x,14\n")
    (root / "b" / "notes.txt").write_text("no log")
    return root


@pytest.fixture(scope="module")
def surveyed(building):
    return fc.survey([building / "a", building / "b"], building / "out", stroke_time=90.0, n_jobs=1)


def test_the_costliest_comes_first_and_what_could_not_be_read_last(surveyed):
    assert list(surveyed.valve.values) == ORDER
    cost = surveyed.degree_hours.values
    assert cost[0] > cost[1] > cost[2] > 0.0
    assert np.isnan(cost[3:]).all()
    assert surveyed.degree_hours.attrs["units"] == "K h d-1"
    assert list(surveyed.problem.values != "") == [False] * 4 + [True] * 2
    assert "command = 'x'" in surveyed.problem.sel(valve="bad").item()
    assert "is empty" in surveyed.problem.sel(valve="empty").item()
    assert np.isnan(surveyed.backlash.sel(valve="bad"))


def test_a_row_is_the_diagnosis_of_its_log(surveyed, building):
    diagnosis = fc.diagnose(building / "a" / "worn.csv", stroke_time=90.0)
    row = surveyed.sel(valve="worn")
    assert (row.backlash, row.low, row.high) == (diagnosis.backlash, *diagnosis.interval)
    assert (row.identified, row.hunts, row.cause) == (diagnosis.identified, diagnosis.hunts, diagnosis.cause)
    assert (row.advice, row.because, row.reason) == (diagnosis.advice.reason, diagnosis.because, diagnosis.reason)
    assert row.warnings == "; ".join(diagnosis.warnings)
    np.testing.assert_array_equal([row[name] for name in diagnosis.indices], list(diagnosis.indices.values()))
    error = np.abs(diagnosis.signals.T_sup - diagnosis.signals.T_set)
    assert float(row.degree_hours) == pytest.approx(24 * float(error.mean()), rel=0.01)


def test_hours_off_and_hours_with_the_valve_rightly_shut_count_as_no_error():
    log = make_loop_log(hours=4, noise=0.0)
    half = np.arange(log.sizes["elapsed_time"]) < log.sizes["elapsed_time"] // 2

    def cost(T_sup, **extra_columns):
        after = np.interp(log.elapsed_time, [7200, 9000], [14.5, T_sup])
        columns = {"command": log.command.where(half, 0.0), "T_sup": log.T_sup.where(half, after)}
        return fc.survey({"valve": log.assign(**columns, **extra_columns)}).degree_hours.item()

    assert cost(10.0) == pytest.approx(0.5 * cost(10.0, enabled=("elapsed_time", half * 1.0, {"units": "1"})), rel=0.1)
    assert cost(T_sup=20.0) > cost(T_sup=10.0) + 30.0, "a cooling valve that is shut while the air is warm"


def test_minutes_of_operation_make_no_rate_a_day_and_come_last():
    """Half an hour of start-up has an error that no day has."""
    log = make_loop_log(hours=4)
    start_up = log.isel(elapsed_time=slice(180))
    ds = fc.survey({"short": start_up.assign(T_sup=start_up.T_sup + 5.0), "day": log})
    assert list(ds.valve.values) == ["day", "short"]
    assert np.isnan([ds[name].sel(valve="short") for name in ("degree_hours", "motor_travel", "reversals")]).all()
    assert [row[:3] for row in ranked_rows(ds)][1] == ["short", "–", "–"]


def test_the_table_holds_the_dataset(surveyed, building):
    table = pd.read_csv(building / "out" / "survey.csv", index_col="valve", keep_default_na=False, na_values={})
    assert list(table.index) == ORDER
    table = table.rename(columns=lambda header: header.partition(" [")[0])
    assert set(table) == set(surveyed.data_vars)
    for name, values in surveyed.data_vars.items():
        if values.dtype.kind == "f":
            np.testing.assert_allclose(pd.to_numeric(table[name]), values, rtol=1e-12)
        else:
            assert list(table[name].astype(str)) == [escape_formulas(str(value)) for value in values.values]


def test_the_page_stands_alone_and_names_every_valve(surveyed, building):
    page = Page(building / "out" / "survey.html")
    page.assert_self_contained()
    assert "6 valves: " in page.text
    for valve in ORDER:
        assert valve in page.text
    assert surveyed.advice.sel(valve="worn").item() in page.text
    assert surveyed.problem.sel(valve="empty").item() in page.text


def test_a_survey_is_no_log_and_replaces_itself_alone(building, tmp_path):
    write_log(make_loop_log(hours=3), tmp_path / "AHU.csv")
    for _ in range(2):
        ds = fc.survey(tmp_path, tmp_path)
    assert list(ds.valve.values) == ["AHU"]
    before = (tmp_path / "AHU.csv").read_bytes()
    assert_refused("out", "path", fc.survey, tmp_path, tmp_path / "AHU.csv")
    assert (tmp_path / "AHU.csv").read_bytes() == before
    assert_refused("out", "path", fc.survey, tmp_path, tmp_path / "out.txt")


def test_mistakes_are_told_together_before_any_log_is_read():
    mistakes = [("stroke_time", "value"), ("n_jobs", "value"), ("drop", "type"), ("progress", "type"), ("out", "type"),
                ("logs", "missing")]  # fmt: skip
    options = {"stroke_time": -1.0, "read": {"drop": "yes"}, "n_jobs": 0, "progress": 2}
    assert_mistakes(mistakes, fc.survey, [], 5, **options)
    assert_refused("read", "choice", fc.survey, "logs", read={"unit": {"command": "%"}})
    assert_refused("logs", "type", fc.survey, make_loop_log(hours=1))


def test_reading_options_are_those_of_read_log(building, surveyed):
    (building / "renamed.csv").write_text((building / "a" / "worn.csv").read_text().replace("T_sup", "point 7"))
    read = {"columns": {"T_sup": "point 7"}}
    row = fc.survey(building / "renamed.csv", stroke_time=90.0, read=read).isel(valve=0)
    logs = {"log": fc.read_log(building / "renamed.csv", **read)}
    assert row.problem == "", row.problem
    assert row.backlash == surveyed.backlash.sel(valve="worn") == fc.survey(logs, stroke_time=90.0).backlash


def test_processes_find_the_same(building):
    names = ["a/AHU.csv", "a/worn.csv", *3 * ["b/bad.csv"], *3 * ["a/empty.csv"]]
    logs = {str(k): building / name for k, name in enumerate(names)}
    in_processes, in_one_process = fc.survey(logs, n_jobs=2), fc.survey(logs, n_jobs=1)
    assert in_processes.sizes["valve"] == 8
    xr.testing.assert_allclose(in_processes, in_one_process, rtol=1e-9)


@pytest.mark.kernel
def test_the_command_lists_the_worst_and_its_exit_code_says_whether_there_is_work(building, tmp_path):
    logs = (building / "a", building / "b", "--fleet", "--stroke-time", 90)
    result = fastcoil("diagnose", *logs, "-o", tmp_path / "page.html")
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    assert lines[0] == "6 valves: 3 with hunting or a gap, 1 without, 2 not read"
    assert [line.split()[0] for line in lines[2:6]] == ORDER[:4]
    assert any(line.startswith("Not read: empty: ") for line in lines)
    assert (tmp_path / "page.html").is_file()
    assert fastcoil("diagnose", *logs, "--fail").exit_code == 1
    good_log = building / "b" / "AHU.csv"
    assert fastcoil("diagnose", good_log, "--fleet", "--fail").exit_code == 0
    assert fastcoil("diagnose", good_log, "--fail").exit_code == 0
    assert fastcoil("diagnose", building / "a" / "AHU.csv", "--fail", "--stroke-time", 90).exit_code == 1
    assert_command_refused("diagnose", building / "a" / "empty.csv", "--fleet")
    for name in ("AHU-1", "AHU-2", "AHU-3"):
        (tmp_path / f"{name}.csv").write_text("elapsed_time,T_sup,command\n0,12,0.5\n10,12,0.5\n")
    alike = fastcoil("diagnose", tmp_path, "--fleet").output
    assert alike.count("T_sup has no unit") == 1
    assert "Not read: AHU-1 and 2 more: elapsed_time has no unit" in alike
    assert_command_refused("diagnose", good_log, "--jobs", 2)
    assert_command_refused("diagnose", good_log, "--fleet", "--report", tmp_path / "r.html")


@pytest.mark.kernel
def test_several_files_are_days_of_one_valve(building):
    result = fastcoil("diagnose", building / "a" / "AHU.csv", building / "a" / "AHU.csv", "--stroke-time", 90)
    assert result.exit_code == 0, result.output
    assert result.output.startswith("AHU.csv and 1 more: 6.0 h")


@pytest.mark.alone
@pytest.mark.full
def test_an_interrupt_leaves_nothing_half_written(building, tmp_path):
    for k in range(100):
        os.link(building / "a" / "AHU.csv", tmp_path / f"{k}.csv")
    command = [sys.executable, "-m", "fastcoil", "diagnose", str(tmp_path), "--fleet", "-o", str(tmp_path / "out.html")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True, text=True)
    wait_for(lambda: living_descendants(process.pid))
    time.sleep(2.0)  # all of them are started
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 130, stderr
    assert stderr.strip() == "fastcoil: interrupted"
    assert {path.suffix for path in tmp_path.iterdir()} == {".csv"}
