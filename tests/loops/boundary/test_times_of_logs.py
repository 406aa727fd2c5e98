"""When a log or a weather file begins, on which clock: kept as the start of the boundary."""

import warnings

import numpy as np
import pytest
from helpers.trend_logs import HEADER, ROWS
from helpers.weather_years import CSV_HEADER, epw, hours_from, tmy3

from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.weather import weather_day

STAMPED = ["timestamp", *HEADER[1:]]
OUTDOORS = {"m_a": 1.2, "T_w_in": 7.0, "T_set": 14.0, "T_return": 24.0, "RH_return": 0.5, "outdoor_fraction": 1.0}


def log_of(write, stamps, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        rows = [[stamp, *row[1:]] for stamp, row in zip(stamps, ROWS, strict=True)]
        return Boundary.from_csv(write(STAMPED, rows), **options)


@pytest.mark.parametrize(
    ("stamps", "start", "zone"),
    [
        (["2024-07-01T08:00:00", "2024-07-01T08:01:00", "2024-07-01T08:02:00"], "2024-07-01T08:00", ""),
        (["2024-07-01T08:00-07:00", "2024-07-01T08:01-07:00", "2024-07-01T08:02-07:00"], "2024-07-01T08", "UTC-07:00"),
        (["2024-07-01T08:00Z", "2024-07-01T08:01Z", "2024-07-01T08:02Z"], "2024-07-01T08:00", "UTC"),
        (["2024-07-01T08:00-07:00", "2024-07-01T09:01-06:00", "2024-07-01T08:02-07:00"], "2024-07-01T15", "UTC"),
        (["1719820800", "1719820860", "1719820920"], "2024-07-01T08:00", "UTC"),
        (["45474.333333", "45474.334028", "45474.334722"], "2024-07-01T08:00", ""),
        (["07/25/2024 8:05 PM", "07/25/2024 8:06 PM", "07/25/2024 8:07 PM"], "2024-07-25T20:05", ""),
        (
            ["25.07.2024 8:05 +0200", "25.07.2024 8:06 +0200", "25.07.2024 8:07 +0200"],
            "2024-07-25T08:05",
            "UTC+02:00",
        ),
        (["2024-07-01T08:00:00.6", "2024-07-01T08:01:00.6", "2024-07-01T08:02:00.6"], "2024-07-01T08:00:01", ""),
    ],
)
def test_a_log_starts_at_its_first_timestamp_on_the_clock_that_wrote_it(write, stamps, start, zone):
    boundary = log_of(write, stamps)
    np.testing.assert_array_equal(boundary.start, [np.datetime64(start, "s")])
    assert boundary.time_zone == zone


def test_a_later_start_in_the_log_is_a_later_start_of_the_boundary(write):
    boundary = log_of(write, ["2024-07-01T08:00", "2024-07-01T08:01", "2024-07-01T08:02"], start=30 / 3600)
    assert boundary.start[0] == np.datetime64("2024-07-01T08:00:30")


def test_seconds_alone_tell_no_date(write):
    assert Boundary.from_csv(write(HEADER, ROWS)).start is None


def day_of(path, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return weather_day(path, **OUTDOORS | {"hours": 1.0} | options)


@pytest.mark.parametrize(("form", "base"), [(epw, 1980), (tmy3, 1982)])
def test_weather_starts_at_the_date_in_the_file_in_its_time_zone(tmp_path, form, base):
    """The years of the made-up files go with the month: in a new month it is another year, also at midnight."""
    path = tmp_path / "site.epw"
    path.write_text("\n".join(form(hours_from(1, 30, 96))))
    assert day_of(path, month=1, day=30, hour=10).start[0] == np.datetime64(f"{base + 1}-01-30T10:00:00")
    days = day_of(path, days=[31, 32], hour=0)
    np.testing.assert_array_equal(days.start, np.array([f"{base + 1}-01-31", f"{base + 2}-02-01"], "M8[s]"))
    assert days.time_zone == "UTC-05:00"
    by_hour = day_of(path, start_hour=24 * 31)  # hour 24 of 31 January
    assert by_hour.start[0] == np.datetime64(f"{base + 2}-02-01T00:00:00")


def test_weather_without_years_or_zone_tells_none(write, tmp_path):
    rows = hours_from(6, 14, 24)
    boundary = day_of(write(CSV_HEADER, [row.values() for row in rows]), month=6, day=14, hour=3)
    assert boundary.start is None
    path = tmp_path / "site.epw"
    path.write_text("\n".join(epw(rows)).replace("-5.0,36.0", "here,36.0").replace("\n1986,", "\nnever,"))
    boundary = day_of(path, month=6, day=14, hour=3)
    assert boundary.start is None
    assert boundary.time_zone == ""
