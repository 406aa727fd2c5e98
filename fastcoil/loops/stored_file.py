"""NetCDF files of a study: hashed before any byte is parsed, the same bytes each time, traces read on demand."""

from __future__ import annotations

import hashlib
import json
import os
import stat
import subprocess
import sys
import weakref
from collections import OrderedDict, deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

import netCDF4
import numpy as np
import xarray as xr
from xarray.backends import AbstractDataStore, BackendArray
from xarray.core import indexing

from fastcoil.base.errors import FastcoilError, IntegrityError, StorageError, out_of_memory
from fastcoil.base.files import storage_errors
from fastcoil.base.machine import available_memory
from fastcoil.loops.netcdf import AS_STORED, COMPRESSION, LARGE, close, entered, left_open, load, outline, parse

_CHUNK = 2**20
"""Bytes read at once."""
_MOST_DESCRIPTORS, _MOST_HANDLES, _MOST_HASHES = 100, 8, 1000
_held: deque[weakref.ref[StoredFile]] = deque()
"""Files with an open descriptor, first opened first."""
_parsed: deque[weakref.ref[StoredFile]] = deque()
"""Files open in the library, first opened first; touched only by who has entered it."""
_hashes: OrderedDict[tuple[int, ...], str] = OrderedDict()
"""SHA-256 of files that this process has read, by all that changes when they do."""


class StoredFile:
    """A NetCDF file in the folder of a study.

    Its bytes are hashed before the first of them is parsed, once in each process.  It is held open, and read even
    after its name was removed or points to another file.  It can be pickled: whoever unpickles it opens it by its
    name, and refuses another file.

    Parameters
    ----------
    path
        The file.
    accepted
        SHA-256 that its bytes may have; that of a file without a recorded one comes from ``try_reading``.
    cure
        What to do if it is damaged.
    """

    def __init__(self, path: Path, accepted: Collection[str], cure: str) -> None:
        self.path, self.accepted, self.cure = path, tuple(accepted), cure
        self._descriptor: Descriptor | None = None
        self._parsed: netCDF4.Dataset | None = None

    def __getstate__(self) -> tuple[Path, tuple[str, ...], str]:
        return self.path.absolute(), self.accepted, self.cure

    def __setstate__(self, state: tuple[Path, tuple[str, ...], str]) -> None:
        self.__init__(*state)  # type: ignore[misc]

    def __del__(self) -> None:
        self._leave()

    def hold(self) -> Descriptor:
        """Open the file, so that it stays what it is."""
        descriptor = self._descriptor
        if descriptor is None:
            descriptor = self._descriptor = Descriptor(self.path, self.cure)
            _held.append(weakref.ref(self))
            if len(_held) > _MOST_DESCRIPTORS:
                _let_go_of_the_oldest()
        return descriptor

    def close(self) -> None:
        """Let go of the file; the next reading opens it by its name."""
        self._descriptor = None
        self._leave()
        with entered():
            pass

    def check(self, *, afresh: bool = False) -> str:
        """Compare the hash of its bytes, computed ``afresh`` or remembered, and return it.

        Raises
        ------
        StorageError, IntegrityError
            If it cannot be read; if it is not what was written.
        """
        return self._checked(afresh=afresh)[1]

    def outline(self) -> xr.Dataset:
        """Names, dims, types and attributes of its variables; only coordinates have values.  Raises as ``check``."""
        descriptor, _ = self._checked()
        with self._readable():
            return outline(descriptor.parse)

    def load(self) -> xr.Dataset:
        """Read all of it; raises as ``check``."""
        descriptor, _ = self._checked()
        with self._readable():
            return load(descriptor.parse)

    def read(self, name: str, shape: tuple[int, ...], key: Any) -> np.ndarray:
        """Read a part of a variable that has a ``shape``; raises as ``check``."""
        descriptor, _ = self._checked()
        with self._readable(), entered():
            variable = self._parse(descriptor).variables.get(name)
            if (
                variable is None
                or variable.shape != shape
                or variable.dtype is str
                or variable.dtype.kind not in "biuf"
            ):
                raise IntegrityError(f"{self.path} holds no such {name}; {self.cure}")
            variable.set_auto_maskandscale(False)
            return np.asarray(variable[key])

    def _checked(self, *, afresh: bool = False) -> tuple[Descriptor, str]:
        """The open file whose hash is accepted, and that hash; whoever reads must read this one.

        Another thread may let go of it in ``hold`` meanwhile, and its name may lead to another file by then.
        """
        with storage_errors(self.path, "read"):
            descriptor = self.hold()
            found = descriptor.sha256(afresh=afresh)
        if found not in self.accepted:
            raise IntegrityError(
                f"{self.path} is damaged, or not of this run (the hash of its bytes differs); {self.cure}"
            )
        return descriptor, found

    def _parse(self, descriptor: Descriptor) -> netCDF4.Dataset:
        parsed = self._parsed
        if parsed is None:
            parsed = self._parsed = descriptor.parse()
            _parsed.append(weakref.ref(self))
            while len(_parsed) > _MOST_HANDLES:
                oldest = _parsed.popleft()()
                if oldest is not None:
                    oldest._leave()
        return parsed

    def _leave(self) -> None:
        """Have the library close the file, later: whoever calls may or may not be in it."""
        parsed, self._parsed = self._parsed, None
        if parsed is not None:
            left_open.append(parsed)

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except (IndexError, KeyError, FastcoilError):
            raise
        except MemoryError as error:
            raise out_of_memory(f"{self.path} cannot be read ({error})") from error
        except (OSError, RuntimeError) as error:  # bytes with this hash can be read
            found = StorageError(
                f"{self.path} cannot be read: {getattr(error, 'strerror', None) or error}; its bytes are as they were "
                "written: repair that and try again"
            )
            found.errno = getattr(error, "errno", None)
            raise found from error
        except Exception as error:
            raise IntegrityError(f"{self.path} cannot be read as NetCDF ({error}); {self.cure}") from error


