"""Reading and writing files: reads are bounded, writes are atomic and on the disk before a name points to them.

What stands at a path that may be closed to us: what cannot be looked at is not taken for absent.
"""

from __future__ import annotations

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

UNFINISHED = ".tmp"
"""Suffix of a file that is being written."""
_CHUNK = 1 << 20
"""Bytes read at once."""
_LOOKS = ("read", "found", "read by another process")
"""What is done to a file without writing, for which no space is needed."""
_PROBE = 1 << 20
"""Bytes that do not fit on a full disk."""
_LONGEST_NAME, _LONGEST_PATH = 255, 4000
"""Bytes; files that we add to a folder need some more."""
_LONGEST_OF_OURS = 200
"""Bytes of a name that we make."""
_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFLNK: "a link",
}


class TooLargeError(ValueError):
    """A file has more bytes than any file of its kind."""


class IrregularError(ValueError):
    """A pipe, a device or a socket stands where a file is expected: it may never end, or never begin."""


def read_text(path: Path, what: str, limit: int, *, utf_16: bool = False, latin_1: bool = False) -> str:
    """Read a text file that a user names: UTF-8, with or without byte order mark; line ends are kept.

    Parameters
    ----------
    path, limit
        The file, and the most bytes it may have.
    what
        What to give if this file cannot be used, such as ``"a CSV file"``.
    utf_16
        Whether it may be UTF-16 instead, with a byte order mark.
    latin_1
        Whether it is read as Latin-1 where it is not UTF-8, because no letter beyond ASCII in it matters.

    Raises
    ------
    InputError
        If it does not exist, is no regular file, is too large, is not UTF-8 or cannot be read.
    """
    require_usable(path, f"give {what}")
    try:
        data = read_bytes(path, limit)
        wide = utf_16 and data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        if latin_1:
            return data.decode("latin-1")
        format = "'CSV UTF-8'" if path.suffix.lower() == ".csv" else "UTF-8"  # as spreadsheets call it
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
    """Read a small file whole; ``read_text`` and everything else that is not NetCDF goes through here.

    Parameters
    ----------
    path, limit
        The file, and the most bytes it may have.
    follow
        Whether it may be a symbolic link.

    Raises
    ------
    OSError
        As the operating system reports it.
    TooLargeError
        If it has more than ``limit`` bytes.
    IrregularError
        If it is a pipe, a device or a socket; it is not waited for.
    """
    # opening some devices does something, hence the look before
    _require_regular(os.stat(path, follow_symlinks=follow))
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW)
    with open(os.open(path, flags), "rb", buffering=0) as file:
        found = os.fstat(file.fileno())
        _require_regular(found)
        if found.st_size > limit:
            raise TooLargeError(f"has {found.st_size:,} bytes, more than {limit:,}")
        data = bytearray()
        # piece by piece: it may grow, and files of the kernel give no size
        while chunk := file.read(_CHUNK):
            data += chunk
            if len(data) > limit:
                raise TooLargeError(f"has more than {limit:,} bytes")
    return bytes(data)


def file_name(name: str) -> str:
    """A name that every file system takes, another one for every other name."""
    plain = re.sub(r"[^\w.=+-]", "-", name)
    if plain == name and len(name.encode()) <= _LONGEST_OF_OURS:
        return name
    return f"{plain[:60]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def require_usable(path: Path, cure: str) -> None:
    """Refuse a path that no file can have: half a character, NUL, names or a whole too long, links in a circle.

    Raises
    ------
    InputError
        With ``cure`` at its end.
    """
    name = shown(str(path))
    try:
        encoded = os.fsencode(path)
    except UnicodeEncodeError:
        raise InputError(f"{name} holds half a character, no path does: {cure}") from None
    if b"\0" in encoded:
        raise InputError(f"{name} holds the character NUL, no path does: {cure}")
    longest = max(map(len, encoded.split(b"/")))
    if longest > _LONGEST_NAME:
        raise InputError(f"{name} has a name of {longest:,} bytes, file systems take {_LONGEST_NAME}: {cure}")
    if len(encoded) > _LONGEST_PATH:
        raise InputError(f"{name} has {len(encoded):,} bytes, a path has at most {_LONGEST_PATH:,}: {cure}")
    try:
        path.stat()
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENAMETOOLONG):
            raise InputError(f"{name} is no usable path ({error.strerror}): {cure}") from None


