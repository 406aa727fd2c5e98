"""Figures of a study: maps over two swept parameters, curves along one, dots for named alternatives.

Every function returns a matplotlib ``Figure`` that belongs to no window, so it works without a display.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.arguments import checking, names_of, text_of
from fastcoil.errors import InputError, nearest
from fastcoil.errors import shown as quoted
from fastcoil.outputs import METRICS, PREDICTIONS, metric_meant
from fastcoil.plots.labels import quantity, quantity_of
from fastcoil.plots.panels import (
    draw_map,
    exact_in_words,
    failed_in_words,
    from_zero,
    label,
    mark_exact,
    numeric_dims,
    picked,
    pooled_dims,
    say_if_empty,
)
from fastcoil.plots.spread import describe, draw_curve, draw_dots
from fastcoil.plots.style import BLUE, GREY, apply_style, wrapped
from fastcoil.result import check_result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STANDARD_METRICS = ("rmse", "rmse_settled", "switch_frequency")
_PANEL = 3.2
"""Width of a panel, inches."""
_PANELS_ABREAST = 3
_OTHERS: Any = {"color": GREY, "lw": 0.8}
_ALTERNATIVES = 100
"""More rows of names than this are no figure."""


@apply_style()
def maps(ds: xr.Dataset, x: str, y: str, metrics: Sequence[str] = STANDARD_METRICS) -> Figure:
    """Metrics over two swept parameters, one panel each: the median over all other dimensions."""
    metrics = _check(ds, metrics, x=x, y=y)
    figure, panels = _figure(-(-len(metrics) // _PANELS_ABREAST), min(len(metrics), _PANELS_ABREAST), 3.0)
    for axes, metric in zip(panels.flat, metrics, strict=False):
        shown = quantity(metric)
        axes.set_title(wrapped(shown.axis, 0.8 * _PANEL, 9))
        mesh = draw_map(axes, ds[metric], shown, x, y, _PANEL)
        if mesh is not None:
            figure.colorbar(mesh, ax=axes)
    _remove_empty(panels, len(metrics))
    _head(figure, ds, describe(ds, pooled_dims(ds["status"], x, y), "Colour", "", "") + exact_in_words(x, y))
    return figure


@apply_style()
def bands(ds: xr.Dataset, x: str, by: str | None = None, metrics: Sequence[str] = STANDARD_METRICS) -> Figure:
    """Metrics along a swept parameter: median and 10–90 % band, or single lines, over all other dims.

    ``by``: a second swept parameter; a row of panels each for its first, middle and last value instead of pooling it.
    """
    metrics = _check(ds, metrics, x=x, **({} if by is None else {"by": by}))
    rows = picked(ds.sizes[by]) if by else [None]
    if by:
        figure, panels = _figure(len(rows), len(metrics), 2.2, sharex="col", sharey="col")
    else:
        figure, panels = _figure(-(-len(metrics) // _PANELS_ABREAST), min(len(metrics), _PANELS_ABREAST), 2.8)
    of_x = quantity_of(ds, x)
    along = of_x.factor * ds[x]
    for k, index in enumerate(rows):
        for axes, metric in zip(panels[k] if by else panels.flat, metrics, strict=False):
            shown = quantity(metric)
            values = shown.factor * ds[metric]
            part, name = values, None
            if by and index is not None:
                part, name = values.isel({by: index}), quantity_of(ds, by).equals(float(ds[by][index]))
                axes.set_title(name, loc="left")
                rest = values.isel({by: [other for other in rows if other != index]})
                axes.plot(along, rest.median([d for d in rest.dims if d not in (x, by)]).transpose(x, by), **_OTHERS)
            draw_curve(axes, along, part, label=name, color=BLUE)
            label(axes, of_x.axis if not by or k == len(rows) - 1 else "", shown.axis, _PANEL)
            mark_exact(axes, x)
            say_if_empty(axes, values)
    _remove_empty(panels, len(metrics) * len(rows))
    for alike in panels.T if by else panels.reshape(-1, 1):
        from_zero(alike, "y")
    words = describe(ds, pooled_dims(ds["status"], x, *([by] if by else [])), "Line", "band", "thin lines")
    _head(figure, ds, words + ("; grey: medians of the other rows" if by else "") + exact_in_words(x))
    return figure


@apply_style()
def alternatives(ds: xr.Dataset, dim: str, metrics: Sequence[str] = STANDARD_METRICS) -> Figure:
    """Metrics of named alternatives: median and 10–90 % range, or single dots, over all other dims."""
    with checking() as check:
        check(check_result, ds)
        check(text_of, "dim", dim)
        metrics = check(_metrics_of, metrics)
    named = [str(d) for d in ds["status"].dims if d in ds.coords]
    if dim not in named:
        known = ", ".join(named) or "none"
        raise InputError(f"dim = {quoted(dim)} is no dimension of this study{nearest(dim, named)}; it has {known}")
    n = ds.sizes[dim]
    figure, panels = _figure(1, len(metrics), 1.0 + 0.22 * n, sharey=True)
    for axes, metric in zip(panels.flat, metrics, strict=True):
        shown = quantity(metric)
        draw_dots(axes, shown.factor * ds[metric], dim, BLUE)
        axes.set_xlabel(wrapped(shown.axis, 0.8 * _PANEL, 9))
        from_zero([axes], "x")
        say_if_empty(axes, ds[metric])
    panels[0, 0].set_yticks(np.arange(n), [str(v) for v in ds[dim].values])
    panels[0, 0].set_ylim(n - 0.4, -0.6)
    _head(figure, ds, describe(ds, pooled_dims(ds["status"], dim), "Dot", "line", "small dots"))
    return figure


def standard_figures(ds: xr.Dataset) -> dict[str, Callable[[], Figure]]:
    """What draws the figures that suit a study's dimensions, by file name without suffix; empty for a single scenario.

    Nothing is drawn, or imported to draw, before one of them is called.
    """
    check_result(ds)
    numeric = numeric_dims(ds["status"])
    named = [str(d) for d in ds["status"].dims if d not in numeric and d in ds.coords and ds.sizes[d] > 1]
    figures: dict[str, Callable[[], Figure]] = {}
    if len(numeric) >= 2:
        y, x = numeric[:2]
        figures["maps"] = partial(maps, ds, x, y)
        figures["bands"] = partial(bands, ds, x, by=y)
    elif numeric:
        figures["bands"] = partial(bands, ds, numeric[0])
    for dim in named:
        if ds[dim].dtype.kind in "OUST" and ds.sizes[dim] <= _ALTERNATIVES:
            figures[dim] = partial(alternatives, ds, dim)
    return figures


def _figure(rows: int, columns: int, height: float, **options: Any) -> tuple[Figure, np.ndarray]:
    """Panels of one width, all of the same height."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_PANEL * max(columns, 2), height * rows + 0.5), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def _remove_empty(panels: np.ndarray, used: int) -> None:
    for axes in panels.flat[used:]:
        axes.remove()


