"""Reading and writing files: reads are bounded, writes are atomic and on the disk before a name points to them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from fastcoil.errors import InputError, StorageError

UNFINISHED = ".tmp"
"""Suffix of a file that is being written."""
_CHUNK = 1 << 20
"""Bytes read at once."""
_PROBE = 1 << 20
"""Bytes that do not fit on a full disk."""


class TooLargeError(ValueError):
    """A file has more bytes than any file of its kind."""


def read_text(path: Path, what: str, limit: int) -> str:
    """Read a text file that a user names: UTF-8, with or without byte order mark; line ends are kept.

    Parameters
    ----------
    path
        The file.
    what
        What to give if this file cannot be used, such as ``"a CSV file"``.
    limit
        The most bytes it may have.

    Raises
    ------
    InputError
        If it does not exist, is a folder, is too large, is not UTF-8 or cannot be read.
    """
    try:
        return read_bytes(path, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        format = "'CSV UTF-8'" if path.suffix.lower() == ".csv" else "UTF-8"  # as spreadsheets call it
        raise InputError(f"{path} is not UTF-8 (byte {error.start}): save it as {format}") from None
    except TooLargeError as error:
        raise InputError(f"{path} {error}: give {what}") from None
    except FileNotFoundError:
        raise InputError(f"{path} does not exist: give {what}") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder: give {what}") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give {what}") from None


def read_bytes(path: Path, limit: int) -> bytes:
    """Read a small file whole; ``read_text`` and everything else that is not NetCDF goes through here.

    Raises
    ------
    OSError
        As the operating system reports it.
    TooLargeError
        If it has more than ``limit`` bytes.
    """
    data = bytearray()
    with path.open("rb") as file:
        # piece by piece: the size of a device or a pipe is not known before
        while chunk := file.read(_CHUNK):
            data += chunk
            if len(data) > limit:
                raise TooLargeError(f"has more than {limit:,} bytes")
    return bytes(data)


def commit(path: Path, data: bytes | memoryview) -> None:
    """Write ``data`` so that ``path`` is, at any moment, the whole new file or what it was before.

    Raises
    ------
    StorageError
        If it cannot be written; nothing half-written is left behind.
    """
    commit_written(path, lambda unfinished: _write(unfinished, data))


def commit_written(path: Path, write: Callable[[Path], object]) -> None:
    """As ``commit``, for a library that writes the file itself: ``write`` gets the name to use."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}{UNFINISHED}")
    try:
        with storage_errors(path, "written"):
            with _reveal_reason(unfinished):
                write(unfinished)
            _sync(unfinished, os.O_RDWR)
            os.replace(unfinished, path)
            _sync(path.parent, os.O_RDONLY)
    except BaseException:
        with contextlib.suppress(OSError):  # the first error is the one to report
            unfinished.unlink(missing_ok=True)
        raise


@contextmanager
def storage_errors(path: Path, done: str) -> Iterator[None]:
    """Turn an error of the operating system into a ``StorageError``: ``path`` cannot be ``done``, and why."""
    try:
        yield
    except StorageError:  # an OSError too, and it says why already
        raise
    except (OSError, RuntimeError) as error:  # netCDF4 reports errors of HDF5 as RuntimeError
        reason = getattr(error, "strerror", None) or error
        found = StorageError(
            f"{path} cannot be {done}: {reason}; free some space or repair the folder, then run the same command again"
        )
        found.errno = getattr(error, "errno", None)
        raise found from error


def is_unfinished(path: Path) -> bool:
    """Whether a file is being written, or was left by a writer that was killed."""
    return path.name.startswith(".") and path.name.endswith(UNFINISHED)


def remove_unfinished(folder: Path) -> None:
    """Remove what killed writers left in a folder; nobody else may be writing there."""
    with storage_errors(folder, "cleaned up"):
        for path in filter(is_unfinished, list(folder.iterdir())):
            path.unlink(missing_ok=True)


def _write(path: Path, data: bytes | memoryview) -> None:
    with path.open("xb") as file:
        file.write(data)


@contextmanager
def _reveal_reason(path: Path) -> Iterator[None]:
    """Let the operating system say why a library could not write: HDF5 calls a full disk "Permission denied"."""
    try:
        yield
    except (OSError, RuntimeError):
        with path.open("ab") as file:
            file.write(bytes(_PROBE))
        raise


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
