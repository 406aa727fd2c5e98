"""What all figures draw with: places to draw into, a map, a curve, a row of dots, and words for what was pooled."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import refuse
from fastcoil.base.errors import InputError, WrongType, nearest, shown
from fastcoil.base.figures import STYLE, apply_style, wrapped
from fastcoil.loops.labels import quantity_of, quantity_of_values, sizes_in_words
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.study.analysis.selected import numeric_dims

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh


_COLUMN = 3.5  # width of a figure, inches: 89 mm, a column of a journal
_LONGEST, _SHORT = 36, 18  # letters of a line in a legend, and of one that has another beside it
_LETTERS, _SMALL = 9, 7  # points


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
        given = list(np.ravel(ax)) if isinstance(ax, (np.ndarray, list, tuple)) else [ax]
        if len(given) != len(heights) or not all(isinstance(one, Axes) for one in given):
            wanted = f"give {len(heights)} matplotlib axes, one for each panel, or leave it out"
            raise InputError(WrongType(f"ax is a {type(ax).__name__}: {wanted}"))
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


def fitted(axes: Axes, text: str, points: int = _LETTERS) -> str:
    """Text in lines that are no wider than some axes."""
    return wrapped(text, axes.bbox.width / axes.figure.dpi, points)


def label_axes(axes: Axes, x: str, y: str) -> None:
    """Name both axes."""
    axes.set(xlabel=fitted(axes, x), ylabel=wrapped(y, 2.0, _LETTERS))


def legend_above(axes: Axes) -> None:
    """A legend above its axes, in two columns where its words are short."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        columns = 2 if max(map(len, labels)) <= _SHORT else 1
        axes.legend(
            handles, [fill(label, _LONGEST) for label in labels], ncols=columns, loc="lower left",
            bbox_to_anchor=(0.0, 1.0), frameon=False, borderaxespad=0.2, columnspacing=1.0,
        )  # fmt: skip


def caption(axes: Axes, words: str) -> None:
    """Small print above some axes."""
    axes.set_title(fitted(axes, words, _SMALL), loc="left", fontsize=_SMALL)


def swept_axes(values: xr.DataArray, **given: str | None) -> list[str]:
    """The swept numbers along the axes: those that are given, for the others those that are left."""
    swept = numeric_dims(values)
    has = f"this result sweeps {', '.join(swept) or 'no number'}"
    named = [dim for dim in given.values() if dim is not None]
    problems = [
        f"{argument} = {shown(dim)} is not a swept number{nearest(str(dim), swept)}: {has}"
        for argument, dim in given.items()
        if dim is not None and dim not in swept
    ]
    if len({*named}) < len(named):
        problems.append(f"{named[0]} is named twice: choose two different axes")
    left = [dim for dim in swept if dim not in named]
    missing = [argument for argument, dim in given.items() if dim is None]
    if not problems and missing and len(left) != len(missing):
        problems.append(f"{' and '.join(missing)}: {has}, name a swept number for each")
    refuse(problems)
    return [left.pop(0) if dim is None else dim for dim in given.values()]


def picked(n: int, most: int = 3) -> list[int]:
    """Which of ``n`` labels get a curve or a row: all of up to ``most``; of more the first, the middle, the last."""
    return list(range(n)) if n <= most else [0, round((n - 1) / 2), n - 1]


def _pooled(values: xr.DataArray, *drawn: str) -> list[str]:
    return [str(d) for d in values.dims if d not in drawn]


def draw_map(axes: Axes, values: xr.DataArray, x: str, y: str) -> QuadMesh | None:
    """Draw the median over all dims but ``x`` and ``y`` as colours, with a scale; None where no value is finite."""
    of, of_x, of_y = quantity_of_values(values), quantity_of(values, x), quantity_of(values, y)
    label_axes(axes, of_x.axis, of_y.axis)
    values = values.sortby([x, y])
    middle = of.factor * values.median(_pooled(values, x, y)).transpose(y, x)
    if say_if_empty(axes, middle):
        return None
    mesh = axes.pcolormesh(
        of_x.factor * values[x], of_y.factor * values[y], middle, cmap="cividis", shading="nearest", rasterized=True
    )
    axes.grid(visible=False)
    scale = axes.figure.colorbar(mesh, ax=axes)
    scale.set_label(wrapped(of.axis, 2.0, _LETTERS))
    scale.ax.tick_params(labelsize=STYLE["font.size"])
    return mesh


def draw_curve(axes: Axes, values: xr.DataArray, x: str, *, color: str, **look: Any) -> None:
    """Draw the median over all dims but ``x``, with what scatters around it; from 0 where it can be."""
    of, of_x = quantity_of_values(values), quantity_of(values, x)
    label_axes(axes, of_x.axis, of.axis)
    axes.axhline(0.0, color="black", lw=0.8).sticky_edges.y.append(0.0)
    values = values.sortby(x)
    curve(axes, of_x.factor * values[x], of.factor * values, color=color, **look)
    say_if_empty(axes, values)


