"""The front of error against motor travel, and what the valves and days held out make of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.figures import BLUE, DOTTED, GREY, RED, YELLOW, apply_style, wrapped
from fastcoil.design.tuning.measures import Limit, Measure
from fastcoil.design.tuning.words import CHOSEN, NOW, SIMC
from fastcoil.loops.labels import quantity

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE = (6.5, 4.6)
_TITLE = 5.6
"""Inches: the axes are narrower than the figure."""
_LOOKS = {NOW: ("s", "black", "now"), CHOSEN: ("o", RED, "chosen"), SIMC: ("^", YELLOW, "SIMC")}


@apply_style()
def draw_front(
    front: xr.Dataset,
    trained: xr.Dataset,
    held_out: xr.Dataset,
    error: Measure,
    travel: Measure,
    limits: Sequence[Limit],
) -> Figure:
    """Draw the front where it was found, and the same tunings on the hold-out."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator

    fig = Figure(figsize=_SIZE, layout="constrained")
    axes = fig.add_subplot()
    there, here = (_places(front, prefix, error, travel) for prefix in ("", "held_out_"))
    for k in range(there[0].size):
        axes.plot([there[0][k], here[0][k]], [there[1][k], here[1][k]], color=GREY, lw=0.6, zorder=1)
    axes.plot(*there, "o-", color=BLUE, ms=3, label="front where it was searched")
    axes.plot(*here, "o", color=BLUE, ms=4, mfc="white", label="the same tunings, held out")
    for tuning in held_out["tuning"].values:
        _point(axes, held_out.sel(tuning=tuning), str(tuning), error, travel)
    for limit in limits:
        if limit.measure in (error, travel):
            at = limit.most * quantity(limit.measure.metric).factor
            line = axes.axvline if limit.measure == travel else axes.axhline
            line(at, color="black", lw=1.0, ls=DOTTED, label="limit")
    axes.set(xlabel=travel.words, ylabel=error.words)
    for axis, scale in ((axes.xaxis, axes.set_xscale), (axes.yaxis, axes.set_yscale)):
        scale("log")
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    groups = f"Searched on {trained.attrs['group']}, held out {held_out.attrs['group']}."
    words = f"{groups}  Bars: 95 % for other valves and days."
    axes.set_title(wrapped(words, _TITLE, 9), loc="left")
    axes.legend(frameon=False)
    return fig


def _places(front: xr.Dataset, prefix: str, error: Measure, travel: Measure) -> tuple[Array, Array]:
    found = (front[prefix + measure.name].values * quantity(measure.metric).factor for measure in (travel, error))
    x, y = (np.where(np.isfinite(values), values, np.nan) for values in found)
    return x, y


def _point(axes: Axes, one: xr.Dataset, tuning: str, error: Measure, travel: Measure) -> None:
    """A tuning on the hold-out with its intervals."""
    marker, colour, words = _LOOKS[tuning]
    x, y = (one[m.name].values * quantity(m.metric).factor for m in (travel, error))
    if not (np.isfinite(x[0]) and np.isfinite(y[0])):
        return
    known = np.isfinite(x).all() and np.isfinite(y).all()
    bars: dict[str, Any] = {"xerr": _bars(x), "yerr": _bars(y)} if known else {}
    axes.errorbar(
        x[0], y[0], **bars, fmt=marker, color=colour, ms=6, lw=1.0, capsize=2, zorder=3, label=f"{words}, held out"
    )  # fmt: skip


def _bars(edges: Array) -> Array:
    return np.maximum([[edges[0] - edges[1]], [edges[2] - edges[0]]], 0.0)
