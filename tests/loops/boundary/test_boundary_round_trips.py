"""A boundary as a dataset, in a file, pickled and copied: it comes back as it was."""

import copy
import pickle

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import only_problem

from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import paper_day
from fastcoil.loops.boundary.series import BOUNDARY_SERIES


@pytest.mark.parametrize("seed", [1, [5, 3]])
def test_dataset_pickle_and_copy_round_trips(seed):
    boundary = paper_day(0.1, seed)
    for other in (
        Boundary.from_dataset(boundary.to_dataset()),
        pickle.loads(pickle.dumps(boundary)),
        copy.deepcopy(boundary),
    ):
        assert other == boundary
        np.testing.assert_array_equal(other.day, boundary.day)
        assert other.has_day_dim == boundary.has_day_dim
        assert not other.series["m_a"].flags.writeable


def test_netcdf_round_trip(tmp_path):
    pytest.importorskip("netCDF4")
    boundary = paper_day(0.05, [5, 3])
    boundary.to_dataset().to_netcdf(tmp_path / "day.nc")
    with xr.open_dataset(tmp_path / "day.nc") as ds:
        assert Boundary.from_dataset(ds) == boundary


def test_dataset_has_units_names_and_coordinates():
    ds = paper_day(0.1, [5, 3]).to_dataset()
    assert ds.sizes == {"day": 2, "elapsed_time": 360}
    assert ds.elapsed_time.attrs["units"] == "s"
    assert ds.elapsed_time.values[-1] == 359.0
    for name, series in BOUNDARY_SERIES.items():
        assert ds[name].attrs["units"] == series.unit
        assert ds[name].attrs["long_name"]
    assert ds.noise.attrs["units_metadata"] == "temperature: difference"
    assert paper_day(0.1).to_dataset().m_a.dims == ("elapsed_time",)


def test_one_day_cut_out_of_a_dataset_keeps_its_label():
    ds = paper_day(0.1, [5, 3]).to_dataset()
    one = Boundary.from_dataset(ds.isel(day=1))
    assert not one.has_day_dim
    np.testing.assert_array_equal(one.day, [3])
    np.testing.assert_array_equal(one.series["m_a"], ds.m_a.values[1:])


def test_from_dataset_ignores_other_variables_and_any_start():
    ds = paper_day(0.1).to_dataset()
    ds["T_outside"] = ("elapsed_time", np.full(360, np.nan))
    later = Boundary.from_dataset(ds.isel(elapsed_time=slice(100, None)))
    np.testing.assert_array_equal(later.series["m_a"][0], ds.m_a.values[100:])


def test_from_dataset_is_strict():
    ds = paper_day(0.1).to_dataset()
    message = only_problem(Boundary.from_dataset, ds.isel(elapsed_time=slice(None, None, 5)))
    assert "elapsed_time has a step of 5 s after sample 0: give 1-s steps" in message
    gap = ds.isel(elapsed_time=[*range(50), *range(53, 360)])
    assert "elapsed_time has a step of 4 s after sample 49" in only_problem(Boundary.from_dataset, gap)
    message = only_problem(Boundary.from_dataset, ds.drop_vars("T_w_in"))
    assert "T_w_in is missing" in message
    assert "entering water temperature" in message
    assert "units" in only_problem(Boundary.from_dataset, ds.assign(m_a=ds.m_a.drop_attrs()))
    assert "coordinate" in only_problem(Boundary.from_dataset, ds.drop_vars("elapsed_time"))