def _let_go_of_the_oldest() -> None:
    with suppress(IndexError):  # another thread does it
        for _ in range(len(_held)):
            reference = _held.popleft()
            file = reference()
            if file is not None and file._descriptor is not None:
                _held.append(reference)
        if len(_held) > _MOST_DESCRIPTORS:
            oldest = _held.popleft()()
            if oldest is not None:
                oldest._descriptor = None


class Descriptor:
    """An open file, closed with the last reference to it."""

    def __init__(self, path: Path, cure: str) -> None:
        self.path, self.number = path, -1
        with storage_errors(path, "read"):
            try:
                self.number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
            except FileNotFoundError:
                raise IntegrityError(f"{path} is missing; {cure}") from None
            self._status = os.fstat(self.number)
            if not stat.S_ISREG(self._status.st_mode):
                raise IntegrityError(f"{path} is no regular file; {cure}")

    def __del__(self) -> None:
        if self.number >= 0:
            os.close(self.number)

    def parse(self) -> netCDF4.Dataset:
        """Open this very file in the library, also if its name leads to another by now; raises as ``netcdf.parse``.

        Whoever calls has entered the library.
        """
        name = f"/dev/fd/{self.number}"
        if not os.path.exists(name):  # some jails have no such folder
            name = str(self.path)
        # the library follows links, and opens only what has a name
        if self._is_at(os.path.realpath(name)):
            try:
                file = parse(name)
            except (OSError, RuntimeError):
                if self._is_at(os.path.realpath(name)):
                    raise
            else:
                if self._is_at(name):
                    return file
                close(file)
        if os.fstat(self.number).st_size > available_memory() / 2:
            raise IntegrityError(f"{self.path} was replaced, and is too large to be read into memory: open it again")
        return parse(b"".join(self.chunks()))

    def _is_at(self, name: str) -> bool:
        """Whether a name leads to this file at this moment."""
        try:
            return os.path.samestat(os.stat(name), self._status)
        except OSError:
            return False

    def chunks(self) -> Iterator[bytes]:
        """Its bytes, from the first to the last."""
        at = 0
        while chunk := os.pread(self.number, _CHUNK, at):
            yield chunk
            at += len(chunk)

    @property
    def identity(self) -> tuple[int, ...]:
        """What changes when the file does, as far as the operating system can tell."""
        found = os.fstat(self.number)
        return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns

    def sha256(self, *, afresh: bool = False) -> str:
        """SHA-256 of all bytes; computed again only if the file changed, or ``afresh``."""
        identity = self.identity
        known = None if afresh else _hashes.get(identity)
        if known is None:
            digest = hashlib.sha256()
            for chunk in self.chunks():
                digest.update(chunk)
            known = _hashes[identity] = digest.hexdigest()
            while len(_hashes) > _MOST_HASHES:
                _hashes.popitem(last=False)
        return known


