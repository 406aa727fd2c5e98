"""Trend logs and hourly weather: exact conversions, holds and straight lines, and every way a file can be wrong."""

import csv
import warnings
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from fastcoil.boundary import Boundary, moist_air
from fastcoil.boundary.days import paper_day
from fastcoil.boundary.series import AIR_FLOW, DIFFERENCE, TEMPERATURE
from fastcoil.boundary.trends import read_trend_log
from fastcoil.boundary.weather import weather_day
from fastcoil.errors import InputError

DATA = Path(__file__).parents[2] / "shared" / "data"
HEADER = ["elapsed_time [s]", "m_a [kg/s]", "T_a_in [degC]", "W_a_in [1]", "T_w_in [degC]", "T_set [degC]"]


def row(time, m_a=1.0, T_a_in=25.0, W_a_in=0.01, T_w_in=7.0, T_set=14.0):
    return [time, m_a, T_a_in, W_a_in, T_w_in, T_set]


ROWS = [row(0), row(60, m_a=1.6, T_set=15.0), row(120, T_a_in=27.0)]


@pytest.fixture
def write(tmp_path):
    def write_csv(header, rows, name="log.csv"):
        path = tmp_path / name
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([header, *rows])
        return path

    return write_csv


def replaced(column, values, rows=ROWS):
    """``rows`` with the values of one column, by its index, replaced."""
    return [[*r[:column], value, *r[column + 1 :]] for r, value in zip(rows, values, strict=True)]


def problems(function, *args, **kwargs):
    with pytest.raises(InputError) as caught:
        function(*args, **kwargs)
    return caught.value.problems


def assert_only_problem(words, function, *args, **kwargs):
    (problem,) = problems(function, *args, **kwargs)
    for word in words:
        assert word in problem, problem


# ------------------------------------------------------------------------------------------------- what is read


def test_continuous_series_run_straight_and_switches_hold(write):
    header = [*HEADER, "noise [K]", "enabled [1]"]
    rows = [[*r, noise, on] for r, noise, on in zip(ROWS, (0.0, 0.6, -0.6), (1, 0, 1), strict=True)]
    series = read_trend_log(write(header, rows)).series
    t = np.arange(121)
    np.testing.assert_allclose(series["m_a"][0], np.where(t < 60, 1 + 0.01 * t, 1.6 - 0.01 * (t - 60)), atol=1e-12)
    np.testing.assert_allclose(series["T_a_in"][0], 25 + np.maximum(t - 60, 0) / 30, atol=1e-12)
    np.testing.assert_array_equal(series["T_set"][0], np.select([t < 60, t < 120], [14.0, 15.0], 14.0))
    np.testing.assert_array_equal(series["enabled"][0], np.select([t < 60, t < 120], [1.0, 0.0], 1.0))
    np.testing.assert_allclose(series["noise"][0, [30, 60, 90]], [0.3, 0.6, 0.0], atol=1e-12)


def test_a_log_of_1_s_samples_is_read_to_the_bit(write):
    boundary = paper_day(0.1, seed=0)  # its label, 0, is that of a log
    names = ["m_a", "T_a_in", "W_a_in", "T_w_in", "T_set"]
    columns = np.array([boundary.series[name][0] for name in names]).T
    rows = [[t, *map(repr, map(float, values))] for t, values in enumerate(columns)]
    assert Boundary.from_csv(write(HEADER, rows)) == boundary


@pytest.mark.parametrize(("unit", "scale"), [("s", 1.0), ("min", 60.0), ("h", 3600.0)])
def test_time_units_and_an_arbitrary_first_time(write, unit, scale):
    """A set-point changes on the very second that is meant, though 0.1 h is not exact in binary."""
    header = [f"elapsed_time [{unit}]", *HEADER[1:]]
    seconds = 720 * np.arange(12)
    rows = [row(1000.1 + t / scale, T_set=14.0 + i % 2) for i, t in enumerate(seconds)]
    T_set = read_trend_log(write(header, rows)).series["T_set"][0]
    assert T_set.size == 720 * 11 + 1
    np.testing.assert_array_equal(np.flatnonzero(np.diff(T_set)) + 1, seconds[1:])


