"""What is drawn into one pair of axes: a map over two swept parameters, a curve along one, marks and limits."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import xarray as xr

from fastcoil.base.figures import DOTTED, wrapped
from fastcoil.loops.labels import Quantity, is_parameter, quantity_of
from fastcoil.model.metric_table import STATUS_OK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh

_SIZES = {"backlash", "backlash_estimate"}
_LETTERS = 9
"""Points."""
_CURVES = 3


def numeric_dims(values: xr.DataArray) -> list[str]:
    """Dimensions that are axes of a swept number, with at least two values."""
    return [
        str(d) for d in values.dims
        if is_parameter(values, d) and d in values.coords and values[d].dtype.kind in "if" and values.sizes[d] > 1
    ]  # fmt: skip


def picked(n: int) -> list[int]:
    """Positions of the first, the middle and the last of ``n`` values: a figure shows three curves."""
    return [int(k) for k in np.unique(np.linspace(0, n - 1, _CURVES).round())]


def pooled_dims(values: xr.DataArray, *shown: str) -> list[str]:
    """The dimensions that a figure does not show."""
    return [str(d) for d in values.dims if d not in shown]


def draw_map(axes: Axes, values: xr.DataArray, of: Quantity, x: str, y: str, width: float) -> QuadMesh | None:
    """Draw the median of ``values`` over all dims but ``x`` and ``y`` as colours, in the unit of ``of``.

    width: of the panel, inches.  Returns the colours, for a scale beside them; None where no value is finite.
    """
    of_x, of_y = quantity_of(values, x), quantity_of(values, y)
    label(axes, of_x.axis, of_y.axis, width)
    shown = of.factor * values.median(pooled_dims(values, x, y)).transpose(y, x)
    if say_if_empty(axes, shown):
        return None
    mesh = axes.pcolormesh(
        of_x.factor * values[x], of_y.factor * values[y], shown, cmap="cividis", shading="nearest", rasterized=True
    )
    axes.grid(visible=False)
    mark_exact(axes, x, y)
    return mesh


def label(axes: Axes, x: str, y: str, width: float) -> None:
    """Name both axes; an empty name leaves one as it is."""
    if x:
        axes.set_xlabel(wrapped(x, 0.8 * width, _LETTERS))
    if y:
        axes.set_ylabel(wrapped(y, 2.0, _LETTERS))


def say_if_empty(axes: Axes, values: xr.DataArray) -> bool:
    """Whether no value is finite; the panel then says so."""
    if np.isfinite(values).any():
        return False
    axes.text(0.5, 0.5, "no finite value", ha="center", transform=axes.transAxes)
    return True


def from_zero(alike: Iterable[Axes], which: Literal["x", "y"]) -> None:
    """Let the axis of some panels start at 0 and end above all that is drawn, unless some of it is negative."""
    drawn = [getattr(axes.dataLim, f"interval{which}") for axes in alike]
    low, high = min(d[0] for d in drawn), max(d[1] for d in drawn)
    if low >= 0.0 and high > 0.0:
        for axes in alike:
            getattr(axes, f"set_{which}lim")(0.0, 1.05 * high)


def failed_in_words(ds: xr.Dataset) -> str:
    """How many scenarios of a result failed, as a clause of a heading; empty if none did."""
    status = ds["status"].values[ds["status"].notnull().values]  # in groups that differ in size places stay empty
    failed = int((status != STATUS_OK).sum())
    return f"; without {failed:,} of {status.size:,} scenarios, which failed" if failed else ""


def mark_exact(axes: Axes, x: str, y: str = "") -> None:
    """Mark where the estimate is the backlash."""
    look: Any = {"color": "white" if y else "black", "lw": 0.8, "ls": DOTTED}
    if x == "estimate_ratio":
        axes.axvline(100.0, **look)
    if y == "estimate_ratio":
        axes.axhline(100.0, **look)
    if {x, y} == _SIZES:
        axes.axline((0.0, 0.0), slope=1.0, **look)


def exact_in_words(*shown: str) -> str:
    """What ``mark_exact`` marks, as a clause of a heading."""
    return "; dotted: estimate = backlash" if "estimate_ratio" in shown or {*shown} == _SIZES else ""
