"""Results on disk: what was written comes back, by one thread at a time; arrays are cut into pieces."""

import gc
import hashlib
import os
import signal
import threading
import time
from types import SimpleNamespace

import netCDF4
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

import fastcoil as fc
from fastcoil.loops import netcdf
from fastcoil.loops.netcdf import cut_into_pieces, file_sha256
from fastcoil.model.metric_table import METRICS

pytestmark = pytest.mark.kernel


def test_a_result_survives_netcdf(tmp_path, swept_result):
    netcdf.save(swept_result, tmp_path / "results.nc")
    back = netcdf.load(str(tmp_path / "results.nc"))
    assert back.content_sha256 == swept_result.content_sha256
    xr.testing.assert_identical(back.drop_attrs(), swept_result.drop_attrs())
    assert all(back[name].attrs["units"] == swept_result[name].attrs["units"] for name in METRICS)
    assert [path.name for path in tmp_path.iterdir()] == ["results.nc"]
    assert fc.Loop.from_dataset(back).sizes == fc.Loop.from_dataset(swept_result).sizes


def test_words_and_open_loops_survive_netcdf(tmp_path, days):
    loop = fc.Loop(action=["cooling", "heating"], kp=xr.DataArray([0.1, 0.2], dims="case", coords={"case": ["a", "ß"]}))
    ds = fc.simulate(loop, days, command=np.full(900, 0.3), traces=["mode"], warm_up=60)
    for result in (ds.isel(case=0), ds):  # the second in place of the first
        netcdf.save(result, tmp_path / "results.nc")
    back = netcdf.load(str(tmp_path / "results.nc"))
    assert back.case.values.tolist() == ["a", "ß"]
    assert back.content_sha256 == ds.content_sha256


def test_no_coordinate_is_said_to_have_missing_values(tmp_path, swept_result):
    netcdf.save(swept_result, tmp_path / "results.nc")
    with netCDF4.Dataset(tmp_path / "results.nc") as file:
        assert not [n for n in map(str, swept_result.coords) if "_FillValue" in file[n].ncattrs()]
        assert "_FillValue" in file["rmse"].ncattrs()


@pytest.mark.parametrize("part", ["whole", "picked", "opened again"])
def test_nor_in_a_file_that_the_user_writes(tmp_path, swept_result, part):
    """CF 2.5.1; xarray itself gives every variable of floats a fill value."""
    path = tmp_path / "own.nc"
    ds = swept_result if part == "whole" else swept_result.isel(tuning=0)
    if part == "opened again":
        netcdf.save(swept_result, tmp_path / "results.nc")
        ds = netcdf.load(str(tmp_path / "results.nc"))
    ds.to_netcdf(path)
    with netCDF4.Dataset(path) as file:
        assert {"backlash", "kp", "elapsed_time"} <= file.variables.keys()
        assert not [n for n in map(str, ds.coords) if "_FillValue" in file[n].ncattrs()]
        assert "_FillValue" in file["rmse"].ncattrs()


def test_nobody_else_is_in_the_library_while_one_is(swept_result, tmp_path):
    data, path, finished = netcdf.netcdf_bytes(swept_result), tmp_path / "results.nc", []
    netcdf.save(swept_result, path)
    with netcdf.NETCDF4_PYTHON_LOCK:
        threads = [
            threading.Thread(target=lambda: finished.append(netcdf.load(data))),
            threading.Thread(target=lambda: finished.append(netcdf.netcdf_bytes(swept_result))),
            threading.Thread(target=lambda: finished.append(xr.load_dataset(path, decode_timedelta=False))),
        ]
        for thread in threads:
            thread.start()
            thread.join(0.1)
        assert finished == []
    for thread in threads:
        thread.join(60)
    assert len(finished) == 3


def test_what_is_read_or_written_is_closed_by_whoever_did_it(swept_result, monkeypatch):
    files = []

    def opened(*words, **options):
        files.append(netCDF4.Dataset(*words, **options))
        return files[-1]

    monkeypatch.setattr(netcdf, "netCDF4", SimpleNamespace(**vars(netCDF4) | {"Dataset": opened}))
    data = netcdf.netcdf_bytes(swept_result)
    ds = netcdf.load(data)
    with pytest.raises((OSError, RuntimeError)):
        netcdf.load(data[: len(data) // 2])
    gc.collect()
    assert len(files) >= 2
    assert not any(file.isopen() for file in files)
    ds.close()


@pytest.mark.timeout(30)
def test_a_child_of_a_fork_reads_though_another_thread_was_in_the_library(swept_result):
    data, inside = netcdf.netcdf_bytes(swept_result), threading.Event()

    def stay():
        with netcdf.NETCDF4_PYTHON_LOCK:
            inside.set()
            time.sleep(0.3)

    thread = threading.Thread(target=stay)
    thread.start()
    inside.wait()
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(10)
        try:
            os._exit(0 if netcdf.load(data).content_sha256 == swept_result.content_sha256 else 1)
        finally:
            os._exit(2)
    thread.join()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert netcdf.load(data).content_sha256 == swept_result.content_sha256  # nor does the parent wait for anybody


def test_a_file_that_changed_is_hashed_again_though_its_size_and_time_are_as_before(tmp_path):
    path = tmp_path / "results.nc"
    path.write_bytes(b"one")
    before = path.stat()
    assert file_sha256(path) == hashlib.sha256(b"one").hexdigest()
    time.sleep(0.05)  # the clock of the file system is coarse
    path.write_bytes(b"two")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    after = path.stat()
    assert (after.st_ino, after.st_size, after.st_mtime_ns) == (before.st_ino, before.st_size, before.st_mtime_ns)
    assert file_sha256(path) == hashlib.sha256(b"two").hexdigest()


@given(st.lists(st.integers(1, 6), max_size=4), st.integers(1, 40))
def test_pieces_are_all_values_in_their_order_and_none_is_too_large(shape, most):
    values = np.arange(np.prod(shape, dtype=int)).reshape(shape)
    pieces = [values[piece] for piece in cut_into_pieces(tuple(shape), most)]
    assert max(piece.size for piece in pieces) <= most
    assert all(piece.ndim == len(shape) for piece in pieces)
    assert np.concatenate([piece.ravel() for piece in pieces]).tolist() == values.ravel().tolist()
    assert len(pieces) <= values.size // most * 2 ** len(shape) + 1 or most == 1