@pytest.mark.parametrize("form", ["%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M", "%Y-%m-%dT%H:%M:%S+02:00", "%Y-%m-%dT%TZ"])
def test_timestamps(write, form):
    begin = datetime(2024, 2, 28, 23, 59)
    rows = [[(begin + timedelta(seconds=r[0])).strftime(form), *r[1:]] for r in ROWS]
    expected = read_trend_log(write(HEADER, ROWS))
    assert read_trend_log(write(["timestamp", *HEADER[1:]], rows)) == expected


def test_start_and_hours_cut_a_window(write):
    path = write(HEADER, ROWS)
    whole = read_trend_log(path).series
    part = read_trend_log(path, start=30 / 3600, hours=45 / 3600).series
    for name, values in part.items():
        np.testing.assert_allclose(values[0], whole[name][0, 30:75], atol=1e-12)
    rest = read_trend_log(path, start=30 / 3600)
    assert rest.n_steps == 91


@pytest.mark.parametrize(("unit", "value"), [("degC", 25.0), ("degF", 77.0), ("K", 298.15)])
def test_temperature_units(write, unit, value):
    header = [cell.replace("T_a_in [degC]", f"T_a_in [{unit}]") for cell in HEADER]
    series = read_trend_log(write(header, replaced(2, [value] * 3))).series
    np.testing.assert_allclose(series["T_a_in"], 25.0, atol=1e-12)
    assert unit in TEMPERATURE


@pytest.mark.parametrize(
    ("unit", "value"),
    [
        ("kg s-1", 1.5),
        ("kg/s", 1.5),
        ("kg/h", 5400.0),
        ("lb/h", 5400 / 0.45359237),
        ("m3/s", 1.25),
        ("m3/h", 4500.0),
        ("L/s", 1250.0),
        ("cfm", 1.25 * 60 / 0.3048**3),
    ],
)
def test_air_flow_units_with_volumes_at_1_2_kg_m3(write, unit, value):
    header = [cell.replace("m_a [kg/s]", f"m_a [{unit}]") for cell in HEADER]
    series = read_trend_log(write(header, replaced(1, [repr(value)] * 3))).series
    np.testing.assert_allclose(series["m_a"], 1.5, rtol=1e-12)
    assert unit in AIR_FLOW


def test_a_temperature_difference_in_fahrenheit_has_no_offset(write):
    rows = [[*r, 1.8] for r in ROWS]
    series = read_trend_log(write([*HEADER, "noise [degF]"], rows)).series
    np.testing.assert_allclose(series["noise"], 1.0, rtol=1e-12)
    assert set(DIFFERENCE) == {"K", "degC", "degF"}


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("W_a_in [g/kg]", 10.0),
        ("W_a_in [kg/kg]", 0.01),
        ("RH_a_in [1]", "rh"),
        ("RH_a_in [percent]", "rh%"),
        ("RH_a_in [%]", "rh%"),
        ("T_dp_in [degC]", "dew"),
    ],
)
def test_humidity_in_every_form(write, column, value):
    pressure = 95e3
    T_dew = float(moist_air.dew_point(0.01, pressure))
    rh = 0.01 * pressure / (0.621945 + 0.01) / float(moist_air.saturation_pressure(25.0))
    value = {"rh": rh, "rh%": 100 * rh, "dew": T_dew}.get(value, value)
    header = [column if cell.startswith("W_a_in") else cell for cell in HEADER]
    rows = replaced(2, [25.0] * 3, replaced(3, [repr(value)] * 3))
    series = read_trend_log(write(header, rows), pressure=pressure).series
    np.testing.assert_allclose(series["W_a_in"], 0.01, rtol=1e-9)


