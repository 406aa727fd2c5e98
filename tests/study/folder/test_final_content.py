"""What results hold must be what their hash says, and of a version that is known."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.studies import PLAIN, golden, run

import fastcoil as fc
from fastcoil.errors import IntegrityError
from fastcoil.simulation import netcdf, stored_file
from fastcoil.study.folder.final import open_final
from fastcoil.study.folder.manifest import Manifest

pytestmark = pytest.mark.kernel


def opened(folder):
    """Open results whose bytes are as they were written, whatever they say."""
    hashes = {"results.nc": [stored_file.file_sha256(folder / "results.nc")]}
    return open_final(folder, Manifest("", "", "", "", outputs=hashes))


def damaged_value(ds):
    ds.rmse[0, 1, 0, 1, 0] += 1e-15


def damaged_label(ds):
    ds["backlash"] = [0.0, np.nextafter(0.07, 1.0), 0.15]


def damaged_unit(ds):
    ds.rmse.attrs["units"] = "degC"


def damaged_parameter(ds):
    ds.attrs["parameters"] = ds.attrs["parameters"].replace("8.8", "8.9")


@pytest.mark.parametrize("damage", [damaged_value, damaged_label, damaged_unit, damaged_parameter])
def test_a_content_that_is_not_that_of_its_hash_is_detected(tmp_path, swept, damage):
    changed = swept.copy(deep=True)
    damage(changed)
    netcdf.save(changed, tmp_path / "results.nc")
    with pytest.raises(IntegrityError, match="is damaged \\(content_sha256 differs\\)"):
        opened(tmp_path)


def test_a_cut_file_without_a_recorded_hash_is_detected(tmp_path, swept):
    path = tmp_path / "results.nc"
    netcdf.save(swept, path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(IntegrityError, match=r"results\.nc"):
        open_final(tmp_path, None)


def test_a_file_of_a_later_version_and_a_missing_one_are_refused(tmp_path, swept):
    with pytest.raises(fc.InputError, match="does not exist"):
        open_final(tmp_path, None)
    netcdf.save(swept.assign_attrs(fastcoil_format=99), tmp_path / "results.nc")
    with pytest.raises(fc.InputError, match="later version"):
        opened(tmp_path)


@pytest.mark.parametrize(
    "attrs", [{"trace_file": "../traces-x.nc"}, {"trace_file": 3}, {"trace_sha256": "["}, {"fastcoil_format": "x"}]
)
def test_attributes_that_nobody_wrote_are_refused(tmp_path, swept, attrs):
    netcdf.save(swept.assign_attrs(attrs), tmp_path / "results.nc")
    with pytest.raises(IntegrityError, match=r"results\.nc"):
        opened(tmp_path)


def test_plain_results_have_no_traces(out):
    run(PLAIN, out)
    assert fc.open_study(out).attrs["content_sha256"] == golden(PLAIN)
    assert set(Manifest.read(out).outputs) == {"results.nc"}
