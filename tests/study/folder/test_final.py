"""The final files of a study: hashed before a byte is parsed, and tried by a child if nobody knows their hash."""

import errno
import functools
import json
import os
import pickle
import subprocess
from unittest.mock import Mock

import netCDF4
import numpy as np
import pytest
import xarray as xr
from helpers.refusals import refuses
from helpers.studies import (
    TRACED_STUDY,
    copy_run,
    folder_contents,
    run,
    undisturbed_hash,
    verify_unchanged,
    with_larger_sweep,
)

import fastcoil as fc
from fastcoil.base.errors import IntegrityError, StorageError
from fastcoil.loops import netcdf
from fastcoil.loops.provenance import combined_sha256
from fastcoil.model.metric_table import METRICS
from fastcoil.study import maintenance
from fastcoil.study.folder.stored import Manifest, find_variable_problems, open_final_results

pytestmark = pytest.mark.kernel


@pytest.fixture
def finished(out):
    """The folder of a finished study with traces."""
    copy_run(TRACED_STUDY, out)
    return out


def trace_path(folder):
    return next(folder.glob("traces-*.nc"))


def zero_sector(path, sector):
    """Write zeros over a sector, as a failing disk does."""
    data = bytearray(path.read_bytes())
    data[512 * sector : 512 * (sector + 1)] = bytes(len(data[512 * sector : 512 * (sector + 1)]))
    path.write_bytes(data)


# --- recorded hashes --------------------------------------------------------------------------------------------------


def test_no_byte_of_a_damaged_file_is_parsed(finished, monkeypatch):
    zero_sector(finished / "results.nc", 8)  # the library never returns from these bytes
    monkeypatch.setattr(netCDF4, "Dataset", None)
    for what in (fc.open_study, lambda out: run(TRACED_STUDY, out)):
        with pytest.raises(IntegrityError, match=r"results\.nc is damaged.*move it away and run the study again"):
            what(finished)
    assert "results.nc is damaged" in " ".join(verify_unchanged(finished))


@pytest.mark.parametrize(
    "error",
    [OSError(-101, "NetCDF: HDF error"), OSError(errno.EMFILE, "Too many open files"), RuntimeError("HDF error")],
    ids=repr,
)
def test_a_sound_file_that_cannot_be_opened_is_not_called_damaged(finished, monkeypatch, error):
    ds = fc.open_study(finished)

    monkeypatch.setattr(netcdf, "parse", Mock(side_effect=error))
    message = "cannot be read: .*; its bytes are as they were written"
    for read in (lambda: fc.open_study(finished), ds["T_sup"].load, lambda: find_variable_problems(ds, finished)):
        with pytest.raises(StorageError, match=message) as refused:
            read()
        assert refused.value.exit_code == 4
    ds.close()
    monkeypatch.undo()
    assert verify_unchanged(finished) == []


def test_damaged_traces_are_found_when_they_are_read_and_metrics_stay_readable(finished):
    path = trace_path(finished)
    good = path.read_bytes()
    path.unlink()
    path.write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
    ds = fc.open_study(finished)
    assert bool(np.isfinite(ds["rmse"]).all())
    assert ds["T_sup"].sizes["elapsed_time"] == ds["elapsed_time"].size
    with pytest.raises(IntegrityError, match=r"traces-.* is damaged.*move results\.nc away and run the study again"):
        ds["T_sup"].isel(day=0).load()
    with pytest.raises(IntegrityError, match="is damaged"):
        run(TRACED_STUDY, finished)


def test_traces_are_hashed_once_in_a_process_and_not_before_they_are_read(finished, monkeypatch):
    hashed, sha256_of = [], netcdf._sha256_of.__wrapped__
    counted = lambda path, identity: hashed.append(path.name) or sha256_of(path, identity)  # noqa: E731
    monkeypatch.setattr(netcdf, "_sha256_of", functools.lru_cache(counted))
    ds = fc.open_study(finished)
    assert hashed == ["results.nc"]
    for k in range(3):
        assert ds["T_sup"].isel(day=k).values.shape == ds["T_sup"].shape[1:]
    assert float(fc.open_study(finished)["T_sup"].isel(day=0, elapsed_time=0).max()) == 20.0
    assert hashed == ["results.nc", trace_path(finished).name]
    assert verify_unchanged(finished) == []
    assert len(hashed) == 4  # verify trusts no memory


