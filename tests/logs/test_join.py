"""Points with times of their own on one clock: values, gaps, names, units; and what is refused."""

from datetime import datetime, timedelta

import numpy as np
import pytest
from helpers.refusals import assert_mistakes, assert_refused

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.join import join_points

START = datetime(2024, 7, 25, 8)


@pytest.fixture
def write_point_file(tmp_path):
    """Return a function that writes the file of a point: seconds from the start, values."""

    def write_point(name, seconds, values, header="Timestamp,Value", form="%Y-%m-%d %H:%M:%S", separator=","):
        path = tmp_path / name
        stamps = [(START + timedelta(seconds=float(s))).strftime(form) for s in seconds]
        rows = [f"{stamp}{separator}{value}" for stamp, value in zip(stamps, values, strict=True)]
        path.write_text("\n".join([header, *rows]), encoding="utf-8")
        return path

    return write_point


def join_files(*paths, columns=None, units=None, **options):
    return join_points(paths, columns=columns or {}, units=units or {}, **options)


def parse_table(text):
    """Header, times in seconds from the start, and values (rows, columns)."""
    header, *lines = text.splitlines()
    cells = [line.split(",") for line in lines]
    seconds = [(datetime.fromisoformat(row[0]).replace(tzinfo=None) - START).total_seconds() for row in cells]
    return header.split(","), np.array(seconds), np.array([row[1:] for row in cells], dtype=float)


PERIODIC_SECONDS = 13 + 60 * np.arange(40)
CHANGE_SECONDS = np.array([0, 40, 75, 400, 410, 900, 1000, 1030, 2000])


def test_a_command_that_is_written_when_it_changes_and_a_temperature_every_minute(write_point_file):
    command = write_point_file("command.csv", CHANGE_SECONDS, 10 * np.arange(9), "Timestamp,Value (%)")
    T_sup = write_point_file("T_sup.csv", PERIODIC_SECONDS, 60 + 0.1 * np.arange(40), "Timestamp,Value (°F)")
    text, notes = join_files(command, T_sup)
    header, seconds, values = parse_table(text)
    assert header == ["timestamp", "command [1]", "T_sup [degC]"]
    np.testing.assert_array_equal(seconds, np.arange(60, 2341, 60))  # while both have values, on whole minutes
    np.testing.assert_allclose(values[:, 0], 0.1 * (np.searchsorted(CHANGE_SECONDS, seconds, side="right") - 1))
    np.testing.assert_allclose(values[:, 1], (60 + 0.1 * (seconds - 13) / 60 - 32) / 1.8, atol=1e-8)
    assert notes == [
        "command: 9 samples of command.csv, written when it changes, held from sample to sample up to 970 s",
        "T_sup: 40 samples of T_sup.csv, on straight lines over 180 s at most",
        "39 rows, 60 s apart",
    ]


def test_a_log_says_which_of_its_joined_points_came_more_slowly_than_rows(write_point_file, tmp_path):
    seconds = np.arange(0, 36000, 60)
    walk = 14.0 + np.cumsum(np.random.default_rng(1).normal(0.0, 0.1, seconds.size)).round(3)
    text, _ = join_files(
        write_point_file("command.csv", seconds, np.abs(walk), "Timestamp,Value (%)"),
        write_point_file("T_sup.csv", seconds[::4] + 13, walk[::4], "Timestamp,Value [degC]"),
    )
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    assert [line.split(", ")[1:] for line in fc.read_log(tmp_path / "log.csv").summary()[1:3]] == [
        [], ["values of its own only every 4 min"],
    ]  # fmt: skip


def test_what_is_joined_is_read_as_a_log(write_point_file, tmp_path):
    text, _ = join_files(
        write_point_file("command.csv", CHANGE_SECONDS, 10 * np.arange(9), "Timestamp,Value (%)"),
        write_point_file("T_sup.csv", PERIODIC_SECONDS, 14 + 0 * PERIODIC_SECONDS, "Timestamp,Value [degC]"),
    )
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    log = read_checked_log(path, ColumnSpec(("command", "T_sup"), measured=("T_sup",)))
    assert (log.n_batches, log.step, log.notes) == (1, 60.0, [])


