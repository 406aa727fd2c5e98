"""Metrics over two swept parameters, or along one: ``fc.plot.map``, ``fc.plot.bands``, and the panels of a study.

The figures of a study have maps, curves, or dots for named alternatives.  They belong to no window, so they need no
display; there is a panel for each metric, as many abreast as the width takes, and with ``by`` a row of them for each
label of a dimension.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_choice, require_instance, require_text
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.base.figures import BLUE, COLOURS, LINE_STYLES, apply_style, wrap_text
from fastcoil.deliver.figures import drawing
from fastcoil.deliver.figures.answers import draw_drivers, draw_learning_study
from fastcoil.loops.labels import label_in_words, plain_pi_label, values_quantity
from fastcoil.loops.scenarios import check_counted_result, require_table_units
from fastcoil.model.metric_table import METRICS, metric_hint
from fastcoil.model.parameter_table import CHANCE_DIMS, PARAMETERS
from fastcoil.study.analysis.answer import find_answer
from fastcoil.study.analysis.choices import PLAIN_PI_VALUES, describe_place, largest, shorten
from fastcoil.study.analysis.learned import is_learning_result

from fastcoil.study.analysis.selected import (  # isort: skip
    condition_dims, drawn_parameters, group_by_parameters, numeric_dims, swept_dims,
)  # fmt: skip

if TYPE_CHECKING:
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure

_AXES_HEIGHT_INCHES = 2.8


@drawing.use_style()
def map(data: Any, metric: str | None = None, *, x: str | None = None, y: str | None = None, ax: Any = None) -> Any:
    """Draw a metric over two swept parameters as colours: the median over days, drawn valves and noise.

    Of a Dataset, other swept parameters are taken at the recommended label, see ``answer``; of a variable, the median
    is over these too.

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

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes
        (1,).

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    values, failed_clause = _select_values(data, metric, x=x, y=y)
    y, x = drawing.resolve_swept_axes(values, y=y, x=x)
    values, place, fixed_words = _at_recommended(data, values, (x, y))
    (axes,) = drawing.prepare_axes(ax, [_AXES_HEIGHT_INCHES])
    drawing.draw_map(axes, values, x, y, mark=place)
    caption = drawing.pooled_in_words(values, (x, y), drawing.COLOUR_MARKS) + fixed_words + failed_clause
    drawing.draw_caption(axes, caption)
    return np.array([axes])