def test_between_its_hash_and_its_name_a_new_file_leaves_the_old_one_readable(finished, monkeypatch):
    before, real = fc.open_study(finished).load(), os.replace

    def killed(source, target):
        if os.fspath(target).endswith("results.nc"):
            raise KeyboardInterrupt
        real(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            run(with_larger_sweep(TRACED_STUDY), finished, extend=True)
    halfway = Manifest.read(finished)
    assert not halfway.finished
    assert len(halfway.outputs["results.nc"]) == 2
    assert verify_unchanged(finished) == []
    partly = fc.open_study(finished)
    np.testing.assert_array_equal(partly["rmse"].sel(backlash=before["backlash"]), before["rmse"])
    assert run(with_larger_sweep(TRACED_STUDY), finished, extend=True) == undisturbed_hash(
        with_larger_sweep(TRACED_STUDY)
    )
    assert all(len(hashes) == 1 for hashes in Manifest.read(finished).outputs.values())


# --- lazily -----------------------------------------------------------------------------------------------------------


def test_lazy_traces_give_what_loaded_ones_give(finished):
    lazy, loaded = fc.open_study(finished), fc.open_study(finished).load()
    for key in (
        {"day": 0}, {"day": [2, 0], "elapsed_time": slice(None, None, -2)}, {"elapsed_time": -1},
        {"backlash": xr.DataArray([0, 1], dims="pair"), "day": xr.DataArray([2, 1], dims="pair")}, {"day": slice(0, 0)},
    ):  # fmt: skip
        for name in ("T_sup", "mode"):
            assert lazy[name].isel(key).identical(loaded[name].isel(key)), (name, key)
            assert lazy[name].dtype == loaded[name].dtype
    assert pickle.loads(pickle.dumps(lazy)).load().identical(loaded)
    assert lazy.chunk({"day": 1}).load().identical(loaded)
    assert lazy.copy(deep=True).load().identical(loaded)


def test_opened_results_leave_no_file_open(finished):
    ds = fc.open_study(finished)
    ds["T_sup"].isel(day=0).load()
    open_files = map(os.path.realpath, (f"/proc/self/fd/{number}" for number in os.listdir("/proc/self/fd")))
    assert not [name for name in open_files if "traces-" in name and str(finished) in name]


# --- files without a recorded hash ------------------------------------------------------------------------------------


def test_results_whose_run_json_was_lost_are_tried_and_the_next_run_records_their_hashes(finished):
    outputs = Manifest.read(finished).outputs
    (finished / "run.json").unlink()
    before = folder_contents(finished)
    message = r"run\.json is missing: the results are of fastcoil 0\.1, .* or it was lost, and running the same"
    extend_larger = lambda out: run(with_larger_sweep(TRACED_STUDY), out, extend=True)  # noqa: E731
    for what in (fc.open_study, maintenance.verify, maintenance.status, extend_larger):
        with pytest.raises(IntegrityError, match=message):
            what(finished)
    assert folder_contents(finished) == before
    assert run(TRACED_STUDY, finished) == undisturbed_hash(TRACED_STUDY)
    assert folder_contents(finished)["results.nc"] == before["results.nc"]
    assert Manifest.read(finished).finished
    assert Manifest.read(finished).outputs == outputs


def test_a_file_that_nobody_knows_and_that_hangs_the_library_is_refused_in_time(finished, monkeypatch):
    endless = finished / "endless.py"
    endless.write_text("while True: pass")
    monkeypatch.setattr(netcdf, "_readable_files", set())
    monkeypatch.setattr(netcdf, "_PROBE_SCRIPT", endless)
    real = subprocess.run
    monkeypatch.setattr(netcdf.subprocess, "run", lambda command, **options: real(command, **options | {"timeout": 1}))
    with pytest.raises(IntegrityError, match=r"results\.nc is damaged: reading it did not end in \d+ s; move it away"):
        open_final_results(finished, None)


def test_a_changed_value_of_a_small_trace_is_found_without_a_recorded_hash(finished):
    with netCDF4.Dataset(trace_path(finished), "a") as file:
        file["mode"][0, 0, 0, 3] = 9 - file["mode"][0, 0, 0, 3]
    with pytest.raises(IntegrityError, match="mode is damaged"):
        open_final_results(finished, None)


def test_a_child_that_crashes_or_finds_no_netcdf_is_reported_in_a_sentence(tmp_path, monkeypatch):
    path = tmp_path / "results.nc"
    path.write_bytes(b"CDF\1 and what follows is none")
    with pytest.raises(IntegrityError, match=r"cannot be read as NetCDF \(.*\); throw it away"):
        netcdf.probe_file(path, "throw it away")
    crash = tmp_path / "crash.py"
    crash.write_text("import os; os.kill(os.getpid(), 11)")
    monkeypatch.setattr(netcdf, "_PROBE_SCRIPT", crash)
    with pytest.raises(IntegrityError, match="the library ended with signal 11"):
        netcdf.probe_file(path, "throw it away")


def test_a_file_with_a_variable_without_values_is_probed_as_sound(tmp_path):
    xr.Dataset({"events": ("event", [])}).to_netcdf(tmp_path / "results.nc")
    assert netcdf.probe_file(tmp_path / "results.nc", "").load()["events"].size == 0


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir], ids=["fifo", "folder"])
@pytest.mark.parametrize("name", ["results.nc", "traces"])
def test_what_is_no_file_is_refused_and_blocks_nobody(finished, make, name):
    path = finished / name if name == "results.nc" else trace_path(finished)
    path.unlink()
    make(path)
    with pytest.raises(IntegrityError, match="is not a regular file"):
        fc.open_study(finished)


