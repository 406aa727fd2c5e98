"""Date, time and zone of a boundary, in results and in files."""

from datetime import date, datetime, timedelta, timezone
from zoneinfo import ZoneInfo

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.series import is_clock_changed
from fastcoil.loops.netcdf import with_decoded_times, with_encoded_times
from fastcoil.loops.provenance import content_sha256

pytestmark = pytest.mark.kernel


ONE_DAY = {"m_a": 1.0, "T_a_in": 25.0, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": np.full(3600, 14.0)}
EIGHT = np.datetime64("2024-07-01T08:00:00")
THREE_HOURS_LATER = timezone(timedelta(hours=3, minutes=30))


@pytest.mark.parametrize(
    ("start", "zone"),
    [
        ("2024-07-01T08:00", ""), (datetime(2024, 7, 1, 8), ""), (EIGHT, ""),
        (xr.DataArray(EIGHT.astype("datetime64[ns]")), ""), ("2024-07-01T08:00-07:00", "UTC-07:00"),
        (datetime(2024, 7, 1, 8, tzinfo=THREE_HOURS_LATER), "UTC+03:30"),
        (datetime(2024, 7, 1, 8, tzinfo=ZoneInfo("Europe/Berlin")), "Europe/Berlin"),
    ],
)  # fmt: skip
def test_a_start_is_the_time_on_the_clock_and_its_offset_the_zone(start, zone):
    boundary = Boundary(**ONE_DAY, start=start)
    assert boundary.start.dtype == np.dtype("datetime64[s]")
    np.testing.assert_array_equal(boundary.start, [EIGHT])
    assert boundary.time_zone == zone


def test_without_a_start_nothing_is_known_and_nothing_else_changes():
    plain, known = Boundary(**ONE_DAY), Boundary(**ONE_DAY, start=EIGHT, time_zone="UTC-08:00")
    assert (plain.start, plain.time_zone) == (None, "")
    assert known == plain
    assert known.sha256 == plain.sha256
    assert repr(known).startswith("<fastcoil.Boundary 1 h from 2024-07-01 08:00:00 (UTC-08:00), sha256")


def test_one_start_is_that_of_consecutive_days_and_several_are_those_of_each():
    there = datetime(2024, 3, 9, tzinfo=ZoneInfo("America/Los_Angeles"))
    changed = [there, there + timedelta(days=2)]  # of another UTC offset
    assert Boundary(**ONE_DAY, day=[1, 3], start=changed).time_zone == "America/Los_Angeles"
    days = Boundary(**ONE_DAY, day=[5, 6, 7], start="2024-02-28T08:00")
    np.testing.assert_array_equal(days.start, np.array(["2024-02-28T08", "2024-02-29T08", "2024-03-01T08"], "M8[s]"))
    days = Boundary(**ONE_DAY, day=[5, 6], start=[date(2024, 5, 1), "2023-01-01T12:00"])
    np.testing.assert_array_equal(days.start, np.array(["2024-05-01", "2023-01-01T12"], "M8[s]"))
    days.start[0] = EIGHT
    assert days.start[0] != EIGHT


@pytest.mark.parametrize(
    ("start", "changed"),
    [
        ("2024-03-10T00:00", True), ("2024-03-09T00:00", False), ("2024-11-03T00:00", True),
        ("2024-11-03T03:00", False), ("2024-11-03T01:30", True), ("2024-03-09T18:00", False),
        ("2024-03-09T18:01", True),
    ],
)  # fmt: skip
def test_a_change_of_clocks_is_found(start, changed):
    assert is_clock_changed("America/Los_Angeles", np.datetime64(start, "s"), 8 * 3600) is changed
    assert not is_clock_changed("UTC-08:00", np.datetime64(start, "s"), 8 * 3600)
    assert not is_clock_changed("", np.datetime64(start, "s"), 8 * 3600)
    # an hour that comes twice
    assert is_clock_changed("America/Los_Angeles", np.datetime64("2024-11-03T01:30", "s"), 600)
    assert not is_clock_changed("America/Los_Angeles", np.datetime64("2024-11-03T02:30", "s"), 600)


@pytest.mark.parametrize(
    ("field", "code", "options"),
    [
        ("start", "value", {"start": "yesterday"}), ("start", "value", {"start": np.datetime64("NaT", "s")}),
        ("start", "type", {"start": [["2024-01-01"], ["2024-01-01", "2024-01-02"]], "day": [1, 2]}),
        ("start", "value", {"start": "1066-10-14"}),
        ("start", "shape", {"start": ["2024-01-01"] * 2, "day": [1, 2, 3]}),
        ("start", "conflict", {"start": ["2024-01-01", "2024-01-02T00:00Z"], "day": [1, 2]}),
        ("start", "time", {"start": "2024-03-10T02:30", "time_zone": "America/Los_Angeles"}),
        ("start", "conflict", {"start": ["2024-03-09T00:00-08:00", "2024-03-11T00:00-07:00"], "day": [1, 2]}),
        ("start", "conflict", {"start": "2024-07-01T08:00-08:00", "time_zone": "America/Los_Angeles"}),
        ("time_zone", "choice", {"time_zone": "America/Los_Angelos"}), ("time_zone", "choice", {"time_zone": "UTC-8"}),
        ("time_zone", "choice", {"time_zone": "UTC+14:30"}), ("time_zone", "choice", {"time_zone": "UTC-12:01"}),
        ("time_zone", "choice", {"start": "2024-07-01T08:00+14:30"}),
    ],
)  # fmt: skip
def test_a_bad_clock_is_refused(field, code, options):
    assert_refused(field, code, Boundary, **ONE_DAY, **options)


def test_the_clock_comes_back_from_a_dataset_and_a_file(tmp_path):
    for day in (3, [3, 4]):
        boundary = Boundary(**ONE_DAY, day=day, start=EIGHT, time_zone="America/Los_Angeles")
        ds = boundary.to_dataset()
        assert ds.start.dims == (("day",) if boundary.has_day_dim else ())
        assert ds.start.attrs["time_zone"] == "America/Los_Angeles"
        ds.to_netcdf(tmp_path / "days.nc")
        with xr.open_dataset(tmp_path / "days.nc") as stored:
            back = Boundary.from_dataset(stored)
        assert back == boundary
        np.testing.assert_array_equal(back.start, boundary.start)
        assert back.time_zone == boundary.time_zone


def test_a_later_part_of_a_dataset_starts_later():
    ds = Boundary(**ONE_DAY, start=EIGHT).to_dataset()
    later = Boundary.from_dataset(ds.isel(elapsed_time=slice(90, None)))
    assert later.start[0] == np.datetime64("2024-07-01T08:01:30")
    assert_refused("start", "type", Boundary.from_dataset, ds.assign_coords(start=5.0))


DAYS = fc.paper_day(0.05, [4, 2]).assign(start="2024-07-01T08:00", time_zone="America/Los_Angeles")


def simulate_loop(boundary, **options):
    return fc.simulate(fc.Loop(backlash=[0.02, 0.07]), boundary, warm_up=60, n_jobs=1, **options)


def test_the_content_of_a_result_is_the_same_after_a_file(tmp_path):
    ds = simulate_loop(DAYS.sel(4), traces=["T_sup"], trace_interval=60)
    ds.to_netcdf(tmp_path / "result.nc")
    with xr.open_dataset(tmp_path / "result.nc") as back:
        assert content_sha256(back) == content_sha256(ds) == ds.attrs["content_sha256"]
        assert back.start.attrs["time_zone"] == "America/Los_Angeles"
    assert ds.start.values == np.datetime64("2024-07-01T08:00")
    np.testing.assert_array_equal(ds.time, ds.start.values + np.array([0, 60, 120], "m8[s]"))
    assert ds.time.dims == ("elapsed_time",)
    where_clocks_change = fc.paper_day(0.05).assign(start="2024-03-10T01:58", time_zone="America/Los_Angeles")
    assert "time" not in simulate_loop(where_clocks_change, traces=["T_sup"]).coords
    moved = ds.assign_coords(start=ds.start + np.timedelta64(1, "s"))
    assert content_sha256(moved) != content_sha256(ds)


def test_in_a_file_times_are_whole_seconds_since_1970():
    stored = with_encoded_times(DAYS.to_dataset())
    assert stored.start.dtype == np.int64
    assert stored.start.attrs["units"] == "seconds since 1970-01-01 00:00:00"
    np.testing.assert_array_equal(stored.start, [1719820800, 1719907200])
    xr.testing.assert_identical(with_decoded_times(stored), DAYS.to_dataset())
