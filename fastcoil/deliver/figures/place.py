"""Where a figure is drawn: the axes that are given, or those of a new figure as wide as a column."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from fastcoil.base.errors import InputError, WrongType
from fastcoil.base.figures import STYLE, apply_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMN = 3.5
"""Width of a figure, inches: 89 mm, a column of a journal."""
_LETTER, _HANDLE = 0.061, 0.42
"""Widths in a legend, inches: of an average letter, of all before and between the letters."""
_LONGEST = 36
"""Letters of a line in a legend."""


@contextmanager
def in_style() -> Iterator[None]:
    """Draw in the style of our figures, which is then taken back."""
    import matplotlib.pyplot as plt

    # a back end that is first loaded inside of a style, as that of a notebook, has what it sets taken back, too
    plt.draw_if_interactive()  # type: ignore[no-untyped-call]
    with apply_style():
        yield


def one_place(ax: Any, height: float) -> Axes:
    """The axes that are given, or those of a new figure of this height [inches].

    Raises
    ------
    InputError
        Unless ``ax`` is one pair of axes, or None.
    """
    return places(ax, [height])[0]


def places(ax: Any, heights: Sequence[float]) -> list[Axes]:
    """The axes that are given, one for each of ``heights`` [inches], or those of a new figure, one above the other.

    Raises
    ------
    InputError
        Unless ``ax`` is as many axes as are needed, or None.
    """
    if ax is not None:
        return _given(ax, len(heights))
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        len(heights), squeeze=False, sharex=True, height_ratios=list(heights), figsize=(COLUMN, sum(heights)),
        layout="constrained",
    )  # fmt: skip
    found = list(panels[:, 0])
    for axes in found:
        # ticks are made when they are first needed, when the style of this figure is no longer in force
        axes.tick_params(labelsize=STYLE["font.size"])
        axes.grid(visible=True, alpha=STYLE["grid.alpha"])
    figure.align_ylabels(found)
    return found


def _given(ax: Any, n: int) -> list[Axes]:
    from matplotlib.axes import Axes

    wanted = f"give {n} matplotlib axes, one for each panel," if n > 1 else "give matplotlib axes,"
    found = list(ax.ravel()) if isinstance(ax, np.ndarray) else list(ax) if isinstance(ax, (list, tuple)) else [ax]
    if not all(isinstance(one, Axes) for one in found):
        raise InputError(WrongType(f"ax is a {type(ax).__name__}: {wanted} or leave it out"))
    if len(found) != n:
        raise InputError(f"ax has {len(found)} axes: {wanted} or leave it out")
    return found


def several(axes: list[Axes]) -> Any:
    """One pair of axes as it is, more as an array, as ``matplotlib.pyplot.subplots`` returns them."""
    return axes[0] if len(axes) == 1 else np.array(axes)


def width_of(axes: Axes, ax: Any) -> float:
    """Inches that a text beside or above some axes has."""
    return 0.8 * COLUMN if ax is None else float(axes.bbox.width / axes.figure.dpi)


def legend_above(axes: Axes, width: float, handles: Sequence[Any] | None = None, **look: Any) -> None:
    """A legend above its axes, in as many columns as fit; ``handles``: what it names, all that is drawn by default."""
    if handles is None:
        handles, _ = axes.get_legend_handles_labels()
    if not handles:
        return
    labels = [fill(str(one.get_label()), _LONGEST) for one in handles]
    longest = max(len(line) for text in labels for line in text.splitlines())
    columns = max(1, min(len(labels), int(width / (_HANDLE + _LETTER * longest))))
    axes.legend(
        handles, labels, ncols=columns, loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, borderaxespad=0.2,
        borderpad=0.2, handlelength=1.8, columnspacing=1.0, **look,
    )  # fmt: skip
