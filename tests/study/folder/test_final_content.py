"""What results hold must be what their hash says, and of a version that is known."""

import json

import numpy as np
import pytest
from helpers.studies import PLAIN, copied, golden

import fastcoil as fc
from fastcoil.base.errors import IntegrityError, StorageError
from fastcoil.loops import netcdf
from fastcoil.loops.provenance import combined_sha256
from fastcoil.model.metric_table import METRICS
from fastcoil.study.folder.manifest import Manifest
from fastcoil.study.folder.result_files import open_final

pytestmark = pytest.mark.kernel


def opened(folder):
    """Open results whose bytes are as they were written, whatever they say."""
    hashes = {"results.nc": [netcdf.file_sha256(folder / "results.nc")]}
    return open_final(folder, Manifest("", "", "", "", outputs=hashes))


def forge(ds, path):
    """Write results with the hash of what they hold."""
    netcdf.save(ds.assign_attrs(title="forged"), path)
    stored = netcdf.load(path)
    hashed = stored.drop_attrs(deep=False).assign_attrs({k: v for k, v in stored.attrs.items() if k != "trace_sha256"})
    netcdf.save(stored.assign_attrs(content_sha256=combined_sha256(hashed)), path)


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
    "attrs",
    [
        {"trace_file": "../traces-x.nc"},
        {"trace_file": "results.nc"},
        {"trace_file": ".holder"},
        {"trace_file": 3},
        {"trace_sha256": "["},
        {"fastcoil_format": "x"},
    ],
)
def test_attributes_that_nobody_wrote_are_refused(tmp_path, swept, attrs):
    forge(swept[[*METRICS, "status"]].assign_attrs(attrs), tmp_path / "results.nc")
    with pytest.raises(IntegrityError, match=r"results\.nc (is no result|names traces|cannot be understood)"):
        opened(tmp_path)


def test_a_small_file_of_very_many_values_ends_in_a_sentence(tmp_path, swept, monkeypatch):
    netcdf.save(swept, tmp_path / "results.nc")
    monkeypatch.setattr(netcdf, "available_memory", lambda: swept.nbytes - 1)
    with pytest.raises(StorageError, match=r"cannot be read \(its values take .* are available\): the memory ran out"):
        opened(tmp_path)


def test_plain_results_have_no_traces(out):
    copied(PLAIN, out)
    assert fc.open_study(out).attrs["content_sha256"] == golden(PLAIN)
    assert set(Manifest.read(out).outputs) == {"results.nc"}


@pytest.mark.parametrize(
    "change",
    [
        lambda ds: ds.drop_vars("status"),
        lambda ds: ds.assign(rmse=ds["rmse"].astype(str)),
    ],
    ids=["no status", "words as a metric"],
)
def test_results_of_another_form_are_refused_whatever_their_hash(tmp_path, swept, change):
    forge(change(swept[[*METRICS, "status"]]), tmp_path / "results.nc")
    with pytest.raises(IntegrityError, match=r"is no result of a study .*; delete it"):
        opened(tmp_path)


def test_whatever_a_simulation_gives_has_the_form_of_results(tmp_path, swept):
    reduced = swept.assign(mine=swept["T_sup"].max("elapsed_time") > 14.0)
    forge(reduced, tmp_path / "results.nc")
    assert opened(tmp_path).identical(netcdf.load(tmp_path / "results.nc"))


def test_traces_of_another_form_than_the_results_say_are_refused_when_they_are_read(tmp_path, swept):
    netcdf.save(swept[["T_sup"]], tmp_path / "traces-x.nc")
    described = {"dims": swept["T_sup"].dims, "shape": swept["T_sup"].shape, "dtype": "float64", "attrs": {}}
    for layout in ({"T_w": described}, {"T_sup": described | {"shape": (*swept["T_sup"].shape[:-1], 99)}}):
        results = swept.drop_vars(["T_sup", "mode", "T_c", "elapsed_time", "volume"]).assign_attrs(
            trace_file="traces-x.nc", trace_layout=json.dumps(layout), trace_sha256="{}"
        )
        forge(results, tmp_path / "results.nc")
        hashes = {name: [netcdf.file_sha256(tmp_path / name)] for name in ("results.nc", "traces-x.nc")}
        with pytest.raises(IntegrityError, match=r"traces-x\.nc holds no such T_"):
            open_final(tmp_path, Manifest("", "", "", "", outputs=hashes)).load()
