"""Parts of all figures: axes, a map, a curve, a row of dots, and captions that say what is pooled."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import raise_problems
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.base.figures import STYLE, apply_style, check_matplotlib, wrap_text
from fastcoil.loops.labels import coordinate_quantity, sizes_in_words, values_quantity
from fastcoil.model.metric_table import STATUS_NOT_RUN, STATUS_OK
from fastcoil.study.analysis.selected import numeric_dims

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.collections import QuadMesh


SHARE_METRICS = ("hunts",)  # 0 or 1 of each loop
_FONT_SIZE = 9  # points
_LEAST_BAND_MEMBERS = 5  # of a band; fewer are drawn one by one: percentiles would lie between two or three numbers
# marks of the median, of a band and of single members
COLOUR_MARKS = ("Colour", "", "")
LINE_MARKS = ("Line", "band", "thin lines")
DOT_MARKS = ("Dot", "line", "small dots")


@contextmanager
def use_style() -> Iterator[None]:
    """Apply the style of our figures in a block or function that makes a pyplot figure."""
    check_matplotlib()
    import matplotlib.pyplot as plt

    # a back end loaded inside a style, as that of a notebook, would lose its own settings at the end
    plt.draw_if_interactive()  # type: ignore[no-untyped-call]
    with apply_style():
        yield


def prepare_axes(ax: Any, heights: Sequence[float]) -> list[Axes]:
    """Return ``ax``, one for each of ``heights`` [inches], or the axes of a new figure, one above the other."""
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes

    if ax is not None:
        panels = list(np.ravel(ax)) if isinstance(ax, (np.ndarray, list, tuple)) else [ax]
        if len(panels) != len(heights) or not all(isinstance(panel, Axes) for panel in panels):
            cure = f"give {len(heights)} matplotlib axes, one for each panel, or leave it out"
            raise InputError(f"ax is a {type(ax).__name__}: {cure}", "ax", "type")
        return panels
    size = (3.5, sum(heights))  # inches: 89 mm, a column of a journal
    figure, grid = plt.subplots(
        len(heights), squeeze=False, sharex=True, height_ratios=list(heights), figsize=size, layout="constrained"
    )
    panels = list(grid[:, 0])
    for axes in panels:
        # ticks are made when they are first needed, when the style of this figure is no longer in force
        axes.tick_params(labelsize=STYLE["font.size"])
        axes.grid(visible=True, alpha=STYLE["grid.alpha"])
    figure.align_ylabels(panels)
    return panels


def wrap_to_axes(axes: Axes, text: str, points: int = _FONT_SIZE) -> str:
    """Break a text into lines that are no wider than some axes."""
    return wrap_text(text, axes.bbox.width / axes.figure.dpi, points)


def label_axes(axes: Axes, x: str, y: str) -> None:
    """Label both axes."""
    height = axes.bbox.height / axes.figure.dpi
    axes.set(xlabel=wrap_to_axes(axes, x), ylabel=wrap_text(y, min(2.0, height), _FONT_SIZE))


def draw_legend_above(axes: Axes) -> None:
    """Draw a legend above its axes, in two columns if no label has more than 18 letters."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        columns = 2 if max(map(len, labels)) <= 18 else 1
        axes.legend(
            handles, [fill(label, 36) for label in labels], ncols=columns, loc="lower left",
            bbox_to_anchor=(0.0, 1.0), frameon=False, borderaxespad=0.2, columnspacing=1.0,
        )  # fmt: skip


def draw_caption(axes: Axes, words: str) -> None:
    """Draw a caption above some axes, 7 points high."""
    axes.set_title(wrap_to_axes(axes, words, 7), loc="left", fontsize=7)


