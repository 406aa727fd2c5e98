"""A median and how its members scatter: a band if they are many, each of them if they are few; and words for it."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.loops.labels import is_parameter, quantity_of
from fastcoil.model.parameter_table import RESERVED_DIMS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BAND = (0.1, 0.9)
FEWEST_FOR_A_BAND = 5
"""Fewer members are drawn one by one: their percentiles would be interpolated between two or three numbers."""


def count(ds: xr.Dataset | xr.DataArray, pooled: Iterable[Any]) -> int:
    """How many members one point pools."""
    return int(np.prod([ds.sizes[d] for d in pooled], dtype=int))


def _band(values: xr.DataArray, pooled: list[Any]) -> tuple[xr.DataArray, xr.DataArray]:
    with warnings.catch_warnings():
        # where every member is NaN the band has a gap, which says enough
        warnings.filterwarnings("ignore", "All-NaN slice encountered", RuntimeWarning)
        low, high = values.quantile(BAND, pooled)
    return low, high


def draw_curve(axes: Axes, x: xr.DataArray, values: xr.DataArray, *, label: str | None = None, **look: Any) -> None:
    """Draw the median of ``values`` over all dims but that of ``x``, with a band, or with a thin line per member."""
    pooled = [d for d in values.dims if d not in x.dims]
    if count(values, pooled) >= FEWEST_FOR_A_BAND:
        low, high = _band(values, pooled)
        axes.fill_between(x, low, high, color=look["color"], alpha=0.2, lw=0)
    elif pooled:
        members = values.transpose(*x.dims, ...).values.reshape(x.size, -1)
        axes.plot(x, members, color=look["color"], lw=0.5, alpha=0.7)
    axes.plot(x, values.median(pooled), label=label, **look)


def draw_dots(axes: Axes, values: xr.DataArray, dim: str, color: str) -> None:
    """Draw the medians of ``values`` along ``dim`` as dots, with a line from 10 to 90 % or a small dot per member."""
    rows = np.arange(values.sizes[dim])
    pooled = [d for d in values.dims if d != dim]
    if count(values, pooled) >= FEWEST_FOR_A_BAND:
        low, high = _band(values, pooled)
        axes.hlines(rows, low, high, color=color, lw=1.0)
    elif pooled:
        for member in values.transpose(..., dim).values.reshape(-1, rows.size):
            axes.plot(member, rows, "o", color=color, ms=2.5, mfc="white", mew=0.7)
    axes.plot(values.median(pooled), rows, "o", color=color, ms=5)


def describe(ds: xr.Dataset | xr.DataArray, pooled: Iterable[Any], median: str, band: str, member: str) -> str:
    """Say over what a figure pools, and what its marks are: those of the median, of a band, of a single member."""
    pooled = [d for d in pooled if ds.sizes[d] > 1]
    if not pooled:
        return f"{median}: a single scenario"
    n = count(ds, pooled)
    over = " × ".join(_in_words(ds, str(d)) for d in pooled)
    if len(pooled) > 1 and not any(d in ds.coords and "pooled_as" in ds[d].attrs for d in pooled):
        over += f" = {n:,} scenarios"
    if not band:
        return f"{median}: median of {over}"
    if n >= FEWEST_FOR_A_BAND:
        return f"{median}: median of {over}; {band}: 10th to 90th percentile"
    return f"{median}: median of {over}; {member}: each of these"


def _in_words(ds: xr.Dataset | xr.DataArray, dim: str) -> str:
    """A pooled dim: how many of what, from where to where, and that the plain PI is among them."""
    size = ds.sizes[dim]
    if dim in ds.coords and "pooled_as" in ds[dim].attrs:  # groups differ in size
        return str(ds[dim].attrs["pooled_as"])
    if dim in RESERVED_DIMS:
        return f"{size} {dim}s"
    if not is_parameter(ds, dim) or dim not in ds.coords or ds[dim].dtype.kind not in "if":
        return f"{size} values of {dim.replace('_', ' ')}"
    shown = quantity_of(ds, dim)
    low, high = float(ds[dim].min()), float(ds[dim].max())
    words = f"{size} values of {shown.text} ({low * shown.factor:.3g} to {shown.number(high)}"
    if dim in ("estimate_ratio", "backlash_estimate") and low == 0.0:
        words += ", 0 being the plain PI"
    return words + ")"