@pytest.mark.parametrize("step", [None, 45])
def test_the_step_of_the_clock(write_point_file, step):
    command = write_point_file("command.csv", 60 * np.arange(40), np.arange(40), "Timestamp,Value (%)")
    T_sup = write_point_file("T_sup.csv", 7 + 10 * np.arange(200), np.arange(200) / 10, "Timestamp,Value (°C)")
    _, seconds, values = parse_table(join_files(command, T_sup, step=step)[0])
    assert set(np.diff(seconds)) == {step or 10}
    np.testing.assert_allclose(values[:, 0], 0.01 * (seconds // 60))
    np.testing.assert_allclose(values[:, 1], (seconds - 7) / 100)


def test_a_gap_of_a_point_leaves_rows_out_and_counts_them(write_point_file):
    is_logged = (PERIODIC_SECONDS < 600) | (PERIODIC_SECONDS > 1200)
    T_sup = write_point_file("T_sup.csv", PERIODIC_SECONDS[is_logged], np.ones(is_logged.sum()), "Timestamp,Value (°C)")
    command = write_point_file("command.csv", CHANGE_SECONDS, np.arange(9), "Timestamp,Value (%)")
    text, notes = join_files(command, T_sup)
    _, seconds, _ = parse_table(text)
    assert not ((seconds >= 600) & (seconds <= 1200)).any()
    assert "11 rows of 39 left out: a point has no sample within its longest gap" in notes
    assert parse_table(join_files(command, T_sup, max_gap=1000)[0])[1].size == 39
    assert parse_table(join_files(command, T_sup, max_gap=400)[0])[1].size < 29  # the command changes less often


def test_points_are_named_by_header_by_file_or_by_the_caller(write_point_file):
    seconds = 60 * np.arange(5)
    command = write_point_file("AHU1.csv", seconds, np.arange(5), "Timestamp,command (%)")
    T_sup = write_point_file("T_sup.csv", seconds, np.arange(5), "Timestamp,AHU1 SAT (°C)")
    m_w = write_point_file("FLOW-7.csv", seconds, np.arange(5), "Timestamp,Present Value")
    for target in ("FLOW-7.csv", "FLOW-7", "Present Value", "FLOW-7.csv:Present Value"):
        header, _, _ = parse_table(join_files(command, T_sup, m_w, columns={"m_w": target}, units={"m_w": "L/s"})[0])
        assert header == ["timestamp", "command [1]", "m_w [kg s-1]", "T_sup [degC]"]


def test_a_table_with_blanks_is_several_points(write_point_file, tmp_path):
    path = tmp_path / "history.csv"
    rows = ["Time,command [%],T_sup [degC],Zone"]
    for k in range(60):
        cells = [str(k), ""] if k % 3 == 0 else ["", str(14 + k / 60)]
        rows.append(",".join([f"2024-07-25T08:{k:02}:00", *cells, "21"]))
    path.write_text("\n".join(rows), encoding="utf-8")
    text, notes = join_files(path, step=60)
    _, seconds, values = parse_table(text)
    np.testing.assert_allclose(values[:, 0], 0.01 * (seconds // 180 * 3))
    np.testing.assert_allclose(values[:, 1], 14 + seconds / 3600)
    assert "left alone: 'Zone'" in notes


def test_each_file_has_its_own_writing_of_times(write_point_file):
    points = PERIODIC_SECONDS, np.arange(40)
    command = write_point_file("command.csv", *points, "Timestamp;Value (%)", "%d/%m/%Y %H:%M:%S", ";")
    T_sup = write_point_file("T_sup.csv", *points, "Timestamp,Value (°C)")
    text, notes = join_files(command, T_sup)
    _, seconds, values = parse_table(text)
    np.testing.assert_allclose(values[:, 1], (seconds - 13) / 60)
    assert notes[0].startswith("command.csv: ")


def test_newest_first_and_doubles(write_point_file):
    seconds = np.array([0, 60, 60, 120, 180])
    expected = join_files(write_point_file("command.csv", [0, 60, 120, 180], [0, 2, 3, 4], "Time,Value (%)"))[0]
    assert join_files(write_point_file("command.csv", seconds, [0, 1, 2, 3, 4], "Time,Value (%)"))[0] == expected
    reversed_text, notes = join_files(write_point_file("command.csv", seconds[::-1], [4, 3, 2, 1, 0], "Time,Value (%)"))
    assert reversed_text == expected
    assert "command.csv: the newest row is first: turned round" in notes
    assert "command.csv: 1 row at the time of the next: left out" in notes
    text, _ = join_files(write_point_file("T_sup.csv", seconds, [0, 9, 2, 3, 4], "Time,Value (°C)"), step=30)
    np.testing.assert_allclose(parse_table(text)[2][:4, 0], [0, 1, 2, 2.5])


def test_files_of_two_zones_are_joined_by_absolute_time(write_point_file):
    seconds = 60.0 * np.arange(240)
    east = write_point_file("command.csv", seconds, np.arange(240) / 4, "Time,Value (%)", "%m/%d/%Y %I:%M:%S %p EDT")
    kelvin, header = np.arange(240) / 10, "Time,Value (°C)"
    west = write_point_file("T_sup.csv", seconds - 3 * 3600, kelvin, header, "%m/%d/%Y %I:%M:%S %p PDT")
    epoch = write_point_file("T_set.csv", seconds, kelvin, header, "%Y-%m-%dT%H:%M:%S-04:00")
    text, notes = join_files(east, west, epoch)
    _, seconds, values = parse_table(text)
    assert text.splitlines()[1].startswith("2024-07-25T12:00:00+00:00,")
    np.testing.assert_allclose(values[:, 0], values[:, 2])  # T_set and T_sup: the same sample of each
    np.testing.assert_allclose(40 * values[:, 1], values[:, 2])
    assert [note for note in notes if "EDT" in note or "PDT" in note] == [
        "command.csv: timestamp is in EDT: read by UTC offset", "T_sup.csv: timestamp is in PDT: read by UTC offset"
    ]  # fmt: skip


@pytest.mark.parametrize("zone", ["America/New_York", "UTC-04:00"])
def test_a_local_clock_beside_an_absolute_one_is_refused_unless_its_zone_is_given(write_point_file, zone):
    east = write_point_file("command.csv", PERIODIC_SECONDS, np.arange(40), "Time,Value (%)", "%Y-%m-%d %H:%M:%S EDT")
    local = write_point_file("T_sup.csv", PERIODIC_SECONDS, np.arange(40), "Time,Value (°C)")
    assert_refused("--time-zone", "conflict", join_files, east, local)
    text, _ = join_files(east, local, time_zone=zone)
    _, _, values = parse_table(text)
    assert text.splitlines()[1].startswith("2024-07-25T08:01:00-04:00,")
    np.testing.assert_allclose(100 * values[:, 0] + 47 / 60, values[:, 1], atol=1e-6)
    china = write_point_file("T_sup.csv", PERIODIC_SECONDS, np.arange(40), "Time,Value (°C)", "%Y-%m-%d %H:%M:%S CST")
    assert_refused("--time-zone", "conflict", join_files, east, china)


# --------------------------------------------------------------------------------------------------------- refused


def test_files_that_cannot_be_joined_are_refused_with_the_cure(write_point_file):
    seconds = 60 * np.arange(5)
    command = write_point_file("command.csv", seconds, np.arange(5), "Time,Value (%)")
    unnamed = write_point_file("VLV-1.csv", seconds, np.arange(5), "Time,Value (%)")
    assert_refused("VLV-1.csv", "missing", join_files, command, unnamed)
    assert_refused("command", "duplicate", join_files, command, command)
    assert_mistakes([("columns", "choice")], join_files, command, unnamed, columns={"T_supp": "VLV-1.csv"})
    assert_refused("columns", "name", join_files, command, columns={"T_sup": "SAT.csv"})
    assert_refused("--column", "conflict", join_files, command, unnamed, columns={"command": "Value"})
    late = write_point_file("T_sup.csv", seconds + 10_000, np.arange(5), "Time,Value (°C)")
    assert_refused("command", "data", join_files, command, late)
    offset = write_point_file("T_sup.csv", seconds, np.arange(5), "Time,Value (°C)", "%Y-%m-%dT%H:%M:%SZ")
    assert_refused("--time-zone", "conflict", join_files, command, offset)


def test_bad_cells_are_refused_with_file_row_and_cure(write_point_file):
    seconds = 60 * np.arange(5)
    off = write_point_file("command.csv", seconds, [0, 1, "off", 3, 4], "Time,Value (%)")
    assert_refused("command", "value", join_files, off)
    without_unit = write_point_file("command.csv", seconds, [0, 10, 20, 30, 40], "Time,Value")
    assert_refused("command", "unit", join_files, without_unit)
    to_and_fro = write_point_file("command.csv", [0, 60, 30, 90, 120], range(5), "Time,Value (%)")
    assert_refused("timestamp", "time", join_files, to_and_fro)
    no_time = write_point_file("command.csv", seconds, range(5), "Zone,Value (%)", "x")
    assert_refused("timestamp", "missing", join_files, no_time)
    years = write_point_file("command.csv", 3e7 * np.arange(5), range(5), "Time,Value (%)")
    assert_refused("--step", "size", join_files, years, step=1)


def test_what_one_file_shows_of_the_order_of_day_and_month_holds_for_all(write_point_file, tmp_path):
    command = write_point_file("command.csv", [0, 60, 120], [1, 2, 3], "Time,Value (%)", "%m/%d/%Y %H:%M")
    T_set = tmp_path / "T_set.csv"
    T_set.write_text("Time,Value (°C)\n7/5/2024 8:00,14\n")
    _, seconds, values = parse_table(join_files(command, T_set)[0])
    np.testing.assert_array_equal(values[:, 0], [14, 14, 14])
    T_set.write_text("Time,Value (°C)\n8/7/2024 8:00,14\n")  # not the 8th of July
    assert_refused("T_set", "data", join_files, command, T_set)
