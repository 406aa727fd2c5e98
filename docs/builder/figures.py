"""Scraper for figures that ``plot()`` of a result returns, which pyplot does not manage."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

LAST_VALUE_NAME = "___"
"""Name under which sphinx-gallery keeps the value of the last line of a block."""


def returned_figures(block: tuple[str, str, int], block_vars: dict[str, Any], conf: dict[str, Any]) -> str:
    """Save the figure that the last line of a block returned, if any, and return its image directive."""
    value = block_vars["example_globals"].get(LAST_VALUE_NAME)
    if not isinstance(value, Figure) or value.canvas.manager is not None:
        return ""
    block_vars["example_globals"][LAST_VALUE_NAME] = None  # so that it is not also shown as text
    path = next(block_vars["image_path_iterator"])
    value.savefig(path, dpi=150)
    return figure_rst([path], conf["src_dir"])
