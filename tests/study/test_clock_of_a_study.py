"""Date and time of a log in the folder of its study: opened again, checked, and read by others."""

import numpy as np
import pytest
import xarray as xr
from helpers.trend_logs import HEADER, ROWS

import fastcoil as fc
from fastcoil.study.maintenance import verify

pytestmark = pytest.mark.kernel

STUDY = """
[loop]
backlash = [0.02, 0.07]
[boundary]
kind = "csv"
path = "log.csv"
[run]
warm_up = 60
traces = ["T_sup"]
trace_interval = 30
"""
STAMPS = [f"2024-07-01T08:0{k}:00-07:00" for k in range(3)]


def test_a_study_opened_again_has_the_start_and_the_time_of_its_traces(write_log, tmp_path):
    write_log(["timestamp", *HEADER[1:]], [[stamp, *row[1:]] for stamp, row in zip(STAMPS, ROWS, strict=True)])
    path, folder = tmp_path / "study.toml", tmp_path / "out"
    path.write_text(STUDY)
    fc.run_study(path, folder, n_jobs=1)
    ds = fc.open_study(folder)
    assert ds.start.values == np.datetime64("2024-07-01T08:00")
    assert ds.start.attrs["time_zone"] == ds.time.attrs["time_zone"] == "UTC-07:00"
    seconds = (ds.time.values - ds.start.values) / np.timedelta64(1, "s")
    np.testing.assert_array_equal(seconds, ds.elapsed_time)
    assert verify(folder) == []
    with xr.open_dataset(folder / "results.nc") as others:
        assert others.start.values == ds.start.values
    (traces,) = folder.glob("traces-*.nc")
    with xr.open_dataset(traces) as others:
        np.testing.assert_array_equal(others.time.values, ds.time.values)