def test_columns_and_units_rename_and_declare(write):
    header = ["Time", "SAF", "AHU1 MAT [degF]", "OA hum", "CHW", "SAT SP", "Comment"]
    rows = [[*r[:2], 77, *r[3:], "fan on"] for r in ROWS]
    boundary = read_trend_log(
        write(header, rows),
        columns={
            "elapsed_time": "Time",
            "m_a": "SAF",
            "T_a_in": "AHU1 MAT [degF]",
            "W_a_in": "OA hum",
            "T_w_in": "CHW",
            "T_set": "SAT SP",
        },
        units={"elapsed_time": "s", "m_a": "kg/s", "W_a_in": "1", "T_w_in": "degC", "T_set": "degC"},
    )
    assert boundary == read_trend_log(write(HEADER, replaced(2, [25.0] * 3)))
    by_label = read_trend_log(write(["x [s]", *HEADER[1:]], ROWS), columns={"elapsed_time": "x"})
    assert by_label == read_trend_log(write(HEADER, ROWS))


def test_constants_stand_for_absent_columns(write):
    drop = [0, 1, 2, 3, 5]
    path = write([HEADER[i] for i in drop], [[r[i] for i in drop] for r in ROWS])
    assert read_trend_log(path, constants={"T_w_in": 7.0}) == read_trend_log(write(HEADER, ROWS, "full.csv"))


def test_a_byte_order_mark_spaces_windows_ends_and_empty_lines_are_harmless(write, tmp_path):
    lines = [" , ".join(map(str, r)) for r in [HEADER, *ROWS]]
    path = tmp_path / "bom.csv"
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join([*lines, "", ""]).encode())
    assert read_trend_log(path) == read_trend_log(write(HEADER, ROWS))


# ------------------------------------------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (replaced(0, [0, 60, 60]), ["row 4 is at the same time as row 3", "drop doubles"]),
        (replaced(0, [0, 60, 30]), ["row 4 is earlier than row 3", "sort"]),
        ([*ROWS, row(180), row(500)], ["rows 5 and 6 are 320 s apart", "others 60 s", "max_gap=320"]),
        (replaced(0, [0, 0.5, 1.0]), ["rows are 0.5 s apart", "1 s or more"]),
        (replaced(2, [25, "nan", 25]), ["T_a_in is nan in row 3", "fill or cut"]),
        (replaced(2, [25, 25, "-inf"]), ["T_a_in is -inf in row 4"]),
        (replaced(2, [-999, 25, 25]), ["T_a_in = -999 degC in row 2", "missing value"]),
        (replaced(2, [25, "", 25]), ["T_a_in is blank in row 3", "fill or cut"]),
        (replaced(2, [25, "off", 25]), ["T_a_in = 'off' in row 3", "give a number"]),
        (replaced(2, [25, "24,5", 25]), ["T_a_in = '24,5' in row 3", "decimal point"]),
        (
            replaced(2, [77, 77, 77]),
            ["T_a_in = 77 degC in row 2", "from -40 to 60 degC", "check its unit", "3 samples"],
        ),
        (replaced(3, [0.01, 9.5, 9.5]), ["W_a_in = 9.5 in row 3", "from 0 to 0.1", "unit"]),
        (replaced(0, ["0", "1:00", "2:00"]), ["elapsed_time = '1:00' in row 3"]),
        (replaced(0, [0, 60, "inf"]), ["elapsed_time is inf in row 4"]),
        ([ROWS[0], ROWS[1][:-1], ROWS[2]], ["row 3 has 5 cells where the header has 6"]),
        ([ROWS[0]], ["one row of data", "at least two"]),
        ([], ["header but no data", "at least two"]),
    ],
)
def test_bad_rows_are_named_with_value_and_cure(write, rows, words):
    assert_only_problem(words, read_trend_log, write(HEADER, rows))


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ([*HEADER[:2], "T_a_in", *HEADER[3:]], ["T_a_in has no unit", "'T_a_in [degC]'", "units={'T_a_in': 'degC'}"]),
        ([*HEADER[:2], "T_a_in [celsius]", *HEADER[3:]], ["T_a_in is in 'celsius'", "degC, degF, K"]),
        ([*HEADER[:1], "m_a [kg/min]", *HEADER[2:]], ["m_a is in 'kg/min', did you mean 'kg/", "cfm"]),
        ([*HEADER[:5], "T_a_in [degC]"], ["column 'T_a_in [degC]' stands twice"]),
        ([f"time {HEADER[0]}"], ["row 2 has 6 cells where the header has 1"]),
        (["elapsed_time [s];m_a [kg/s];T_a_in [degC]"], ["';'", "use commas"]),
    ],
)
def test_bad_headers_are_named_with_the_cure(write, header, words):
    assert_only_problem(words, read_trend_log, write(header, ROWS))


