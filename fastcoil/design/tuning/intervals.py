"""Measures with their intervals over other valves and days."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array
from fastcoil.design.tuning.measures import Measure
from fastcoil.loops.labels import quantity

EDGES = ("value", "low", "high")
CHANGE = "change"
_LEVEL = 0.95
_DRAWS = 400


def with_intervals(
    cases: Mapping[str, Array], measures: Sequence[Measure], tunings: Sequence[str], seed: int
) -> xr.Dataset:
    """Measures along ``tuning`` and ``edge`` from metrics (tuning, day, valve, replicate).

    The interval is that of the bootstrap: valves and days are drawn anew, each on their own, since every valve meets
    every day (Owen 2007, doi:10.1214/07-AOAS122); all tunings get the same draws, so that ``change``, that of the first
    measure against the first tuning, is one of pairs.  A single day shows no scatter between days, and the interval
    then holds none; a single valve on a single day has no interval: NaN.
    """
    some = next(iter(cases.values()))
    n, days, valves = some.shape[:3]
    rng = np.random.default_rng([seed, 3])
    n_draws = 1 if days == valves == 1 else _DRAWS
    draws = [(rng.integers(0, days, days), rng.integers(0, valves, valves)) for _ in range(n_draws)]
    ds = xr.Dataset(coords={"tuning": list(tunings), "edge": list(EDGES)})
    drawn: dict[str, Array] = {}
    for measure in measures:
        values = cases[measure.metric]
        drawn[measure.name] = np.stack([measure.of(values[:, d][:, :, v].reshape(n, -1)) for d, v in draws], axis=1)
        found = _edges(measure.of(values.reshape(n, -1)), drawn[measure.name])
        attrs = {"long_name": measure.words, "units": measure.unit}
        ds[measure.name] = (("tuning", "edge"), found, attrs)
    goal = measures[0]
    value = ds[goal.name].values[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):  # of something infinite or 0 there is no share
        change = _edges(value / value[0] - 1.0, drawn[goal.name] / drawn[goal.name][:1] - 1.0)
    words = f"{quantity(goal.metric).text} against that of {tunings[0]}, as a share"
    ds[CHANGE] = (("tuning", "edge"), change, {"long_name": words, "units": "1"})
    return ds


def _edges(value: Array, drawn: Array) -> Array:
    """Value and interval, (n, 3), from values (n,) and draws (n, n_draws), by order: some may be infinite."""
    tails = (0.5 - 0.5 * _LEVEL, 0.5 + 0.5 * _LEVEL)
    if drawn.shape[1] < _DRAWS:
        return np.stack([value, np.full_like(value, np.nan), np.full_like(value, np.nan)], axis=1)
    low, high = (np.quantile(drawn, tail, axis=1, method="nearest") for tail in tails)
    return np.stack([value, low, high], axis=1)
