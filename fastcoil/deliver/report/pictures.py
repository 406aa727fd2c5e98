"""Figures as pictures of a page: what their marks mean stands under them, not in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fastcoil.base.figures import encode
from fastcoil.deliver.report.page import Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 200
"""Of an A4 page; a PNG is the same everywhere and no larger for a log of a million rows."""


def picture(figure: Figure, caption: str, alt: str) -> Picture:
    """A figure without its head, which the page has in words."""
    figure.suptitle("")
    return Picture(encode(figure, "png", DPI), caption, alt)


def study_picture(figure: Figure, title: str, name: str, alt: str) -> Picture:
    """A figure of a study, whose head, the title and what its marks mean, becomes the caption."""
    words = " ".join(figure.get_suptitle().split())
    head = " ".join(title.split())
    return picture(figure, f"{name}.  {words.removeprefix(head).strip()}.", alt)
