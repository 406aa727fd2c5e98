"""Files: bounded reads, atomic and durable writes, and existence checks that raise for an unreadable path."""

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

from fastcoil.base.errors import InputError, StorageError, short_repr
from fastcoil.base.machine import IS_POSIX, NO_FOLLOW_FLAG, READ_FLAGS, flush_to_disk, retry_while_locked

TEMPORARY_SUFFIX = ".tmp"  # suffix of a file that is being written
_CHUNK_BYTES = 1 << 20  # bytes read at once, or written to find out whether the disk is full
_URL_START = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")  # also of a `Path`, which drops one slash; no drive letter


class TooLargeError(ValueError):
    """A file is larger than any valid file of its kind."""


class IrregularFileError(ValueError):
    """A pipe, device or socket where a regular file is expected; reading it might block or never end."""


def read_text(path: Path, what: str, limit: int, *, utf_16: bool = False, latin_1: bool = False) -> str:
    """Read a text file named by the user: UTF-8, with or without byte order mark; line ends are kept.

    what: what to give if this file cannot be used, such as ``"a CSV file"``.  limit: bytes.  utf_16: also accept UTF-16
    with a byte order mark.  latin_1: fall back to Latin-1, for formats whose meaning is ASCII only.
    """
    require_usable_path(path, f"give {what}")
    try:
        data = read_bytes(path, limit)
        is_utf_16 = utf_16 and data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return data.decode("utf-16" if is_utf_16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        if latin_1:
            return data.decode("latin-1")
        format = "'CSV UTF-8'" if path.suffix.lower() == ".csv" else "UTF-8"  # the name in spreadsheets
        sentence = f"{path} is not UTF-8 (byte {error.start}): save it as {format}"
        raise InputError(sentence, str(path), "format") from None
    except (TooLargeError, IrregularFileError) as error:
        reason = str(error)
    except FileNotFoundError:
        reason = "does not exist"
    except IsADirectoryError:
        reason = "is a folder"
    except OSError as error:
        reason = f"cannot be read ({error.strerror})"
    raise InputError(f"{path} {reason}: give {what}", str(path), "path")


def read_bytes(path: Path, limit: int, *, follow: bool = True) -> bytes:
    """Read a whole file of at most ``limit`` bytes; all reads except NetCDF go through here.

    ``TooLargeError`` above the limit, ``IrregularFileError`` if it is a pipe, a device or a socket, else ``OSError``.
    """
    # checked before opening: opening a device can have side effects
    _require_regular_file(os.stat(path, follow_symlinks=follow))
    with open(os.open(path, os.O_RDONLY | READ_FLAGS | (0 if follow else NO_FOLLOW_FLAG)), "rb", buffering=0) as file:
        status = os.fstat(file.fileno())
        _require_regular_file(status)
        if status.st_size > limit:
            raise TooLargeError(f"has {status.st_size:,} bytes, more than {limit:,}")
        data = bytearray()
        # in chunks: the file may grow, and files of /proc report no size
        while chunk := file.read(_CHUNK_BYTES):
            data += chunk
            if len(data) > limit:
                raise TooLargeError(f"has more than {limit:,} bytes")
    return bytes(data)


def portable_file_name(name: str) -> str:
    """Convert a name to a file name that every system allows, different for each name."""
    portable = re.sub(r"[^\w.=+-]", "-", name)
    if portable == name and len(name.encode()) <= 200:
        return name
    return f"{portable[:60]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def require_usable_path(path: Path, cure: str, field: str = "") -> None:
    """Raise an `InputError` for a path that no local file can have: an address, a NUL, a name too long, a loop."""
    field = field or str(path)
    if _URL_START.match(str(path)):
        sentence = f"{short_repr(str(path))} is an address, and fastcoil reads and writes local files: {cure}"
        raise InputError(sentence, field, "path")
    try:
        path.stat()
    except (OSError, ValueError) as error:  # ValueError: a NUL, or a surrogate that no encoding has
        if isinstance(error, ValueError) or error.errno in _IMPOSSIBLE_PATH_ERRNOS:
            reason = getattr(error, "strerror", None) or error
            sentence = f"{short_repr(str(path))} is not a usable path ({reason}): {cure}"
            raise InputError(sentence, field, "path") from None


def _require_regular_file(status: os.stat_result) -> None:
    kind = stat.S_IFMT(status.st_mode)
    if kind == stat.S_IFDIR:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if kind != stat.S_IFREG:
        raise IrregularFileError("is not a regular file")


def write_atomically(path: Path, data: bytes | memoryview) -> None:
    """Write ``data`` so that ``path`` is at any moment the complete new file or unchanged, or raise `StorageError`."""

    def write(temporary: Path) -> None:
        with temporary.open("xb") as file:
            file.write(data)

    replace_atomically(path, write)


def replace_atomically(
    path: Path, write: Callable[[Path], object], record: Callable[[Path], object] = lambda temporary: None
) -> None:
    """Replace a file atomically by what ``write`` writes to the temporary name that it receives.

    record: called with the temporary name after the file is on disk and before it is renamed to ``path``.
    """
    # two machines that share the folder may have the same process number
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{os.urandom(3).hex()}{TEMPORARY_SUFFIX}")
    try:
        with convert_os_errors(path, "written"):
            with _reveal_disk_error(temporary):
                write(temporary)
            flush_to_disk(temporary)
            record(temporary)
            retry_while_locked(lambda: os.replace(temporary, path))
            flush_to_disk(path.parent)
    except BaseException:
        with contextlib.suppress(OSError):  # report the first error
            temporary.unlink(missing_ok=True)
        raise


def make_folder(path: Path, *, parents: bool = False) -> None:
    """Make a folder, flushed to disk, and missing ``parents``; ``OSError`` of the system, or for a symbolic link."""
    if not parents and path.is_symlink():
        raise OSError(errno.ELOOP, "it is a symbolic link, which may lead anywhere: move it away")
    folders = (path, *path.parents) if parents else (path,)
    new_folders = [folder for folder in folders if not folder.exists()]
    for folder in reversed(new_folders):
        folder.mkdir(exist_ok=True)
    for folder in new_folders:
        flush_to_disk(folder.parent)


@contextmanager
def convert_os_errors(path: Path, operation: str) -> Iterator[None]:
    """Convert an operating-system error in the block to a ``StorageError`` that ``path`` cannot be ``operation``."""
    try:
        yield
    except StorageError:
        raise
    except (OSError, RuntimeError) as error:  # netCDF4 raises RuntimeError for HDF5 errors
        reason = getattr(error, "strerror", None) or error
        needs_no_space = operation in ("read", "found", "read by another process")
        cure = "check its permissions and the disk" if needs_no_space else "free some space or repair the folder"
        if isinstance(error, PermissionError) and not IS_POSIX:
            cure = "close the program that has it open, or check its permissions"
        storage_error = StorageError(f"{path} cannot be {operation}: {reason}; {cure}, then run the same command again")
        storage_error.errno = getattr(error, "errno", None)
        raise storage_error from error


def is_temporary_file(path: Path) -> bool:
    """Whether this is a temporary file of ``write_atomically``."""
    return path.name.startswith(".") and path.name.endswith(TEMPORARY_SUFFIX)


def remove_temporary_files(folder: Path) -> None:
    """Remove temporary files that killed processes left; the caller holds the lock of the folder."""
    with convert_os_errors(folder, "cleaned up"):
        for path in filter(is_temporary_file, list(folder.iterdir())):
            path.unlink(missing_ok=True)


@contextmanager
def _reveal_disk_error(path: Path) -> Iterator[None]:
    """Raise the operating system's error for a failed write: HDF5 reports a full disk as "Permission denied"."""
    try:
        yield
    except (OSError, RuntimeError):
        with path.open("ab") as file:
            file.write(bytes(_CHUNK_BYTES))
        raise


_IMPOSSIBLE_PATH_ERRNOS = (errno.ELOOP, errno.ENAMETOOLONG, errno.EINVAL)  # the last: not allowed by Windows
_ABSENT_PATH_ERRNOS = (errno.ENOENT, errno.ENOTDIR, errno.EBADF, errno.ELOOP)  # of ``stat`` where nothing exists


def exists(path: Path) -> bool:
    """Whether a file or folder exists; ``StorageError`` if that cannot be determined, as for lack of permission."""
    return _stat_or_none(path) is not None


def is_folder(path: Path) -> bool:
    """Whether a folder exists; raises as ``exists``."""
    return (status := _stat_or_none(path)) is not None and stat.S_ISDIR(status.st_mode)


def is_file(path: Path) -> bool:
    """Whether a regular file exists; raises as ``exists``."""
    return (status := _stat_or_none(path)) is not None and stat.S_ISREG(status.st_mode)


def has_mark(path: Path, mark: bytes, n_bytes: int = 2000) -> bool:
    """Whether the first bytes of a regular file have the mark of what fastcoil writes; False if it cannot be read."""
    with contextlib.suppress(OSError):
        if path.is_file():
            with path.open("rb") as file:
                return mark in file.read(n_bytes)
    return False


def is_possible_file(path: Path) -> bool:
    """Whether a file could be written here: its folder exists, and the path is not a folder."""
    return not is_folder(path) and is_folder(path.absolute().parent)


def require_output_file(option: str, path: Path, *suffixes: str) -> None:
    """Raise unless a file with one of these suffixes could be written at ``path``."""
    if path.suffix.lower() not in suffixes or not is_possible_file(path):
        names = " or ".join(f"NAME{suffix}" for suffix in suffixes)
        raise InputError(f"{option} {path}: give a file {names} in a folder that exists", option, "path")


def _stat_or_none(path: Path) -> os.stat_result | None:
    with convert_os_errors(path, "read"):
        try:
            return path.stat()
        except ValueError:  # not a possible path
            return None
        except OSError as error:
            if error.errno in _ABSENT_PATH_ERRNOS:
                return None
            raise


def list_folder(folder: Path) -> list[Path]:
    """List the sorted entries of a folder; none if it does not exist, ``StorageError`` if it cannot be read."""
    with convert_os_errors(folder, "read"):
        try:
            return sorted(folder.iterdir())
        except FileNotFoundError:
            return []
