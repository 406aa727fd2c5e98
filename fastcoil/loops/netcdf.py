"""NetCDF files: the only module that calls the library to read or write results.

Neither netCDF-C nor HDF5 may be called by two threads at a time: every call holds the lock of xarray's netcdf4 backend;
inside, xarray gets no lock, since this one is not reentrant.  Every file that is opened here is closed here.

Damaged bytes may crash or hang the library.  A file with a recorded hash is parsed only if its bytes have that hash;
any other is first read to its end by a child process.
"""

import hashlib
import json
import math
import os
import stat
import subprocess
import sys
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import netCDF4
import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.backends.netCDF4_ import NETCDF4_PYTHON_LOCK
from xarray.core import indexing

from fastcoil.base.arrays import allocate_on_disk
from fastcoil.base.errors import FastcoilError, IntegrityError, StorageError, out_of_memory_error
from fastcoil.base.files import convert_os_errors, replace_atomically
from fastcoil.base.machine import IS_POSIX, available_memory, format_bytes

COMPRESSION = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
MAX_UNCOMPRESSED_VALUES = 64  # of a variable; a larger one is compressed
WITHOUT_DECODING: dict[str, Any] = {"decode_times": False, "decode_timedelta": False}
unclosed_files: list[netCDF4.Dataset] = []
"""Files that could not be written or closed, as on a full disk.  A reference keeps the garbage collector from closing
them, which may crash the library."""

# a forked child inherits the lock in its current state: no thread may hold it then
if IS_POSIX:
    _release = NETCDF4_PYTHON_LOCK.release
    os.register_at_fork(before=NETCDF4_PYTHON_LOCK.acquire, after_in_parent=_release, after_in_child=_release)


def close_file(file: netCDF4.Dataset) -> Any:
    """Close a file, with the lock held; return the bytes of a file in memory."""
    try:
        return file.close()
    except BaseException:
        unclosed_files.append(file)
        raise


def netcdf_bytes(ds: xr.Dataset) -> bytes | memoryview:
    """Write a Dataset as an uncompressed NetCDF file in memory: a killed writer leaves no file that opens."""
    return _write_file(ds, "in memory", "w", {}, lambda file: None, memory=0)  # type: ignore[no-any-return]


def save(ds: xr.Dataset, path: Path) -> None:
    """Write a Dataset as NetCDF atomically; ``StorageError`` if that fails, with ``path`` unchanged."""
    replace_atomically(path, lambda unfinished: write(ds, unfinished, mode="w"))


def write(
    ds: xr.Dataset, path: Path, mode: Literal["w", "a"],
    append_rest: Callable[[netCDF4.Dataset], object] = lambda file: None,
) -> None:  # fmt: skip
    """Write or append to an unpublished file, without a copy in memory; ``append_rest`` writes more, unlocked."""
    large = {n for n, v in ds.variables.items() if v.dtype.kind in "fi" and v.ndim and v.size > MAX_UNCOMPRESSED_VALUES}
    without_fill_values(ds)
    encoding = {n: COMPRESSION | {k: v for k, v in ds[n].encoding.items() if k == "_FillValue"} for n in large}
    _write_file(ds, str(path), mode, encoding, append_rest)


def parse(source: str | Path | bytes) -> netCDF4.Dataset:
    """Open a file by its name or from its bytes, with the lock held and after a check of their hash."""
    with _small_caches():
        if isinstance(source, (str, Path)):
            return netCDF4.Dataset(str(source))
        return netCDF4.Dataset("in memory", memory=source)


@contextmanager
def _small_caches() -> Iterator[None]:
    """Give variables that are opened or made, with the lock held, 1 MiB of cache: each is read or written once."""
    size, n, preemption = netCDF4.get_chunk_cache()
    netCDF4.set_chunk_cache(2**20, n, preemption)
    try:
        yield
    finally:
        netCDF4.set_chunk_cache(size, n, preemption)


