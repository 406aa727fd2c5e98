"""Files: bounded reads, atomic and durable writes, and existence checks.

A write is flushed to disk before its name is in place.  An unreadable path raises; it is not reported as missing.
"""

import codecs
import contextlib
import errno
import hashlib
import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from fastcoil.base.errors import InputError, StorageError, shown
from fastcoil.base.machine import IS_POSIX, NO_LINK, READ, patiently, sync

UNFINISHED = ".tmp"
"""Suffix of a file that is being written."""
_CHUNK = 1 << 20  # bytes read at once
_LOOKS = ("read", "found", "read by another process")  # operations that need no space on the disk
_PROBE = 1 << 20  # bytes written to find out whether the disk is full
_LONGEST_OF_OURS = 200  # bytes of a name made by ``file_name``
_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")
"""Begins ``s3://bucket`` and ``https://host``, also as a `Path`, which drops one of the slashes; no drive letter."""


class TooLargeError(ValueError):
    """A file is larger than any valid file of its kind."""


class IrregularError(ValueError):
    """A pipe, device or socket where a regular file is expected; reading it might block or never end."""


def read_text(path: Path, what: str, limit: int, *, utf_16: bool = False, latin_1: bool = False) -> str:
    """Read a text file named by the user: UTF-8, with or without byte order mark; line ends are kept.

    path, limit: the file and its maximum size in bytes.  what: what to give if this file cannot be used, such as ``"a
    CSV file"``.  utf_16: also accept UTF-16 with a byte order mark.  latin_1: fall back to Latin-1 if the file is not
    UTF-8, for formats whose meaning is ASCII only.

    ``InputError`` if it does not exist, is not a regular file, is too large, is not UTF-8 or cannot be read.
    """
    require_usable(path, f"give {what}")
    try:
        data = read_bytes(path, limit)
        wide = utf_16 and data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        if latin_1:
            return data.decode("latin-1")
        format = "'CSV UTF-8'" if path.suffix.lower() == ".csv" else "UTF-8"  # the name in spreadsheets
        raise InputError(f"{path} is not UTF-8 (byte {error.start}): save it as {format}") from None
    except (TooLargeError, IrregularError) as error:
        raise InputError(f"{path} {error}: give {what}") from None
    except FileNotFoundError:
        raise InputError(f"{path} does not exist: give {what}") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder: give {what}") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give {what}") from None


def read_bytes(path: Path, limit: int, *, follow: bool = True) -> bytes:
    """Read a whole file of at most ``limit`` bytes; all reads except NetCDF go through here.

    follow: follow symbolic links.

    ``OSError`` from the operating system.  ``TooLargeError`` if it has more than ``limit`` bytes.  ``IrregularError``
    if it is a pipe, a device or a socket.
    """
    # checked before opening: opening a device can have side effects
    _require_regular(os.stat(path, follow_symlinks=follow))
    with open(os.open(path, os.O_RDONLY | READ | (0 if follow else NO_LINK)), "rb", buffering=0) as file:
        found = os.fstat(file.fileno())
        _require_regular(found)
        if found.st_size > limit:
            raise TooLargeError(f"has {found.st_size:,} bytes, more than {limit:,}")
        data = bytearray()
        # in chunks: the file may grow, and files of /proc report no size
        while chunk := file.read(_CHUNK):
            data += chunk
            if len(data) > limit:
                raise TooLargeError(f"has more than {limit:,} bytes")
    return bytes(data)


def file_name(name: str) -> str:
    """A portable file name, different for each ``name``."""
    plain = re.sub(r"[^\w.=+-]", "-", name)
    if plain == name and len(name.encode()) <= _LONGEST_OF_OURS:
        return name
    return f"{plain[:60]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def require_usable(path: Path, cure: str) -> None:
    """Raise an `InputError` for a path that no local file can have: an address, a NUL, a name too long, a loop."""
    if _ADDRESS.match(str(path)):
        raise InputError(f"{shown(str(path))} is an address, and fastcoil reads and writes local files: {cure}")
    try:
        path.stat()
    except (OSError, ValueError) as error:  # ValueError: a NUL, or a surrogate that no encoding has
        if isinstance(error, ValueError) or error.errno in _IMPOSSIBLE:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{shown(str(path))} is not a usable path ({reason}): {cure}") from None


def _require_regular(found: os.stat_result) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind == stat.S_IFDIR:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if kind != stat.S_IFREG:
        raise IrregularError("is not a regular file")


def commit(path: Path, data: bytes | memoryview) -> None:
    """Write ``data`` atomically: at any moment ``path`` is the complete new file or unchanged.

    ``StorageError`` if it cannot be written; no partial file remains.
    """
    commit_written(path, lambda unfinished: _write(unfinished, data))


