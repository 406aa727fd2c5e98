"""Differences within pairs of loops: their median with its interval, and how far they spread over the valves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

_RESAMPLES, _AT_ONCE = 1000, 20
_SEED = 20261122
"""Of the resamples: a summary says the same twice."""
_LEVEL = 0.95
_SPREAD = 0.05, 0.95


class Middle(NamedTuple):
    """Median of some values, its 95 % interval over the units, and what 5 and 95 % of the values stay below."""

    median: float
    low: float
    high: float
    q05: float
    q95: float
    n: int


def middle_of(values: xr.DataArray, unit: str = "sample") -> Middle:
    """The median and its bootstrap interval.

    Parameters
    ----------
    values
        Of pairs; NaN is left out.
    unit
        Dim whose labels are drawn anew, each with all that belongs to it; every value by itself if there is none.

    Returns
    -------
    Middle
        All NaN without a value; the interval is NaN with a single unit.
    """
    if unit in values.dims:
        rows = values.transpose(unit, ...).values.reshape(values.sizes[unit], -1)
    else:
        rows = values.values.reshape(-1, 1)
    rows = rows[np.isfinite(rows).any(axis=1)]
    if not rows.size:
        return Middle(np.nan, np.nan, np.nan, np.nan, np.nan, 0)
    low = high = np.nan
    if len(rows) > 1:
        draw, n = np.random.default_rng(_SEED), len(rows)
        median = np.nanmedian if np.isnan(rows).any() else np.median
        drawn = (rows[draw.integers(n, size=(_AT_ONCE, n))] for _ in range(_RESAMPLES // _AT_ONCE))
        medians = np.concatenate([median(part.reshape(_AT_ONCE, -1), axis=1) for part in drawn])
        low, high = np.quantile(medians, [0.5 - 0.5 * _LEVEL, 0.5 + 0.5 * _LEVEL])
    q05, q95 = np.nanquantile(rows, _SPREAD)
    n = int(np.isfinite(rows).sum())
    return Middle(float(np.nanmedian(rows)), float(low), float(high), float(q05), float(q95), n)
