"""``fc.plot.map`` and ``fc.plot.bands``: a metric over two swept parameters, or along one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import xarray as xr

from fastcoil.base.arguments import checking, instance_of, text_of
from fastcoil.base.errors import InputError, shown
from fastcoil.base.figures import BLUE, COLOURS, LINE_STYLES
from fastcoil.deliver.figures import drawing
from fastcoil.loops.labels import label_in_words
from fastcoil.loops.scenarios import check_result, require_our_units
from fastcoil.model.metric_table import METRICS, metric_meant
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.study.analysis.selected import binned, drawn_parameters

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_HEIGHT = 2.8
_DEFAULT = "rmse"


@drawing.in_style()
def map(data: Any, metric: str | None = None, *, x: str | None = None, y: str | None = None, ax: Any = None) -> Axes:
    """Draw a metric over two swept parameters as colours: the median over all other dims.

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
    drawing.draw_map(axes, values, x, y)
    drawing.caption(axes, drawing.pooled_in_words(values, (x, y), drawing.COLOUR) + failed)
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
    chosen = [] if by is None else drawing.picked(values.sizes[by])
    for k, index in enumerate(chosen):
        words = label_in_words(values, str(by), index)
        drawing.draw_curve(axes, values.isel({by: index}), x, label=words, color=COLOURS[k], ls=LINE_STYLES[k])
    if chosen:
        axes.legend(loc="best", framealpha=0.8, edgecolor="none")
    else:
        drawing.draw_curve(axes, values, x, color=BLUE)
    axes.margins(x=0.0)
    left = drawing.left_out_in_words(values, by, len(chosen))
    drawing.caption(axes, drawing.pooled_in_words(values, (x, by), drawing.LINE) + left + failed)
    return axes


def _values_of(data: Any, metric: Any, **axes: Any) -> tuple[xr.DataArray, str]:
    """What is drawn, and which part of the result failed, in words; drawn parameters among the axes in groups."""
    with checking() as check:
        for argument, name in axes.items():
            check.unless_none(text_of, argument, name)
        check.unless_none(text_of, "metric", metric)
    if isinstance(data, xr.DataArray):
        if metric is not None:
            raise InputError(f"metric = {shown(metric)}: leave it out, data is one variable already")
        if data.dtype.kind not in "iufb":
            raise InputError(f"data is of type {data.dtype}: give numbers")
        require_our_units(data.coords.to_dataset(), PARAMETERS)
        return data, ""
    cure = "give a Dataset of fastcoil.simulate or open_study, or one of its variables"
    check_result(instance_of("data", data, xr.Dataset, cure))
    drawn = [name for name in drawn_parameters(data) if name in axes.values()]
    ds, name = binned(data, drawn) if drawn else data, metric or _DEFAULT
    numbers = [str(n) for n in ds.data_vars if ds[n].dtype.kind in "iufb" and "elapsed_time" not in ds[n].dims]
    if name not in numbers:
        near = metric_meant(name) if name not in METRICS else ""
        raise InputError(f"metric = {shown(name)} is none of this result{near}; it has {', '.join(numbers)}")
    return ds[name], drawing.failed_in_words(ds)