def commit_written(
    path: Path, write: Callable[[Path], object], record: Callable[[Path], object] = lambda unfinished: None
) -> None:
    """As ``commit``, with a callback ``write`` that receives the temporary name to write to.

    record: called with the temporary name after the file is on disk and before it is renamed to ``path``.
    """
    # two machines that share the folder may have the same process number
    unfinished = path.with_name(f".{path.name}.{os.getpid()}-{os.urandom(3).hex()}{UNFINISHED}")
    try:
        with storage_errors(path, "written"):
            with _reveal_reason(unfinished):
                write(unfinished)
            sync(unfinished)
            record(unfinished)
            patiently(lambda: os.replace(unfinished, path))
            sync(path.parent)
    except BaseException:
        with contextlib.suppress(OSError):  # report the first error
            unfinished.unlink(missing_ok=True)
        raise


def make_folder(path: Path, *, parents: bool = False) -> None:
    """Make a folder and, with ``parents``, missing parents; flushed to disk before anything is written into it.

    Without ``parents``, a symbolic link is refused.

    ``OSError`` from the operating system.
    """
    if not parents and path.is_symlink():
        raise OSError(errno.ELOOP, "it is a symbolic link, which may lead anywhere: remove it")
    made = [p for p in ((path, *path.parents) if parents else (path,)) if not p.exists()]
    for folder in reversed(made):
        folder.mkdir(exist_ok=True)
    for folder in made:
        sync(folder.parent)


@contextmanager
def storage_errors(path: Path, done: str) -> Iterator[None]:
    """Turn an operating-system error into a ``StorageError``: ``path`` cannot be ``done``, and why."""
    try:
        yield
    except StorageError:
        raise
    except (OSError, RuntimeError) as error:  # netCDF4 raises RuntimeError for HDF5 errors
        reason = getattr(error, "strerror", None) or error
        cure = "check its permissions and the disk" if done in _LOOKS else "free some space or repair the folder"
        if isinstance(error, PermissionError) and not IS_POSIX:
            cure = "close the program that has it open, or check its permissions"
        found = StorageError(f"{path} cannot be {done}: {reason}; {cure}, then run the same command again")
        found.errno = getattr(error, "errno", None)
        raise found from error


def is_unfinished(path: Path) -> bool:
    """Whether this is a temporary file of ``commit``."""
    return path.name.startswith(".") and path.name.endswith(UNFINISHED)


def remove_unfinished(folder: Path) -> None:
    """Remove temporary files that killed processes left; the caller holds the lock of the folder."""
    with storage_errors(folder, "cleaned up"):
        for path in filter(is_unfinished, list(folder.iterdir())):
            path.unlink(missing_ok=True)


def _write(path: Path, data: bytes | memoryview) -> None:
    with path.open("xb") as file:
        file.write(data)


@contextmanager
def _reveal_reason(path: Path) -> Iterator[None]:
    """Find the operating system's reason for a failed write: HDF5 reports a full disk as "Permission denied"."""
    try:
        yield
    except (OSError, RuntimeError):
        with path.open("ab") as file:
            file.write(bytes(_PROBE))
        raise


_IMPOSSIBLE = (errno.ELOOP, errno.ENAMETOOLONG, errno.EINVAL)  # the last for a name that Windows does not allow
_ABSENT = (errno.ENOENT, errno.ENOTDIR, errno.EBADF, errno.ELOOP)  # errors of ``stat`` for a path that does not exist


def exists(path: Path) -> bool:
    """Whether a file or folder exists.

    ``StorageError`` if it cannot be determined, for example without permission for a parent folder.
    """
    return _status(path) is not None


def is_folder(path: Path) -> bool:
    """Whether a folder exists; raises as ``exists``."""
    found = _status(path)
    return found is not None and stat.S_ISDIR(found.st_mode)


def is_file(path: Path) -> bool:
    """Whether a regular file exists; raises as ``exists``."""
    found = _status(path)
    return found is not None and stat.S_ISREG(found.st_mode)


def has_mark(path: Path, mark: bytes, within: int = 2000) -> bool:
    """Whether the first bytes of a regular file have the mark of what fastcoil writes; False if it cannot be read."""
    with contextlib.suppress(OSError):
        if path.is_file():
            with path.open("rb") as file:
                return mark in file.read(within)
    return False


def may_be_file(path: Path) -> bool:
    """Whether a file could be written here: its folder exists, and the path is not a folder."""
    return not is_folder(path) and is_folder(path.absolute().parent)


def require_file(option: str, path: Path, *suffixes: str) -> None:
    """Raise unless a file with one of these suffixes could be written at ``path``."""
    if path.suffix.lower() not in suffixes or not may_be_file(path):
        names = " or ".join(f"NAME{suffix}" for suffix in suffixes)
        raise InputError(f"{option} {path}: give a file {names} in a folder that exists")


def _status(path: Path) -> os.stat_result | None:
    with storage_errors(path, "read"):
        try:
            return path.stat()
        except ValueError:  # not a possible path
            return None
        except OSError as error:
            if error.errno in _ABSENT:
                return None
            raise


def entries(folder: Path) -> list[Path]:
    """The sorted entries of a folder; empty if it does not exist.

    ``StorageError`` if it cannot be read.
    """
    with storage_errors(folder, "read"):
        try:
            return sorted(folder.iterdir())
        except FileNotFoundError:
            return []