def resolve_swept_axes(values: xr.DataArray, **requested: str | None) -> list[str]:
    """Return the swept parameter for each axis of a figure: the requested one, or for None one of the others."""
    swept = numeric_dims(values)
    has = f"this result sweeps {', '.join(swept) or 'no number'}"
    named = [dim for dim in requested.values() if dim is not None]
    problems = []
    for argument, dim in requested.items():
        if dim is not None and dim not in swept:
            sentence = f"{argument} = {short_repr(dim)} is not a swept number{did_you_mean(str(dim), swept)}: {has}"
            problems.append(Problem(sentence, argument, "name"))
    if len({*named}) < len(named):
        problems.append(Problem(f"{named[0]} is named twice: choose two different axes", named[0], "duplicate"))
    unnamed = [dim for dim in swept if dim not in named]
    unset = [argument for argument, dim in requested.items() if dim is None]
    if not problems and unset and len(unnamed) != len(unset):
        problems.append(Problem(f"{' and '.join(unset)}: {has}, name a swept number for each", unset[0], "missing"))
    raise_problems(problems)
    return [unnamed.pop(0) if dim is None else dim for dim in requested.values()]


def pick_labels(n: int, most: int = 3, inner: int | None = None) -> list[int]:
    """Return the indices of labels to draw: all of up to ``most``, else the first, the last and one between them.

    inner: index of the one between them; the middle if it is None, the first or the last.
    """
    return list(range(n)) if n <= most else [0, inner if inner and inner < n - 1 else round((n - 1) / 2), n - 1]


def _pooled_dims(values: xr.DataArray, *drawn: str) -> list[str]:
    return [str(d) for d in values.dims if d not in drawn]


def pool(values: xr.DataArray, *drawn: str) -> xr.DataArray:
    """Return the median over all dims but those drawn, of whether a loop hunts the share."""
    dims = _pooled_dims(values, *drawn)
    return values.mean(dims) if values.name in SHARE_METRICS else values.median(dims)


_LOG_RANGE = 8.0  # of the values of a map from which its colours are logarithmic
_MOST_TICKS = 8  # of swept values along an axis


def _set_swept_ticks(axis: Axis, positions: np.ndarray, values: np.ndarray) -> None:
    """Put ticks at swept values, at some of many."""
    k = np.unique(np.linspace(0, len(values) - 1, min(len(values), _MOST_TICKS)).round().astype(int))
    axis.set_ticks(positions[k].tolist(), [f"{v:.3g}" for v in values[k]])


_ONE_TWO_FIVE = [m * 10.0**k for k in range(-9, 9) for m in (1, 2, 5)]  # ticks of a logarithmic scale
_LEAST_LOG_RATIO = 4.0  # of the largest over the least value along an axis, where it is logarithmic


def set_swept_scale(axes: Axes, values: np.ndarray) -> None:
    """Make the x axis logarithmic where the values are spaced more evenly so; 0 keeps a place beside them."""
    from matplotlib.ticker import FixedLocator

    positive = values[values > 0.0]
    if values.min() < 0.0 or positive.size < 3 or positive.max() < _LEAST_LOG_RATIO * positive.min():
        return
    low, middle, high = np.quantile(positive, (0.0, 0.5, 1.0))
    place, log_place = (middle - low) / (high - low), math.log(middle / low) / math.log(high / low)
    if abs(log_place - 0.5) < abs(place - 0.5):
        is_with_zero = positive.size < values.size
        options: dict[str, Any] = {"linthresh": low, "linscale": 0.4} if is_with_zero else {}
        axes.set_xscale("symlog" if is_with_zero else "log", **options)
        axes.minorticks_off()
        axes.xaxis.set_major_locator(FixedLocator(_ONE_TWO_FIVE))
        axes.xaxis.set_major_formatter("{x:g}")