def _require_regular(found: os.stat_result) -> None:
    kind = stat.S_IFMT(found.st_mode)
    if kind == stat.S_IFDIR:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if kind != stat.S_IFREG:
        raise IrregularError(f"is {_KINDS.get(kind, 'something else')}, not a file")


def commit(path: Path, data: bytes | memoryview) -> None:
    """Write ``data`` so that ``path`` is, at any moment, the whole new file or what it was before.

    Raises
    ------
    StorageError
        If it cannot be written; nothing half-written is left behind.
    """
    commit_written(path, lambda unfinished: _write(unfinished, data))


def commit_written(
    path: Path, write: Callable[[Path], object], record: Callable[[Path], object] = lambda unfinished: None
) -> None:
    """As ``commit``, for a library that writes the file itself: ``write`` gets the name to use.

    record: gets the same name once the file is on the disk, and before ``path`` points to it.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}{UNFINISHED}")
    try:
        with storage_errors(path, "written"):
            with _reveal_reason(unfinished):
                write(unfinished)
            _sync(unfinished, os.O_RDWR)
            record(unfinished)
            os.replace(unfinished, path)
            _sync(path.parent, os.O_RDONLY)
    except BaseException:
        with contextlib.suppress(OSError):  # the first error is the one to report
            unfinished.unlink(missing_ok=True)
        raise


def make_folder(path: Path, *, parents: bool = False) -> None:
    """Make a folder, and ``parents`` that are missing; what is made is on the disk before anything is in it.

    Without ``parents`` it belongs to the folder above it: a link is refused.

    Raises
    ------
    OSError
        As the operating system reports it.
    """
    if not parents and path.is_symlink():
        raise OSError(errno.ELOOP, "it is a symbolic link, which may lead anywhere: remove it")
    made = [p for p in ((path, *path.parents) if parents else (path,)) if not p.exists()]
    for folder in reversed(made):
        folder.mkdir(exist_ok=True)
    for folder in made:
        _sync(folder.parent, os.O_RDONLY)


@contextmanager
def storage_errors(path: Path, done: str) -> Iterator[None]:
    """Turn an error of the operating system into a ``StorageError``: ``path`` cannot be ``done``, and why."""
    try:
        yield
    except StorageError:  # an OSError too, and it says why already
        raise
    except (OSError, RuntimeError) as error:  # netCDF4 reports errors of HDF5 as RuntimeError
        reason = getattr(error, "strerror", None) or error
        cure = "check its permissions and the disk" if done in _LOOKS else "free some space or repair the folder"
        found = StorageError(f"{path} cannot be {done}: {reason}; {cure}, then run the same command again")
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


_ABSENT = (errno.ENOENT, errno.ENOTDIR, errno.EBADF, errno.ELOOP)
"""Answers to a question for something that does not exist."""


def exists(path: Path) -> bool:
    """Whether a file or folder has this name.

    Raises
    ------
    StorageError
        If that cannot be seen, for a folder above it may not be entered, say.
    """
    return _status(path) is not None


def is_folder(path: Path) -> bool:
    """Whether a folder has this name; raises as ``exists``."""
    found = _status(path)
    return found is not None and stat.S_ISDIR(found.st_mode)


def is_file(path: Path) -> bool:
    """Whether a regular file has this name; raises as ``exists``."""
    found = _status(path)
    return found is not None and stat.S_ISREG(found.st_mode)


def may_be_file(path: Path) -> bool:
    """Whether a file can have this name: the folder that it would be in exists, and no folder has the name."""
    return not is_folder(path) and is_folder(path.absolute().parent)


def _status(path: Path) -> os.stat_result | None:
    with storage_errors(path, "read"):
        try:
            return path.stat()
        except ValueError:  # no path has this name
            return None
        except OSError as error:
            if error.errno in _ABSENT:
                return None
            raise


def entries(folder: Path) -> list[Path]:
    """All that is in a folder, sorted; nothing is in one that is missing.

    Raises
    ------
    StorageError
        If it cannot be read.
    """
    with storage_errors(folder, "read"):
        try:
            return sorted(folder.iterdir())
        except FileNotFoundError:
            return []
