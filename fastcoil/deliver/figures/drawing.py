"""What all figures draw with: places to draw into, maps, curves, dots, marks, and words for what was pooled."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError, WrongType, nearest, shown
from fastcoil.base.figures import DOTTED, STYLE, apply_style, wrapped
from fastcoil.loops.labels import Quantity, is_parameter, plain_pi, quantity_of
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.model.parameter_table import RESERVED_DIMS
from fastcoil.study.analysis.selected import numeric_dims

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh


_COLUMN = 3.5  # width of a figure, inches: 89 mm, a column of a journal
_LETTER, _HANDLE = 0.061, 0.42
"""Widths in a legend, inches: of an average letter, of all before and between the letters."""
_LONGEST = 36  # letters of a line in a legend


@contextmanager
def in_style() -> Iterator[None]:
    """Draw in the style of our figures, which is then taken back."""
    import matplotlib.pyplot as plt

    # a back end loaded inside a style, as that of a notebook, would have its own settings taken back
    plt.draw_if_interactive()  # type: ignore[no-untyped-call]
    with apply_style():
        yield


def places(ax: Any, heights: Sequence[float]) -> list[Axes]:
    """The axes that are given, one for each of ``heights`` [inches], or those of a new figure, one above the other."""
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes

    if ax is not None:
        n = len(heights)
        wanted = f"give {n} matplotlib axes, one for each panel," if n > 1 else "give matplotlib axes,"
        given = list(np.ravel(ax)) if isinstance(ax, (np.ndarray, list, tuple)) else [ax]
        if not all(isinstance(one, Axes) for one in given):
            raise InputError(WrongType(f"ax is a {type(ax).__name__}: {wanted} or leave it out"))
        if len(given) != n:
            raise InputError(f"ax has {len(given)} axes: {wanted} or leave it out")
        return given
    figure, panels = plt.subplots(
        len(heights), squeeze=False, sharex=True, height_ratios=list(heights), figsize=(_COLUMN, sum(heights)),
        layout="constrained",
    )  # fmt: skip
    found = list(panels[:, 0])
    for axes in found:
        # ticks are made when they are first needed, when the style of this figure is no longer in force
        axes.tick_params(labelsize=STYLE["font.size"])
        axes.grid(visible=True, alpha=STYLE["grid.alpha"])
    figure.align_ylabels(found)
    return found


def width_of(axes: Axes, ax: Any) -> float:
    """Inches that a text beside or above some axes has."""
    return 0.8 * _COLUMN if ax is None else float(axes.bbox.width / axes.figure.dpi)


def legend_above(axes: Axes, width: float, **look: Any) -> None:
    """A legend above its axes, in as many columns as fit."""
    handles, labels = axes.get_legend_handles_labels()
    if not handles:
        return
    labels = [fill(label, _LONGEST) for label in labels]
    longest = max(len(line) for text in labels for line in text.splitlines())
    columns = max(1, min(len(labels), int(width / (_HANDLE + _LETTER * longest))))
    axes.legend(
        handles, labels, ncols=columns, loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, borderaxespad=0.2,
        borderpad=0.2, handlelength=1.8, columnspacing=1.0, **look,
    )  # fmt: skip


def caption(axes: Axes, words: str, width: float) -> None:
    """Small print above some axes."""
    axes.set_title(wrapped(words, width, 7), loc="left", fontsize=7)


def swept_axes(values: xr.DataArray, **given: str | None) -> list[str]:
    """The swept numbers along the axes: those that are given, for the others those that are left."""
    swept = numeric_dims(values)
    named = [dim for dim in given.values() if dim is not None]
    problems = [
        f"{argument} = {shown(dim)} is not a swept number of this result{nearest(str(dim), swept)}; it has "
        f"{', '.join(swept) or 'none'}"
        for argument, dim in given.items()
        if dim is not None and dim not in swept
    ]
    if not problems and len({*named}) < len(named):
        problems.append(f"{named[0]} is named twice: choose two different axes")
    if problems:
        raise InputError(problems)
    left = [dim for dim in swept if dim not in named]
    missing = [argument for argument, dim in given.items() if dim is None]
    if missing and len(left) != len(missing):
        has = f"this result sweeps {', '.join(swept) or 'no number'}"
        if len(left) > len(missing):
            raise InputError(f"{has}: say which is {' and '.join(sorted(missing))}")
        raise InputError(f"{has}: a figure needs {len(given)} swept number{'s' * (len(given) > 1)}")
    return [left.pop(0) if dim is None else dim for dim in given.values()]


def check_dim(argument: str, dim: str, dims: Sequence[str]) -> None:
    """Refuse a name that is no dimension."""
    if dim not in dims:
        has = ", ".join(dims) or "none"
        raise InputError(f"{argument} = {shown(dim)} is no dimension of this result{nearest(dim, dims)}; it has {has}")


_SIZES = {"backlash", "backlash_estimate"}
_LETTERS = 9  # points


def picked(ds: xr.Dataset | xr.DataArray, dim: str, most: int = 3) -> list[int]:
    """Positions of the labels that get a curve or a row: all of ``most``, of more the first, one between, the last.

    That between is the middle one, or the estimate that is exact.
    """
    n = ds.sizes[dim]
    if n <= most:
        return list(range(n))
    between = round((n - 1) / 2)
    if dim == "estimate_ratio" and (ds[dim] == 1.0).any():
        between = int((ds[dim].values == 1.0).argmax())
    return sorted({0, between, n - 1})


def left_out_in_words(ds: xr.Dataset | xr.DataArray, dim: str, n_shown: int) -> str:
    """How many labels have no curve or row, as a clause of a heading; empty if all have."""
    n = ds.sizes[dim]
    return "" if n_shown == n else f"; shown are {n_shown} of {n} values of {quantity_of(ds, dim).text}"


def pooled_dims(values: xr.DataArray, *shown: str | None) -> list[str]:
    """The dimensions that a figure does not show."""
    return [str(d) for d in values.dims if d not in shown]


def median_map(axes: Axes, values: xr.DataArray, of: Quantity, x: str, y: str, width: float) -> QuadMesh | None:
    """Draw the median of ``values`` over all dims but ``x`` and ``y`` as colours, in the unit of ``of``.

    width: of the panel, inches.  Returns the colours, for a scale beside them; None where no value is finite.
    """
    of_x, of_y = quantity_of(values, x), quantity_of(values, y)
    label_axes(axes, of_x.axis, of_y.axis, width)
    middle = of.factor * values.median(pooled_dims(values, x, y)).transpose(y, x)
    if say_if_empty(axes, middle):
        return None
    mesh = axes.pcolormesh(
        of_x.factor * values[x], of_y.factor * values[y], middle, cmap="cividis", shading="nearest", rasterized=True
    )
    axes.grid(visible=False)
    mark_exact(axes, x, y)
    return mesh


def label_axes(axes: Axes, x: str, y: str, width: float) -> None:
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
    known = ds["status"].notnull()  # in groups that differ in size places stay empty
    failed = int((known & (ds["status"] != STATUS_OK)).sum())
    return f"; without {failed:,} of {int(known.sum()):,} scenarios, which failed" if failed else ""


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


BAND = (0.1, 0.9)
FEWEST_FOR_A_BAND = 5
"""Fewer members are drawn one by one: their percentiles would be interpolated between two or three numbers."""


def _band_or_members(values: xr.DataArray, dim: str) -> tuple[xr.DataArray | None, np.ndarray | None]:
    """Along a dim the band of all others, (2, n), or if they are few their members, (n, members); neither if alone."""
    pooled = pooled_dims(values, dim)
    if math.prod(values.sizes[d] for d in pooled) >= FEWEST_FOR_A_BAND:
        with warnings.catch_warnings():
            # where every member is NaN the band has a gap, which says enough
            warnings.filterwarnings("ignore", "All-NaN slice encountered", RuntimeWarning)
            return values.quantile(BAND, pooled), None
    return None, values.transpose(dim, ...).values.reshape(values.sizes[dim], -1) if pooled else None


def curve(axes: Axes, x: xr.DataArray, values: xr.DataArray, *, label: str | None = None, **look: Any) -> None:
    """Draw the median of ``values`` over all dims but that of ``x``, with a band, or with a thin line per member."""
    dim = str(x.dims[0])
    band, members = _band_or_members(values, dim)
    if band is not None:
        axes.fill_between(x, *band, color=look["color"], alpha=0.2, lw=0)
    elif members is not None:
        axes.plot(x, members, color=look["color"], lw=0.5, alpha=0.7)
    axes.plot(x, values.median(pooled_dims(values, dim)), label=label, **look)


def dots(axes: Axes, values: xr.DataArray, dim: str, color: str) -> None:
    """Draw the medians of ``values`` along ``dim`` as dots, with a line from 10 to 90 % or a small dot per member."""
    rows = np.arange(values.sizes[dim])
    band, members = _band_or_members(values, dim)
    if band is not None:
        axes.hlines(rows, *band, color=color, lw=1.0)
    elif members is not None:
        axes.plot(members, rows, "o", color=color, ms=2.5, mfc="white", mew=0.7)
    axes.plot(values.median(pooled_dims(values, dim)), rows, "o", color=color, ms=5)


def describe(ds: xr.Dataset | xr.DataArray, pooled: Iterable[str], median: str, band: str, member: str) -> str:
    """Say over what a figure pools, and what its marks are: those of the median, of a band, of a single member."""
    pooled = [d for d in pooled if ds.sizes[d] > 1]
    if not pooled:
        return f"{median}: a single scenario"
    n = math.prod(ds.sizes[d] for d in pooled)
    over = " × ".join(_in_words(ds, d) for d in pooled)
    if len(pooled) > 1 and not any(d in ds.coords and "pooled_as" in ds[d].attrs for d in pooled):
        over += f" = {n:,} scenarios"
    marks = f"; {band}: 10th to 90th percentile" if n >= FEWEST_FOR_A_BAND else f"; {member}: each of these"
    return f"{median}: median of {over}{marks if band else ''}"


def _in_words(ds: xr.Dataset | xr.DataArray, dim: str) -> str:
    """A pooled dim: how many of what, from where to where, and that the plain PI is among them."""
    size = ds.sizes[dim]
    if dim in ds.coords and "pooled_as" in ds[dim].attrs:  # groups differ in size
        return str(ds[dim].attrs["pooled_as"])
    if dim in RESERVED_DIMS:
        return f"{size} {dim}s"
    if not is_parameter(ds, dim) or dim not in ds.coords or ds[dim].dtype.kind not in "if":
        return f"{size} values of {dim.replace('_', ' ')}"
    of = quantity_of(ds, dim)
    low, high = float(ds[dim].min()), float(ds[dim].max())
    plain = f", 0 being the {plain_pi(ds)}" if dim in ("estimate_ratio", "backlash_estimate") and low == 0.0 else ""
    return f"{size} values of {of.text} ({low * of.factor:.3g} to {of.number(high)}{plain})"