def draw_map(
    axes: Axes, values: xr.DataArray, x: str, y: str, mark: Mapping[str, Any] | None = None,
    limits: tuple[float, float] | None = None,
) -> QuadMesh | None:  # fmt: skip
    """Draw the median over all dims but ``x`` and ``y`` as colours, with a scale; None where no value is finite.

    The swept values lie equally far apart.  mark: labels of the recommended cell, row or column, which gets a frame.
    limits: of the colours.
    """
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.patches import Rectangle
    from matplotlib.ticker import FixedLocator

    quantity = values_quantity(values)
    x_quantity, y_quantity = (coordinate_quantity(values, dim) for dim in (x, y))
    label_axes(axes, x_quantity.axis, y_quantity.axis)
    values = values.sortby([x, y])
    median = quantity.factor * pool(values, x, y).transpose(y, x)
    if mark_if_empty(axes, median):
        return None
    least, largest = limits or (float(median.min()), float(median.max()))
    if values.name in SHARE_METRICS:
        least, largest = 0.0, 100.0
    is_log = least > 0.0 and largest > _LOG_RANGE * least
    norm = (LogNorm if is_log else Normalize)(least, largest)
    mesh = axes.pcolormesh(median, cmap="cividis", norm=norm, rasterized=True)
    axes.grid(visible=False)
    for axis, dim, of_dim in ((axes.xaxis, x, x_quantity), (axes.yaxis, y, y_quantity)):
        _set_swept_ticks(axis, np.arange(values.sizes[dim]) + 0.5, of_dim.factor * values[dim].values)
    if mark and {x, y} & {*mark}:
        places = [
            (int((values[d].values == mark[d]).argmax()), 1) if d in mark else (0, values.sizes[d]) for d in (x, y)
        ]
        (column, width), (row, height) = places
        for colour, line_width in (("white", 3.0), ("black", 1.2)):
            look: Any = {"fill": False, "ec": colour, "lw": line_width, "zorder": 3, "clip_on": False}
            axes.add_patch(Rectangle((column, row), width, height, **look))
    scale = axes.figure.colorbar(mesh, ax=axes, format="{x:g}")
    if is_log:
        scale.ax.yaxis.set_major_locator(FixedLocator(_ONE_TWO_FIVE))
        scale.minorticks_off()
    scale.set_label(wrap_text(quantity.axis, 2.0, _FONT_SIZE))
    scale.ax.tick_params(labelsize=STYLE["font.size"])
    return mesh


def draw_curve(
    axes: Axes, values: xr.DataArray, x: str, *, color: str, mark: Mapping[str, Any] | None = None,
    spread: Sequence[xr.DataArray] = (), **look: Any,
) -> None:  # fmt: skip
    """Draw the median over all dims but ``x``, with its band or members; from 0 if possible.

    mark: labels, of which that along ``x`` is marked.  spread: further curves along ``x``, in grey.
    """
    quantity, x_quantity = values_quantity(values), coordinate_quantity(values, x)
    label_axes(axes, x_quantity.axis, quantity.axis)
    axes.axhline(0.0, color="black", lw=0.8).sticky_edges.y.append(0.0)
    values = values.sortby(x)
    along = x_quantity.factor * values[x].values
    set_swept_scale(axes, along)
    if values.sizes[x] <= _MOST_TICKS:
        _set_swept_ticks(axes.xaxis, along, along)
    if mark and x in mark:
        axes.axvline(x_quantity.factor * mark[x], color="black", lw=0.8, ls=":")
    for edge in spread:
        axes.plot(along, quantity.factor * edge.sortby(x), color="0.5", lw=0.8, ls="--")
    draw_median_curve(axes, x_quantity.factor * values[x], quantity.factor * values, color=color, **look)
    if values.name in SHARE_METRICS:
        axes.set_ylim(0.0, 105.0)
    mark_if_empty(axes, values)


def draw_median_curve(axes: Axes, along: xr.DataArray, values: xr.DataArray, *, color: str, **look: Any) -> None:
    """Draw the median of ``values`` over all dims but that of ``along``, with a band or a thin line per member."""
    x = str(along.dims[0])
    band, members = _band_or_members(values, x)
    if band is not None:
        axes.fill_between(along, *band, color=color, alpha=0.2, lw=0)
    elif members is not None:
        axes.plot(along, members, color=color, lw=0.5, alpha=0.7)
    axes.plot(along, pool(values, x), color=color, **look)


