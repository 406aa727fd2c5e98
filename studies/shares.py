"""Shares and means over crossed valves and days, with their intervals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.text import percent
from fastcoil.study.analysis.paired import interval

Z = 1.96
CROSSED = ("sample", "day")
"""Every valve meets every day."""


class Share(NamedTuple):
    """A share and its interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return self.written(0)

    def written(self, decimals: int) -> str:
        """In per cent."""
        return percent(*self, decimals=decimals)


def share_of(holds: xr.DataArray, among: xr.DataArray | None = None) -> Share:
    """In how many of the valves, and days where there are any, something holds, with its 95 % interval.

    The variance is that of the means of the valves and of the means of the days, see ``interval``.

    among: the valves and days that count, all if None; of at least one.
    """
    values = holds.astype(float) if among is None else holds.astype(float).where(among.astype(bool))
    p, (variance, labels) = float(values.mean()), _crossed(values)
    low, high = interval(np.array(p), np.array(variance), int(values.count()), labels, Z)
    return Share(p, float(low), float(high))


def mean_of(values: xr.DataArray) -> tuple[float, float]:
    """The mean over valves and days, and half of its 95 % interval over others of both."""
    return float(values.mean()), Z * float(np.sqrt(_crossed(values)[0]))


def _crossed(values: xr.DataArray) -> tuple[float, int]:
    """The variance of the mean, of the means of valves and of those of days, and the larger number of them."""
    dims = [dim for dim in CROSSED if dim in values.dims]
    means = [values.mean([other for other in dims if other != dim]).dropna(dim) for dim in dims]
    variance = sum((float(m.var(ddof=1)) / m.size for m in means if m.size > 1), 0.0)
    return variance, max(m.size for m in means)
