"""Trend logs: exact conversions of units, holds and straight lines, times, mistakes."""

import numpy as np
import pytest
from helpers.refusals import assert_refused
from helpers.trend_logs import HEADER, ROWS, replace_column, row
from helpers.weather_years import CSV_HEADER, epw, hours_from, tmy3

from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import paper_day
from fastcoil.loops.boundary.weather import weather_day
from fastcoil.model import moist_air


def test_continuous_series_run_straight_and_switches_hold(write_log):
    header = [*HEADER, "noise [K]", "enabled [1]"]
    rows = [[*r, noise, on] for r, noise, on in zip(ROWS, (0.0, 0.6, -0.6), (1, 0, 1), strict=True)]
    series = Boundary.from_csv(write_log(header, rows)).series
    t = np.arange(121)
    np.testing.assert_allclose(series["m_a"][0], np.where(t < 60, 1 + 0.01 * t, 1.6 - 0.01 * (t - 60)), atol=1e-12)
    np.testing.assert_allclose(series["T_a_in"][0], 25 + np.maximum(t - 60, 0) / 30, atol=1e-12)
    np.testing.assert_array_equal(series["T_set"][0], np.select([t < 60, t < 120], [14.0, 15.0], 14.0))
    np.testing.assert_array_equal(series["enabled"][0], np.select([t < 60, t < 120], [1.0, 0.0], 1.0))
    np.testing.assert_allclose(series["noise"][0, [30, 60, 90]], [0.3, 0.6, 0.0], atol=1e-12)


def test_a_log_of_1_s_samples_is_read_to_the_bit(write_log):
    boundary = paper_day(0.1, seed=0)  # its label, 0, is that of a log
    names = ["m_a", "T_a_in", "W_a_in", "T_w_in", "T_set"]
    columns = np.array([boundary.series[name][0] for name in names]).T
    rows = [[t, *map(repr, map(float, values))] for t, values in enumerate(columns)]
    assert Boundary.from_csv(write_log(HEADER, rows)) == boundary


@pytest.mark.parametrize(("unit", "scale"), [("s", 1.0), ("min", 60.0), ("h", 3600.0)])
def test_time_units_and_an_arbitrary_first_time(write_log, unit, scale):
    """A set-point changes on the very second that is meant, though 0.1 h is not exact in binary."""
    header = [f"elapsed_time [{unit}]", *HEADER[1:]]
    seconds = 720 * np.arange(12)
    rows = [row(1000.1 + t / scale, T_set=14.0 + i % 2) for i, t in enumerate(seconds)]
    T_set = Boundary.from_csv(write_log(header, rows)).series["T_set"][0]
    assert T_set.size == 720 * 11 + 1
    np.testing.assert_array_equal(np.flatnonzero(np.diff(T_set)) + 1, seconds[1:])


def test_start_and_hours_cut_a_window(write_log):
    path = write_log(HEADER, ROWS)
    whole = Boundary.from_csv(path).series
    part = Boundary.from_csv(path, start=30 / 3600, hours=45 / 3600).series
    for name, values in part.items():
        np.testing.assert_allclose(values[0], whole[name][0, 30:75], atol=1e-12)
    rest = Boundary.from_csv(path, start=30 / 3600)
    assert (rest.n_steps, rest.start) == (91, None)


@pytest.mark.parametrize(
    ("column", "value"), [("W_a_in [g/kg]", 10.0), ("RH_a_in [%]", "rh%"), ("T_dp_in [degC]", "dew")]
)
def test_humidity_in_every_form(write_log, column, value):
    pressure = 95e3
    T_dew = float(moist_air.dew_point(0.01, pressure))
    rh = 0.01 * pressure / (0.621945 + 0.01) / float(moist_air.saturation_pressure(25.0))
    value = {"rh%": 100 * rh, "dew": T_dew}.get(value, value)
    header = [column if cell.startswith("W_a_in") else cell for cell in HEADER]
    rows = replace_column(2, [25.0] * 3, replace_column(3, [repr(value)] * 3))
    series = Boundary.from_csv(write_log(header, rows), pressure=pressure).series
    np.testing.assert_allclose(series["W_a_in"], 0.01, rtol=1e-9)


def test_columns_and_units_rename_and_declare(write_log):
    header = ["Time", "SAF", "AHU1 MAT [degF]", "OA hum", "CHW", "SAT SP", "Comment"]
    rows = [[*r[:2], 77, *r[3:], "fan on"] for r in ROWS]
    boundary = Boundary.from_csv(
        write_log(header, rows),
        columns=dict(zip(("elapsed_time", "m_a", "T_a_in", "W_a_in", "T_w_in", "T_set"), header, strict=False)),
        units={"elapsed_time": "s", "m_a": "kg/s", "W_a_in": "1", "T_w_in": "degC", "T_set": "degC"},
    )
    assert boundary == Boundary.from_csv(write_log(HEADER, replace_column(2, [25.0] * 3)))
    by_label = Boundary.from_csv(write_log(["x [s]", *HEADER[1:]], ROWS), columns={"elapsed_time": "x"})
    assert by_label == Boundary.from_csv(write_log(HEADER, ROWS))


