"""Figures of a study: maps over two swept parameters, bands over all the rest.

Every function returns a matplotlib ``Figure`` that belongs to no window, so it works without a display.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.errors import InputError, nearest
from fastcoil.files import commit_written, storage_errors
from fastcoil.outputs import METRICS
from fastcoil.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STANDARD_METRICS = ("rmse", "rmse_settled", "switch_frequency")
_BAND = (0.1, 0.9)
_CURVES = 3
STYLE: Any = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "font.size": 9,
    "axes.titlesize": 10,
    "figure.dpi": 100,
    "savefig.dpi": 150,
    "svg.hashsalt": "fastcoil",
}
LINE_STYLES = ("-", "--", ":")
# dark to light in print, too
COLOURS = ("#1b3a5c", "#2a7f62", "#d9822b")


def numeric_dims(ds: xr.Dataset) -> list[str]:
    """Dimensions that are axes of a swept number, with at least two values."""
    return [
        str(d) for d in ds["status"].dims
        if d in PARAMETERS and d in ds.coords and ds[d].dtype.kind in "if" and ds.sizes[d] > 1
    ]  # fmt: skip


def label(name: str) -> str:
    """Axis label of a metric or parameter, with its unit."""
    output, parameter = METRICS.get(name), PARAMETERS.get(name)
    if output:
        unit, text = output.unit, output.long_name
    elif parameter:
        unit, text = parameter.unit, name.replace("_", " ")
    else:
        return name
    shown = {"1": "", "K-1": "1/K", "kg s-1": "kg/s", "kJ K-1": "kJ/K", "kW h": "kWh", "degC": "°C"}.get(unit, unit)
    return f"{text} [{shown}]" if shown else text


def maps(ds: xr.Dataset, x: str, y: str, metrics: Sequence[str] = STANDARD_METRICS) -> Figure:
    """Metrics over two swept parameters, one panel each: the median over all other dimensions."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    _check(ds, metrics, x, y)
    with rc_context(STYLE):
        figure = Figure(figsize=(4.2 * len(metrics), 3.6), layout="constrained")
        for axes, metric in zip(np.atleast_1d(figure.subplots(1, len(metrics), sharey=True)), metrics, strict=True):
            others = [d for d in ds[metric].dims if d not in (x, y)]
            values = ds[metric].median(others).transpose(y, x)
            if not np.isfinite(values).any():
                axes.text(0.5, 0.5, "no finite value", ha="center", transform=axes.transAxes)
                continue
            mesh = axes.pcolormesh(ds[x], ds[y], values, cmap="cividis", shading="nearest", rasterized=True)
            axes.grid(visible=False)
            figure.colorbar(mesh, ax=axes, label=label(metric))
            axes.set(xlabel=label(x), title=METRICS[metric].long_name)
            if {x, y} == {"backlash", "estimate_ratio"}:
                (axes.axvline if x == "estimate_ratio" else axes.axhline)(1.0, color="white", lw=0.8, ls="--")
        figure.axes[0].set_ylabel(label(y))
        figure.suptitle(_over(ds, x, y), fontsize=9)
    return figure


