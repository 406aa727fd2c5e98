"""Figures of two kinds of study: what learning settings find, and what drives the spread of a population."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fastcoil.base.figures import BLUE, COLOURS, LINE_STYLES, apply_style, wrap_text
from fastcoil.deliver.figures import drawing
from fastcoil.loops.labels import coordinate_quantity, label_in_words, quantity, values_quantity
from fastcoil.study.analysis.answer import Answer, find_answer
from fastcoil.study.analysis.choices import describe_place
from fastcoil.study.analysis.selected import condition_dims

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANEL_INCHES = 2.4, 1.9
_LEARNING_ROWS = {
    "share_right": ("right to the end [%]", 100.0),
    "share_too_high": ("too high at the end [%]", 100.0),
    "time_median": ("half have found it after [h]", 1.0 / 3600.0),
    "motor_travel": ("motor travel [strokes]", 1.0),
}
"""Row of the table → label of the axis and factor."""
_MOST_CONDITIONS = 4  # columns of panels
_MOST_LINES = len(COLOURS)  # in a panel


@apply_style()
def draw_learning_study(ds: xr.Dataset, width: float | None = None) -> Figure:
    """Draw how often settings learn the backlash, how fast, and at what travel: a column for each condition."""
    from matplotlib.figure import Figure

    found = find_answer(ds)
    dims = [str(d) for d in found.table["rmse"].dims]
    conditions = [d for d in dims if d in condition_dims(found.table)]
    settings = [d for d in dims if d not in conditions]
    x, *others = sorted(settings, key=lambda d: -found.table.sizes[d])
    line_dim, fixed = (others[0] if others else None), {d: found.place[d] for d in others[1:]}
    table = found.table.sel(fixed)
    columns = [dict(zip(conditions, at, strict=True)) for at in np.ndindex(*(table.sizes[d] for d in conditions))]
    n_conditions = len(columns)
    columns = [columns[k] for k in drawing.pick_labels(n_conditions, _MOST_CONDITIONS)]
    inches = _PANEL_INCHES[0] * max(2, len(columns)) if width is None else width
    figure = Figure(figsize=(inches, _PANEL_INCHES[1] * len(_LEARNING_ROWS) + 0.6), layout="constrained")
    grid = figure.subplots(len(_LEARNING_ROWS), len(columns), squeeze=False, sharex=True, sharey="row")
    for column, (place, panels) in enumerate(zip(columns, grid.T, strict=True)):
        part = table.isel(place)
        for axes, (name, (text, factor)) in zip(panels, _LEARNING_ROWS.items(), strict=True):
            _draw_settings(axes, factor * part[name], x, line_dim, found)
            if column == 0:
                axes.set_ylabel(wrap_text(text, _PANEL_INCHES[1], 9))
        words = ", ".join(label_in_words(table, d, k) for d, k in place.items())
        panels[0].set_title(drawing.wrap_to_axes(panels[0], words, 8), loc="left", fontsize=8)
        panels[-1].set_xlabel(drawing.wrap_to_axes(panels[-1], coordinate_quantity(table, x).axis))
    for axes, (_, factor) in zip(grid[:, 0], _LEARNING_ROWS.values(), strict=True):
        axes.set_ylim(0.0, 105.0 if factor == 100.0 else None)
    if line_dim:
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=max(1, int(inches // 2.4)), frameon=False)
    shown = f"; {len(columns)} of {n_conditions} conditions" if len(columns) < n_conditions else ""
    shown += drawing.left_out_in_words(table, line_dim, min(_MOST_LINES, table.sizes.get(line_dim, _MOST_LINES)))
    shown = "; dotted: recommended" * bool(found.recommend) + f"; a gap in a line: never{shown}"
    caption = f"Median over days{describe_place(table, fixed)}{shown}"
    figure.suptitle(wrap_text("\n".join(filter(None, [str(ds.attrs.get("title", "")), caption])), inches - 0.4, 9))
    return figure


def _draw_settings(axes: Axes, values: xr.DataArray, x: str, line_dim: str | None, found: Answer) -> None:
    """Draw a line over ``x`` for each label of a second setting."""
    is_number = values[x].dtype.kind in "if"
    along = coordinate_quantity(values, x).factor * values[x].values if is_number else np.arange(values.sizes[x])
    drawing.set_swept_scale(axes, along)
    labels = [] if line_dim is None else drawing.pick_labels(values.sizes[line_dim], _MOST_LINES)
    for k, place in enumerate([{line_dim: index} for index in labels] or [{}]):
        label = label_in_words(values, line_dim, place[line_dim]) if line_dim else None
        curve = values.isel(place).transpose(x).values
        curve = np.where(np.isfinite(curve), curve, np.nan)
        # each line narrower than the one below, so that equal values show both
        width = 1.0 + 0.9 * (len(labels) - 1 - k) if labels else 1.5
        axes.plot(along, curve, LINE_STYLES[k], marker="o", ms=2 + width, lw=width, color=COLOURS[k], label=label)
    if found.recommend and x in found.place:
        axes.axvline(along[int((values[x].values == found.place[x]).argmax())], color="black", lw=0.8, ls=":")
    axes.set_xticks(along, [f"{v:.3g}" for v in along] if is_number else [str(v) for v in values[x].values])


_MOST_SCATTERS = 2  # parameters over which a metric is drawn
_LEAST_WIDTH_INCHES = 6.5


@apply_style()
def draw_drivers(ds: xr.Dataset, width: float | None = None) -> Figure:
    """Draw Sobol' indices of each metric with their intervals, and the metric over the strongest parameters."""
    from matplotlib.figure import Figure

    table = find_answer(ds).table
    metrics = [str(n) for n in table.data_vars if "parameter" in table[n].dims and table[n].notnull().any()]
    rest = [d for d in table[metrics[0]].dims if d not in ("parameter", "index", "edge")]
    first_labels = {str(d): 0 for d in rest}
    inches = _LEAST_WIDTH_INCHES if width is None else width
    figure = Figure(figsize=(inches, 2.2 * len(metrics) + 0.5), layout="constrained")
    grid = figure.subplots(len(metrics), 1 + _MOST_SCATTERS, squeeze=False)
    population = ds.sel(design=["A", "B"])
    for metric, panels in zip(metrics, grid, strict=True):
        indices = table[metric].isel(first_labels).transpose("parameter", "index", "edge")
        _draw_indices(panels[0], indices)
        panels[0].set_title(drawing.wrap_to_axes(panels[0], quantity(metric).text), loc="left")
        strongest = np.argsort(-indices.sel(index="total", edge="value").fillna(0.0).values)
        names = [str(indices["parameter"].values[k]) for k in strongest[:_MOST_SCATTERS]]
        _draw_scatters(panels[1:], population[metric].isel(first_labels), names)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2, frameon=False)
    at = describe_place(ds, {str(d): ds[d].values[0] for d in rest})
    caption = f"Bars: share of the spread{at}, lines: 95 % intervals; dots: a drawn loop each"
    figure.suptitle(wrap_text("\n".join(filter(None, [str(ds.attrs.get("title", "")), caption])), inches, 9))
    return figure


