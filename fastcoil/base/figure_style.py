"""The looks of all figures: colours, line styles, settings, and texts that fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from textwrap import fill
from typing import Any

BLUE, RED, YELLOW = "#004488", "#BB5566", "#DDAA33"
COLOURS = (BLUE, RED, YELLOW)
"""The "high-contrast" scheme of Tol, Colour Schemes, SRON/EPS/TN/09-002, issue 3.2 (2021), dark to light.

Deuteranopes and protanopes can tell them apart, and from black and ``GREY``.  In a grey print they differ, too.
"""
GREY = "0.65"
"""For lines to compare with.  In a grey print it is as light as yellow: there, only line styles tell them apart."""
FAINT = "0.9"
"""For shaded backgrounds."""
LINE_STYLES = ("-", "--", ":")
"""One for each of ``COLOURS``."""
DOTTED = (0, (1, 3))
"""Line style of reference lines."""
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
}
_INCHES_PER_POINT = 1 / 72
_LETTER = 0.55
"""Width of an average letter of the standard font, in font sizes; rounded up, so that no line is too long."""


@contextmanager
def apply_style(**changes: Any) -> Iterator[None]:
    """Draw in ``STYLE``; a context, or a decorator of what draws.

    ``changes`` are settings that differ, as ``axes_grid=False`` for ``axes.grid``.
    """
    from matplotlib import rc_context

    settings: Any = {**STYLE, **{name.replace("_", "."): value for name, value in changes.items()}}
    with rc_context(settings):
        yield


def wrapped(text: str, inches: float, points: float) -> str:
    """Text broken into lines of at most this width at this font size; its own line breaks stay."""
    letters = max(int(inches / (_LETTER * points * _INCHES_PER_POINT)), 1)
    return "\n".join(fill(line, letters, break_long_words=False) for line in text.splitlines())
