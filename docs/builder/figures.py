"""Figures of the examples that matplotlib's pyplot does not know: those that ``plot()`` of a result returns."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

LAST = "___"
"""Where sphinx-gallery keeps the value of the last line of a block."""


def returned_figures(block: tuple[str, str, int], block_vars: dict[str, Any], conf: dict[str, Any]) -> str:
    """The figure that the last line of a block returned, if any, as an image of the page."""
    value = block_vars["example_globals"].get(LAST)
    if not isinstance(value, Figure) or value.canvas.manager is not None:
        return ""
    block_vars["example_globals"][LAST] = None  # drawn once, and not shown as text besides
    path = next(block_vars["image_path_iterator"])
    value.savefig(path, dpi=150)
    return figure_rst([path], conf["src_dir"])