def _draw_indices(axes: Axes, indices: xr.DataArray) -> None:
    rows = np.arange(indices.sizes["parameter"])
    for k, (index, label) in enumerate((("first_order", "alone"), ("total", "with interactions"))):
        value, low, high = 100.0 * indices.sel(index=index).transpose("edge", "parameter").values
        y = rows + 0.36 * (k - 0.5)
        axes.barh(y, value, 0.34, color=COLOURS[k], label=label)
        axes.hlines(y, low, high, color="black", lw=0.8)
    axes.set_yticks(rows, [wrap_text(quantity(str(n)).text, 1.2, 8) for n in indices["parameter"].values])
    axes.invert_yaxis()
    axes.set(xlabel="share of the spread [%]", xlim=(0.0, 105.0))


def _draw_scatters(panels: Sequence[Axes], values: xr.DataArray, names: Sequence[str]) -> None:
    shown_as = values_quantity(values)
    for axes, name in zip(panels, names, strict=False):
        x = coordinate_quantity(values, name)
        xs, ys = xr.broadcast(values[name], values)
        drawing.set_swept_scale(axes, xs.values.ravel())
        axes.plot(x.factor * xs.values.ravel(), shown_as.factor * ys.values.ravel(), ".", color=BLUE, ms=2, alpha=0.6)
        drawing.label_axes(axes, x.axis, shown_as.axis)
