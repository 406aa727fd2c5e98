"""What stands in a folder that may be closed to us: a folder that cannot be looked at is not taken for an empty one."""

from __future__ import annotations

from pathlib import Path

from fastcoil.files import storage_errors


def exists(path: Path) -> bool:
    """Whether a file or folder has this name.

    Raises
    ------
    StorageError
        If that cannot be seen, for a folder above it may not be entered, say.
    """
    with storage_errors(path, "read"):
        return path.exists()


def is_folder(path: Path) -> bool:
    """Whether a folder has this name; raises as ``exists``."""
    with storage_errors(path, "read"):
        return path.is_dir()


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
