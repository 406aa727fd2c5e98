"""``fc.read_log``: bad logs are refused with column, row and cure; what is left out is counted; a log is read once."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from helpers.log_files import COIL_HEADER, VALVE_HEADER, change_cell, coil_rows, valve_rows
from helpers.refusals import assert_mistakes, assert_refused

import fastcoil as fc
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.log import as_log, check_read_options
from fastcoil.logs.series import HUMIDITY_COLUMNS

VALVE = ColumnSpec(required=("command", "m_w"), optional=("enabled",), measured=("m_w",))
COIL = ColumnSpec(("m_w", "m_a", "T_w_in", "T_a_in", HUMIDITY_COLUMNS, "T_sup"), measured=("T_sup",))


def read(path, spec=VALVE, **options):
    return fc.read_log(path, **options).read(spec)


# ------------------------------------------------------------------------------------------------- columns and cells


@pytest.mark.parametrize(
    ("header", "change", "mistakes"),
    [
        (["elapsed_time [s]", "command", "m_w [kg/s]"], None, [("command", "unit")]),
        (["elapsed_time [s]", "command [1]", "m_w [L/sek]"], None, [("m_w", "unit")]),
        (["elapsed_time [s]", "command [1]", "flow [kg/s]"], None, [("flow [kg/s]", "name"), ("m_w", "missing")]),
        (["t [s]", "command [1]", "m_w [kg/s]"], None, [("t [s]", "name"), ("elapsed_time", "missing")]),
        (VALVE_HEADER, (5, 2, "nan"), [("m_w", "value")]),
        (VALVE_HEADER, (5, 1, ""), [("command", "value")]),
        (VALVE_HEADER, (5, 2, "1,5"), [("m_w", "value")]),
        (VALVE_HEADER, (5, 1, "1.7"), [("command", "value")]),
        (VALVE_HEADER, (5, 2, "-999"), [("m_w", "value")]),
        (VALVE_HEADER, (5, 0, "240"), [("elapsed_time", "time")]),
        (VALVE_HEADER, (5, 0, "10"), [("elapsed_time", "time")]),
    ],
)
def test_bad_logs_of_a_valve_are_refused_with_column_row_and_cure(valve_log, header, change, mistakes):
    rows = valve_rows() if change is None else change_cell(valve_rows(), *change)
    assert_mistakes(mistakes, read, valve_log(rows, header))


@pytest.mark.parametrize(
    ("header", "change", "options", "mistakes"),
    [
        ([*COIL_HEADER[:6], "T_supply [degC]"], None, {}, [("T_supply [degC]", "name"), ("T_sup", "missing")]),
        (COIL_HEADER, (5, 3, 99999), {}, [("T_w_in", "value")]),
        (COIL_HEADER, (5, 4, 0), {}, [("T_a_in", "data")]),
        (COIL_HEADER, None, {"constants": {"m_a": 1.2}}, [("m_a", "conflict")]),
        (COIL_HEADER, None, {"constants": {"T_dp_in": 99}}, [("constants", "value"), ("RH_a_in", "conflict")]),
        (COIL_HEADER, None, {"constants": {"elapsed_time": 1}}, [("constants", "choice")]),
        (COIL_HEADER, None, {"columns": {"T_supp": "x"}}, [("columns", "choice"), ("columns", "name")]),
        (COIL_HEADER, None, {"columns": {"T_sup": "T_supply"}}, [("columns", "name")]),
        (COIL_HEADER, None, {"units": {"T_supp": "K"}, "time_zone": "UTC"}, [("units", "choice")]),
        (COIL_HEADER, None, {"time_zone": "UTC"}, [("time_zone", "conflict")]),
        (COIL_HEADER, None, {"max_gap": 0, "jumps": "x"}, [("jumps", "choice"), ("max_gap", "value")]),
        (COIL_HEADER, None, {"time_zone": "Europe/Munich"}, [("time_zone", "choice")]),
    ],
)  # fmt: skip
def test_bad_logs_and_options_are_refused(coil_log, header, change, options, mistakes):
    rows = coil_rows() if change is None else change_cell(coil_rows(), *change)
    assert_mistakes(mistakes, read, coil_log(rows, header), COIL, **options)


def test_a_source_is_a_path_a_frame_or_a_dataset(tmp_path, valve_log):
    path = tmp_path / "none.csv"
    assert_refused(str(path), "path", fc.read_log, path)
    assert_refused("source", "type", fc.read_log, 7)
    assert_refused("log", "type", as_log, "log", 7)
    path = valve_log(valve_rows(), ["Trend", "", ""])
    assert_refused(str(path), "format", fc.read_log, path)


# ------------------------------------------------------------------------------------------------------------- time


def test_a_log_with_two_times_must_say_which_to_read(valve_log):
    header = ["timestamp", *VALVE_HEADER]
    rows = [[f"2024-07-01T{t // 3600:02d}:{t // 60 % 60:02d}:00", t, c, m] for t, c, m in valve_rows()]
    path = valve_log(rows, header)
    assert_refused("elapsed_time", "conflict", read, path)
    by_stamp = read(path, columns={"timestamp": "timestamp"})
    np.testing.assert_array_equal(by_stamp.time, read(path, columns={"elapsed_time": "elapsed_time"}).time)
    rows[5][0] = "midnight"
    path = valve_log(rows, header)
    assert_refused("timestamp", "time", read, path, columns={"timestamp": "timestamp"})
    log = read(path, columns={"timestamp": "timestamp"}, drop=True)
    assert "1 row left out: timestamp is not an admissible number (first in row 7)" in log.notes


def test_a_local_clock_has_the_zone_that_is_given_through_the_change_of_clocks(write_log):
    local = pd.date_range("2024-03-10T01:00", periods=4, freq="30min").strftime("%Y-%m-%dT%H:%M")
    rows = [[stamp, 0.5, 1] for stamp in (*local[:2], "2024-03-10T03:00", "2024-03-10T03:30")]
    path = write_log(["timestamp", *VALVE_HEADER[1:]], rows)
    assert read(path).time.tolist() == [0, 1800, 7200, 9000]
    log = read(path, time_zone="America/New_York")
    assert (log.time.tolist(), log.time_zone) == ([0, 1800, 3600, 5400], "America/New_York")
    assert log.start == np.datetime64("2024-03-10T01:00:00")


# --------------------------------------------------------------------------------------------- what is left out


def test_dropped_rows_gaps_and_jumps_are_counted(valve_log):
    rows = change_cell(change_cell(change_cell(valve_rows(), 5, 2, "nan"), 6, 2, "-999"), 9, 1, "off")
    notes = read(valve_log(rows), drop=True).notes
    assert "1 row left out: command is not an admissible number (first in row 11)" in notes
    assert any(note.startswith("2 values left out: m_w") for note in notes)
    path = valve_log([[t + 3600 * (i > 30), c, m] for i, (t, c, m) in enumerate(valve_rows())])
    assert any("1 gap in time (first: 3660 s between rows 32 and 33)" in note for note in read(path).notes)
    assert not any("gap in time" in note for note in read(path, max_gap=3660).notes)
    path = valve_log([[t - 900 * (i > 30), c, m] for i, (t, c, m) in enumerate(valve_rows())])
    assert any("goes back or does not advance 1 time:" in note for note in read(path, jumps="split").notes)


def test_readings_that_scatter_about_a_bound_are_taken_as_the_bound(valve_log):
    log = read(valve_log(change_cell(change_cell(valve_rows(), 5, 1, "1.004"), 9, 2, "-0.01")))
    assert (log.values["command"][5], log.values["m_w"][9]) == (1.0, 0.0)
    for name, row in (("command", 7), ("m_w", 11)):
        note = f"1 value of {name} just outside the possible range: taken as its bound (first in row {row})"
        assert note in log.notes
    assert_refused("command", "value", read, valve_log(change_cell(valve_rows(), 5, 1, "1.2")))


def test_lines_without_content_are_no_rows(valve_log):
    rows = valve_rows()
    log = read(valve_log([*rows[:30], ["", "", ""], *rows[30:], [" ", "", ""], []]))
    np.testing.assert_array_equal(log.values["m_w"], read(valve_log(rows)).values["m_w"])
    assert log.rows[30] == 33


# -------------------------------------------------------------------------------------------- one log, many readers


def test_a_log_is_read_from_its_file_once_and_as_often_as_it_is_used(valve_log):
    rows = [[f"2024-07-01T08:{t // 60:02d}:00", c, m] for t, c, m in change_cell(valve_rows(), 9, 1, "off")]
    path = valve_log(rows[::-1], ["timestamp", *VALVE_HEADER[1:]])
    log = fc.read_log(path, drop=True, jumps="split", constants={"m_a": 1.2, "RH_a_in": 0.5})
    path.unlink()
    first, second = (log.read(VALVE) for _ in range(2))
    assert first.notes == second.notes
    np.testing.assert_array_equal(first.values["m_w"], second.values["m_w"])
    assert first.values.keys() == {"command", "m_w"}, "constants are for those who need them"
    assert set(log.read(ColumnSpec(("m_a",))).values["m_a"].tolist()) == {1.2}
    assert as_log("log", log) is log


def test_a_dataset_of_a_simulation_has_the_temperature_that_its_controller_read():
    coordinates = {"elapsed_time": ("elapsed_time", 60.0 * np.arange(3), {"units": "s"})}
    last_values = {"T_sup": 16.0, "T_measured": 17.0}
    series = {name: ("elapsed_time", [14.0, 15.0, last], {"units": "degC"}) for name, last in last_values.items()}
    ds, spec = xr.Dataset(series, coordinates), ColumnSpec(("T_sup",))
    assert fc.read_log(ds).read(spec).values["T_sup"][-1] == 16.0
    assert fc.read_log(ds).read(spec, use_sensor=True).values["T_sup"][-1] == 17.0
    assert fc.read_log(ds, columns={"T_sup": "T_sup"}).read(spec, use_sensor=True).values["T_sup"][-1] == 16.0


def test_a_log_prints_what_it_is_and_what_keeps_it_from_being_read(write_log):
    header = ["timestamp", "CHW VLV (%)", "SAT"]
    path = write_log(header, [[f"2024-07-01T08:0{k}", 10 * k, 14 + k] for k in range(3)])
    assert repr(fc.read_log(path, units={"T_sup": "degC"}, constants={"m_a": 1.2})).splitlines() == [
        "<fastcoil Log> log.csv",
        "3 rows, 60 s apart, in 1 piece: 120 s from 2024-07-01T08:00:00",
        "m_a = 1.2, a constant",
        "command [%] from the column 'CHW VLV (%)'",
        "T_sup [degC] from the column 'SAT'",
        "Note: 'CHW VLV (%)' is read as command, 'SAT' is read as T_sup",
    ]
    assert "cannot be read as it is: log.csv: T_sup has no unit: " in repr(fc.read_log(path))


@pytest.mark.parametrize(
    ("options", "mistakes"),
    [
        (5, [("read", "type")]),
        ({"dropp": True, "source": "x"}, [("read", "choice"), ("read", "choice")]),
        ({"drop": 1, "max_gap": 0}, [("drop", "type"), ("max_gap", "value")]),
    ],
)
def test_options_for_many_logs_are_checked_before_any_is_read(options, mistakes):
    check_read_options({"drop": True, "units": {"m_w": "kg/s"}})
    assert_mistakes(mistakes, check_read_options, options)
