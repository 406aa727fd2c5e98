"""Panels on a page: as many abreast as its width takes, a row of them for each label of a dimension.

Figures of a study: maps over two swept parameters, curves along one, dots for named alternatives.

Every function returns a matplotlib ``Figure`` that belongs to no window, so it works without a display.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, names_of, number_of, text_of
from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.base.errors import shown as quoted
from fastcoil.base.figures import BLUE, GREY, apply_style, wrapped
from fastcoil.deliver.figures.axes import (
    describe,
    draw_curve,
    draw_dots,
    draw_map,
    exact_in_words,
    failed_in_words,
    from_zero,
    label,
    mark_exact,
    picked,
    pooled_dims,
    say_if_empty,
)
from fastcoil.loops.dataset import check_result
from fastcoil.loops.labels import is_parameter, quantity_of, quantity_of_values
from fastcoil.model.metric_table import METRICS, PREDICTIONS, metric_meant
from fastcoil.model.parameter_table import CHANCE_DIMS
from fastcoil.study.analysis.selected import numeric_dims

if TYPE_CHECKING:
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure


_PANEL = 3.2  # width of a panel where the figure may be as wide as it likes, inches
_NARROWEST = 2.2  # width in which a panel is still read, inches
_ABREAST = 3
_MILLIMETRES = 25.4
_MOST_ROWS = 6
_CONTROL = {
    "backlash_estimate": 0.0,
    "estimate_ratio": 0.0,
    "learning_step": 0.0,
    "estimator": "none",
    "law": "pi",
}
"""What a plain PI has: it assumes no backlash, and learns none."""


class Page(NamedTuple):
    """width: of the figure, inches; None: as wide as its panels want."""

    width: float | None

    @property
    def abreast(self) -> int:
        """How many panels stand side by side."""
        return _ABREAST if self.width is None else int(np.clip(self.width / _NARROWEST, 1, _ABREAST))

    def panel(self, columns: int) -> float:
        """Width of a panel, inches."""
        return _PANEL if self.width is None else self.width / columns

    def grid(self, n: int) -> tuple[int, int]:
        """Rows and columns of ``n`` panels that follow each other."""
        columns = min(n, self.abreast)
        return -(-n // columns), columns

    def row(self, n: int) -> int:
        """The columns of ``n`` panels that belong into one row."""
        if self.width is not None and n > self.abreast:
            raise InputError(
                f"a figure of {_MILLIMETRES * self.width:.0f} mm takes {self.abreast} panel"
                f"{'s' * (self.abreast > 1)} abreast, not one for each of {n} metrics: give fewer, or more width"
            )
        return n

    def figure(self, rows: int, columns: int, height: float, **options: Any) -> tuple[Figure, np.ndarray]:
        """Panels of one width, all of the same height."""
        from matplotlib.figure import Figure

        size = (_PANEL * max(columns, 2) if self.width is None else self.width, height * rows + 0.5)
        figure = Figure(figsize=size, layout="constrained")
        return figure, figure.subplots(rows, columns, squeeze=False, **options)


def page_of(width: float | None) -> Page:
    """A page of a width in inches."""
    if width is None:
        return Page(None)
    return Page(number_of("width", width, "give the width in inches, from 1 to 60", least=1.0, most=60.0))


def rows_of(ds: xr.Dataset, by: str | None) -> list[tuple[int | None, str]]:
    """Position and words of the labels that get a row of panels each.

    Those are up to six names; of more names, and of numbers, the first, the middle and the last.
    """
    if by is None:
        return [(None, "")]
    dims = [str(d) for d in ds["status"].dims if d in ds.coords and ds.sizes[d] > 1]
    if by not in dims:
        raise InputError(f"by = {shown(by)} is no dimension of this study{nearest(by, dims)}; it has {', '.join(dims)}")
    labels = ds[by].values
    if labels.dtype.kind == "f" and is_parameter(ds, by):
        of = quantity_of(ds, by)
        return [(k, of.equals(float(labels[k])) + _plain(by, labels[k])) for k in picked(labels.size)]
    if labels.dtype.kind in "if":
        return [(k, f"{by} = {labels[k]}") for k in picked(labels.size)]
    chosen = range(labels.size) if labels.size <= _MOST_ROWS else picked(labels.size)
    return [(k, str(labels[k])) for k in chosen]


def control_dims(ds: xr.Dataset) -> list[str]:
    """Dimensions along which a plain PI is one of several controllers: a median over them would be of unlike things."""
    dims = [str(d) for d in ds["status"].dims if ds.sizes[d] > 1 and d not in CHANCE_DIMS]
    return [d for d in dims if d == "controller" or _has_plain_pi(ds, d)]


def _has_plain_pi(ds: xr.Dataset, dim: str) -> bool:
    """Whether some labels of a dimension, and not all, are a plain PI by what differs along it."""
    plain = [ds[n].values == value for n, value in _CONTROL.items() if n in ds.coords and ds[n].dims == (dim,)]
    alike = np.logical_and.reduce(plain) if plain else np.zeros(1, dtype=bool)
    return bool(alike.any() and not alike.all())


def _plain(by: str, label: float) -> str:
    return ", plain PI" if by in ("estimate_ratio", "backlash_estimate") and label == 0.0 else ""


STANDARD_METRICS = ("rmse", "rmse_settled", "switch_frequency")
_OTHERS: Any = {"color": GREY, "lw": 0.8}
_ALTERNATIVES = 100  # more rows of names than this are no figure


@apply_style()
def maps(
    ds: xr.Dataset,
    x: str,
    y: str,
    metrics: Sequence[str] = STANDARD_METRICS,
    by: str | None = None,
    width: float | None = None,
) -> Figure:
    """Metrics over two swept parameters, one panel each: the median over all other dimensions.

    ``by``: a further dimension, with a row of panels for each name, or for its first, middle and last value.
    ``width``: of the figure, inches.
    """
    metrics = _check(ds, metrics, x=x, y=y)
    rows, page = _layout(ds, by, width, x, y)
    grid = (len(rows), page.row(len(metrics))) if by else page.grid(len(metrics))
    figure, panels = page.figure(*grid, 3.0)
    panel = page.panel(grid[1])
    meshes: dict[str, list[QuadMesh]] = {metric: [] for metric in metrics}
    for k, (index, words) in enumerate(rows):
        part = ds if index is None else ds.isel({by: index})
        for axes, metric in zip(panels[k] if by else panels.flat, metrics, strict=False):
            shown = quantity_of_values(part[metric])
            axes.set_title(wrapped("\n".join(filter(None, [words, shown.axis])), 0.8 * panel, 9))
            mesh = draw_map(axes, part[metric], shown, x, y, panel)
            if mesh is not None:
                meshes[metric].append(mesh)
                figure.colorbar(mesh, ax=axes)
    for alike in meshes.values():  # rows are compared
        limits = [mesh.get_clim() for mesh in alike]
        for mesh in alike:
            mesh.set_clim(min(low for low, _ in limits), max(high for _, high in limits))
    _remove_empty(panels, len(metrics) * len(rows))
    pooled = pooled_dims(ds["status"], x, y, *([by] if by else []))
    _head(figure, ds, describe(ds, pooled, "Colour", "", "") + exact_in_words(x, y))
    return figure


@apply_style()
def bands(
    ds: xr.Dataset,
    x: str,
    by: str | None = None,
    metrics: Sequence[str] = STANDARD_METRICS,
    width: float | None = None,
) -> Figure:
    """Metrics along a swept parameter: median and 10–90 % band, or single lines, over all other dims.

    ``by``: a further dimension; a row of panels for each name, or for its first, middle and last value, instead of
    pooling it.  ``width``: of the figure, inches.
    """
    metrics = _check(ds, metrics, x=x)
    rows, page = _layout(ds, by, width, x)
    grid = (len(rows), page.row(len(metrics))) if by else page.grid(len(metrics))
    shared: Any = {"sharex": "col", "sharey": "col"} if by else {}
    figure, panels = page.figure(*grid, 2.2 if by else 2.8, **shared)
    of_x = quantity_of(ds, x)
    along = of_x.factor * ds[x]
    for k, (index, name) in enumerate(rows):
        for axes, metric in zip(panels[k] if by else panels.flat, metrics, strict=False):
            shown = quantity_of_values(ds[metric])
            part = values = shown.factor * ds[metric]
            if by and index is not None:
                part = values.isel({by: index})
                axes.set_title(wrapped(name, 0.8 * page.panel(grid[1]), 9), loc="left")
                rest = values.isel({by: [other for other, _ in rows if other != index]})
                axes.plot(along, rest.median([d for d in rest.dims if d not in (x, by)]).transpose(x, by), **_OTHERS)
            draw_curve(axes, along, part, label=name or None, color=BLUE)
            label(axes, of_x.axis if not by or k == len(rows) - 1 else "", shown.axis, page.panel(grid[1]))
            mark_exact(axes, x)
            if "relative_to" in ds[metric].attrs:
                axes.axhline(0.0, color="black", lw=0.8)
            say_if_empty(axes, values)
    _remove_empty(panels, len(metrics) * len(rows))
    for alike in panels.T if by else panels.reshape(-1, 1):
        from_zero(alike, "y")
    words = describe(ds, pooled_dims(ds["status"], x, *([by] if by else [])), "Line", "band", "thin lines")
    _head(figure, ds, words + ("; grey: medians of the other rows" if by else "") + exact_in_words(x))
    return figure


@apply_style()
def alternatives(
    ds: xr.Dataset,
    dim: str,
    metrics: Sequence[str] = STANDARD_METRICS,
    by: str | None = None,
    width: float | None = None,
) -> Figure:
    """Metrics of named alternatives: median and 10–90 % range, or single dots, over all other dims.

    ``by``, ``width``: as of ``bands``.
    """
    with checking() as check:
        check(check_result, ds)
        check(text_of, "dim", dim)
        metrics = check(_metrics_of, metrics)
    named = [str(d) for d in ds["status"].dims if d in ds.coords]
    if dim not in named:
        known = ", ".join(named) or "none"
        raise InputError(f"dim = {quoted(dim)} is no dimension of this study{nearest(dim, named)}; it has {known}")
    n, (rows, page) = ds.sizes[dim], _layout(ds, by, width, dim)
    # beside the names there is room for one panel less
    grid = (len(rows), page.row(len(metrics))) if by or width is None else page.grid(len(metrics))
    shared: Any = {"sharex": "col"} if by else {}
    figure, panels = page.figure(*grid, 1.0 + 0.22 * n, sharey=True, **shared)
    for k, (index, words) in enumerate(rows):
        for axes, metric in zip(panels[k] if by else panels.flat, metrics, strict=False):
            values = ds[metric] if index is None else ds[metric].isel({by: index})
            shown = quantity_of_values(values)
            draw_dots(axes, shown.factor * values, dim, BLUE)
            axes.set_title(wrapped(words, 0.9 * page.panel(grid[1]), 9), loc="left")
            if not by or k == len(rows) - 1:
                axes.set_xlabel(wrapped(shown.axis, 0.8 * page.panel(grid[1]), 9))
            say_if_empty(axes, values)
    _remove_empty(panels, len(metrics) * len(rows))
    for alike in panels.T if by else panels.reshape(-1, 1):
        from_zero(alike, "x")
    panels[0, 0].set_yticks(np.arange(n), [str(v) for v in ds[dim].values])
    panels[0, 0].set_ylim(n - 0.4, -0.6)
    _head(figure, ds, describe(ds, pooled_dims(ds["status"], dim, *([by] if by else [])), "Dot", "line", "small dots"))
    return figure


def standard_figures(ds: xr.Dataset, width: float | None = None) -> dict[str, Callable[[], Figure]]:
    """What draws the figures that suit a study's dimensions, by file name without suffix; empty for a single scenario.

    A plain PI and an inverse are never pooled: what a figure does not show of them has rows of its own.  A row has as
    many metrics as fit into ``width``, inches.  Nothing is drawn, or imported to draw, before one of them is called.
    """
    check_result(ds)
    numeric, control = numeric_dims(ds["status"]), control_dims(ds)
    named = [str(d) for d in ds["status"].dims if d not in numeric and d in ds.coords and ds.sizes[d] > 1]
    of_row = [name for name in STANDARD_METRICS if name in ds][: page_of(width).abreast]

    def unlike(*shown: str) -> str | None:
        return next((d for d in control if d not in shown), None)

    def drawn(draw: Callable[..., Figure], *axes: str, by: str | None = None) -> Callable[[], Figure]:
        metrics = of_row if by else [name for name in STANDARD_METRICS if name in ds]
        return partial(draw, ds, *axes, by=by, metrics=metrics, width=width)

    figures: dict[str, Callable[[], Figure]] = {}
    if len(numeric) >= 2:
        swept = [d for d in numeric if d in control]
        y, x = numeric[:2] if not swept or {*numeric[:2]} & {*swept} else (numeric[0], swept[0])
        figures["maps"] = drawn(maps, x, y, by=unlike(x, y))
        figures["bands"] = drawn(bands, x, by=unlike(x) or y)
    elif numeric:
        figures["bands"] = drawn(bands, numeric[0], by=unlike(numeric[0]))
    for dim in named:
        by = unlike(dim)
        if ds[dim].dtype.kind in "OUST" and ds.sizes[dim] * len(rows_of(ds, by)) <= _ALTERNATIVES:
            figures[dim] = drawn(alternatives, dim, by=by)
    return figures


def _layout(
    ds: xr.Dataset, by: str | None, width: float | None, *shown: str
) -> tuple[list[tuple[int | None, str]], Page]:
    """The rows of panels and the page; raises as ``rows_of`` and ``page_of``."""
    with checking() as check:
        check.unless_none(text_of, "by", by)
        page = check(page_of, width)
    if by in shown:
        raise InputError(f"{by} is named twice: choose two different axes")
    return rows_of(ds, by), page


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
