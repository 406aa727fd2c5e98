"""Figures of a study: maps over two swept parameters, curves along one, dots for named alternatives.

Every function returns a matplotlib ``Figure`` that belongs to no window, so it works without a display.  It has a panel
for each metric, as many abreast as its width takes, and with ``by`` a row of them for each label of a dimension.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking
from fastcoil.base.errors import InputError, nearest
from fastcoil.base.errors import shown as quoted
from fastcoil.base.figures import BLUE, apply_style, wrapped
from fastcoil.deliver.figures import drawing
from fastcoil.loops.labels import label_in_words, plain_pi
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
    meshes: dict[Hashable, list[QuadMesh]] = defaultdict(list)

    def draw(axes: Axes, values: xr.DataArray) -> None:
        mesh = drawing.draw_map(axes, values, x, y)
        if mesh is not None:
            meshes[values.name].append(mesh)

    figure = _figure(ds, metrics, (x, y), draw, drawing.COLOUR, by, width, 3.0)
    for alike in meshes.values():  # rows are compared
        ends = [end for mesh in alike for end in mesh.get_clim()]
        for mesh in alike:
            mesh.set_clim(min(ends), max(ends))
    return figure


@apply_style()
def bands(
    ds: xr.Dataset, x: str, by: str | None = None, metrics: Sequence[str] = STANDARD_METRICS, width: float | None = None
) -> Figure:
    """Metrics along a swept parameter: median and 10–90 % band, or single lines, over all other dims.

    ``by``, ``width``: as of ``maps``; what ``by`` names is not pooled.
    """
    _check(ds, metrics, x=x)

    def draw(axes: Axes, values: xr.DataArray) -> None:
        drawing.draw_curve(axes, values, x, color=BLUE)

    return _figure(ds, metrics, (x,), draw, drawing.LINE, by, width, 2.4)


@apply_style()
def alternatives(
    ds: xr.Dataset, dim: str, metrics: Sequence[str] = STANDARD_METRICS, by: str | None = None,
    width: float | None = None,
) -> Figure:  # fmt: skip
    """Metrics of named alternatives: median and 10–90 % range, or single dots, over all other dims.

    ``by``, ``width``: as of ``bands``.
    """
    _check(ds, metrics)

    def draw(axes: Axes, values: xr.DataArray) -> None:
        drawing.draw_dots(axes, values, dim, BLUE)

    return _figure(ds, metrics, (dim,), draw, drawing.DOT, by, width, 1.0 + 0.22 * ds.sizes[dim], sharey=True)


def panels_abreast(width: float | None) -> int:
    """How many panels stand side by side in a width in inches."""
    return _ABREAST if width is None else int(np.clip(width / _NARROWEST, 1, _ABREAST))


def _figure(
    ds: xr.Dataset, metrics: Sequence[str], drawn: tuple[str, ...], draw: Callable[[Axes, xr.DataArray], None],
    marks: Sequence[str], by: str | None, width: float | None, height: float, *, sharey: bool = False,
) -> Figure:  # fmt: skip
    """A figure with a panel for each metric, and with ``by`` a row of them for each label.

    drawn: dimensions that a panel shows.  draw: draws values into a panel.  height: of a panel, inches.
    """
    from matplotlib.figure import Figure

    if by in drawn:
        raise InputError(f"{by} is named twice: choose two different axes")
    rows, n = rows_of(ds, by), len(metrics)
    columns = n if by else min(n, panels_abreast(width))
    inches = _PANEL * max(columns, 2) if width is None else width
    if by and inches < n * _NARROWEST:
        raise InputError(
            f"a figure of {_MILLIMETRES * inches:.0f} mm takes no {n} panels abreast: give fewer metrics, or more width"
        )
    panels = [
        (ds[metric] if index is None else ds[metric].isel({by: index}), words)
        for index, words in rows
        for metric in metrics
    ]
    n_rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(inches, height * n_rows + 0.5), layout="constrained")
    alike: Any = "col" if by else False
    axes = figure.subplots(n_rows, columns, squeeze=False, sharex=alike, sharey=sharey or alike).ravel()
    for unused in axes[len(panels) :]:
        unused.remove()
    for panel, (values, words) in zip(axes, panels, strict=False):
        draw(panel, values)
        panel.set_title(drawing.fitted(panel, words), loc="left")
        if by and not panel.get_subplotspec().is_last_row():
            panel.set_xlabel("")
    words = drawing.pooled_in_words(ds["status"], (*drawn, by), marks)
    words += drawing.left_out_in_words(ds, by, len(rows)) + drawing.failed_in_words(ds)
    figure.suptitle(wrapped("\n".join(filter(None, [str(ds.attrs.get("title", "")), words])), inches, 9))
    return figure


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

    Those are all of up to six; of more the first, the middle and the last.
    """
    if by is None:
        return [(None, "")]
    dims = [str(d) for d in ds["status"].dims if d in ds.coords and ds.sizes[d] > 1]
    drawing.check_dim("by", by, dims)
    chosen = drawing.picked(ds.sizes[by], _MOST_ROWS)
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
