"""NetCDF files of a study: hashed before any byte is parsed, and traces read on demand.

On damaged bytes the NetCDF library may crash or hang, deaf to Ctrl-C.  A file whose hash was recorded is parsed only if
its bytes have that hash.  Any other file, a foreign one or one of a folder that lost its ``run.json``, is first read to
its end by a child process.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import subprocess
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from fastcoil.base.errors import FastcoilError, IntegrityError, StorageError, out_of_memory
from fastcoil.base.files import storage_errors
from fastcoil.loops.netcdf import COMPRESSION, LARGE, close, entered, load, parse

_CHUNK = 2**20
"""Bytes read at once."""
_READER = Path(__file__).with_name("netcdf_probe.py")
_SECONDS, _BYTES_PER_SECOND = 30, 5e6
"""Limits of the child process, far above what reading takes."""
_MEMORY = 2**31
Identity = tuple[int, ...]
"""Device, inode, size and times: they change when the file does."""
_passed: set[Identity] = set()
"""Files that a child process read to their end."""
TraceLayout = Mapping[str, Mapping[str, Any]]
"""Of each variable in a file: its ``dims``, ``shape``, ``dtype`` and ``attrs``."""


@dataclass(frozen=True)
class StoredFile:
    """A NetCDF file in the folder of a study.

    accepted: SHA-256 that its bytes may have; they are compared before they are parsed, once in each process.  cure:
    what to do if it is damaged.
    """

    path: Path
    accepted: Collection[str]
    cure: str

    def identity(self) -> Identity:
        """Identity of the file.

        Raises
        ------
        StorageError, IntegrityError
            If it cannot be examined; if it is missing or no regular file.
        """
        with storage_errors(self.path, "read"):
            try:
                found = os.stat(self.path)
            except FileNotFoundError:
                raise IntegrityError(f"{self.path} is missing, open the study again or {self.cure}") from None
        if not stat.S_ISREG(found.st_mode):
            raise IntegrityError(f"{self.path} is no regular file; {self.cure}")
        return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns

    def check(self, *, afresh: bool = False) -> str:
        """Compare the hash of its bytes, computed ``afresh`` or remembered, and return it.

        Raises
        ------
        StorageError, IntegrityError
            If it cannot be read; if it is not what was written.
        """
        digest = _sha256_of.__wrapped__ if afresh else _sha256_of
        identity = self.identity()
        with storage_errors(self.path, "read"):
            found: str = digest(self.path, identity)
        if found not in self.accepted:
            raise IntegrityError(
                f"{self.path} is damaged, or not of this run (the hash of its bytes differs); {self.cure}"
            )
        return found

    def load(self) -> xr.Dataset:
        """Read all of it; raises as ``check``."""
        with self._readable():
            return load(self.path)

    def read(self, name: str, shape: tuple[int, ...], key: Any) -> np.ndarray:
        """Read a part of a variable that has a ``shape``; raises as ``check``."""
        with self._readable(), entered():
            file = parse(self.path)
            try:
                variable = file.variables.get(name)
                if variable is None or variable.shape != shape or variable.dtype is str:
                    raise IntegrityError(f"{self.path} holds no such {name}; {self.cure}")
                variable.set_auto_maskandscale(False)
                return np.asarray(variable[key])
            finally:
                close(file)

    @contextmanager
    def _readable(self) -> Iterator[None]:
        """Read the file whose hash was checked: bytes with this hash can be parsed."""
        identity = self.identity()
        self.check()
        try:
            yield
        except (IndexError, KeyError, FastcoilError):
            raise
        except MemoryError as error:
            raise out_of_memory(f"{self.path} cannot be read ({error})") from error
        except (OSError, RuntimeError) as error:
            found = StorageError(
                f"{self.path} cannot be read: {getattr(error, 'strerror', None) or error}; its bytes are as they were "
                "written: repair that and try again"
            )
            found.errno = getattr(error, "errno", None)
            raise found from error
        except Exception as error:
            raise IntegrityError(f"{self.path} cannot be read as NetCDF ({error}); {self.cure}") from error
        if self.identity() != identity:
            raise IntegrityError(f"{self.path} was replaced while it was read: open the study again")


@lru_cache(maxsize=1000)
def _sha256_of(path: Path, identity: Identity) -> str:
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def file_sha256(path: Path) -> str:
    """SHA-256 of the bytes of a file, computed again only if the file changed.

    Raises
    ------
    StorageError, IntegrityError
        If it cannot be read; if it is missing or no regular file.
    """
    identity = StoredFile(path, (), "run the study again").identity()
    with storage_errors(path, "read"):
        return _sha256_of(path, identity)


def try_reading(path: Path, cure: str) -> StoredFile:
    """Have a child process read a file to its end, once in each process, and give it with the hash of its bytes.

    cure: what to do if it is damaged.

    Raises
    ------
    IntegrityError
        If that fails, or does not end.
    StorageError
        If it cannot be tried.
    """
    identity = StoredFile(path, (), cure).identity()
    if identity not in _passed:
        seconds = int(_SECONDS + identity[2] / _BYTES_PER_SECOND)
        words = [path, seconds, _MEMORY, json.dumps([p for p in sys.path if p])]
        try:
            with storage_errors(path, "read by another process"):
                child = subprocess.run(
                    [sys.executable, "-I", str(_READER), *map(str, words)],
                    stdin=subprocess.DEVNULL,
                    capture_output=True,
                    check=False,
                    timeout=seconds,
                )
        except subprocess.TimeoutExpired:
            raise IntegrityError(f"{path} is damaged: reading it did not end in {seconds} s; {cure}") from None
        if child.returncode:
            said = child.stderr.decode(errors="replace").strip().splitlines()
            why = [f"the library ended with signal {-child.returncode}"] if child.returncode < 0 else said
            raise IntegrityError(f"{path} cannot be read as NetCDF ({why[-1]}); {cure}")
        _passed.add(identity)
    with storage_errors(path, "read"):
        return StoredFile(path, (_sha256_of(path, identity),), cure)


# ------------------------------------------------------------------------------------------------- traces on demand


def layout_of(variables: Iterable[tuple[str, xr.Variable]]) -> dict[str, Any]:
    """Describe variables, so that they can be offered before their file is opened; all of it is valid JSON."""
    return {
        name: {
            "dims": list(variable.dims),
            "shape": list(variable.shape),
            "dtype": variable.dtype.name,
            "attrs": {k: v if isinstance(v, str) else np.asarray(v).tolist() for k, v in variable.attrs.items()},
        }
        for name, variable in variables
    }


def open_lazily(file: StoredFile, layout: TraceLayout) -> xr.Dataset:
    """The variables of a file, read when their values are needed; the file is not opened before."""
    variables = {}
    for name, described in layout.items():
        array = _OnDisk(file, name, tuple(described["shape"]), np.dtype(described["dtype"]))
        # kept once read, and copied before it is changed, as by xarray.open_dataset
        lazy: Any = indexing.LazilyIndexedArray(array)
        lazy = indexing.CopyOnWriteArray(indexing.MemoryCachedArray(lazy))  # type: ignore[no-untyped-call, arg-type]
        attrs = {k: v if isinstance(v, str) else np.asarray(v) for k, v in described["attrs"].items()}
        encoding = dict(COMPRESSION) if np.prod(array.shape) > LARGE else {}
        variables[name] = xr.Variable(described["dims"], lazy, attrs, encoding)
    return xr.Dataset(variables)


class _OnDisk(BackendArray):
    """A variable in a file, as xarray reads it."""

    def __init__(self, file: StoredFile, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.file, self.name, self.shape, self.dtype = file, name, shape, dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: Any) -> np.ndarray:
        found = self.file.read(self.name, self.shape, key)
        return found.astype(self.dtype, copy=False)
