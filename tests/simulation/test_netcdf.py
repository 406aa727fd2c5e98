"""Results on disk: what was written comes back, and damage is reported."""

import netCDF4
import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from fastcoil.errors import IntegrityError, StorageError
from fastcoil.outputs import METRICS
from fastcoil.simulation import netcdf

pytestmark = pytest.mark.kernel


def test_adding_a_day_changes_no_scenario():
    loop = fc.Loop(noise_std=0.05)
    one = fc.simulate(loop, fc.paper_day(hours=0.25, seed=1), warm_up=60)
    two = fc.simulate(loop, fc.paper_day(hours=0.25, seed=[1, 2]), warm_up=60)
    assert float(two.rmse.sel(day=1)) == float(one.rmse)


def test_a_result_survives_netcdf(tmp_path, swept):
    netcdf.save(swept, tmp_path / "results.nc")
    back = netcdf.load(tmp_path / "results.nc")
    assert back.content_sha256 == swept.content_sha256
    xr.testing.assert_identical(back.drop_attrs(), swept.drop_attrs())
    assert all(back[name].attrs["units"] == swept[name].attrs["units"] for name in METRICS)
    assert [path.name for path in tmp_path.iterdir()] == ["results.nc"]
    assert fc.Loop.from_dataset(back).sizes == fc.Loop.from_dataset(swept).sizes


def test_words_and_open_loops_survive_netcdf(tmp_path, days):
    loop = fc.Loop(action=["cooling", "heating"], kp=xr.DataArray([0.1, 0.2], dims="case", coords={"case": ["a", "ß"]}))
    ds = fc.simulate(loop, days, command=np.full(900, 0.3), traces=["mode"], warm_up=60)
    netcdf.save(ds, tmp_path / "results.nc")
    back = netcdf.load(tmp_path / "results.nc")
    assert back.case.values.tolist() == ["a", "ß"]
    assert back.content_sha256 == ds.content_sha256


def test_no_coordinate_is_said_to_have_missing_values(tmp_path, swept):
    netcdf.save(swept, tmp_path / "results.nc")
    with netCDF4.Dataset(tmp_path / "results.nc") as file:
        assert not [n for n in map(str, swept.coords) if "_FillValue" in file[n].ncattrs()]
        assert "_FillValue" in file["rmse"].ncattrs()


def test_a_file_of_a_later_version_is_refused(tmp_path, swept):
    netcdf.save(swept.assign_attrs(fastcoil_format=99), tmp_path / "results.nc")
    with pytest.raises(fc.InputError, match="later version"):
        netcdf.load(tmp_path / "results.nc")


def damaged_value(ds):
    ds.rmse[0, 1, 0, 1, 0] += 1e-15


def damaged_label(ds):
    ds["backlash"] = [0.0, np.nextafter(0.07, 1.0), 0.15]


def damaged_unit(ds):
    ds.rmse.attrs["units"] = "degC"


def damaged_parameter(ds):
    ds.attrs["parameters"] = ds.attrs["parameters"].replace("8.8", "8.9")


@pytest.mark.parametrize("damage", [damaged_value, damaged_label, damaged_unit, damaged_parameter])
def test_a_changed_file_is_detected(tmp_path, swept, damage):
    changed = swept.copy(deep=True)
    damage(changed)
    netcdf.save(changed, tmp_path / "results.nc")
    with pytest.raises(IntegrityError, match="is damaged \\(content_sha256 differs\\)"):
        netcdf.load(tmp_path / "results.nc")


@pytest.mark.parametrize("keep", [0.0, 0.01, 0.5])
def test_a_cut_file_is_detected(tmp_path, swept, keep):
    path = tmp_path / "results.nc"
    netcdf.save(swept, path)
    image = path.read_bytes()
    path.write_bytes(image[: int(keep * len(image))])
    with pytest.raises(IntegrityError, match=r"results\.nc"):
        netcdf.load(path)


def test_a_missing_file_and_an_unwritable_place(tmp_path, swept):
    with pytest.raises(fc.InputError, match="does not exist"):
        netcdf.load(tmp_path / "none.nc")
    with pytest.raises(StorageError, match="cannot be written"):
        netcdf.save(swept, tmp_path / "no folder" / "results.nc")


def test_saving_over_a_result_leaves_one_of_the_two(tmp_path, swept):
    path = tmp_path / "results.nc"
    netcdf.save(swept, path)
    other = fc.simulate(fc.Loop(), fc.paper_day(hours=0.1), warm_up=0)
    netcdf.save(other, path)
    assert netcdf.load(path).content_sha256 == other.content_sha256