def bands(ds: xr.Dataset, x: str, by: str | None = None, metrics: Sequence[str] = STANDARD_METRICS) -> Figure:
    """Metrics along a swept parameter: median and 10–90 % band over all other dimensions.

    ``by``: a second swept parameter; a curve for its first, middle and last value instead of a band over it.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    _check(ds, metrics, x, *([by] if by else []))
    picked = np.unique(np.linspace(0, ds.sizes[by] - 1, _CURVES).round().astype(int)) if by else [None]
    with rc_context(STYLE):
        figure = Figure(figsize=(4.2 * len(metrics), 3.4), layout="constrained")
        for axes, metric in zip(np.atleast_1d(figure.subplots(1, len(metrics))), metrics, strict=True):
            for k, index in enumerate(picked):
                part = ds[metric] if index is None else ds[metric].isel({by: index})
                name = None if index is None else f"{label(str(by))} = {float(ds[by][index]):.3g}"
                _band(axes, part, x, name, k)
            axes.set(xlabel=label(x), ylabel=label(metric), title=METRICS[metric].long_name)
            axes.set_ylim(bottom=0.0)
            if x == "estimate_ratio":
                axes.axvline(1.0, color="0.5", lw=0.8, ls="--")
        if by:
            figure.axes[0].legend(frameon=False, fontsize=8)
        figure.suptitle(_over(ds, x, *([by] if by else []), band=True), fontsize=9)
    return figure


def _band(axes: Axes, part: xr.DataArray, x: str, name: str | None, k: int) -> None:
    others = [d for d in part.dims if d != x]
    colour = COLOURS[k % len(COLOURS)]
    if others:
        low, high = part.quantile(_BAND[0], others), part.quantile(_BAND[1], others)
        axes.fill_between(part[x], low, high, color=colour, alpha=0.18, lw=0)
    axes.plot(part[x], part.median(others), color=colour, ls=LINE_STYLES[k % len(LINE_STYLES)], label=name)


def alternatives(ds: xr.Dataset, dim: str, metrics: Sequence[str] = STANDARD_METRICS) -> Figure:
    """Metrics of named alternatives: median and 10–90 % range over all other dimensions."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(4.2 * len(metrics), 1.2 + 0.25 * ds.sizes[dim]), layout="constrained")
        rows = np.arange(ds.sizes[dim])
        for axes, metric in zip(np.atleast_1d(figure.subplots(1, len(metrics), sharey=True)), metrics, strict=True):
            others = [d for d in ds[metric].dims if d != dim]
            middle = ds[metric].median(others)
            spread = abs(ds[metric].quantile(list(_BAND), others) - middle)
            axes.errorbar(middle, rows, xerr=spread, fmt="o", color=COLOURS[0], ms=4, lw=1)
            axes.set(xlabel=label(metric), title=METRICS[metric].long_name)
        figure.axes[0].set_yticks(rows, [str(v) for v in ds[dim].values])
        figure.axes[0].invert_yaxis()
    return figure


def standard_figures(ds: xr.Dataset) -> dict[str, Figure]:
    """The figures that suit a study's dimensions, by file name without suffix; empty for a single scenario."""
    numeric = numeric_dims(ds)
    named = [str(d) for d in ds["status"].dims if d not in numeric and d in ds.coords and ds.sizes[d] > 1]
    figures = {}
    if len(numeric) >= 2:
        y, x = numeric[:2]
        figures["maps"] = maps(ds, x, y)
        figures["bands"] = bands(ds, x, by=y)
    elif numeric:
        figures["bands"] = bands(ds, numeric[0])
    figures |= {dim: alternatives(ds, dim) for dim in named if ds[dim].dtype.kind in "OUST"}
    return figures


def write(figures: dict[str, Figure], folder: Path) -> list[Path]:
    """Write figures as PNG; returns their paths.

    Raises
    ------
    StorageError
        If one cannot be written; nothing half-written is left behind.
    """
    with storage_errors(folder, "made"):
        folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        paths.append(folder / f"{name}.png")
        commit_written(paths[-1], partial(figure.savefig, format="png", metadata={"Software": "fastcoil"}))
    return paths


def _over(ds: xr.Dataset, *shown: str, band: bool = False) -> str:
    others = [
        f"{ds.sizes[d]} {d}s" if not str(d).endswith("s") else str(d) for d in ds["status"].dims if d not in shown
    ]
    if not others:
        return ""
    return f"median{' and 10–90 % band' if band else ''} over {' × '.join(others)}"


def _check(ds: xr.Dataset, metrics: Sequence[str], *dims: str) -> None:
    problems = [
        f"{m} is not a metric{nearest(m, METRICS)}; known: {', '.join(METRICS)}" for m in metrics if m not in METRICS
    ]
    swept = numeric_dims(ds)
    problems += [
        f"{d} is not a swept number of this study{nearest(d, swept)}; its axes are: {', '.join(swept) or 'none'}"
        for d in dict.fromkeys(dims)
        if d not in swept
    ]
    problems += [f"{d} is named twice: choose two different axes" for d in dict.fromkeys(dims) if dims.count(d) > 1]
    if problems:
        raise InputError(problems)
