"""Shares with their 95 % intervals over other valves and other days."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

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
        value, low, high = (f"{100 * x:.{decimals}f}" for x in self)
        return f"{value} % ({low} to {high})"


def share_of(holds: xr.DataArray, among: xr.DataArray | None = None) -> Share:
    """In how many of the valves, and days where there are any, something holds; the interval is Wilson's.

    Days of a valve are alike, and so are valves of a day: the number of cases is taken as what would have the variance
    that the means of the valves and those of the days show; where nothing varies, as that of the valves.

    among: the valves and days that count, all if None; of at least one.
    """
    values = holds.astype(float) if among is None else holds.astype(float).where(among.astype(bool))
    dims, cases, p = [dim for dim in CROSSED if dim in holds.dims], int(values.count()), float(values.mean())
    means = [values.mean([other for other in dims if other != dim]).dropna(dim) for dim in dims]
    spread = sum(float(m.var(ddof=1)) / m.size for m in means if m.size > 1)
    n = min(float(cases), p * (1.0 - p) / spread) if spread > 0.0 else float(max(m.size for m in means))
    middle, half = p + Z**2 / (2 * n), Z * np.sqrt(p * (1.0 - p) / n + Z**2 / (4 * n**2))
    low, high = ((middle + sign * half) / (1.0 + Z**2 / n) for sign in (-1, 1))
    return Share(p, abs(max(low, 0.0)), min(high, 1.0))
