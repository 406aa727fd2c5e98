"""Style of all figures, and writing them as PNG, PDF or SVG, atomically and with reproducible bytes."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from fastcoil.base.arguments import argument_checks, require_choice, require_integer
from fastcoil.base.errors import settings_errors
from fastcoil.base.files import convert_os_errors, make_folder, read_bytes, write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure


BLUE = "#004488"
RED = "#BB5566"
YELLOW = "#DDAA33"
COLOURS = (BLUE, RED, YELLOW)
"""The "high-contrast" scheme of Tol, Colour Schemes, SRON/EPS/TN/09-002, issue 3.2 (2021), dark to light.

Distinct from each other, black and ``LINE_GREY`` for deuteranopes and protanopes, and from each other in greyscale.
"""
LINE_GREY = "0.65"  # for reference lines; in greyscale print as light as yellow
SHADE_GREY = "0.9"  # for shaded backgrounds
LINE_STYLES = ("-", "--", ":")  # one for each of ``COLOURS``
DOTTED_LINE = (0, (1, 3))  # line style of reference lines
STYLE: Mapping[str, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "font.size": 9,
    "axes.titlesize": 9,
    "figure.titlesize": 9,
    "legend.fontsize": 8,
    "lines.linewidth": 1.4,
    "figure.dpi": 150,
    "timezone": "UTC",  # times are drawn as they stand
}


def check_matplotlib() -> None:
    """Refuse settings of this machine with which matplotlib cannot be imported."""
    with settings_errors("matplotlib", "correct the file matplotlibrc or the environment variable MPLBACKEND"):
        import matplotlib  # noqa: F401, ICN001


@contextmanager
def apply_style(**changes: Any) -> Iterator[None]:
    """Apply ``STYLE`` as a context manager or decorator, with ``changes``: ``axes_grid=False`` for ``axes.grid``."""
    check_matplotlib()
    from matplotlib import rc_context, style

    settings: Any = {**STYLE, **{name.replace("_", "."): value for name, value in changes.items()}}
    with style.context("default"), rc_context(settings):  # without a matplotlibrc, whose text.usetex needs LaTeX
        yield


def wrap_text(text: str, inches: float, points: float) -> str:
    """Wrap text to a width in inches at a font size in points; existing line breaks are kept."""
    character_width = 0.55 * points / 72  # average of the default font, rounded up so that no line is too long
    n_characters = max(int(inches / character_width), 1)
    return "\n".join(fill(line, n_characters, break_long_words=False) for line in text.splitlines())


FIGURES_FOLDER = "figures"  # name of the figure folder inside a study's folder
FIGURE_FORMATS = ("png", "pdf", "svg")
DEFAULT_DPI = 200  # dots per inch of a PNG and of rasterised maps in a PDF or SVG
_SOFTWARE_METADATA: Mapping[str, dict[str, Any]] = {
    "png": {"Software": "fastcoil"},
    "pdf": {"Creator": "fastcoil", "CreationDate": None},
    "svg": {"Creator": "fastcoil", "Date": None},
}
_ORIGIN_FIELD = {"png": "Source", "pdf": "Keywords", "svg": "Source"}
"""Standard metadata field that holds the origin of a figure; these formats allow no custom names."""
_ORIGIN_PREFIX = "content_sha256 "
_ORIGIN_HASH = _ORIGIN_PREFIX.encode() + rb"([0-9a-f]{64})"
_ORIGIN_IN_FILE = {
    "png": re.compile(rb"\0\0\0VtEXtSource\0" + _ORIGIN_HASH),  # V: the length of this text, 86
    "pdf": re.compile(rb"/Keywords \(" + _ORIGIN_HASH + rb"\)"),
    "svg": re.compile(rb"<dc:source>" + _ORIGIN_HASH + rb"</dc:source>"),
}
# text is stored as text, so that it can be searched and edited
_SAVE_SETTINGS: Any = {"svg.hashsalt": "fastcoil", "svg.fonttype": "none", "pdf.fonttype": 42, "timezone": "UTC"}


def check_format(format: str, dpi: object) -> None:
    """Raise an ``InputError`` unless ``format`` is one of ``FIGURE_FORMATS`` and ``dpi`` a whole number, 50 to 1200."""
    with argument_checks() as check:
        check(require_choice, "format", format, FIGURE_FORMATS)
        check(require_integer, "dpi", dpi, 50, 1200, "give a whole number from 50 to 1200")


def encode_figure(figure: Figure, format: str = "png", dpi: int = DEFAULT_DPI, drawn_from: str | None = None) -> bytes:
    """Encode a figure as the bytes of a file; ``drawn_from``: ``content_sha256`` of the results it shows."""
    from matplotlib import rc_context, style
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        # a user's label with $ is not mathtext; the tick labels of logarithmic axes are
        if isinstance(text, Text) and "$" in text.get_text() and "mathdefault" not in text.get_text():
            text.set_parse_math(False)
    origin_metadata = {} if drawn_from is None else {_ORIGIN_FIELD[format]: _ORIGIN_PREFIX + drawn_from}
    data = io.BytesIO()
    with style.context("default"), rc_context(_SAVE_SETTINGS):
        figure.savefig(data, format=format, dpi=dpi, metadata={**_SOFTWARE_METADATA[format], **origin_metadata})
    return data.getvalue()


def write_figures(
    figures: Mapping[str, Figure], folder: Path, *, format: str = "png", dpi: int = DEFAULT_DPI,
    drawn_from: str | None = None,
) -> list[Path]:  # fmt: skip
    """Write figures, by name without suffix, into a folder, made if missing; ``drawn_from``: hash of the results."""
    with convert_os_errors(folder, "made"):
        make_folder(folder, parents=True)
    paths = [folder / f"{name}.{format}" for name in figures]
    for path, figure in zip(paths, figures.values(), strict=True):
        write_atomically(path, encode_figure(figure, format, dpi, drawn_from))
    return paths


def read_origin(path: Path) -> str | None:
    """Read the ``content_sha256`` of the results that a figure was drawn from, in its metadata; None without one."""
    try:
        data = read_bytes(path, 2**26) if path.is_file() else b""
    except (OSError, ValueError):  # unreadable, too large or not a regular file
        return None
    match = _ORIGIN_IN_FILE[path.suffix[1:]].search(data)
    return match[1].decode() if match else None


def current_figures(folder: Path, content_sha256: str) -> list[Path]:
    """Return the figures in a study's folder that were drawn from these results."""
    return [path for path in _figure_files(folder) if read_origin(path) == content_sha256]


def stale_figures(folder: Path, content_sha256: str) -> list[Path]:
    """Return the figures in a study's folder that were drawn from other results, as their metadata say."""
    return [path for path in _figure_files(folder) if read_origin(path) not in (content_sha256, None)]


def _figure_files(folder: Path) -> list[Path]:
    return sorted(path for format in FIGURE_FORMATS for path in (folder / FIGURES_FOLDER).glob(f"*.{format}"))