def draw_dots(axes: Axes, values: xr.DataArray, dim: str, color: str) -> None:
    """Draw the medians of named alternatives as dots, with a line from 10 to 90 % or a small dot per member."""
    quantity, n = values_quantity(values), values.sizes[dim]
    axes.set_xlabel(wrap_to_axes(axes, quantity.axis))
    axes.set_yticks(range(n), [str(v) for v in values[dim].values])
    axes.set_ylim(n - 0.4, -0.6)
    axes.axvline(0.0, color="black", lw=0.8).sticky_edges.x.append(0.0)
    values = quantity.factor * values
    band, members = _band_or_members(values, dim)
    if band is not None:
        axes.hlines(range(n), *band, color=color, lw=1.0)
    elif members is not None:
        axes.plot(members, range(n), "o", color=color, ms=2.5, mfc="white", mew=0.7)
    axes.plot(pool(values, dim), range(n), "o", color=color, ms=5)
    mark_if_empty(axes, values)


def mark_if_empty(axes: Axes, values: xr.DataArray) -> bool:
    """Write into the panel that no value is finite, and return whether that is so."""
    if np.isfinite(values).any():
        return False
    axes.text(0.5, 0.5, "no finite value", ha="center", transform=axes.transAxes)
    return True


def _band_or_members(values: xr.DataArray, dim: str) -> tuple[xr.DataArray | None, np.ndarray | None]:
    """Return the 10–90 % band over all dims but one, (2, n), or the members if few, (n, members); or neither."""
    pooled_dims = _pooled_dims(values, dim)
    if values.name in SHARE_METRICS:
        return None, None
    if math.prod(values.sizes[d] for d in pooled_dims) >= _LEAST_BAND_MEMBERS:
        with warnings.catch_warnings():
            # where every member is NaN the band has a gap, which says enough
            warnings.filterwarnings("ignore", "All-NaN slice encountered", RuntimeWarning)
            return values.quantile((0.1, 0.9), pooled_dims), None
    return None, values.transpose(dim, ...).values.reshape(values.sizes[dim], -1) if pooled_dims else None


def pooled_in_words(values: xr.DataArray, drawn: Sequence[str | None], marks: Sequence[str]) -> str:
    """Return the caption of a figure: what it pools, and what marks median, band and single members."""
    median, band, member = marks
    sizes = {str(d): n for d, n in values.sizes.items() if d not in drawn and n > 1}
    if not sizes:
        return f"{median}: a single scenario"
    labels = {d: values[d].attrs["pooled_as"] for d in sizes if d in values.coords and "pooled_as" in values[d].attrs}
    has_run = values != STATUS_NOT_RUN if values.name == "status" else values.notnull()
    n_run = {d: int(has_run.any([dim for dim in values.dims if dim != d]).sum()) for d in sizes}
    parts = {d: f"{n_run[d]:,} of " * (n_run[d] < n) + sizes_in_words({d: n}) for d, n in sizes.items()}
    over = " × ".join(labels.get(d) or part for d, part in parts.items())
    has_band = math.prod(sizes.values()) >= _LEAST_BAND_MEMBERS
    words = f"; {band}: 10th to 90th percentile" if has_band else f"; {member}: each of these"
    return f"{median}: median of {over}{words if band else ''}"


def left_out_in_words(ds: xr.Dataset | xr.DataArray, dim: str | None, n_shown: int) -> str:
    """Return the clause of a caption with the number of labels that are drawn; empty if all are."""
    n = n_shown if dim is None else ds.sizes[dim]
    return "" if n_shown == n else f"; shown are {n_shown} of {n} values of {coordinate_quantity(ds, str(dim)).text}"


def failed_in_words(ds: xr.Dataset) -> str:
    """Return the clause of a caption with the numbers of scenarios that failed or were not run; empty without any."""
    status = ds["status"].values  # in groups that differ in size places stay empty: NaN
    n, n_not_run = int(np.isfinite(status).sum()), int((status == STATUS_NOT_RUN).sum())
    n_failed = n - n_not_run - int((status == STATUS_OK).sum())
    counts = [f"{k:,} that {why}" for k, why in ((n_failed, "failed"), (n_not_run, "are not run yet")) if k]
    return f"; without {' and '.join(counts)} of the {n:,} scenarios drawn" if counts else ""