def file_sha256(path: Path) -> str:
    """SHA-256 of the bytes of a file.

    Raises
    ------
    StorageError
        If it cannot be read.
    """
    descriptor = Descriptor(path, "run the study again")
    with storage_errors(path, "read"):
        return descriptor.sha256()


Layout = Mapping[str, Mapping[str, Any]]
"""Of each variable in a file: its ``dims``, ``shape``, ``dtype`` and ``attrs``."""


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


def open_lazily(file: StoredFile, layout: Layout) -> xr.Dataset:
    """The variables of a file, which stay on the disk until they are asked for; the file is not looked at."""
    return xr.open_dataset(cast("Any", _Store(file, layout)), **AS_STORED)


class _Store(AbstractDataStore):
    """What xarray needs to open a file."""

    def __init__(self, file: StoredFile, layout: Layout) -> None:
        self._file, self._layout = file, layout

    def get_variables(self) -> dict[str, xr.Variable]:
        return {name: self._variable(name, described) for name, described in self._layout.items()}

    def get_attrs(self) -> dict[str, Any]:
        return {}

    def close(self) -> None:
        self._file.close()

    def _variable(self, name: str, described: Mapping[str, Any]) -> xr.Variable:
        array = _Array(self._file, name, tuple(described["shape"]), np.dtype(described["dtype"]))
        attrs = {k: v if isinstance(v, str) else np.asarray(v) for k, v in described["attrs"].items()}
        encoding = COMPRESSION if np.prod(array.shape) > LARGE else {}
        return xr.Variable(described["dims"], indexing.LazilyIndexedArray(array), attrs, dict(encoding))


class _Array(BackendArray):
    """A variable in a file, as xarray reads it; it can be pickled."""

    def __init__(self, file: StoredFile, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.file, self.name, self.shape, self.dtype = file, name, shape, dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: Any) -> np.ndarray:
        found = self.file.read(self.name, self.shape, key)
        return found.astype(self.dtype, copy=False)


_READER = Path(__file__).with_name("netcdf_probe.py")
_SECONDS, _BYTES_PER_SECOND = 30, 5e6
"""What reading may take: much more than it does."""
_MEMORY = 2**31
_passed: set[tuple[int, ...]] = set()
"""Files that were read to their end, by all that changes when they do."""


def try_reading(path: Path, cure: str) -> StoredFile:
    """Have a child process read a file to its end, once for each process, and give it with the hash of its bytes.

    cure: what to do if it is damaged.

    Raises
    ------
    IntegrityError
        If that fails, or does not end.
    StorageError
        If it cannot be tried.
    """
    file = StoredFile(path, (), cure)
    descriptor = file.hold()
    identity = descriptor.identity
    if identity in _passed:
        file.accepted = (descriptor.sha256(),)
        return file
    seconds = int(_SECONDS + identity[2] / _BYTES_PER_SECOND)
    words = [descriptor.number, seconds, _MEMORY, json.dumps([p for p in sys.path if p])]
    try:
        with storage_errors(path, "read by another process"):
            child = subprocess.run(
                [sys.executable, "-I", str(_READER), *map(str, words)],
                pass_fds=[descriptor.number],
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
    file.accepted = (child.stdout.decode().strip(),)
    _passed.add(identity)
    return file