def load(
    source: str | Path | bytes, skipped_names: Collection[str] = (), max_bytes: float = math.inf,
    open_later: "Callable[[TraceLayout], xr.Dataset]" = lambda layout: xr.Dataset(),
) -> xr.Dataset:  # fmt: skip
    """Read a file as ``parse`` opens it, without the variables ``skipped_names``; damage may raise anything.

    max_bytes, open_later: results of a larger file are opened by ``open_later`` from their layout.
    ``MemoryError`` if it takes more than is available: a small file may hold a large array of one value.
    """
    with NETCDF4_PYTHON_LOCK:
        file = parse(source)
        try:
            stored = xr.backends.NetCDF4DataStore(file, lock=False)  # type: ignore[no-untyped-call]
            # by name, xarray would look for it in every installed package
            engine = xr.backends.StoreBackendEntrypoint
            ds = xr.open_dataset(stored, engine=engine, drop_variables=list(skipped_names), **WITHOUT_DECODING)
            ds.set_close(None)  # the caller gets it with the file closed
            names = [*ds.data_vars]
            large = [n for n in names if ds[n].dtype.kind == "f"] if ds.nbytes > max_bytes else []
            layout, ds = describe_variables((n, ds.variables[n]) for n in large), ds.drop_vars(large)
            if ds.nbytes > (available := available_memory()):
                raise MemoryError(f"its values take {format_bytes(ds.nbytes)}, {format_bytes(available)} are available")
            ds = without_fill_values(with_decoded_times(ds.load()))
            variables = {**ds.variables, **open_later(layout).variables}
            return xr.Dataset({n: variables[n] for n in names}, ds.coords, ds.attrs)
        finally:
            close_file(file)


def _write_file(
    ds: xr.Dataset, name: str, mode: Literal["w", "a"], encoding: Any,
    append_rest: Callable[[netCDF4.Dataset], object], **options: Any,
) -> Any:  # fmt: skip
    ds = with_encoded_times(ds.compute())  # values may be in another file, behind the same lock
    with NETCDF4_PYTHON_LOCK:
        file = netCDF4.Dataset(name, mode=mode, format="NETCDF4", **options)
    try:
        with NETCDF4_PYTHON_LOCK, _small_caches():
            stored = xr.backends.NetCDF4DataStore(file, lock=False)  # type: ignore[no-untyped-call]
            ds.dump_to_store(stored, encoding=encoding)
        append_rest(file)
        if not options:  # a failing write raises in sync; in close it would crash the library
            with NETCDF4_PYTHON_LOCK:
                file.sync()
    except (OSError, RuntimeError):
        unclosed_files.append(file)
        raise
    except BaseException:
        with NETCDF4_PYTHON_LOCK, suppress(RuntimeError):  # the first error is the one to report
            close_file(file)
        raise
    with NETCDF4_PYTHON_LOCK:
        return close_file(file)


_CHUNK_VALUES = 2**17  # of a chunk
_CHUNK_TIMES = 2**10  # the values of a chunk along time if there are several scenarios
_SLAB_VALUES = 2**23  # written or read at a time


