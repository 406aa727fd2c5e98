"""The only module that calls the NetCDF library to read or write results.

Neither netCDF-C nor HDF5 may be called by two threads at once: ``entered`` holds the lock of xarray's netcdf4 backend,
so that a user's own datasets wait too; inside, xarray gets no lock, for this one is not reentrant.  Nothing that is
opened here is left to the garbage collector, which takes no lock.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Hashable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

import netCDF4
import numpy as np
import xarray as xr
from xarray.backends.netCDF4_ import NETCDF4_PYTHON_LOCK

from fastcoil.base.files import commit_written
from fastcoil.base.machine import available_memory, gib

COMPRESSION = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
LARGE = 64
"""Values; a variable with more is compressed."""
AS_STORED: dict[str, Any] = {"decode_times": False, "decode_timedelta": False}
abandoned: list[netCDF4.Dataset] = []
"""Files that could not be written or closed, as on a full disk.  Closing them may crash the library, and the garbage
collector would try: a reference is kept."""

# a forked child inherits the lock in its current state: no thread may hold it then
os.register_at_fork(
    before=NETCDF4_PYTHON_LOCK.acquire,
    after_in_parent=NETCDF4_PYTHON_LOCK.release,
    after_in_child=NETCDF4_PYTHON_LOCK.release,
)


@contextmanager
def entered() -> Iterator[None]:
    """Enter the library: no other thread is in it."""
    with NETCDF4_PYTHON_LOCK:
        yield


def close(file: netCDF4.Dataset) -> Any:
    """Close a file, inside ``entered``.  Returns the bytes of one in memory."""
    try:
        return file.close()
    except BaseException:
        abandoned.append(file)
        raise


def netcdf_bytes(ds: xr.Dataset) -> bytes | memoryview:
    """The Dataset as an uncompressed NetCDF file in memory: a killed writer leaves no file that opens."""
    return _written(ds, "in memory", "w", {}, memory=0)  # type: ignore[no-any-return]


def save(ds: xr.Dataset, path: Path) -> None:
    """Write a Dataset as NetCDF, atomically: ``path`` is the whole new file or remains as it was.

    Raises
    ------
    StorageError
        If the file cannot be written; nothing half-written is left behind.
    """
    commit_written(path, lambda unfinished: write(ds, unfinished, mode="w"))


def write(ds: xr.Dataset, path: Path, mode: Literal["w", "a"]) -> None:
    """Write or append to an unpublished file, without a copy of it in memory."""
    _written(ds, str(path), mode, _encoding(ds))


def parse(source: str | Path | bytes) -> netCDF4.Dataset:
    """Open a file by its name or from its bytes, inside ``entered`` and after a check of their hash.

    Raises
    ------
    OSError, RuntimeError, ValueError
        If it is no NetCDF file; damaged bytes may also crash the library or make it hang.
    """
    if isinstance(source, (str, Path)):
        return netCDF4.Dataset(str(source))
    return netCDF4.Dataset("in memory", memory=source)


def load(source: str | Path | bytes, leave_out: Collection[str] = ()) -> xr.Dataset:
    """Read a file as ``parse`` opens it, without the variables ``leave_out``; damage may raise anything.

    Raises
    ------
    MemoryError
        If it takes more than is available: a small file may hold a large array of one value.
    """
    with entered():
        file = parse(source)
        try:
            stored = xr.backends.NetCDF4DataStore(file, lock=False)  # type: ignore[no-untyped-call]
            ds = xr.open_dataset(stored, drop_variables=list(leave_out), **AS_STORED)
            ds.set_close(None)  # the caller gets it with the file closed
            if ds.nbytes > available_memory():
                raise MemoryError(f"its values take {gib(ds.nbytes)}, {gib(available_memory())} are available")
            return with_times(ds.load())
        finally:
            close(file)


def _written(ds: xr.Dataset, name: str, mode: Literal["w", "a"], encoding: Any, **options: Any) -> Any:
    ds = with_numbers(ds.compute())  # values may be in another file, behind the same lock
    with entered():
        file = netCDF4.Dataset(name, mode=mode, format="NETCDF4", **options)
        try:
            stored = xr.backends.NetCDF4DataStore(file, lock=False)  # type: ignore[no-untyped-call]
            ds.dump_to_store(stored, encoding=encoding)
            if not options:  # a failing write raises in sync; in close it would crash the library
                file.sync()
        except (OSError, RuntimeError):
            abandoned.append(file)
            raise
        except BaseException:
            with suppress(RuntimeError):  # the first error is the one to report
                close(file)
            raise
        return close(file)


def _encoding(ds: xr.Dataset) -> dict[Hashable, dict[str, object]]:
    large = {n for n, v in ds.variables.items() if v.dtype.kind in "fi" and v.ndim and v.size > LARGE}
    # CF 2.5.1: nothing is missing in a coordinate
    complete = {n for n in ds.coords if ds[n].dtype.kind == "f"}
    return {
        n: (COMPRESSION if n in large else {}) | ({"_FillValue": None} if n in complete else {})
        for n in large | complete
    }


CLOCK = ("start", "time")
"""Coordinates of a result whose boundary has a start."""
_STORED = {"units": "seconds since 1970-01-01 00:00:00", "calendar": "standard"}


def encoded(variable: xr.Variable) -> xr.Variable:
    """A variable as a file holds it: times as numbers."""
    if variable.dtype.kind != "M":
        return variable
    seconds = variable.values.astype("datetime64[s]").astype(np.int64)
    return xr.Variable(variable.dims, seconds, variable.attrs | _STORED)


def with_numbers(ds: xr.Dataset) -> xr.Dataset:
    """A Dataset as a file holds it."""
    return ds.assign({name: encoded(v) for name, v in ds.variables.items() if v.dtype.kind == "M"})


def with_times(ds: xr.Dataset) -> xr.Dataset:
    """A Dataset as it was before it was written."""
    times = {}
    for name in CLOCK:
        variable = ds.variables.get(name)
        if variable is None or variable.dtype.kind != "i" or variable.attrs.get("units") != _STORED["units"]:
            continue
        attrs = {key: value for key, value in variable.attrs.items() if key not in _STORED}
        values = variable.values.astype("datetime64[s]").astype("datetime64[ns]")
        times[name] = xr.Variable(variable.dims, values, attrs)
    return ds.assign(times)
