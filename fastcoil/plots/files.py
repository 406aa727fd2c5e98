"""Figures as files: PNG, PDF or SVG, whole or not at all, and the same bytes every time."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fastcoil.arguments import checking, choice_of, mapping_of, path_of, whole_of
from fastcoil.errors import InputError, WrongType
from fastcoil.files import commit, storage_errors

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
    low, high = _DPI_RANGE
    with checking() as check:
        check(choice_of, "format", format, FORMATS)
        check(whole_of, "dpi", dpi, low, high, f"give a whole number from {low} to {high}")


def _check_figures(figures: Mapping[str, Figure]) -> None:
    """Refuse anything but figures by file name."""
    cure = "give figures by file name, such as {'rmse': figure}"
    for name, figure in mapping_of("figures", figures, cure).items():
        path_of("figures", name, cure)
        if not hasattr(type(figure), "savefig"):
            raise InputError(WrongType(f"figures has a {type(figure).__name__}: {cure}"))


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
    with checking() as check:
        check(check_format, format, dpi)
        folder = check(path_of, "folder", folder, "give the path of a folder")
        check(_check_figures, figures)
    with storage_errors(folder, "made"):
        folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        paths.append(folder / f"{name}.{format}")
        commit(paths[-1], encode(figure, format, dpi))
    return paths