def cut_into_pieces(shape: tuple[int, ...], max_values: int) -> Iterator[tuple[slice, ...]]:
    """Cut an array, in C order, into blocks of neighbouring values, at most ``max_values`` or one."""
    axis, inner = len(shape), 1
    while axis and inner * shape[axis - 1] <= max_values:
        axis -= 1
        inner *= shape[axis]
    inner_slices = tuple(slice(0, n) for n in shape[axis:])
    if axis == 0:
        yield inner_slices
        return
    n = shape[axis - 1]
    step = -(-n // -(-n // max(1, max_values // inner)))  # of equal length, as far as they can be
    for outer in np.ndindex(shape[: axis - 1]):
        for start in range(0, n, step):
            yield *(slice(k, k + 1) for k in outer), slice(start, min(start + step, n)), *inner_slices


def trace_slabs(shape: tuple[int, ...], n_dims: int) -> tuple[list[tuple[slice, ...]], tuple[int, ...]]:
    """Return the slabs of scenarios in which a trace is written, and its chunk: some scenarios at some times."""
    *volumes, n_points = shape[n_dims:] or (1,)
    values_per_point = math.prod(volumes)
    per_chunk = _CHUNK_VALUES // (values_per_point * min(n_points, _CHUNK_TIMES))
    slabs = list(cut_into_pieces(shape[:n_dims], max(1, min(per_chunk, _SLAB_VALUES // (values_per_point * n_points)))))
    sizes = [piece.stop - piece.start for piece in slabs[0]]
    return slabs, (*sizes, *volumes, min(n_points, max(1, _CHUNK_VALUES // (values_per_point * math.prod(sizes)))))


def append_trace(file: netCDF4.Dataset, name: str, trace: xr.Variable, n_dims: int) -> None:
    """Append a trace, slab by slab, with ``n_dims`` dims of scenarios; its values may be in a file, unlike NetCDF."""
    slabs, chunk = trace_slabs(trace.shape, n_dims)
    with NETCDF4_PYTHON_LOCK, _small_caches():
        for dim, size in trace.sizes.items():
            if dim not in file.dimensions:
                file.createDimension(str(dim), size)
        fill_value = np.nan if trace.dtype.kind == "f" else None
        options: Any = COMPRESSION | {"chunksizes": chunk, "fill_value": fill_value}
        variable = file.createVariable(name, trace.dtype, map(str, trace.dims), **options)
        variable.setncatts(trace.attrs)
        variable.set_auto_maskandscale(False)
    for slab in slabs:
        with NETCDF4_PYTHON_LOCK:
            variable[slab] = trace.values[slab]


def compressed_share(arrays: Iterable[np.ndarray]) -> float:
    """Return the share of bytes that is left when values are compressed as in a file; 1 without any."""
    shuffled = [np.ascontiguousarray(a).reshape(-1, 1).view(np.uint8).T.tobytes() for a in arrays]
    compressed_size = sum(len(zlib.compress(raw, COMPRESSION["complevel"])) for raw in shuffled)
    return compressed_size / sum(map(len, shuffled)) if shuffled else 1.0


def without_fill_values(ds: xr.Dataset) -> xr.Dataset:
    """Give the coordinates no fill value, also in a file that a user writes (CF 2.5.1)."""
    for name in ds.coords:
        ds.variables[name].encoding["_FillValue"] = None
    return ds


TRACE_DIMS = ("volume", "elapsed_time")  # after those of scenarios
CLOCK_COORDINATES = ("start", "time")  # of a result whose boundary has a start
_TIME_ENCODING = {"units": "seconds since 1970-01-01 00:00:00", "calendar": "standard"}


def encode_times(variable: xr.Variable) -> xr.Variable:
    """Convert a variable to its form in a file: times to numbers."""
    if variable.dtype.kind != "M":
        return variable
    seconds = variable.values.astype("datetime64[s]").astype(np.int64)
    return xr.Variable(variable.dims, seconds, variable.attrs | _TIME_ENCODING)


def with_encoded_times(ds: xr.Dataset) -> xr.Dataset:
    """Convert the times of a Dataset to numbers, as in a file."""
    return ds.assign({name: encode_times(v) for name, v in ds.variables.items() if v.dtype.kind == "M"})


def with_decoded_times(ds: xr.Dataset) -> xr.Dataset:
    """Convert the times of a Dataset from numbers, as before it was written."""
    times = {}
    for name in CLOCK_COORDINATES:
        variable = ds.variables.get(name)
        if variable is None or variable.dtype.kind != "i" or variable.attrs.get("units") != _TIME_ENCODING["units"]:
            continue
        attrs = {key: value for key, value in variable.attrs.items() if key not in _TIME_ENCODING}
        times[name] = xr.Variable(variable.dims, variable.values.astype("M8[s]").astype("M8[ns]"), attrs)
    return ds.assign(times)


_PROBE_SCRIPT = Path(__file__).with_name("netcdf_probe.py")
FileIdentity = tuple[int, ...]
"""Device, inode, size and times: they change when the file does."""
_readable_files: set[FileIdentity] = set()  # files that a child process read to their end
TraceLayout = Mapping[str, Mapping[str, Any]]
"""``dims``, ``shape``, ``dtype`` and ``attrs`` of each variable in a file."""


@dataclass(frozen=True)
class StoredFile:
    """A NetCDF file in the folder of a study, and what to do if it is damaged; accepted: SHA-256 that it may have."""

    path: Path
    accepted: Collection[str]
    cure: str

    def identity(self) -> FileIdentity:
        """Return its identity; ``StorageError`` if it cannot be read, ``IntegrityError`` if it is no regular file."""
        with convert_os_errors(self.path, "read"):
            try:
                status = os.stat(self.path)
            except FileNotFoundError:
                raise IntegrityError(f"{self.path} is missing, open the study again or {self.cure}") from None
        if not stat.S_ISREG(status.st_mode):
            raise IntegrityError(f"{self.path} is not a regular file; {self.cure}")
        return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns

    def sha256(self, *, afresh: bool = False) -> str:
        """Return the SHA-256 of its bytes, computed ``afresh`` or only if the file changed; raises as ``identity``."""
        digest = _sha256_of.__wrapped__ if afresh else _sha256_of
        identity = self.identity()
        with convert_os_errors(self.path, "read"):
            return str(digest(self.path, identity))

    def check(self, *, afresh: bool = False) -> str:
        """Compare ``sha256`` and return it; ``IntegrityError`` if it is not accepted."""
        digest = self.sha256(afresh=afresh)
        if digest not in self.accepted:
            sentence = f"{self.path} is damaged, or not of this run (the hash of its bytes differs)"
            raise IntegrityError(f"{sentence}; {self.cure}")
        return digest

    def load(self, max_bytes: float = math.inf) -> xr.Dataset:
        """Read it; results of more than ``max_bytes`` bytes when their values are needed; raises as ``check``."""
        with self._guard_reading():
            return load(self.path, (), max_bytes, lambda layout: open_lazily(self, layout))

    def read(self, name: str, shape: tuple[int, ...], key: Any) -> np.ndarray:
        """Read a part of a variable of this ``shape``; raises as ``check``."""
        with self._guard_reading(), NETCDF4_PYTHON_LOCK:
            file = parse(self.path)
            try:
                variable = file.variables.get(name)
                if variable is None or variable.shape != shape or variable.dtype is str:
                    raise IntegrityError(f"{self.path} holds no such {name}; {self.cure}")
                variable.set_auto_maskandscale(False)
                return np.asarray(variable[key])
            finally:
                close_file(file)

    @contextmanager
    def _guard_reading(self) -> Iterator[None]:
        """Read the file whose hash was checked: bytes with this hash can be parsed."""
        identity = self.identity()
        self.check()
        try:
            yield
        except (IndexError, KeyError, FastcoilError):
            raise
        except MemoryError as error:
            raise out_of_memory_error(f"{self.path} cannot be read ({error})") from error
        except (OSError, RuntimeError) as error:
            cause = getattr(error, "strerror", None) or error
            cure = "its bytes are as they were written: repair that and try again"
            storage_error = StorageError(f"{self.path} cannot be read: {cause}; {cure}")
            storage_error.errno = getattr(error, "errno", None)
            raise storage_error from error
        except Exception as error:
            raise IntegrityError(f"{self.path} cannot be read as NetCDF ({error}); {self.cure}") from error
        if self.identity() != identity:
            raise IntegrityError(f"{self.path} was replaced while it was read: open the study again")


@lru_cache(maxsize=1000)
def _sha256_of(path: Path, identity: FileIdentity) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def file_sha256(path: Path) -> str:
    """SHA-256 of the bytes of a file, see ``StoredFile.sha256``."""
    return StoredFile(path, (), "run the study again").sha256()


def probe_file(path: Path, cure: str) -> StoredFile:
    """Read a file to its end in a child process, once in each process; return it with the hash of its bytes."""
    identity = StoredFile(path, (), cure).identity()
    if identity not in _readable_files:
        seconds = int(30 + identity[2] / 5e6)  # far above what reading takes
        paths = json.dumps([*filter(None, sys.path), str(_PROBE_SCRIPT.parents[2])])
        command = [sys.executable, "-I", str(_PROBE_SCRIPT), str(path), str(seconds), str(2**31), paths]
        options: Any = {"stdin": subprocess.DEVNULL, "capture_output": True, "timeout": seconds}
        try:
            with convert_os_errors(path, "read by another process"):
                child = subprocess.run(command, check=False, **options)
        except subprocess.TimeoutExpired:
            raise IntegrityError(f"{path} is damaged: reading it did not end in {seconds} s; {cure}") from None
        if child.returncode:
            error_lines = child.stderr.decode(errors="replace").strip().splitlines()
            # a crash is a signal, on Windows a code without a word
            exit_text = f"signal {-child.returncode}" if child.returncode < 0 else f"code {child.returncode:#x}"
            reasons = error_lines if error_lines and child.returncode > 0 else [f"the library ended with {exit_text}"]
            raise IntegrityError(f"{path} cannot be read as NetCDF ({reasons[-1]}); {cure}")
        _readable_files.add(identity)
    with convert_os_errors(path, "read"):
        return StoredFile(path, (_sha256_of(path, identity),), cure)


def describe_variables(variables: Iterable[tuple[Any, xr.Variable]]) -> dict[str, Any]:
    """Describe variables, in valid JSON, so that they can be listed before their file is opened."""
    layout = {}
    for name, v in variables:
        attrs = {k: value if isinstance(value, str) else np.asarray(value).tolist() for k, value in v.attrs.items()}
        layout[name] = {"dims": list(v.dims), "shape": list(v.shape), "dtype": v.dtype.name, "attrs": attrs}
    return layout


def open_lazily(file: StoredFile, layout: TraceLayout) -> xr.Dataset:
    """Return the variables of a file, which is opened when their values are needed."""
    variables = {}
    for name, description in layout.items():
        array = _LazyVariable(file, name, description)
        # kept once read, and copied before it is changed, as by xarray.open_dataset
        lazy: Any = indexing.LazilyIndexedArray(array)
        lazy = indexing.CopyOnWriteArray(indexing.MemoryCachedArray(lazy))  # type: ignore[no-untyped-call, arg-type]
        attrs = {k: v if isinstance(v, str) else np.asarray(v) for k, v in description["attrs"].items()}
        variables[name] = xr.Variable(description["dims"], lazy, attrs, dict(COMPRESSION))
        slabs, _ = trace_slabs(array.shape, sum(dim not in TRACE_DIMS for dim in description["dims"]))
        full_sizes = dict(zip(variables[name].dims, array.shape, strict=True))
        slab_sizes = {dim: piece.stop - piece.start for dim, piece in zip(full_sizes, slabs[0], strict=False)}
        variables[name].encoding["preferred_chunks"] = full_sizes | slab_sizes
    return xr.Dataset(variables)


class _LazyVariable(BackendArray):
    """A variable in a file, as xarray reads it."""

    def __init__(self, file: StoredFile, name: str, description: Mapping[str, Any]) -> None:
        self.file, self.name = file, name
        self.shape, self.dtype = tuple(description["shape"]), np.dtype(description["dtype"])
        self.is_trace = not {*description["dims"]}.isdisjoint(TRACE_DIMS)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: Any) -> np.ndarray:
        if self.is_trace or any(k != slice(None) for k in key):
            return self.file.read(self.name, self.shape, key).astype(self.dtype, copy=False)
        # all values, which xarray keeps, go into a nameless file, so that many scenarios take no memory
        values = allocate_on_disk(self.shape, 0, self.dtype)
        for piece in cut_into_pieces(self.shape, _SLAB_VALUES):
            values[piece] = self.file.read(self.name, self.shape, piece)
        return values