def _head(figure: Figure, ds: xr.Dataset, words: str) -> None:
    """Write the title of the study, what is drawn, and how much of it failed."""
    words += failed_in_words(ds)
    lines = [str(ds.attrs["title"])] if ds.attrs.get("title") else []
    figure.suptitle(wrapped("\n".join([*lines, words]), figure.get_figwidth(), 9))


def _check(ds: xr.Dataset, metrics: Sequence[str], **dims: str) -> list[str]:
    """The metrics to draw; ``dims``: the arguments that name axes."""
    check_result(ds)
    swept, given = numeric_dims(ds["status"]), list(dims.values())
    with checking() as check:
        names = check(_metrics_of, metrics)
        check.problems += [
            f"metrics: {m} is not in this result: choose another metric" for m in names or () if m not in ds
        ]
        for argument, dim in dims.items():
            check(_axis_of, argument, dim, swept)
        if not check.problems and len(set(given)) < len(given):
            check.problems.append(f"{given[0]} is named twice: choose two different axes")
    return names


def _axis_of(argument: str, dim: str, swept: list[str]) -> None:
    if text_of(argument, dim) not in swept:
        axes = ", ".join(swept) or "none"
        raise InputError(
            f"{quoted(dim)} is not a swept number of this study{nearest(dim, swept)}; its axes are: {axes}"
        )


def _metrics_of(metrics: Sequence[str]) -> list[str]:
    names = names_of("metrics", metrics)
    known = ", ".join(METRICS)
    problems = [
        f"metrics: {quoted(m)} is not a metric{metric_meant(m)}; known: {known}"
        for m in names
        if m not in METRICS and m not in PREDICTIONS
    ]
    if problems:
        raise InputError(problems)
    return names