def test_an_unknown_column_is_named_with_the_nearest_known_one(write):
    found = problems(read_trend_log, write([*HEADER[:2], "T_a_inn [degC]", *HEADER[3:]], ROWS))
    assert "column 'T_a_inn [degC]' is unknown, did you mean 'T_a_in'?" in found[0]
    assert "T_a_in is missing: add a column 'T_a_in [degC]'" in found[1]


def test_humidity_and_time_are_given_once(write):
    both = [*HEADER, "RH_a_in [1]"], [[*r, 0.5] for r in ROWS]
    assert_only_problem(["W_a_in and RH_a_in are both there", "give one of"], read_trend_log, write(*both))
    neither = [[cell for i, cell in enumerate(r) if i != 3] for r in [HEADER, *ROWS]]
    assert_only_problem(["W_a_in is missing", "RH_a_in, T_dp_in"], read_trend_log, write(neither[0], neither[1:]))
    untimed = [r[1:] for r in [HEADER, *ROWS]]
    assert_only_problem(["elapsed_time is missing", "timestamp"], read_trend_log, write(untimed[0], untimed[1:]))


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (["2024-07-01T08:00", "01/07/2024 08:01", "2024-07-01T08:02"], ["'01/07/2024 08:01' in row 3", "ISO 8601"]),
        (["2024-11-03T01:00-04:00", "2024-11-03T01:30-04:00", "2024-11-03T01:00-05:00"], ["row 4", "UTC offset"]),
        (["2024-11-03T01:00", "2024-11-03T01:30-04:00", "2024-11-03T02:00"], ["row 3", "UTC offset"]),
        (["2024-11-03T01:00", "2024-11-03T01:30", "2024-11-03T01:00"], ["row 4 is earlier than row 3"]),
    ],
)
def test_bad_timestamps(write, stamps, words):
    path = write(["timestamp", *HEADER[1:]], replaced(0, stamps))
    assert_only_problem(words, read_trend_log, path)


def test_a_gap_is_bridged_on_request(write):
    path = write(HEADER, [*ROWS, row(180, T_w_in=7.0), row(500, T_w_in=8.6)])
    boundary = read_trend_log(path, max_gap=320)
    assert boundary.series["T_w_in"][0, 340] == pytest.approx(7.8)


def test_all_mistakes_of_a_file_are_raised_at_once(write):
    rows = replaced(1, [1, -2, 1], replaced(2, [25, 25, "x"], replaced(4, [7, 7, -999], replaced(0, [0, 60, 60]))))
    found = problems(read_trend_log, write(HEADER, rows))
    assert len(found) == 4
    for text, words in zip(found, ("m_a = -2", "T_a_in = 'x'", "T_w_in = -999", "same time"), strict=True):
        assert words in text
        assert text.startswith("log.csv: ")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", ["is empty", "header row"]),
        (b"\n\n\n", ["is empty"]),
        ("m_a [kg/s],T_ä\n1,2\n".encode("latin-1"), ["not UTF-8", "CSV UTF-8"]),
        (b"\x00\x01\x02,\x00\n\x00,\x00\n", ["bytes.csv"]),
    ],
)
def test_bad_files(tmp_path, content, words):
    path = tmp_path / "bytes.csv"
    path.write_bytes(content)
    found = problems(read_trend_log, path)
    for word in words:
        assert word in found[0]


