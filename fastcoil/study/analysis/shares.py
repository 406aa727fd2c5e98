"""Shares with their intervals over other valves and other days."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.text import percent

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
    p, means = float(values.mean()), _means(values)
    labels = max(m.size for m in means)
    low, high = interval(np.array(p), np.array(_variance(means)), int(values.count()), labels, Z)
    return Share(p, float(low), float(high))


def mean_of(values: xr.DataArray) -> tuple[float, float]:
    """The mean over valves and days, and half of its 95 % interval over others of both."""
    return float(values.mean()), Z * float(np.sqrt(_variance(_means(values))))


def _means(values: xr.DataArray) -> list[xr.DataArray]:
    """The means of the valves, and those of the days."""
    dims = [dim for dim in CROSSED if dim in values.dims]
    return [values.mean([other for other in dims if other != dim]).dropna(dim) for dim in dims]


def _variance(means: list[xr.DataArray]) -> float:
    """The variance of the mean of all."""
    return sum((float(m.var(ddof=1)) / m.size for m in means if m.size > 1), 0.0)


def interval(
    share: np.ndarray,
    variance: np.ndarray,
    cases: np.ndarray | int,
    labels: np.ndarray | int,
    quantile: np.ndarray | float,
) -> tuple[np.ndarray, np.ndarray]:
    """The interval of shares by Wilson's formula (1927, doi:10.1080/01621459.1927.10502953).

    Days of a valve are alike, and so are valves of a day: the number of cases is taken as what would have the variance
    that is seen; where nothing varies, as that of the labels.

    Parameters
    ----------
    share, variance
        The shares, and the variances of their means.
    cases
        How many cases each is of.
    labels
        How many valves, or days if they are more.
    quantile
        Of the standard normal or Student's distribution.

    Returns
    -------
    tuple
        Lower and upper ends.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing varies, or there is no case at all
        n = np.where(variance > 0.0, np.minimum(cases, share * (1.0 - share) / variance), labels)
        middle = share + quantile**2 / (2 * n)
        half = quantile * np.sqrt(share * (1.0 - share) / n + quantile**2 / (4 * n**2))
        low, high = ((middle + sign * half) / (1.0 + quantile**2 / n) for sign in (-1, 1))
    return abs(np.maximum(low, 0.0)), np.minimum(high, 1.0)
