"""Files that are either whole or not there: bytes are on the disk before a name points to them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from fastcoil.errors import StorageError

UNFINISHED = ".tmp"
"""Suffix of a file that is being written."""
_PROBE = 1 << 20
"""Bytes that a full disk does not take."""


def commit(path: Path, data: bytes | memoryview) -> None:
    """Write ``data`` so that ``path`` is, at any moment, the whole new file or what it was before.

    Raises
    ------
    StorageError
        If it cannot be written; nothing half-written is left behind.
    """
    commit_written(path, lambda unfinished: _write(unfinished, data))


def commit_written(path: Path, write: Callable[[Path], object]) -> None:
    """As ``commit``, for a library that wants to write the file by its name."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}{UNFINISHED}")
    try:
        with reported(path, "written"):
            with _reason_found(unfinished):
                write(unfinished)
            _synced(unfinished, os.O_RDWR)
            os.replace(unfinished, path)
            _synced(path.parent, os.O_RDONLY)
    except BaseException:
        _forget(unfinished)
        raise


@contextmanager
def reported(path: Path, done: str) -> Iterator[None]:
    """Tell what the operating system refuses as a ``StorageError``: that ``path`` cannot be ``done``, and why."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # netCDF4 reports errors of HDF5 as RuntimeError
        reason = getattr(error, "strerror", None) or error
        raise StorageError(
            f"{path} cannot be {done}: {reason}; free some space or mend the folder, then run the same command again"
        ) from error


def is_unfinished(path: Path) -> bool:
    """Whether a file is being written, or was left by a writer that was killed."""
    return path.name.startswith(".") and path.name.endswith(UNFINISHED)


def remove_unfinished(folder: Path) -> None:
    """Remove what a killed writer left in a folder; nobody else may be writing there."""
    with reported(folder, "tidied"):
        for path in filter(is_unfinished, list(folder.iterdir())):
            path.unlink(missing_ok=True)


def _write(path: Path, data: bytes | memoryview) -> None:
    with path.open("xb") as file:
        file.write(data)


@contextmanager
def _reason_found(path: Path) -> Iterator[None]:
    """Let the operating system say why a library could not write: HDF5 calls a full disk "Permission denied"."""
    try:
        yield
    except (OSError, RuntimeError):
        with path.open("ab") as file:
            file.write(bytes(_PROBE))
        raise


def _synced(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _forget(unfinished: Path) -> None:
    with contextlib.suppress(OSError):  # the first error is the one to tell
        unfinished.unlink(missing_ok=True)