# --- content ----------------------------------------------------------------------------------------------------------


def open_unchecked(folder):
    """Open results whose bytes are as they were written, whatever they say."""
    hashes = {"results.nc": [netcdf.file_sha256(folder / "results.nc")]}
    return open_final_results(folder, Manifest("", "", "", "", outputs=hashes))


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
def test_a_content_that_is_not_that_of_its_hash_is_detected(tmp_path, swept_result, damage):
    changed = swept_result.copy(deep=True)
    damage(changed)
    netcdf.save(changed, tmp_path / "results.nc")
    with pytest.raises(IntegrityError, match="is damaged \\(content_sha256 differs\\)"):
        open_unchecked(tmp_path)


def test_a_file_of_a_later_version_and_a_missing_one_are_refused(tmp_path, swept_result):
    with refuses((str(tmp_path / "results.nc"), "path")):
        open_final_results(tmp_path, None)
    netcdf.save(swept_result.assign_attrs(fastcoil_format=99), tmp_path / "results.nc")
    with refuses((str(tmp_path / "results.nc"), "format")):
        open_unchecked(tmp_path)


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
def test_attributes_that_nobody_wrote_are_refused(tmp_path, swept_result, attrs):
    forge(swept_result[[*METRICS, "status"]].assign_attrs(attrs), tmp_path / "results.nc")
    with pytest.raises(IntegrityError, match=r"results\.nc (is not a result|names traces|cannot be understood)"):
        open_unchecked(tmp_path)


@pytest.mark.parametrize(
    "change",
    [lambda ds: ds.drop_vars("status"), lambda ds: ds.assign(rmse=ds["rmse"].astype(str))],
    ids=["no status", "words as a metric"],
)
def test_results_of_another_form_are_refused_whatever_their_hash(tmp_path, swept_result, change):
    forge(change(swept_result[[*METRICS, "status"]]), tmp_path / "results.nc")
    with pytest.raises(IntegrityError, match=r"is not a result of a study .*; move it away"):
        open_unchecked(tmp_path)


def test_traces_of_another_form_than_the_results_say_are_refused_when_they_are_read(tmp_path, swept_result):
    netcdf.save(swept_result[["T_sup"]], tmp_path / "traces-x.nc")
    described = {
        "dims": swept_result["T_sup"].dims,
        "shape": swept_result["T_sup"].shape,
        "dtype": "float64",
        "attrs": {},
    }
    for layout in ({"T_w": described}, {"T_sup": described | {"shape": (*swept_result["T_sup"].shape[:-1], 99)}}):
        results = swept_result.drop_vars(["T_sup", "mode", "T_c", "elapsed_time", "volume"]).assign_attrs(
            trace_file="traces-x.nc", trace_layout=json.dumps(layout), trace_sha256="{}"
        )
        forge(results, tmp_path / "results.nc")
        hashes = {name: [netcdf.file_sha256(tmp_path / name)] for name in ("results.nc", "traces-x.nc")}
        with pytest.raises(IntegrityError, match=r"traces-x\.nc holds no such T_"):
            open_final_results(tmp_path, Manifest("", "", "", "", outputs=hashes)).load()