@drawing.use_style()
def bands(data: Any, metric: str | None = None, *, x: str | None = None, by: str | None = None, ax: Any = None) -> Any:
    """Draw a metric along a swept parameter: the median over chance, with a band from 10 to 90 %.

    Fewer than five members are drawn as a thin line each.  Other swept parameters are as in ``map``.

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

    Returns
    -------
    numpy.ndarray of matplotlib.axes.Axes
        (1,).

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    values, failed_clause = _select_values(data, metric, x=x, by=by)
    if by is not None:
        require_choice("by", by, [str(d) for d in values.dims])
    (x,) = drawing.resolve_swept_axes(values.isel({by: 0}, drop=True) if by else values, x=x)
    values, _, fixed_words = _at_recommended(data, values, (x, by))
    (axes,) = drawing.prepare_axes(ax, [_AXES_HEIGHT_INCHES])
    label_indices = [] if by is None else drawing.pick_labels(values.sizes[by])
    for k, index in enumerate(label_indices):
        words = label_in_words(values, str(by), index)
        drawing.draw_curve(axes, values.isel({by: index}), x, label=words, color=COLOURS[k], ls=LINE_STYLES[k])
    if label_indices:
        axes.legend(loc="best", framealpha=0.8, edgecolor="none")
    else:
        drawing.draw_curve(axes, values, x, color=BLUE)
    axes.margins(x=0.0)
    omitted_note = drawing.left_out_in_words(values, by, len(label_indices))
    pooled_note = drawing.pooled_in_words(values, (x, by), drawing.LINE_MARKS)
    drawing.draw_caption(axes, pooled_note + fixed_words + omitted_note + failed_clause)
    return np.array([axes])


def _select_values(data: Any, metric: Any, **axes: Any) -> tuple[xr.DataArray, str]:
    """Return the values to draw, and a clause on failed scenarios; drawn parameters among the axes are grouped."""
    with argument_checks() as check:
        for argument, name in axes.items():
            check.unless_none(require_text, argument, name)
        check.unless_none(require_text, "metric", metric)
    if isinstance(data, xr.DataArray):
        if metric is not None:
            sentence = f"metric = {short_repr(metric)}: leave it out, data is one variable already"
            raise InputError(sentence, "metric", "conflict")
        if data.dtype.kind not in "iufb":
            raise InputError(f"data is of type {data.dtype}: give numbers", "data", "data")
        require_table_units(data.coords.to_dataset(), PARAMETERS)
        return data, ""
    cure = "give a Dataset of fastcoil.simulate or open_study, or one of its variables"
    check_counted_result(require_instance("data", data, xr.Dataset, cure))
    drawn = [name for name in drawn_parameters(data) if name in axes.values()]
    ds, name = group_by_parameters(data, drawn) if drawn else data, metric or "rmse"
    numbers = [str(n) for n in ds.data_vars if ds[n].dtype.kind in "iufb" and "elapsed_time" not in ds[n].dims]
    if name not in numbers:
        hint = metric_hint(name) if name not in METRICS else ""
        sentence = f"metric = {short_repr(name)} is not in this result{hint}; it has {', '.join(numbers)}"
        raise InputError(sentence, "metric", "name")
    return ds[name], drawing.failed_in_words(ds)


def _at_recommended(
    data: Any, values: xr.DataArray, drawn: Sequence[str | None]
) -> tuple[xr.DataArray, dict[str, Any], str]:
    """Return the values at the recommended labels of what is not drawn, those labels, and a clause for the caption."""
    if not isinstance(data, xr.Dataset) or {*values.dims} != {*data["status"].dims}:
        return values, {}, ""
    place, fixed, words = recommend_labels(data, [d for d in drawn if d])
    return values.sel(fixed), place, words


_LEAST_PANEL_WIDTH_INCHES = 2.2  # legible
_ESTIMATE_PARAMETERS = ("estimate_ratio", "backlash_estimate")
STANDARD_METRICS = ("rmse", "motor_travel", "hunts")  # as the answer quotes


@apply_style()
def draw_panels(
    ds: xr.Dataset, x: str, y: str | None = None, by: str | None = None, metrics: Sequence[str] = STANDARD_METRICS,
    width: float | None = None, *, overlays: bool = False,
) -> Figure:  # fmt: skip
    """Draw a panel for each metric: maps over two swept parameters, curves along one, or dots for names along ``x``.

    Days, drawn valves, noise are pooled: their median, along a swept number with its 10–90 % range, or single
    members.  Other swept axes are not: see ``recommend_labels``.  by: a further dimension, with a row of panels for
    each of ``panel_rows``; with ``overlays`` a curve in the same panel.  width: of the figure, inches.
    """
    from matplotlib.figure import Figure

    dims, has_names = tuple(filter(None, (x, y))), x in ds.coords and ds[x].dtype.kind in "OUST"
    with argument_checks() as check:
        if not has_names or y:
            check(drawing.resolve_swept_axes, ds["status"], x=x, **({"y": y} if y else {}))
        for name in (name for name in metrics if name not in ds):
            sentence = f"metrics: {short_repr(name)} is not in this result"
            hint = metric_hint(name) or did_you_mean(name, METRICS)
            check.problems.append(Problem(sentence + hint, "metrics", "name"))
    if by in dims:
        raise InputError(f"{by} is named twice: choose two different axes", "by", "duplicate")
    recommended, fixed, fixed_words = recommend_labels(ds, [d for d in (x, y, by) if d])
    all_ds, ds = ds, ds.sel(fixed)
    if not y and {*fixed} & {*recommended}:
        fixed_words += "; dashed: best and worst of the choices not drawn"
    all_rows = panel_rows(ds, by, recommended)
    draw: Callable[..., QuadMesh | None]
    if y:
        draw, marks, height = partial(drawing.draw_map, x=x, y=y), drawing.COLOUR_MARKS, 3.0
    elif has_names:
        draw, marks, height = partial(drawing.draw_dots, dim=x, color=BLUE), drawing.DOT_MARKS, 1 + 0.22 * ds.sizes[x]
    else:
        draw = partial(drawing.draw_curve, x=x, color=BLUE)
        marks, height = drawing.LINE_MARKS, 2.4 if len(all_rows) <= 2 else 1.7
    rows = all_rows
    if overlays := overlays and by is not None and not y and not has_names:
        rows, all_rows = [(None, "")], [all_rows[k] for k in drawing.pick_labels(len(all_rows))]
    n = len(metrics)
    columns = n if by else min(n, panels_per_row(width))
    inches = 3.2 * max(columns, 2) if width is None else width
    if by and inches < n * _LEAST_PANEL_WIDTH_INCHES:
        raise InputError(f"{n} panels in {25.4 * inches:.0f} mm: give fewer metrics, or more width", "width", "size")
    n_rows = math.ceil(len(rows) * n / columns)
    figure = Figure(figsize=(inches, height * n_rows + 0.5), layout="constrained")
    shared_axes: Any = "col" if by else False
    sharey = (has_names and not y) or shared_axes
    grid = figure.subplots(n_rows, columns, squeeze=False, sharex=shared_axes, sharey=sharey).ravel()
    for unused_axes in grid[len(rows) * n :]:
        unused_axes.remove()
    for axes, ((index, words), metric) in zip(grid, product(rows, metrics), strict=False):
        at = {} if index is None else {by: index}
        is_recommended = index is None or ds[by].values[index] == recommended.get(str(by), ds[by].values[index])
        spread = _other_choices(all_ds[metric].isel(at), x, recommended) if not y and not has_names else {}
        look: dict[str, Any] = {} if has_names and not y else {"mark": recommended if is_recommended else None}
        if y:  # rows are compared
            medians = values_quantity(ds[metric]).factor * drawing.pool(ds[metric], *dims, *([by] if by else []))
            look["limits"] = float(medians.min()), float(medians.max())
        if overlays:
            for (k, words_of_curve), colour, style in zip(all_rows, COLOURS, LINE_STYLES, strict=False):
                values = ds[metric].isel({by: k})
                drawing.draw_curve(axes, values, x, color=colour, ls=style, label=words_of_curve)
        else:
            draw(axes, ds[metric].isel(at), **look, **spread)
        title = shorten(words) + (", recommended" if is_recommended and str(by) in recommended else "")
        axes.set_title(drawing.wrap_to_axes(axes, title, 8), loc="left", fontsize=8)
        if by and not axes.get_subplotspec().is_last_row():
            axes.set_xlabel("")
    if overlays:
        figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", edgecolor="none")
    words = drawing.pooled_in_words(ds["status"], (*dims, by), marks) + fixed_words
    words += drawing.left_out_in_words(ds, by, len(all_rows)) + drawing.failed_in_words(ds)
    figure.suptitle(wrap_text("\n".join(filter(None, [str(ds.attrs.get("title", "")), words])), inches, 9))
    return figure


def recommend_labels(ds: xr.Dataset, drawn: Sequence[str]) -> tuple[dict[str, Any], dict[str, Any], str]:
    """Recommend labels of the choices; fix axes that a figure does not draw: choices there, conditions at the worst.

    Returns the recommended labels of all choices, none where the answer has none, those to select, and a clause for
    the caption.
    """
    if "rmse" not in ds or "members" in ds.coords:
        return {}, {}, ""  # groups of drawn parameters
    found = find_answer(ds)
    if "rmse" not in found.table:
        return {}, {}, ""
    left = [d for d in swept_dims(ds) if d not in drawn]
    fixed = {d: found.place[d] for d in left if d in found.place}
    label = describe_place(ds, found.place if found.recommend else fixed).removeprefix(" at ")
    words = f"; {'recommended' if found.recommend else 'drawn'}: {label}" if label else ""
    if conditions := [d for d in left if d not in found.place]:
        rmse = found.table["rmse"].sel(found.place)
        worst = rmse.isel(largest(rmse))
        worst_labels = {d: worst[d].values.item() for d in conditions}
        words += f"; drawn{describe_place(ds, worst_labels)}, where the error is largest"
        fixed |= worst_labels
    return dict(found.place) if found.recommend else {}, fixed, words


def _other_choices(values: xr.DataArray, x: str, recommended: Mapping[str, Any]) -> dict[str, Any]:
    """Return the best and the worst of the choices that a curve does not draw, medians over chance."""
    dims = [d for d in recommended if d in values.dims and d != x]
    if not dims:
        return {}
    medians = drawing.pool(values, *(str(d) for d in values.dims if d not in CHANCE_DIMS))
    over = [d for d in medians.dims if d != x]
    return {"spread": (medians.min(over), medians.max(over))}


def panels_per_row(width: float | None) -> int:
    """Return how many panels fit side by side into a width in inches, at most 3."""
    return 3 if width is None else int(np.clip(width / _LEAST_PANEL_WIDTH_INCHES, 1, 3))


def standard_figures(ds: xr.Dataset, width: float | None = None) -> dict[str, Callable[[], Figure]]:
    """Return functions that draw the figures for a study's dimensions, by file name; none for a single scenario.

    A further swept axis, first one with a plain PI and other controllers, has a row of panels for each label.  A row
    has as many metrics as fit into ``width``, inches.  Nothing is imported before a function is called.
    """
    numeric = numeric_dims(ds["status"])
    named_dims = [str(d) for d in ds["status"].dims if d not in numeric and d in ds.coords and ds.sizes[d] > 1]
    row_metrics = [name for name in STANDARD_METRICS if name in ds][: panels_per_row(width)]

    def next_axis(*drawn: str) -> str | None:
        return next((d for d in [*control_dims(ds), *swept_dims(ds)] if d not in drawn), None)

    def panel_figure(x: str, y: str | None = None) -> Callable[[], Figure]:
        by = next_axis(x, *([y] if y else []))
        metrics = row_metrics if by else [name for name in STANDARD_METRICS if name in ds]
        return partial(draw_panels, ds, x, y, by, metrics, width)

    if "design" in ds["status"].dims:
        return {"drivers": partial(draw_drivers, ds, width)}
    figures: dict[str, Callable[[], Figure]] = {}
    if is_learning_result(ds):
        figures["learning"] = partial(draw_learning_study, ds, width)
    # a map of two columns would be bars
    wide = [d for d in numeric if ds.sizes[d] > 2]
    if len(wide) >= 2:
        swept = [d for d in wide if d in control_dims(ds)]
        y, x = wide[:2] if not swept or {*wide[:2]} & {*swept} else (wide[0], swept[0])
        figures["maps"] = panel_figure(x, y)
        choices = [d for d in (x, y, *wide) if d not in condition_dims(ds)]
        figures["bands"] = panel_figure([*choices, x][0])
    elif numeric:
        figures["bands"] = panel_figure(max(numeric, key=lambda d: ds.sizes[d]))
    for dim in named_dims:
        if ds[dim].dtype.kind in "OUST" and ds.sizes[dim] * len(panel_rows(ds, next_axis(dim))) <= 100:
            figures[dim] = panel_figure(dim)
    return figures


def panel_rows(ds: xr.Dataset, by: str | None, recommended: Mapping[str, Any] = {}) -> list[tuple[int | None, str]]:
    """Return index and words of the labels with a row of panels: all of up to six, else first, recommended, last."""
    if by is None:
        return [(None, "")]
    require_choice("by", by, [str(d) for d in ds["status"].dims if d in ds.coords and ds.sizes[d] > 1])
    is_recommended = ds[by].values == recommended.get(by)
    label_indices = drawing.pick_labels(ds.sizes[by], 6, int(np.argmax(is_recommended)))
    is_plain, pi = (ds[by].values == 0.0) & (by in _ESTIMATE_PARAMETERS), plain_pi_label(ds)
    return [(k, label_in_words(ds, by, k) + (f", {pi}" if is_plain[k] else "")) for k in label_indices]


def control_dims(ds: xr.Dataset) -> list[str]:
    """Return the dimensions with a plain PI among other controllers, over which no median makes sense."""
    dims = [str(d) for d in ds["status"].dims if ds.sizes[d] > 1 and d not in CHANCE_DIMS]
    controls = []
    for dim in dims:
        # some labels, and not all, are a plain PI by what differs along the dimension
        along = {n: v for n, v in PLAIN_PI_VALUES.items() if n in ds.coords and ds[n].dims == (dim,)}
        is_plain = np.array([ds[n].values == v for n, v in along.items()] or [[False]]).all(axis=0)
        if dim == "controller" or (is_plain.any() and not is_plain.all()):
            controls.append(dim)
    return controls
