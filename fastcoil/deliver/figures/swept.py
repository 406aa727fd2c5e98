"""``fc.plot.map`` and ``fc.plot.bands``: a metric over two swept parameters, or along one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, text_of
from fastcoil.base.errors import InputError, WrongType
from fastcoil.base.errors import shown as quoted
from fastcoil.base.figures import BLUE, COLOURS, LINE_STYLES, STYLE, wrapped
from fastcoil.deliver.figures import drawing
from fastcoil.loops.labels import label_in_words, quantity_of, quantity_of_values
from fastcoil.loops.scenarios import check_result
from fastcoil.model.metric_table import METRICS, metric_meant
from fastcoil.study.analysis.selected import binned, drawn_parameters

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh

_HEIGHT = 2.8
_MOST_COLUMNS, _MOST_ROWS = 7, 10  # a map of so few cells has its numbers written into them
_DEFAULT = "rmse"
_DARK = 0.55  # share of the scale of colours up to which white letters are read best


@drawing.in_style()
def map(data: Any, metric: str | None = None, *, x: str | None = None, y: str | None = None, ax: Any = None) -> Axes:
    """Draw a metric over two swept parameters as colours: the median over all other dims.

    A map of few cells has its numbers written into them.  Where the axes are the backlash and an estimate of it, a
    dotted line marks where they are equal.

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
    values, failed = _values_of(data, metric, x=x, y=y)
    y, x = drawing.swept_axes(values, y=y, x=x)
    (axes,) = drawing.places(ax, [_HEIGHT])
    width, of = drawing.width_of(axes, ax), quantity_of_values(values)
    mesh = drawing.median_map(axes, values, of, x, y, width)
    if mesh is not None:
        scale = axes.figure.colorbar(mesh, ax=axes)
        scale.set_label(wrapped(of.axis, 2.0, 9))
        scale.ax.tick_params(labelsize=STYLE["font.size"])
        shown = of.factor * values.median(drawing.pooled_dims(values, x, y)).transpose(y, x)
        _write_numbers(axes, mesh, shown, (quantity_of(values, y).factor, quantity_of(values, x).factor))
    words = drawing.describe(values, drawing.pooled_dims(values, x, y), "Colour", "", "")
    _caption(axes, words, drawing.exact_in_words(x, y) + failed, width)
    return axes


@drawing.in_style()
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
    values, failed = _values_of(data, metric, x=x, by=by)
    if by is not None:
        drawing.check_dim("by", by, [str(d) for d in values.dims])
    (x,) = drawing.swept_axes(values.isel({by: 0}, drop=True) if by else values, x=x)
    (axes,) = drawing.places(ax, [_HEIGHT])
    width, of, of_x = drawing.width_of(axes, ax), quantity_of_values(values), quantity_of(values, x)
    along, scaled = of_x.factor * values[x], of.factor * values
    chosen = [] if by is None else drawing.picked(values, by)
    if by is None:
        drawing.curve(axes, along, scaled, color=BLUE)
    else:
        for k, index in enumerate(chosen):
            words = label_in_words(values, by, index)
            drawing.curve(axes, along, scaled.isel({by: index}), label=words, color=COLOURS[k], ls=LINE_STYLES[k])
        axes.legend(loc="best", framealpha=0.8, edgecolor="none")
    drawing.label_axes(axes, of_x.axis, of.axis, width)
    drawing.mark_exact(axes, x)
    drawing.say_if_empty(axes, scaled)
    drawing.from_zero([axes], "y")
    axes.margins(x=0.0)
    words = drawing.describe(values, drawing.pooled_dims(values, x, by), "Line", "band", "thin lines")
    left = "" if by is None else drawing.left_out_in_words(values, by, len(chosen))
    _caption(axes, words, left + drawing.exact_in_words(x) + failed, width)
    return axes


def _values_of(data: Any, metric: Any, **axes: Any) -> tuple[xr.DataArray, str]:
    """What is drawn, and which part of the result failed, in words; drawn parameters among the axes in groups."""
    with checking() as check:
        for argument, name in axes.items():
            check.unless_none(text_of, argument, name)
        check.unless_none(text_of, "metric", metric)
    if isinstance(data, xr.DataArray):
        if metric is not None:
            raise InputError(f"metric = {quoted(metric)}: leave it out, data is one variable already")
        if data.dtype.kind not in "iufb":
            raise InputError(f"data is of type {data.dtype}: give numbers")
        return data, ""
    if not isinstance(data, xr.Dataset):
        cure = "give a Dataset of fastcoil.simulate or open_study, or one of its variables"
        raise InputError(WrongType(f"data is a {type(data).__name__}: {cure}"))
    check_result(data)
    drawn = [name for name in drawn_parameters(data) if name in axes.values()]
    ds, name = binned(data, drawn) if drawn else data, metric or _DEFAULT
    numbers = [str(n) for n in ds.data_vars if ds[n].dtype.kind in "iufb" and "elapsed_time" not in ds[n].dims]
    if name not in numbers:
        near = metric_meant(name) if name not in METRICS else ""
        raise InputError(f"metric = {quoted(name)} is none of this result{near}; it has {', '.join(numbers)}")
    return ds[name], drawing.failed_in_words(ds)


def _write_numbers(axes: Axes, mesh: QuadMesh, values: xr.DataArray, factors: tuple[float, float]) -> None:
    """Write the values, along y and x, into the cells of a map, if each has room for a number."""
    at_y, at_x = (factor * values[dim].values for factor, dim in zip(factors, values.dims, strict=True))
    for at, most in ((at_x, _MOST_COLUMNS), (at_y, _MOST_ROWS)):
        if np.abs(np.diff(at)).min() * (most - 0.999) < np.ptp(at):
            return
    low, high = (float(one) for one in mesh.get_clim())
    for (i, j), value in np.ndenumerate(values.values):
        if np.isfinite(value):
            colour = "white" if value - low < _DARK * (high - low) else "black"
            axes.text(
                float(at_x[j]), float(at_y[i]), f"{value:.2g}", ha="center", va="center", fontsize=7, color=colour
            )


def _caption(axes: Axes, words: str, more: str, width: float) -> None:
    """What is pooled, and what the marks are; a single scenario needs neither."""
    if more or not words.endswith(": a single scenario"):
        drawing.caption(axes, words + more, width)
