"""Figures as files: PNG, PDF or SVG, whole or not at all, and the same bytes every time."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fastcoil.errors import InputError, nearest
from fastcoil.files import commit, make_folder, storage_errors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "pdf", "svg")
DPI = 200
"""Dots per inch of a PNG, and of the maps inside a PDF or SVG."""
_DPI_RANGE = (50, 1200)
_METADATA: Mapping[str, dict[str, Any]] = {
    "png": {"Software": "fastcoil"},
    "pdf": {"Creator": "fastcoil", "CreationDate": None},
    "svg": {"Creator": "fastcoil", "Date": None},
}
_SETTINGS: Any = {"svg.hashsalt": "fastcoil", "svg.fonttype": "none", "pdf.fonttype": 42}
"""Texts stay texts, to be searched and edited."""


def check_format(format: str, dpi: object) -> None:
    """Refuse a format or a resolution that cannot be written.

    Raises
    ------
    InputError
        If ``format`` is none of ``FORMATS`` or ``dpi`` no whole number from 50 to 1200.
    """
    problems = []
    if format not in FORMATS:
        problems.append(f"format = {format!r}{nearest(str(format), FORMATS)}: give {', '.join(FORMATS[:-1])} or svg")
    low, high = _DPI_RANGE
    if isinstance(dpi, bool) or not isinstance(dpi, int) or not low <= dpi <= high:
        problems.append(f"dpi = {dpi!r}: give a whole number from {low} to {high}")
    if problems:
        raise InputError(problems)


def encode(figure: Figure, format: str = "png", dpi: int = DPI) -> bytes:
    """Encode a figure as the bytes of a file."""
    from matplotlib import rc_context

    data = io.BytesIO()
    with rc_context(_SETTINGS):
        figure.savefig(data, format=format, dpi=dpi, metadata=_METADATA[format])
    return data.getvalue()


def write(figures: Mapping[str, Figure], folder: Path, *, format: str = "png", dpi: int = DPI) -> list[Path]:
    """Write figures into a folder, made if need be; returns their paths.

    Parameters
    ----------
    figures
        Figures by file name without suffix.
    format
        ``png``, ``pdf`` or ``svg``.
    dpi
        Dots per inch of a PNG, and of the maps inside a PDF or SVG; 50 to 1200.

    Raises
    ------
    InputError
        If ``format`` or ``dpi`` is not one of these.
    StorageError
        If a file cannot be written; nothing half-written is left behind.
    """
    check_format(format, dpi)
    with storage_errors(folder, "made"):
        make_folder(folder, parents=True)
    paths = []
    for name, figure in figures.items():
        paths.append(folder / f"{name}.{format}")
        commit(paths[-1], encode(figure, format, dpi))
    return paths