def test_missing_files_and_directories(tmp_path):
    assert_only_problem(["none.csv", "No such file", "give a CSV file"], read_trend_log, tmp_path / "none.csv")
    assert_only_problem([str(tmp_path), "directory", "give a CSV file"], read_trend_log, tmp_path)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"columns": {"T_a_inn": "x"}}, ["columns has unknown 'T_a_inn', did you mean 'T_a_in'?"]),
        ({"columns": {"T_a_in": "T_a_im [degC]"}}, ["T_a_in: there is no column", "did you mean 'T_a_in [degC]'?"]),
        ({"units": {"T_oa": "degC"}}, ["units has unknown 'T_oa'", "use m_a"]),
        ({"units": {"T_a_in": "degF"}}, ["T_a_in is in 'degC' by its header, in 'degF' by units"]),
        ({"constants": {"RH_a_in": 0.5}}, ["constants has unknown 'RH_a_in'"]),
        ({"constants": {"noise": "0"}}, ["constants has noise = '0'", "number"]),
        ({"constants": {"noise": 60.0}}, ["noise = 60 K", "from -50 to 50"]),
        ({"hours": 1.0}, ["hours = 1", "120 s", "lower it"]),
        ({"start": 1.0}, ["start = 1 h", "120 s"]),
        ({"start": -1.0}, ["start = -1 h", "from 0"]),
        ({"hours": 0}, ["hours = 0 h"]),
        ({"pressure": 1013.25}, ["pressure = 1013.25 Pa"]),
        ({"max_gap": 0}, ["max_gap = 0 s"]),
    ],
)
def test_bad_arguments(write, arguments, words):
    path = write(HEADER, ROWS)
    found = problems(read_trend_log, path, **arguments)
    for word in words:
        assert word in found[0], found


# ---------------------------------------------------------------------------------------------- hourly weather

