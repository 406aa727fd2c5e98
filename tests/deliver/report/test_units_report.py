"""Pages and rankings of air handlers: findings in words, CSV, exit codes; unread logs named."""

import subprocess
import sys

import pandas as pd
import pytest
from helpers.air_handler_logs import make_unit_log

import fastcoil as fc


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("units")
    make_unit_log(1.0, leak=(0.5, 0.0)).to_csv(path / "AHU-1.csv", index=False)
    make_unit_log(1.0, cooling=0.2).to_csv(path / "AHU-2.csv", index=False)
    make_unit_log(1.0).rename(columns={"AHU-3 Supply Air Temp": "X"}).to_csv(path / "AHU-3.csv", index=False)
    return path


def command(*words):
    return subprocess.run(
        [sys.executable, "-m", "fastcoil", *map(str, words)], capture_output=True, text=True, check=False
    )


def test_a_folder_of_air_handlers_is_ranked_with_a_row_a_finding(folder, tmp_path):
    ds = fc.survey(folder, tmp_path / "out", n_jobs=1)
    assert ds["air_handler"].values.tolist() == ["AHU-1", "AHU-2"]
    assert ds["kind"].values.tolist() == ["leak", "none"]
    assert ds["unread"].values.tolist() == ["AHU-3"]
    assert "T_sup is missing" in ds["problem"].values[0]
    table = pd.read_csv(tmp_path / "out" / "survey.csv")
    assert table.loc[0, ["air_handler", "component", "kind"]].tolist() == ["AHU-1", "cooling valve", "leak"]
    page = (tmp_path / "out" / "survey.html").read_text()
    assert "cooling valve" in page
    assert "no fault found" in page
    # an earlier survey may be replaced, and is no log
    assert fc.survey([folder, tmp_path / "out" / "survey.csv"], tmp_path / "out", n_jobs=1).sizes["finding"] == 2


def test_a_page_of_a_unit_has_its_findings_and_is_the_same_again(folder, tmp_path):
    unit = fc.inspect(folder / "AHU-1.csv")
    pages = [fc.report(unit, tmp_path / name).read_bytes() for name in ("a.html", "b.html")]
    assert pages[0] == pages[1]
    assert b"colder than it enters" in pages[0]


def test_the_command_prints_findings_and_each_valve(folder, tmp_path):
    result = command("diagnose", folder / "AHU-1.csv", "-o", tmp_path / "columns.toml", "--fail")
    assert result.returncode == 1
    lines = result.stdout.splitlines()
    assert lines[1].startswith("1. Cooling valve: commanded shut")
    assert any(f"--answers {tmp_path / 'columns.toml'}" in line for line in lines)
    assert (tmp_path / "columns.png").exists()
    again = command("diagnose", folder / "AHU-2.csv", "--answers", tmp_path / "columns.toml", "--fail")
    assert again.returncode == 0, again.stderr
    assert "No fault of valves, loops or sensors found." in again.stdout


def test_several_logs_are_days_of_one_unit_and_a_fleet_is_ranked(folder, tmp_path):
    make_unit_log(1.0, leak=(0.5, 0.0), start="2026-03-05").to_csv(tmp_path / "later.csv", index=False)
    result = command("diagnose", folder / "AHU-1.csv", tmp_path / "later.csv")
    assert result.returncode == 0, result.stderr
    assert "on 2 of 2 days (03-02, 05)" in result.stdout
    ranked = command("diagnose", "--fleet", folder, "--jobs", "1")
    assert ranked.returncode == 0
    assert "3 air handlers: 1 with findings, 1 without, 1 not read" in ranked.stdout


def test_options_of_one_valve_are_refused_beside_an_air_handler(folder):
    for call in ("diagnose", folder / "AHU-1.csv"), ("diagnose", "--fleet", folder, "--jobs", "1"):
        result = command(*call, "--stroke-time", "120")
        assert result.returncode == 2
        assert "stroke_time is for the log of one valve" in result.stderr
    with pytest.raises(fc.InputError, match="answers"):
        fc.survey({"valve": make_unit_log(0.1).drop(columns="AHU-3 HHW Valve")}, answers={"columns": {}})
