"""Figures of a study: maps over two swept parameters, curves along one, dots for named alternatives.

Every function returns a matplotlib ``Figure`` that belongs to no window, so it works without a display.  It has a panel
for each metric, as many abreast as its width takes, and with ``by`` a row of them for each label of a dimension.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking
from fastcoil.base.errors import InputError, nearest
from fastcoil.base.errors import shown as quoted
from fastcoil.base.figures import BLUE, GREY, apply_style, wrapped
from fastcoil.deliver.figures import drawing
from fastcoil.loops.labels import label_in_words, plain_pi, quantity_of, quantity_of_values
from fastcoil.model.metric_table import METRICS, metric_meant
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
_ALTERNATIVES = 100  # more rows of names than this are no figure


class _Panel(NamedTuple):
    """values: of its metric, of all rows; row, words: its label of ``by``; lowest: whether it labels its column."""

    axes: Axes
    values: xr.DataArray
    row: int | None
    words: str
    lowest: bool


class _Sheet:
    """A figure with its panels.  of: dimensions that they show; height: of a panel; width: of the figure, inches."""

    def __init__(
        self, ds: xr.Dataset, metrics: Sequence[str], of: Sequence[str], by: str | None, width: float | None,
        height: float, *, one_row: bool = False, **shared: Any,
    ) -> None:  # fmt: skip
        from matplotlib.figure import Figure

        if by in of:
            raise InputError(f"{by} is named twice: choose two different axes")
        self.ds, self.by, self.rows = ds, by, rows_of(ds, by)
        self.pooled = drawing.pooled_dims(ds["status"], *of, by)
        n, abreast = len(metrics), panels_abreast(width)
        rows, columns = (len(self.rows), n) if by or one_row else (-(-n // min(n, abreast)), min(n, abreast))
        if by and width is not None and n > abreast:
            raise InputError(
                f"a figure of {_MILLIMETRES * width:.0f} mm takes {abreast} panel{'s' * (abreast > 1)} abreast, "
                f"not one for each of {n} metrics: give fewer, or more width"
            )
        size = (_PANEL * max(columns, 2) if width is None else width, height * rows + 0.5)
        self.figure = Figure(figsize=size, layout="constrained")
        axes = self.figure.subplots(rows, columns, squeeze=False, **shared)
        for unused in axes.flat[n * len(self.rows) :]:
            unused.remove()
        self.width = _PANEL if width is None else width / columns
        self.panels = [
            _Panel(panel, ds[metric], index, words, lowest=not by or k == len(self.rows) - 1)
            for k, (index, words) in enumerate(self.rows)
            for panel, metric in zip(axes[k] if by else axes.flat, metrics, strict=False)
        ]
        self.alike = axes.T if by else axes.reshape(-1, 1)
        """Panels that share a scale, in rows."""

    def head(self, *marks: str, more: str = "") -> Figure:
        """Write the title of the study, what is pooled and drawn, and how much of it failed."""
        left = "" if self.by is None else drawing.left_out_in_words(self.ds, self.by, len(self.rows))
        words = drawing.describe(self.ds, self.pooled, *marks) + left + more + drawing.failed_in_words(self.ds)
        lines = [str(self.ds.attrs["title"])] if self.ds.attrs.get("title") else []
        self.figure.suptitle(wrapped("\n".join([*lines, words]), self.figure.get_figwidth(), 9))
        return self.figure


def panels_abreast(width: float | None) -> int:
    """How many panels stand side by side in a width in inches."""
    return _ABREAST if width is None else int(np.clip(width / _NARROWEST, 1, _ABREAST))


@apply_style()
def maps(
    ds: xr.Dataset, x: str, y: str, metrics: Sequence[str] = STANDARD_METRICS, by: str | None = None,
    width: float | None = None,
) -> Figure:  # fmt: skip
    """Metrics over two swept parameters, one panel each: the median over all other dimensions.

    ``by``: a further dimension, with a row of panels for each of the labels that ``rows_of`` chooses.
    ``width``: of the figure, inches.
    """
    _check(ds, metrics, x=x, y=y)
    sheet = _Sheet(ds, metrics, (x, y), by, width, 3.0)
    meshes: dict[Any, list[QuadMesh]] = {}
    for axes, values, index, words, _ in sheet.panels:
        part = values if index is None else values.isel({by: index})
        of = quantity_of_values(part)
        axes.set_title(wrapped("\n".join(filter(None, [words, of.axis])), 0.8 * sheet.width, 9))
        mesh = drawing.median_map(axes, part, of, x, y, sheet.width)
        if mesh is not None:
            meshes.setdefault(values.name, []).append(mesh)
            sheet.figure.colorbar(mesh, ax=axes)
    for alike in meshes.values():  # rows are compared
        limits = [mesh.get_clim() for mesh in alike]
        for mesh in alike:
            mesh.set_clim(min(low for low, _ in limits), max(high for _, high in limits))
    return sheet.head("Colour", "", "", more=drawing.exact_in_words(x, y))


@apply_style()
def bands(
    ds: xr.Dataset, x: str, by: str | None = None, metrics: Sequence[str] = STANDARD_METRICS, width: float | None = None
) -> Figure:
    """Metrics along a swept parameter: median and 10–90 % band, or single lines, over all other dims.

    ``by``, ``width``: as of ``maps``; what ``by`` names is not pooled.
    """
    _check(ds, metrics, x=x)
    shared: Any = {"sharex": "col", "sharey": "col"} if by else {}
    sheet = _Sheet(ds, metrics, (x,), by, width, 2.2 if by else 2.8, **shared)
    of_x = quantity_of(ds, x)
    along = of_x.factor * ds[x]
    for axes, unscaled, index, words, lowest in sheet.panels:
        of = quantity_of_values(unscaled)
        part = values = of.factor * unscaled
        if index is not None:
            part = values.isel({by: index})
            axes.set_title(wrapped(words, 0.8 * sheet.width, 9), loc="left")
            others = values.isel({by: [other for other, _ in sheet.rows if other != index]})
            axes.plot(along, others.median(drawing.pooled_dims(others, x, by)).transpose(x, by), color=GREY, lw=0.8)
        drawing.curve(axes, along, part, label=words or None, color=BLUE)
        drawing.label_axes(axes, of_x.axis if lowest else "", of.axis, sheet.width)
        drawing.mark_exact(axes, x)
        if "relative_to" in unscaled.attrs:
            axes.axhline(0.0, color="black", lw=0.8)
        drawing.say_if_empty(axes, values)
    for alike in sheet.alike:
        drawing.from_zero(alike, "y")
    more = ("; grey: medians of the other rows" if by else "") + drawing.exact_in_words(x)
    return sheet.head("Line", "band", "thin lines", more=more)


@apply_style()
def alternatives(
    ds: xr.Dataset, dim: str, metrics: Sequence[str] = STANDARD_METRICS, by: str | None = None,
    width: float | None = None,
) -> Figure:  # fmt: skip
    """Metrics of named alternatives: median and 10–90 % range, or single dots, over all other dims.

    ``by``, ``width``: as of ``bands``.
    """
    _check(ds, metrics)
    n = ds.sizes[dim]
    shared: Any = {"sharex": "col"} if by else {}
    sheet = _Sheet(ds, metrics, (dim,), by, width, 1.0 + 0.22 * n, one_row=width is None, sharey=True, **shared)
    for axes, values, index, words, lowest in sheet.panels:
        part = values if index is None else values.isel({by: index})
        of = quantity_of_values(part)
        drawing.dots(axes, of.factor * part, dim, BLUE)
        axes.set_title(wrapped(words, 0.9 * sheet.width, 9), loc="left")
        if lowest:
            axes.set_xlabel(wrapped(of.axis, 0.8 * sheet.width, 9))
        drawing.say_if_empty(axes, part)
    for alike in sheet.alike:
        drawing.from_zero(alike, "x")
    first = sheet.panels[0].axes
    first.set_yticks(np.arange(n), [str(v) for v in ds[dim].values])
    first.set_ylim(n - 0.4, -0.6)
    return sheet.head("Dot", "line", "small dots")


def standard_figures(ds: xr.Dataset, width: float | None = None) -> dict[str, Callable[[], Figure]]:
    """What draws the figures that suit a study's dimensions, by file name without suffix; empty for a single scenario.

    A plain PI and an inverse are never pooled: what a figure does not show of them has rows of its own.  A row has as
    many metrics as fit into ``width``, inches.  Nothing is drawn, or imported to draw, before one of them is called.
    """
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

    Those are all of up to six; of more the first, the middle and the last, of estimates that of 100 % between.
    """
    if by is None:
        return [(None, "")]
    dims = [str(d) for d in ds["status"].dims if d in ds.coords and ds.sizes[d] > 1]
    drawing.check_dim("by", by, dims)
    chosen = drawing.picked(ds, by, _MOST_ROWS)
    is_plain, pi = (ds[by].values == 0.0) & (by in ESTIMATES), plain_pi(ds)
    return [(k, label_in_words(ds, by, k) + (f", {pi}" if is_plain[k] else "")) for k in chosen]


def control_dims(ds: xr.Dataset) -> list[str]:
    """Dimensions along which a plain PI is one of several controllers: a median over them would be of unlike things."""
    dims = [str(d) for d in ds["status"].dims if ds.sizes[d] > 1 and d not in CHANCE_DIMS]
    return [d for d in dims if d == "controller" or _has_plain_pi(ds, d)]


def _has_plain_pi(ds: xr.Dataset, dim: str) -> bool:
    """Whether some labels of a dimension, and not all, are a plain PI by what differs along it."""
    plain = [ds[n].values == value for n, value in _CONTROL.items() if n in ds.coords and ds[n].dims == (dim,)]
    alike = np.logical_and.reduce(plain) if plain else np.zeros(1, dtype=bool)
    return bool(alike.any() and not alike.all())


def _check(ds: xr.Dataset, metrics: Sequence[str], **axes: str | None) -> None:
    """Refuse axes that are not swept, together with metrics that the result does not have."""
    with checking() as check:
        if axes:
            check(drawing.swept_axes, ds["status"], **axes)
        check.problems += [
            f"metrics: {quoted(name)} is not in this result{metric_meant(name) or nearest(name, METRICS)}"
            for name in metrics
            if name not in ds
        ]