def curve(axes: Axes, along: xr.DataArray, values: xr.DataArray, *, color: str, **look: Any) -> None:
    """Draw the median of ``values`` over all dims but that of ``along``, with a band or a thin line per member."""
    x = str(along.dims[0])
    band, members = _band_or_members(values, x)
    if band is not None:
        axes.fill_between(along, *band, color=color, alpha=0.2, lw=0)
    elif members is not None:
        axes.plot(along, members, color=color, lw=0.5, alpha=0.7)
    axes.plot(along, values.median(_pooled(values, x)), color=color, **look)


def draw_dots(axes: Axes, values: xr.DataArray, dim: str, color: str) -> None:
    """Draw the medians of named alternatives as dots, with a line from 10 to 90 % or a small dot per member."""
    of, n = quantity_of_values(values), values.sizes[dim]
    axes.set_xlabel(fitted(axes, of.axis))
    axes.set_yticks(range(n), [str(v) for v in values[dim].values])
    axes.set_ylim(n - 0.4, -0.6)
    axes.axvline(0.0, color="black", lw=0.8).sticky_edges.x.append(0.0)
    values = of.factor * values
    band, members = _band_or_members(values, dim)
    if band is not None:
        axes.hlines(range(n), *band, color=color, lw=1.0)
    elif members is not None:
        axes.plot(members, range(n), "o", color=color, ms=2.5, mfc="white", mew=0.7)
    axes.plot(values.median(_pooled(values, dim)), range(n), "o", color=color, ms=5)
    say_if_empty(axes, values)


def say_if_empty(axes: Axes, values: xr.DataArray) -> bool:
    """Whether no value is finite; the panel then says so."""
    if np.isfinite(values).any():
        return False
    axes.text(0.5, 0.5, "no finite value", ha="center", transform=axes.transAxes)
    return True


_FEWEST_FOR_A_BAND = 5  # fewer are drawn one by one: percentiles would lie between two or three numbers


def _band_or_members(values: xr.DataArray, dim: str) -> tuple[xr.DataArray | None, np.ndarray | None]:
    """Along a dim the band of all others, (2, n), or if they are few their members, (n, members); neither if alone."""
    pooled = _pooled(values, dim)
    if math.prod(values.sizes[d] for d in pooled) >= _FEWEST_FOR_A_BAND:
        with warnings.catch_warnings():
            # where every member is NaN the band has a gap, which says enough
            warnings.filterwarnings("ignore", "All-NaN slice encountered", RuntimeWarning)
            return values.quantile((0.1, 0.9), pooled), None
    return None, values.transpose(dim, ...).values.reshape(values.sizes[dim], -1) if pooled else None


COLOUR, LINE, DOT = ("Colour", "", ""), ("Line", "band", "thin lines"), ("Dot", "line", "small dots")
"""What shows the median, a band and single members."""


def pooled_in_words(values: xr.DataArray, drawn: Sequence[str | None], marks: Sequence[str]) -> str:
    """Over what a figure pools, and what its marks are: those of the median, of a band, of a single member."""
    median, band, member = marks
    sizes = {str(d): n for d, n in values.sizes.items() if d not in drawn and n > 1}
    if not sizes:
        return f"{median}: a single scenario"
    grouped = {d: values[d].attrs["pooled_as"] for d in sizes if d in values.coords and "pooled_as" in values[d].attrs}
    over = " × ".join(grouped.get(d) or sizes_in_words({d: n}) for d, n in sizes.items())
    many = math.prod(sizes.values()) >= _FEWEST_FOR_A_BAND
    words = f"; {band}: 10th to 90th percentile" if many else f"; {member}: each of these"
    return f"{median}: median of {over}{words if band else ''}"


def left_out_in_words(ds: xr.Dataset | xr.DataArray, dim: str | None, n_shown: int) -> str:
    """How many labels have no curve or row, as a clause of a heading; empty if all have."""
    n = n_shown if dim is None else ds.sizes[dim]
    return "" if n_shown == n else f"; shown are {n_shown} of {n} values of {quantity_of(ds, str(dim)).text}"


def failed_in_words(ds: xr.Dataset) -> str:
    """How many scenarios of a result failed, as a clause of a heading; empty if none did."""
    known = ds["status"].notnull()  # in groups that differ in size places stay empty
    failed = int((known & (ds["status"] != STATUS_OK)).sum())
    return f"; without {failed:,} of {int(known.sum()):,} scenarios, which failed" if failed else ""
