"""Figures of a study: maps over two swept parameters, curves along one, dots for named alternatives.

Every function returns a matplotlib ``Figure`` that belongs to no window, so it works without a display.  It has a panel
for each metric, as many abreast as its width takes, and with ``by`` a row of them for each label of a dimension.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, names_of, number_of, text_of
from fastcoil.base.errors import InputError, nearest
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
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure


_PANEL = 3.2  # width of a panel where the figure may be as wide as it likes, inches
_NARROWEST = 2.2  # width in which a panel is still read, inches
_ABREAST = 3
_MILLIMETRES = 25.4
_MOST_ROWS = 6
ESTIMATES = ("estimate_ratio", "backlash_estimate")
_CONTROL = {**dict.fromkeys(ESTIMATES, 0.0), "learning_step": 0.0, "estimator": "none", "law": "pi"}
"""What a plain PI has: it assumes no backlash, and learns none."""
STANDARD_METRICS = ("rmse", "rmse_settled", "switch_frequency")
_OTHERS: Any = {"color": GREY, "lw": 0.8}
_ALTERNATIVES = 100  # more rows of names than this are no figure


class _Sheet:
    """A figure with its panels.  ``of``: what its panels show along their axes; ``width``: inches, None: any."""

    def __init__(self, ds: xr.Dataset, metrics: Sequence[str], by: str | None, width: float | None, *of: str) -> None:
        with checking() as check:
            check.unless_none(text_of, "by", by)
            self.abreast = check(panels_abreast, width)
        if by in of:
            raise InputError(f"{by} is named twice: choose two different axes")
        self.ds, self.metrics, self.by, self.width = ds, metrics, by, width
        self.rows = rows_of(ds, by)
        self.pooled = pooled_dims(ds["status"], *of, *([by] if by else []))

    def panels(self, height: float, *, one_row: bool = False, **options: Any) -> Figure:
        """The empty figure; ``height``: of a panel, inches."""
        from matplotlib.figure import Figure

        n, abreast = len(self.metrics), self.abreast
        rows, columns = (len(self.rows), n) if self.by or one_row else (-(-n // min(n, abreast)), min(n, abreast))
        if self.by and self.width is not None and n > abreast:
            raise InputError(
                f"a figure of {_MILLIMETRES * self.width:.0f} mm takes {abreast} panel{'s' * (abreast > 1)} abreast, "
                f"not one for each of {n} metrics: give fewer, or more width"
            )
        size = (_PANEL * max(columns, 2) if self.width is None else self.width, height * rows + 0.5)
        figure = Figure(figsize=size, layout="constrained")
        self.axes: np.ndarray = figure.subplots(rows, columns, squeeze=False, **options)
        self.panel = _PANEL if self.width is None else self.width / columns
        for unused in self.axes.flat[n * len(self.rows) :]:
            unused.remove()
        return figure

    def __iter__(self) -> Iterator[tuple[Axes, str, int | None, str]]:
        """Each panel with its metric, and the position and words of its row."""
        for k, (index, words) in enumerate(self.rows):
            for axes, metric in zip(self.axes[k] if self.by else self.axes.flat, self.metrics, strict=False):
                yield axes, metric, index, words

    @property
    def alike(self) -> np.ndarray:
        """The panels that share a scale, in rows."""
        alike: np.ndarray = self.axes.T if self.by else self.axes.reshape(-1, 1)
        return alike

    def is_lowest(self, axes: Axes) -> bool:
        """Whether a panel has the label of its column."""
        return not self.by or axes in self.axes[-1]

    def head(self, figure: Figure, *marks: str, more: str = "") -> Figure:
        """Write the title of the study, what is pooled and drawn, and how much of it failed."""
        words = describe(self.ds, self.pooled, *marks) + more + failed_in_words(self.ds)
        lines = [str(self.ds.attrs["title"])] if self.ds.attrs.get("title") else []
        figure.suptitle(wrapped("\n".join([*lines, words]), figure.get_figwidth(), 9))
        return figure


def panels_abreast(width: float | None) -> int:
    """How many panels stand side by side in a width from 1 to 60 inches."""
    if width is None:
        return _ABREAST
    width = number_of("width", width, "give the width in inches, from 1 to 60", least=1.0, most=60.0)
    return int(np.clip(width / _NARROWEST, 1, _ABREAST))


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
    sheet = _Sheet(ds, _check(ds, metrics, x=x, y=y), by, width, x, y)
    figure = sheet.panels(3.0)
    meshes: dict[str, list[QuadMesh]] = {}
    for axes, metric, index, words in sheet:
        part = ds[metric] if index is None else ds[metric].isel({by: index})
        shown = quantity_of_values(part)
        axes.set_title(wrapped("\n".join(filter(None, [words, shown.axis])), 0.8 * sheet.panel, 9))
        mesh = draw_map(axes, part, shown, x, y, sheet.panel)
        if mesh is not None:
            meshes.setdefault(metric, []).append(mesh)
            figure.colorbar(mesh, ax=axes)
    for alike in meshes.values():  # rows are compared
        limits = [mesh.get_clim() for mesh in alike]
        for mesh in alike:
            mesh.set_clim(min(low for low, _ in limits), max(high for _, high in limits))
    return sheet.head(figure, "Colour", "", "", more=exact_in_words(x, y))


@apply_style()
def bands(
    ds: xr.Dataset,
    x: str,
    by: str | None = None,
    metrics: Sequence[str] = STANDARD_METRICS,
    width: float | None = None,
) -> Figure:
    """Metrics along a swept parameter: median and 10–90 % band, or single lines, over all other dims.

    ``by``, ``width``: as of ``maps``; what ``by`` names is not pooled.
    """
    sheet = _Sheet(ds, _check(ds, metrics, x=x), by, width, x)
    shared: Any = {"sharex": "col", "sharey": "col"} if by else {}
    figure = sheet.panels(2.2 if by else 2.8, **shared)
    of_x = quantity_of(ds, x)
    along = of_x.factor * ds[x]
    for axes, metric, index, name in sheet:
        shown = quantity_of_values(ds[metric])
        part = values = shown.factor * ds[metric]
        if by and index is not None:
            part = values.isel({by: index})
            axes.set_title(wrapped(name, 0.8 * sheet.panel, 9), loc="left")
            rest = values.isel({by: [other for other, _ in sheet.rows if other != index]})
            axes.plot(along, rest.median([d for d in rest.dims if d not in (x, by)]).transpose(x, by), **_OTHERS)
        draw_curve(axes, along, part, label=name or None, color=BLUE)
        label(axes, of_x.axis if sheet.is_lowest(axes) else "", shown.axis, sheet.panel)
        mark_exact(axes, x)
        if "relative_to" in ds[metric].attrs:
            axes.axhline(0.0, color="black", lw=0.8)
        say_if_empty(axes, values)
    for alike in sheet.alike:
        from_zero(alike, "y")
    more = ("; grey: medians of the other rows" if by else "") + exact_in_words(x)
    return sheet.head(figure, "Line", "band", "thin lines", more=more)


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
    sheet, n = _Sheet(ds, metrics, by, width, dim), ds.sizes[dim]
    # beside the names there is room for one panel less
    shared: Any = {"sharex": "col"} if by else {}
    figure = sheet.panels(1.0 + 0.22 * n, one_row=width is None, sharey=True, **shared)
    for axes, metric, index, words in sheet:
        values = ds[metric] if index is None else ds[metric].isel({by: index})
        shown = quantity_of_values(values)
        draw_dots(axes, shown.factor * values, dim, BLUE)
        axes.set_title(wrapped(words, 0.9 * sheet.panel, 9), loc="left")
        if sheet.is_lowest(axes):
            axes.set_xlabel(wrapped(shown.axis, 0.8 * sheet.panel, 9))
        say_if_empty(axes, values)
    for alike in sheet.alike:
        from_zero(alike, "x")
    sheet.axes[0, 0].set_yticks(np.arange(n), [str(v) for v in ds[dim].values])
    sheet.axes[0, 0].set_ylim(n - 0.4, -0.6)
    return sheet.head(figure, "Dot", "line", "small dots")


def standard_figures(ds: xr.Dataset, width: float | None = None) -> dict[str, Callable[[], Figure]]:
    """What draws the figures that suit a study's dimensions, by file name without suffix; empty for a single scenario.

    A plain PI and an inverse are never pooled: what a figure does not show of them has rows of its own.  A row has as
    many metrics as fit into ``width``, inches.  Nothing is drawn, or imported to draw, before one of them is called.
    """
    check_result(ds)
    numeric, control = numeric_dims(ds["status"]), control_dims(ds)
    named = [str(d) for d in ds["status"].dims if d not in numeric and d in ds.coords and ds.sizes[d] > 1]
    of_row = [name for name in STANDARD_METRICS if name in ds][: panels_abreast(width)]

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


def rows_of(ds: xr.Dataset, by: str | None) -> list[tuple[int | None, str]]:
    """Position and words of the labels that get a row of panels each.

    Those are up to six names; of more names, and of numbers, the first, the middle and the last.
    """
    if by is None:
        return [(None, "")]
    dims = [str(d) for d in ds["status"].dims if d in ds.coords and ds.sizes[d] > 1]
    if by not in dims:
        known = ", ".join(dims)
        raise InputError(f"by = {quoted(by)} is no dimension of this study{nearest(by, dims)}; it has {known}")
    labels = ds[by].values
    if labels.dtype.kind == "f" and is_parameter(ds, by):
        texts = [quantity_of(ds, by).equals(float(label)) for label in labels]
        is_plain = (labels == 0.0) & (by in ESTIMATES)
        return [(k, f"{texts[k]}, plain PI" if is_plain[k] else texts[k]) for k in picked(labels.size)]
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
