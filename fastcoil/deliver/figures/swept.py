"""``fc.plot.map`` and ``fc.plot.bands``: a metric over two swept parameters, or along one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, text_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, WrongType, nearest, shown
from fastcoil.base.figures import BLUE, COLOURS, LINE_STYLES, STYLE, wrapped
from fastcoil.deliver.figures.axes import (
    describe,
    draw_curve,
    draw_map,
    exact_in_words,
    failed_in_words,
    from_zero,
    in_style,
    label,
    mark_exact,
    one_place,
    picked,
    pooled_dims,
    say_if_empty,
    width_of,
)
from fastcoil.loops.dataset import check_result
from fastcoil.loops.labels import Quantity, label_in_words, quantity_of, quantity_of_values
from fastcoil.model.metric_table import METRICS, metric_meant
from fastcoil.study.analysis.selected import binned, drawn_parameters, numeric_dims

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh

_HEIGHT = 2.8
_MOST_COLUMNS, _MOST_ROWS = 7, 10
"""A map of so few cells has its numbers written into them; one of more has contours."""
_LEVELS = 5
_DEFAULT = "rmse"
_DARK = 0.55  # share of the scale of colours up to which white letters are read best


class _Values(NamedTuple):
    """What is drawn, how it is called, and which part of the result failed, in words."""

    values: xr.DataArray
    shown: Quantity
    failed: str


@in_style()
def map(data: Any, metric: str | None = None, *, x: str | None = None, y: str | None = None, ax: Any = None) -> Axes:
    """Draw a metric over two swept parameters as colours: the median over all other dims.

    A map of few cells has its numbers written into them, another has contours.  Where the axes are the backlash and an
    estimate of it, a dotted line marks where they are equal.

    Parameters
    ----------
    data
        Dataset of ``simulate``, ``run_study`` or ``open_study``, or one of its variables such as ``ds.rmse``.
    metric
        Name of a variable of the Dataset; ``rmse`` if left out.
    x, y
        Swept parameters; if left out, the two that the result has.  Drawn ones, of a Dataset, are put in groups of
        equal counts.
    ax
        Axes to draw into; a new figure if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    drawn = _values_of(_grouped(data, x, y), metric)
    y, x = _axes_of(drawn.values, y=y, x=x)
    axes = one_place(ax, _HEIGHT)
    width = width_of(axes, ax)
    mesh = draw_map(axes, drawn.values, drawn.shown, x, y, width)
    if mesh is not None:
        scale = axes.figure.colorbar(mesh, ax=axes)
        scale.set_label(wrapped(drawn.shown.axis, 2.0, 9))
        scale.ax.tick_params(labelsize=STYLE["font.size"])
        _tell(axes, drawn, x, y, mesh)
    words = describe(drawn.values, pooled_dims(drawn.values, x, y), "Colour", "", "")
    _caption(axes, words + exact_in_words(x, y) + drawn.failed, width)
    return axes