PLANT = {"m_a": 1.2, "T_w_in": 7.0, "T_set": 14.0, "outdoor_fraction": 0.25, "T_return": 24.0, "RH_return": 0.5}
WEATHER_HEADER = ["hour_of_year", "month", "day", "hour", "T_drybulb_C", "T_dewpoint_C", "RH_pct", "p_Pa"]
WEATHER_ROWS = [
    [h, 1, 1 + (h - 1) // 24, (h - 1) % 24 + 1, 10.0 + h % 24 / 2, 5.0 + h % 24 / 4, 60 + h % 24, 100e3 + h]
    for h in range(1, 73)
]


def quiet_weather_day(*args, **kwargs):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return weather_day(*args, **kwargs)


def test_weather_warns_that_hours_say_nothing_about_seconds(write):
    with pytest.warns(UserWarning, match="faster than an hour"):
        weather_day(write(WEATHER_HEADER, WEATHER_ROWS), start_hour=8, **PLANT)


def test_weather_is_exact_at_full_hours_and_straight_between(write):
    path = write(WEATHER_HEADER, WEATHER_ROWS)
    series = quiet_weather_day(path, start_hour=30, hours=3, **PLANT | {"outdoor_fraction": 1.0}).series
    for k, h in enumerate((30, 31, 32)):
        T, T_dew, p = WEATHER_ROWS[h - 1][4], WEATHER_ROWS[h - 1][5], WEATHER_ROWS[h - 1][7]
        assert series["T_a_in"][0, 3600 * k] == pytest.approx(T, abs=1e-10)
        expected = moist_air.saturation_humidity_ratio(T_dew, p)
        assert series["W_a_in"][0, 3600 * k] == pytest.approx(float(expected), rel=1e-10)
    for name in ("T_a_in", "W_a_in"):
        middle = (series[name][0, 0] + series[name][0, 3600]) / 2
        assert series[name][0, 1800] == pytest.approx(middle, rel=1e-9)
    assert (series["m_a"] == 1.2).all()
    assert (series["T_set"] == 14.0).all()


def test_weather_mixes_water_and_enthalpy_with_return_air(write):
    path = write(WEATHER_HEADER, WEATHER_ROWS)
    outdoors = quiet_weather_day(path, start_hour=12, hours=1, **PLANT | {"outdoor_fraction": 1.0}).series
    indoors = quiet_weather_day(path, start_hour=12, hours=1, **PLANT | {"outdoor_fraction": 0.0}).series
    mixed = quiet_weather_day(path, start_hour=12, hours=1, **PLANT).series
    np.testing.assert_allclose(indoors["T_a_in"], 24.0, atol=1e-10)
    p_start = 100e3 + 12
    assert indoors["W_a_in"][0, 0] == pytest.approx(float(moist_air.humidity_ratio(24.0, 0.5, p_start)), rel=1e-10)
    np.testing.assert_allclose(mixed["W_a_in"], 0.25 * outdoors["W_a_in"] + 0.75 * indoors["W_a_in"], rtol=1e-12)
    h = [moist_air.enthalpy(x["T_a_in"], x["W_a_in"]) for x in (outdoors, indoors, mixed)]
    np.testing.assert_allclose(h[2], 0.25 * h[0] + 0.75 * h[1], rtol=1e-12)
    stated = {name: value for name, value in PLANT.items() if name != "RH_return"} | {"outdoor_fraction": 0.0}
    dry = quiet_weather_day(path, start_hour=12, hours=1, W_return=0.004, **stated).series
    np.testing.assert_allclose(dry["W_a_in"], 0.004, rtol=1e-12)


def test_the_start_of_a_weather_day_in_three_ways(write):
    path = write(WEATHER_HEADER, WEATHER_ROWS)
    by_hour = quiet_weather_day(path, start_hour=34, **PLANT)
    assert quiet_weather_day(path, month=1, day=2, hour=10, **PLANT) == by_hour
    days = quiet_weather_day(path, days=[3, 2], hour=10, **PLANT)
    assert days.has_day_dim
    np.testing.assert_array_equal(days.day, [3, 2])
    np.testing.assert_array_equal(days.series["T_a_in"][1], by_hour.series["T_a_in"][0])


def test_weather_by_relative_humidity_other_headers_and_pressure(write):
    header = ["hour_of_year", "a", "b", "c", "OAT [degF]", "d", "OA RH", "p_Pa"]
    rows = [[*r[:4], r[4] * 1.8 + 32, "-", r[6] / 100, r[7]] for r in WEATHER_ROWS]
    series = quiet_weather_day(
        write(header, rows),
        start_hour=30,
        hours=1,
        pressure=90e3,
        columns={"T_drybulb": "OAT", "RH": "OA RH"},
        units={"RH": "1"},
        **PLANT | {"outdoor_fraction": 1.0},
    ).series
    T, rh = WEATHER_ROWS[29][4], WEATHER_ROWS[29][6] / 100
    assert series["T_a_in"][0, 0] == pytest.approx(T, abs=1e-9)
    assert series["W_a_in"][0, 0] == pytest.approx(float(moist_air.humidity_ratio(T, rh, 90e3)), rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, ["the start is given as []", "start_hour"]),
        ({"start_hour": 3, "days": [1]}, ["start_hour", "days"]),
        ({"start_hour": 3, "hour": 4}, ["give start_hour, or"]),
        ({"start_hour": 3.5}, ["start_hour = 3.5", "whole number from 1"]),
        ({"start_hour": 0}, ["start_hour = 0"]),
        ({"start_hour": 66}, ["hours of the year 1 to 72", "66 to 73.9997", "fewer hours"]),
        ({"days": [1, 4], "hour": 8}, ["1 to 72", "80 to"]),
        ({"days": [1, 1], "hour": 8}, ["day label 1 stands twice"]),
        ({"days": 2, "hour": 8}, ["days = 2", "list"]),
        ({"days": [2]}, ["hour = None", "from 0 to 24"]),
        ({"month": 2, "day": 1, "hour": 8}, ["0 rows for month 2, day 1, hour 8", "file's own dates"]),
        ({"month": 1, "day": 2}, ["hour = None"]),
        ({"start_hour": 8, "outdoor_fraction": 1.5}, ["outdoor_fraction = 1.5", "from 0 to 1"]),
        ({"start_hour": 8, "RH_return": 50}, ["RH_return = 50"]),
        ({"start_hour": 8, "W_return": 0.008}, ["RH_return and W_return", "one of them"]),
        ({"start_hour": 8, "T_w_in": 280}, ["T_w_in = 280 degC"]),
        ({"start_hour": 8, "hours": -1}, ["hours = -1 h"]),
        ({"start_hour": 8, "columns": {"T": "T_drybulb_C"}}, ["columns has unknown 'T'"]),
        ({"start_hour": 8, "columns": {"RH": "humidity"}}, ["RH: there is no column 'humidity'"]),
        ({"start_hour": 8, "units": {"T_drybulb": "C"}}, ["T_drybulb is in 'C'", "degC, degF, K"]),
    ],
)
def test_weather_refuses(write, arguments, words):
    path = write(WEATHER_HEADER, WEATHER_ROWS)
    found = problems(quiet_weather_day, path, **PLANT | arguments)
    for word in words:
        assert word in found[0], found


