"""One writer at a time in the folder of a study, and who that is."""

from __future__ import annotations

import errno
import fcntl
import os
import platform
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from fastcoil.base.errors import InputError, LockedError, StorageError, shown
from fastcoil.base.files import commit, make_folder, read_bytes, remove_unfinished, require_usable, storage_errors
from fastcoil.base.text import printable

_LOCK, _HOLDER = ".lock", ".holder"
_LONGEST_HOLDER = 4096
_PATIENCE, _PAUSE = 0.5, 0.01
"""Seconds to try to get the lock, since somebody may just be looking whether it is held; seconds between two trials."""
_WITHOUT_LOCKS = (errno.EOPNOTSUPP, errno.ENOLCK, errno.ENOSYS)
"""Answers of a file system that has no locks, or has run out of them."""


@contextmanager
def hold(folder: Path) -> Iterator[None]:
    """Hold the folder for one writer, make it if it is missing; one made here that stays empty is removed again.

    Raises
    ------
    InputError
        If there is a file of that name, or no folder can have that name.
    LockedError
        If another process holds it; the operating system frees it when that process ends, however it ends.
    StorageError
        If it cannot be written or its file system has no locks.
    """
    require_usable(folder, "choose another folder with -o")
    try:
        str(folder.absolute()).encode()
    except UnicodeEncodeError:  # the NetCDF library would refuse it, after everything was run
        raise InputError(f"{str(folder)!r} is not UTF-8: choose another folder with -o") from None
    if "\\" in str(folder):
        raise InputError(
            f"{shown(str(folder))} holds a backslash, which the NetCDF library takes for a slash: choose another "
            "folder with -o"
        )
    with storage_errors(folder, "written"):  # a folder above it may be closed to us
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder} is a file: choose another folder with -o")
        made = [p for p in (folder, *folder.parents) if not p.exists()]
    lock = None
    try:
        with storage_errors(folder, "written"):
            make_folder(folder, parents=True)
            try:
                lock = _acquire(folder)
            except StorageError:
                if made:  # where there are no locks, nobody holds this one
                    (folder / _LOCK).unlink(missing_ok=True)
                raise
        now = datetime.now(UTC).isoformat(timespec="seconds")
        text = f"process {os.getpid()} on {platform.node()} since {now}"
        commit(folder / _HOLDER, text.encode(errors="replace"))
        remove_unfinished(folder)
        yield
    finally:
        if lock is not None:
            with suppress(OSError):  # whatever is left is in nobody's way
                (folder / _HOLDER).unlink(missing_ok=True)
                if made and [p.name for p in folder.iterdir()] == [_LOCK]:
                    (folder / _LOCK).unlink()
            os.close(lock)
        with suppress(OSError):  # one that is not empty stays
            for path in made:
                path.rmdir()


def find_holder(folder: Path) -> str | None:
    """Who is writing to the folder, in words, or ``None``."""
    try:
        lock = _open(folder / _LOCK, os.O_RDONLY)
    except (OSError, StorageError):  # nobody can write here
        return None
    try:
        # shared, so that two who look do not take each other for a writer
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return _describe_holder(folder)
    except OSError:
        return None
    finally:
        os.close(lock)
    return None


def _acquire(folder: Path) -> int:
    """The descriptor of the lock file, which holds the lock until it is closed."""
    path, last = folder / _LOCK, time.monotonic() + _PATIENCE
    while True:
        lock, held = _open(path, os.O_RDWR | os.O_CREAT), False
        try:
            # whoever held it before may have removed the file of that name
            held = _try_to_lock(lock, folder) and _is_same(lock, path)
        finally:
            if not held:
                os.close(lock)
        if held:
            return lock
        if time.monotonic() > last:
            raise LockedError(
                f"{folder} is in use by {_describe_holder(folder)}: wait for it to end, or choose another folder"
            )
        time.sleep(_PAUSE)


def _try_to_lock(lock: int, folder: Path) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # some file systems answer EACCES
        return False
    except OSError as error:
        if error.errno not in _WITHOUT_LOCKS:
            raise
        raise StorageError(
            f"{folder} is on a file system without locks ({error.strerror}), where two runs could spoil each other's "
            "results: choose a folder on another one with -o"
        ) from None
    return True


def _open(path: Path, flags: int) -> int:
    """Open the lock file itself: a link could lead to a file of somebody else."""
    try:
        lock = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC, 0o666)
    except OSError as error:
        if error.errno not in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
            raise
    else:
        if stat.S_ISREG(os.fstat(lock).st_mode):
            return lock
        os.close(lock)
    raise StorageError(f"{path} is a link, a pipe or a folder, but not a file: delete it, then run the same again")


def _is_same(lock: int, path: Path) -> bool:
    """Whether the open file is still the one of that name."""
    try:
        return os.path.samestat(os.fstat(lock), os.stat(path, follow_symlinks=False))
    except FileNotFoundError:
        return False


def _describe_holder(folder: Path) -> str:
    try:
        text = read_bytes(folder / _HOLDER, _LONGEST_HOLDER, follow=False).decode(errors="replace")
    except (OSError, ValueError):
        return "another run"
    return f"another run ({printable(text)})"