@in_style()
def bands(data: Any, metric: str | None = None, *, x: str | None = None, by: str | None = None, ax: Any = None) -> Axes:
    """Draw a metric along a swept parameter: the median over all other dims, with a band from 10 to 90 %.

    Fewer than five members are drawn as a thin line each.

    Parameters
    ----------
    data
        Dataset of ``simulate``, ``run_study`` or ``open_study``, or one of its variables such as ``ds.rmse``.
    metric
        Name of a variable of the Dataset; ``rmse`` if left out.
    x
        Swept parameter; if left out, the one that the result has.  A drawn one, of a Dataset, is put in groups of equal
        counts.
    by
        A second dim, of numbers or names: a curve for each, or for the first, the middle and the last of more than
        three.
    ax
        Axes to draw into; a new figure if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    drawn = _values_of(_grouped(data, x, by), metric)
    values, shown_as = drawn.values, drawn.shown
    if by is not None:
        dims = [str(d) for d in values.dims]
        if text_of("by", by) not in dims:
            raise InputError(
                f"by = {shown(by)} is no dimension of this result{nearest(by, dims)}; it has {', '.join(dims)}"
            )
    (x,) = _axes_of(values.isel({by: 0}, drop=True) if by else values, x=x)
    axes = one_place(ax, _HEIGHT)
    width = width_of(axes, ax)
    of_x = quantity_of(values, x)
    along, scaled = of_x.factor * values[x], shown_as.factor * values
    if by is None:
        draw_curve(axes, along, scaled, color=BLUE)
    else:
        for k, index in enumerate(picked(values.sizes[by])):
            words = label_in_words(values, by, index)
            draw_curve(axes, along, scaled.isel({by: index}), label=words, color=COLOURS[k], ls=LINE_STYLES[k])
        axes.legend(loc="best", framealpha=0.8, edgecolor="none")
    label(axes, of_x.axis, shown_as.axis, width)
    mark_exact(axes, x)
    say_if_empty(axes, scaled)
    from_zero([axes], "y")
    axes.margins(x=0.0)
    pooled = pooled_dims(values, x, *([by] if by else []))
    words = describe(values, pooled, "Line", "band", "thin lines")
    _caption(axes, words + exact_in_words(x) + drawn.failed, width)
    return axes


def _grouped(data: Any, *axes: Any) -> Any:
    """A result with the drawn parameters among its axes in groups, as they are no dims."""
    if not isinstance(data, xr.Dataset) or "status" not in data:
        return data
    names = [name for name in drawn_parameters(data) if name in [a for a in axes if isinstance(a, str)]]
    return binned(data, names) if names else data


def _values_of(data: Any, metric: Any) -> _Values:
    if isinstance(data, xr.DataArray):
        if metric is not None:
            raise InputError(f"metric = {shown(metric)}: leave it out, data is one variable already")
        if data.dtype.kind not in "iufb":
            raise InputError(f"data is of type {data.dtype}: give numbers")
        return _Values(data, quantity_of_values(data), "")
    with checking() as check:
        if not isinstance(data, xr.Dataset):
            cure = "give a Dataset of fastcoil.simulate or open_study, or one of its variables"
            raise InputError(WrongType(f"data is a {type(data).__name__}: {cure}"))
        check(check_result, data)
        name = check(text_of, "metric", _DEFAULT if metric is None else metric)
    numbers = [str(n) for n in data.data_vars if data[n].dtype.kind in "iufb" and "elapsed_time" not in data[n].dims]
    if name not in numbers:
        near = metric_meant(name) if name not in METRICS else ""
        raise InputError(f"metric = {shown(name)} is none of this result{near}; it has {', '.join(numbers)}")
    return _Values(data[name], quantity_of_values(data[name]), failed_in_words(data))


def _axes_of(values: xr.DataArray, **given: Any) -> list[str]:
    """The swept parameters along the axes: those that are given, for the others those that are left."""
    swept, found = numeric_dims(values), []
    with checking() as check:
        given = {argument: check.unless_none(text_of, argument, dim) for argument, dim in given.items()}
    problems = [
        f"{argument} = {shown(dim)} is not a swept number of this result{nearest(str(dim), swept)}; it has "
        f"{', '.join(swept) or 'none'}"
        for argument, dim in given.items()
        if dim is not None and dim not in swept
    ]
    named = [dim for dim in given.values() if dim is not None]
    if not problems and len({*named}) < len(named):
        problems.append(f"{named[0]} is named twice: choose two different axes")
    if problems:
        raise InputError(problems)
    left = [dim for dim in swept if dim not in named]
    open_ = [argument for argument, dim in given.items() if dim is None]
    if open_ and len(left) != len(open_):
        has = f"sweeps {', '.join(swept)}" if swept else "sweeps no number"
        raise InputError(
            f"this result {has}: " + (f"say which is {' and '.join(sorted(open_))}" if len(left) > len(open_) else
            f"a figure needs {len(given)} swept number{'s' * (len(given) > 1)}")
        )  # fmt: skip
    for argument, dim in given.items():
        found.append(str(dim) if dim is not None else left[open_.index(argument)])
    return found


def _tell(axes: Axes, drawn: _Values, x: str, y: str, mesh: QuadMesh) -> None:
    """Write the values into the cells, or draw contours."""
    values = drawn.shown.factor * drawn.values.median(pooled_dims(drawn.values, x, y)).transpose(y, x)
    at_x = np.asarray(quantity_of(drawn.values, x).factor * values[x].values)
    at_y = np.asarray(quantity_of(drawn.values, y).factor * values[y].values)
    if _has_room(at_x, _MOST_COLUMNS) and _has_room(at_y, _MOST_ROWS):
        low, high = (float(one) for one in mesh.get_clim())
        for (i, j), value in np.ndenumerate(values.values):
            if np.isfinite(value):
                colour = "white" if value - low < _DARK * (high - low) else "black"
                place = float(at_x[j]), float(at_y[i])
                axes.text(*place, f"{value:.2g}", ha="center", va="center", fontsize=7, color=colour)
    elif np.ptp(values.values[np.isfinite(values.values)]) > 0.0:
        _contours(axes, at_x, at_y, values.values)


def _has_room(at: Array, most: int) -> bool:
    """Whether each cell along an axis is wide enough for a number."""
    return bool(np.abs(np.diff(at)).min() * (most - 0.999) >= np.ptp(at))


def _contours(axes: Axes, x: Array, y: Array, values: Array) -> None:
    from matplotlib.patheffects import withStroke
    from matplotlib.ticker import MaxNLocator

    finite = values[np.isfinite(values)]
    levels = MaxNLocator(_LEVELS).tick_values(float(finite.min()), float(finite.max()))[1:-1]
    if len(levels):
        drawn = axes.contour(x, y, np.ma.masked_invalid(values), levels=levels, colors="white", linewidths=0.8)
        drawn.set_path_effects([withStroke(linewidth=1.6, foreground="black")])
        for text in axes.clabel(drawn, fmt="%g", fontsize=7):
            text.set_path_effects([withStroke(linewidth=1.6, foreground="black")])


def _caption(axes: Axes, words: str, width: float) -> None:
    """What is pooled, and what the marks are; a single scenario needs neither."""
    if ": a single scenario" not in words or ";" in words:
        axes.set_title(wrapped(words, width, 7), loc="left", fontsize=7)