def test_bad_weather_files(write):
    def message(header, rows):
        return problems(quiet_weather_day, write(header, rows), start_hour=8, **PLANT)[0]

    assert "T_drybulb is missing" in message(["hour_of_year", *"abcdefg"], WEATHER_ROWS)
    assert "hour_of_year does not rise by 1 from row 6" in message(WEATHER_HEADER, WEATHER_ROWS[:5] + WEATHER_ROWS[6:])
    fahrenheit = replaced(4, [50 + r[4] for r in WEATHER_ROWS], WEATHER_ROWS)
    assert "T_drybulb = 60.5 degC in row 2: must be from -40 to 60 degC" in message(WEATHER_HEADER, fahrenheit)
    missing = replaced(5, [-999 if i == 7 else r[5] for i, r in enumerate(WEATHER_ROWS)], WEATHER_ROWS)
    assert "T_dewpoint = -999 degC in row 9" in message(WEATHER_HEADER, missing)
    no_moisture = [[*r[:5], r[7]] for r in [WEATHER_HEADER, *WEATHER_ROWS]]
    assert "T_dewpoint and RH are both missing" in message(no_moisture[0], no_moisture[1:])


# --------------------------------------------------------------------------------------------------- real files


def real(name):
    if not (DATA / name).exists():
        pytest.skip(f"the measured series {name} is not beside this checkout")
    return DATA / name


def test_a_june_day_in_san_francisco():
    boundary = quiet_weather_day(
        real("san_francisco_tmy3_hourly.csv"), month=6, day=16, hour=15, **PLANT | {"outdoor_fraction": 1.0}
    )
    series = boundary.series
    # The file's rows of hour_of_year 3999 and 4006: 13.3 and 11.1 degC, dew point 9.4 and 8.3 degC.
    assert series["T_a_in"][0, 0] == pytest.approx(13.3, abs=1e-9)
    assert series["T_a_in"][0, 7 * 3600] == pytest.approx(11.1, abs=1e-9)
    np.testing.assert_allclose(
        moist_air.dew_point(series["W_a_in"][0, [0, 7 * 3600]], [101500, 101600]), [9.4, 8.3], atol=1e-9
    )


def test_every_week_of_a_year_of_weather_is_admissible():
    days = quiet_weather_day(real("san_francisco_tmy3_hourly.csv"), days=range(1, 365, 7), hour=8, hours=1, **PLANT)
    assert days.n_days == 52
    assert 15.0 < days.series["T_a_in"].min() < days.series["T_a_in"].max() < 28.0


def test_a_measured_air_handler_log():
    """105 h of a hunting valve, 5 s; the log has no flows or humidity, which are given as numbers."""
    boundary = read_trend_log(
        real("b33_ahu2_5s.csv"),
        hours=24.0,
        start=24.0,
        columns={"elapsed_time": "time_s", "T_a_in": "T_out_C", "T_set": "T_sup_set_C", "enabled": "fan_enable"},
        units={"elapsed_time": "s", "T_a_in": "degC", "T_set": "degC", "enabled": "1"},
        constants={"m_a": 5.0, "W_a_in": 0.008, "T_w_in": 7.0},
    )
    assert boundary.hours == 24.0
    with (DATA / "b33_ahu2_5s.csv").open() as file:
        log = {float(r["time_s"]): r for r in csv.DictReader(file)}
    for second in (0, 36_000, 86_395):
        recorded = log[86_400.0 + second]
        assert boundary.series["T_a_in"][0, second] == pytest.approx(float(recorded["T_out_C"]), abs=1e-9)
        assert boundary.series["T_set"][0, second] == pytest.approx(float(recorded["T_sup_set_C"]), abs=1e-12)
        assert boundary.series["enabled"][0, second + 4] == float(recorded["fan_enable"])
