"""Date and time from the boundary to the result, to the file and back."""

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import only_problem

import fastcoil as fc
from fastcoil.loops.netcdf import with_numbers, with_times
from fastcoil.loops.plan import plan_simulation
from fastcoil.loops.provenance import content_sha256

pytestmark = pytest.mark.kernel

LOOP = fc.Loop(backlash=[0.02, 0.07])
DAYS = fc.paper_day(0.05, [4, 2]).assign(start="2024-07-01T08:00", time_zone="America/Los_Angeles")


def run(boundary, **options):
    return fc.simulate(LOOP, boundary, warm_up=60, n_jobs=1, **options)


def test_several_days_have_their_starts_and_one_the_time_of_its_traces():
    ds = run(DAYS, traces=["T_sup"], trace_interval=60)
    assert ds.start.dims == ("day",)
    np.testing.assert_array_equal(ds.start.values, DAYS.start.astype("M8[ns]"))
    assert ds.start.attrs["time_zone"] == "America/Los_Angeles"
    assert "time" not in ds.coords
    one = run(DAYS.sel(2), traces=["T_sup"], trace_interval=60)
    assert one.start.values == np.datetime64("2024-07-02T08:00")
    assert one.time.dims == ("elapsed_time",)
    np.testing.assert_array_equal(
        one.time.values, np.array(["2024-07-02T08:00", "2024-07-02T08:01", "2024-07-02T08:02"], "M8[ns]")
    )
    assert "time" not in run(DAYS.sel(2)).coords


def test_where_clocks_are_changed_traces_have_no_time():
    day = fc.paper_day(0.05).assign(start="2024-03-10T01:58", time_zone="America/Los_Angeles")
    ds = run(day, traces=["T_sup"])
    assert "start" in ds.coords
    assert "time" not in ds.coords


def test_without_a_start_a_result_has_no_clock_and_the_same_numbers():
    plain, known = run(DAYS.assign(start=None, time_zone=None)), run(DAYS)
    assert not {"start", "time"} & set(plain.coords)
    assert known.attrs["boundary_sha256"] == plain.attrs["boundary_sha256"]
    xr.testing.assert_identical(known.drop_vars("start").drop_attrs(), plain.drop_attrs())


def test_the_content_of_a_result_is_the_same_after_a_file(tmp_path):
    pytest.importorskip("netCDF4")
    ds = run(DAYS.sel(4), traces=["T_sup"], trace_interval=60)
    ds.to_netcdf(tmp_path / "result.nc")
    with xr.open_dataset(tmp_path / "result.nc") as back:
        assert content_sha256(back) == content_sha256(ds) == ds.attrs["content_sha256"]
        assert back.start.attrs["time_zone"] == "America/Los_Angeles"
    moved = ds.assign_coords(start=ds.start + np.timedelta64(1, "s"))
    assert content_sha256(moved) != content_sha256(ds)


def test_in_a_file_times_are_whole_seconds_since_1970():
    stored = with_numbers(DAYS.to_dataset())
    assert stored.start.dtype == np.int64
    assert stored.start.attrs["units"] == "seconds since 1970-01-01 00:00:00"
    np.testing.assert_array_equal(stored.start, [1719820800, 1719907200])
    xr.testing.assert_identical(with_times(stored), DAYS.to_dataset())


def test_a_sweep_that_uses_the_name_of_the_clock_is_refused():
    loop = fc.Loop(kp=("start", [0.01, 0.02]))
    assert "start is swept, and the boundary has a start" in only_problem(plan_simulation, loop, DAYS, warm_up=60)
    assert plan_simulation(loop, DAYS.assign(start=None), warm_up=60).n_scenarios == 4
