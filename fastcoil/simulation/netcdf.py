"""The one place that reads and writes NetCDF files: shards, results and traces."""

from __future__ import annotations

from collections.abc import Collection, Hashable
from pathlib import Path
from typing import Any, Literal

import netCDF4
import xarray as xr

from fastcoil.errors import InputError, IntegrityError, StorageError
from fastcoil.files import commit_written
from fastcoil.simulation.dataset import FORMAT, combined_sha256

_COMPRESSION = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
_AS_STORED: dict[str, Any] = {"decode_times": False, "decode_timedelta": False}


def netcdf_bytes(ds: xr.Dataset) -> bytes | memoryview:
    """The Dataset as an uncompressed NetCDF file in memory: a killed writer leaves no file that opens."""
    return ds.to_netcdf(engine="netcdf4")


def save(ds: xr.Dataset, path: Path) -> None:
    """Write a Dataset as NetCDF so that ``path`` is either the whole new file or what it was before.

    Raises
    ------
    StorageError
        If the file cannot be written; nothing half-written is left behind.
    """
    commit_written(path, lambda unfinished: write(ds, unfinished, mode="w"))


def write(ds: xr.Dataset, path: Path, mode: Literal["w", "a"]) -> None:
    """Write or append to a file that nobody relies on yet, without a copy of it in memory."""
    ds.to_netcdf(path, mode=mode, engine="netcdf4", encoding=_encoding(ds))


def load(path: Path) -> xr.Dataset:
    """Read a result into memory and check its ``content_sha256``.

    Raises
    ------
    InputError
        If there is no such file, or a later version of fastcoil wrote it.
    StorageError
        If it cannot be read.
    IntegrityError
        If its content is not what was written.
    """
    if not path.is_file():
        raise InputError(f"{path} does not exist: run the study first")
    try:
        with open_lazily(path) as stored:
            ds = stored.load()
    except Exception as error:  # damaged bytes may raise anything in the library
        if isinstance(error, OSError) and (error.errno or 0) > 0:  # those of the NetCDF library are negative
            raise StorageError(f"{path} cannot be read: {error.strerror}; repair that and try again") from error
        raise IntegrityError(f"{path} cannot be read as NetCDF ({error}); delete it and run the study again") from error
    if ds.attrs.get("fastcoil_format", 0) > FORMAT:
        raise InputError(f"{path} was written by a later version of fastcoil: open it with that version")
    if ds.attrs.get("content_sha256") != combined_sha256(ds):
        raise IntegrityError(f"{path} is damaged (content_sha256 differs); delete it and run the study again")
    return ds


def load_bytes(data: bytes, name: str, leave_out: Collection[str] = ()) -> xr.Dataset:
    """Read a NetCDF file that is in memory, without the variables ``leave_out``; ``name`` is only for the library.

    Raises
    ------
    OSError, RuntimeError, ValueError
        If the bytes are no NetCDF file; damaged ones may crash the HDF5 library, so check their hash first.
    """
    with netCDF4.Dataset(name, memory=data) as file:
        stored = xr.backends.NetCDF4DataStore(file)  # type: ignore[no-untyped-call]
        return xr.open_dataset(stored, drop_variables=list(leave_out), **_AS_STORED).load()


def open_lazily(path: Path) -> xr.Dataset:
    """Open a NetCDF file; values stay on the disk until they are asked for, and nothing is checked.

    Raises
    ------
    Exception
        Whatever the library raises for a damaged file.
    """
    return xr.open_dataset(path, engine="netcdf4", **_AS_STORED)


def _encoding(ds: xr.Dataset) -> dict[Hashable, dict[str, object]]:
    large = {n for n, v in ds.variables.items() if v.dtype.kind in "fi" and v.ndim and v.size > 64}
    # CF 2.5.1: nothing is missing in a coordinate
    complete = {n for n in ds.coords if ds[n].dtype.kind == "f"}
    return {
        n: (_COMPRESSION if n in large else {}) | ({"_FillValue": None} if n in complete else {})
        for n in large | complete
    }