@pytest.mark.parametrize(
    ("field", "code", "rows"),
    [
        ("elapsed_time", "time", [*ROWS, row(180), row(500)]),
        ("T_a_in", "value", replace_column(2, [25, 25, "-inf"])),
        ("T_a_in", "value", replace_column(2, [77, 77, 77])),
    ],
)
def test_bad_rows_are_refused(write_log, field, code, rows):
    assert_refused(field, code, Boundary.from_csv, write_log(HEADER, rows))


@pytest.mark.parametrize(
    ("field", "code", "value"),
    [
        ("constants", "value", {"noise": 60.0}), ("hours", "value", 1.0), ("start", "value", 1.0),
        ("pressure", "value", 1013.25),
    ],
)  # fmt: skip
def test_bad_arguments_are_refused(write_log, field, code, value):
    assert_refused(field, code, Boundary.from_csv, write_log(HEADER, ROWS), **{field: value})


OUTDOORS = {"m_a": 1.2, "T_w_in": 7.0, "T_set": 14.0, "T_return": 24.0, "RH_return": 0.5, "outdoor_fraction": 1.0}
pytestmark = pytest.mark.filterwarnings("ignore:hourly weather", "ignore:log.csv. timestamp")


@pytest.mark.parametrize(
    ("stamps", "start", "zone"),
    [
        (["2024-07-01T08:00:00", "2024-07-01T08:01:00", "2024-07-01T08:02:00"], "2024-07-01T08:00", ""),
        (["2024-07-01T08:00-07:00", "2024-07-01T08:01-07:00", "2024-07-01T08:02-07:00"], "2024-07-01T08", "UTC-07:00"),
        (["2024-07-01T08:00-07:00", "2024-07-01T09:01-06:00", "2024-07-01T08:02-07:00"], "2024-07-01T15", "UTC"),
        (["1719820800", "1719820860", "1719820920"], "2024-07-01T08:00", "UTC"),
        (["2024-07-01T08:00:00.6", "2024-07-01T08:01:00.6", "2024-07-01T08:02:00.6"], "2024-07-01T08:00:01", ""),
    ],
)
def test_a_log_starts_at_its_first_timestamp_on_the_clock_that_wrote_it(write_log, stamps, start, zone):
    rows = [[stamp, *row[1:]] for stamp, row in zip(stamps, ROWS, strict=True)]
    boundary = Boundary.from_csv(write_log(["timestamp", *HEADER[1:]], rows))
    np.testing.assert_array_equal(boundary.start, [np.datetime64(start, "s")])
    assert boundary.time_zone == zone


def read_weather_day(path, **options):
    return weather_day(path, **OUTDOORS | {"hours": 1.0} | options)


@pytest.mark.parametrize(("form", "base"), [(epw, 1980), (tmy3, 1982)])
def test_weather_starts_at_the_date_in_the_file_in_its_time_zone(tmp_path, form, base):
    """The years of the made-up files go with the month: in a new month it is another year, also at midnight."""
    path = tmp_path / "site.epw"
    path.write_text("\n".join(form(hours_from(1, 30, 96))))
    assert read_weather_day(path, days=30, hour=10).start[0] == np.datetime64(f"{base + 1}-01-30T10:00:00")
    days = read_weather_day(path, days=[31, 32], hour=0)
    np.testing.assert_array_equal(days.start, np.array([f"{base + 1}-01-31", f"{base + 2}-02-01"], "M8[s]"))
    assert days.time_zone == "UTC-05:00"
    by_hour = read_weather_day(path, days=31, hour=24)  # hour 24 of 31 January
    assert by_hour.start[0] == np.datetime64(f"{base + 2}-02-01T00:00:00")


def test_weather_without_years_or_zone_tells_none(write_log, tmp_path):
    rows = hours_from(6, 14, 24)
    boundary = read_weather_day(write_log(CSV_HEADER, [row.values() for row in rows]), days=165, hour=3)
    assert boundary.start is None
    path = tmp_path / "site.epw"
    path.write_text("\n".join(epw(rows)).replace("-5.0,36.0", "here,36.0").replace("\n1986,", "\nnever,"))
    boundary = read_weather_day(path, days=165, hour=3)
    assert (boundary.start, boundary.time_zone) == (None, "")
