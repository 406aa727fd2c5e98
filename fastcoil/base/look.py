"""What stands at a path that may be closed to us: what cannot be looked at is not taken for absent."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from fastcoil.base.files import storage_errors

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
