"""The only module that calls the NetCDF library to read or write results.

Neither netCDF-C nor HDF5 may be called by two threads at once: ``entered`` holds the lock of xarray's netcdf4 backend,
so that a user's own datasets wait too; inside, xarray gets no lock, for this one is not reentrant.  Nothing that is
opened here is left to the garbage collector, which takes no lock.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Collection, Hashable, Iterator
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
Source = str | Path | bytes | Callable[[], netCDF4.Dataset]
"""A file: its name, its bytes, or what opens it, called inside."""
left_open: deque[netCDF4.Dataset] = deque()
"""Files that nobody reads any more; whoever enters next closes them."""
abandoned: list[netCDF4.Dataset] = []
"""Files that could not be written or closed, for a disk was full, say: in closing them the library may crash, and the
garbage collector would try it."""


_forking: set[int] = set()
"""The thread that has entered in order to fork."""


def _enter_to_fork() -> None:
    NETCDF4_PYTHON_LOCK.acquire()
    _forking.add(threading.get_ident())


def _leave_after_fork() -> None:
    # not of a thread that began to fork before this file was loaded
    if threading.get_ident() in _forking:
        _forking.clear()
        NETCDF4_PYTHON_LOCK.release()


# a child of a fork inherits the lock as it is: no thread may be inside then
os.register_at_fork(before=_enter_to_fork, after_in_parent=_leave_after_fork, after_in_child=_leave_after_fork)


@contextmanager
def entered() -> Iterator[None]:
    """Enter the library: no other thread is in it."""
    with NETCDF4_PYTHON_LOCK:
        while left_open:
            with suppress(OSError, RuntimeError):  # of a file that was only read
                close(left_open.popleft())
        yield


def close(file: netCDF4.Dataset) -> Any:
    """Close a file; whoever calls has entered.  Returns the bytes of one in memory."""
    try:
        return file.close()
    except BaseException:
        abandoned.append(file)
        raise


def netcdf_bytes(ds: xr.Dataset) -> bytes | memoryview:
    """The Dataset as an uncompressed NetCDF file in memory: a killed writer leaves no file that opens."""
    return _written(ds, "in memory", "w", {}, memory=0)  # type: ignore[no-any-return]


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
    _written(ds, str(path), mode, _encoding(ds))


def parse(source: str | Path | bytes) -> netCDF4.Dataset:
    """Open a file by its name, or from its bytes; whoever calls has entered, and checked their hash before.

    Raises
    ------
    OSError, RuntimeError, ValueError
        If it is no NetCDF file; damaged bytes may also crash the library, or keep it for ever.
    """
    if isinstance(source, (str, Path)):
        return netCDF4.Dataset(str(source))
    return netCDF4.Dataset("in memory", memory=source)


def load(source: Source, leave_out: Collection[str] = ()) -> xr.Dataset:
    """Read a file as ``parse`` opens it, without the variables ``leave_out``; damage may raise anything.

    Raises
    ------
    MemoryError
        If it takes more than is available: a small file may hold a large array of one value.
    """
    with _opened(source, leave_out) as ds:
        if ds.nbytes > available_memory():
            raise MemoryError(f"its values take {gib(ds.nbytes)}, {gib(available_memory())} are available")
        return with_times(ds.load())


def outline(source: Source) -> xr.Dataset:
    """The variables of a file as ``parse`` opens it; only coordinates have values."""
    with _opened(source) as ds:
        for coordinate in ds.coords.values():
            coordinate.load()
        return with_times(ds)


@contextmanager
def _opened(source: Source, leave_out: Collection[str] = ()) -> Iterator[xr.Dataset]:
    with entered():
        file = source() if callable(source) else parse(source)
        try:
            stored = xr.backends.NetCDF4DataStore(file, lock=False)  # type: ignore[no-untyped-call]
            ds = xr.open_dataset(stored, drop_variables=list(leave_out), **AS_STORED)
            ds.set_close(None)  # whoever gets it finds the file closed
            yield ds
        finally:
            close(file)


def _written(ds: xr.Dataset, name: str, mode: Literal["w", "a"], encoding: Any, **options: Any) -> Any:
    ds = with_numbers(ds.compute())  # values may be in another file, behind the same lock
    with entered():
        file = netCDF4.Dataset(name, mode=mode, format="NETCDF4", **options)
        try:
            stored = xr.backends.NetCDF4DataStore(file, lock=False)  # type: ignore[no-untyped-call]
            ds.dump_to_store(stored, encoding=encoding)
            if not options:  # in which a failing write is reported; in closing, it crashes the library
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
    return _replaced(ds, {name: encoded(v) for name, v in ds.variables.items() if v.dtype.kind == "M"})


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
    return _replaced(ds, times)


def _replaced(ds: xr.Dataset, variables: dict[Any, xr.Variable]) -> xr.Dataset:
    coordinates = {name: variable for name, variable in variables.items() if name in ds.coords}
    others = {name: variable for name, variable in variables.items() if name not in ds.coords}
    return ds.assign_coords(coordinates).assign(others) if variables else ds
