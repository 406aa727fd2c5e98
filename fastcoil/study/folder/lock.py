"""One writer at a time in the folder of a study, and who that is."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from fastcoil.errors import InputError, LockedError, StorageError
from fastcoil.files import make_folder, read_bytes, remove_unfinished, storage_errors

_LOCK, _HOLDER = ".lock", ".holder"
_LONGEST_HOLDER = 4096


@contextmanager
def hold(folder: Path) -> Iterator[None]:
    """Hold the folder for one writer, make it if it is missing; one made here that stays empty is removed again.

    Raises
    ------
    InputError
        If there is a file of that name, or the name is not UTF-8.
    LockedError
        If another process holds it; the operating system frees it when that process ends, however it ends.
    StorageError
        If it cannot be written or its file system has no locks.
    """
    try:
        str(folder.absolute()).encode()
    except UnicodeEncodeError:  # the NetCDF library would refuse it, after everything was run
        raise InputError(f"{str(folder)!r} is not UTF-8: choose another folder with -o") from None
    with storage_errors(folder, "written"):  # a folder above it may be closed to us
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder} is a file: choose another folder with -o")
        made = [p for p in (folder, *folder.parents) if not p.exists()]
    lock = FileLock(folder / _LOCK)
    try:
        with storage_errors(folder, "written"):
            make_folder(folder, parents=True)
            _acquire(lock, folder)
            now = datetime.now(UTC).isoformat(timespec="seconds")
            text = f"process {os.getpid()} on {platform.node()} since {now}"
            (folder / _HOLDER).write_text(text, encoding="utf-8")
        remove_unfinished(folder)
        yield
    finally:
        if lock.is_locked:
            with suppress(OSError):  # whatever is left is in nobody's way
                (folder / _HOLDER).unlink(missing_ok=True)
                if made and [p.name for p in folder.iterdir()] == [_LOCK]:
                    (folder / _LOCK).unlink()
            lock.release()
        with suppress(OSError):  # one that is not empty stays
            for path in made:
                path.rmdir()


def find_holder(folder: Path) -> str | None:
    """Who is writing to the folder, in words, or ``None``."""
    if not (folder / _LOCK).exists():
        return None
    lock = FileLock(folder / _LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return _describe_holder(folder)
    except (OSError, NotImplementedError):  # nobody can write here
        return None
    lock.release()
    return None


def _acquire(lock: FileLock, folder: Path) -> None:
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise LockedError(
            f"{folder} is in use by {_describe_holder(folder)}: wait for it to end, or choose another folder with -o"
        ) from None
    except NotImplementedError:
        raise StorageError(f"{folder} is on a file system without locks: choose another folder with -o") from None


def _describe_holder(folder: Path) -> str:
    try:
        return f"another run ({read_bytes(folder / _HOLDER, _LONGEST_HOLDER).decode()})"
    except (OSError, ValueError):
        return "another run"
