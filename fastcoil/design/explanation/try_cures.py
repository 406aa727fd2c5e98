"""The cures, simulated: one sweep on the given day."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Mask
from fastcoil.design.explanation.cures import AS_IS, DEAD_BAND, REPAIRED, Cure, with_cures
from fastcoil.design.explanation.operating_points import PointsOfDay
from fastcoil.design.explanation.predicted import Foretold
from fastcoil.design.theory.cycles import HUNTS_ABOVE
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import simulate
from fastcoil.model.metric_table import OFF, SETTLING_TIME, STATUS_OK

_POINTS = 43200
"""Most samples of a trace: one every 2 s of a day."""
PLAIN = 1.5
"""So many times as large a swing shows that a loop hunts here and not there."""
AS_FORETOLD = 0.7
"""Simulated over foretold swing from which the one counts as the other."""
WORSE, BETTER = 1.05, 0.95
"""RMSE relative to now from which a cure counts as worse, and up to which as better."""


def try_cures(loop: Loop, boundary: Boundary, cures: list[Cure], warm_up: int, seed: int) -> xr.Dataset:
    """Simulate every cure on one day: metrics and the trace T_sup, over ``cure``."""
    every = max(2, -(-boundary.n_steps // _POINTS))
    swept = with_cures(loop, cures)
    ds = simulate(
        swept, boundary, traces=["T_sup"], trace_interval=every, warm_up=warm_up, seed=seed, n_jobs=1,
        progress=False,
    )  # fmt: skip
    ds = ds.isel(day=0, drop=True) if "day" in ds.dims else ds
    return ds if "cure" in ds.dims else ds.expand_dims("cure")


def swings_at(points: PointsOfDay, boundary: Boundary, now: xr.Dataset) -> Array:
    """Simulated swing at each operating point, K: max - min of T_sup in settled seconds; NaN if there are none."""
    T_set = boundary.series["T_set"][0]
    seconds = np.arange(T_set.size)
    changed = np.flatnonzero(np.diff(T_set, prepend=T_set[0]))
    last = np.searchsorted(changed, seconds, side="right")
    since = seconds - np.where(last > 0, changed[last - 1] if changed.size else 0, -SETTLING_TIME)
    of_second = np.where(since >= SETTLING_TIME, points.of_second, -1)[now["elapsed_time"].values.astype(int)]
    T_sup = now["T_sup"].values
    seen = [T_sup[of_second == k] for k in range(points.size)]
    return np.array([np.ptp(T) if T.size else np.nan for T in seen])


def hunts_uncounted(foretold: Foretold, swings: Array, now: xr.Dataset) -> bool:
    """Whether a loop hunts although the metric does not count it, since it does at times only, or not regularly enough.

    At the operating points at which it is foretold to hunt, the simulated swings are, in the median, ``PLAIN`` times
    those elsewhere; or they are of the size foretold, ``AS_FORETOLD``, and above ``OFF``.
    """
    if now["hunts"] > 0 or not foretold.n_hunting:
        return False
    there, rest = (_median(swings[some]) for some in (foretold.hunting, foretold.elsewhere))
    expected = 2.0 * _median(foretold.cycles.amplitude[foretold.hunting])
    return there > PLAIN * rest or there > max(AS_FORETOLD * expected, OFF)


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def hunting(ds: xr.Dataset) -> Mask:
    """Which cures leave the loop hunting, as it is first: those whose simulated day hunts.

    Where that is not counted for the loop as it is, those that are foretold to hunt somewhere, too.
    """
    shown, told = ds["hunts"].values > 0, ds["n_hunting"].values > 0
    return np.asarray(shown | told if ds["uncounted"] else shown)


def verdict(ds: xr.Dataset, k: int) -> str:
    """What a cure did, in a few words; as it is first in ``ds``."""
    if ds["status"].values[k] != STATUS_OK:
        return "failed"
    before, after = hunting(ds)[[0, k]]
    with np.errstate(divide="ignore", invalid="ignore"):
        error, swing = (float(of[k] / of[0]) for of in (ds["rmse"].values, ds["hunting_swing"].values))
    if not before:
        if after:
            return "makes it hunt"
        return "worse" if error > WORSE else "better" if error < BETTER else "no gain"
    if not after:
        return "cures it, at a larger error" if error > WORSE else "cures it"
    return "still hunts, and worse" if swing > 1.1 else "still hunts, but less" if swing < 0.7 else "still hunts"


def recommended(ds: xr.Dataset, names: list[str]) -> int:
    """Which cure to take: of those that leave no hunting, neither simulated nor foretold, the one with the least RMSE.

    A cure whose margin stays too large comes after these, a dead band or a repaired valve last.  0 where the loop is
    good as it is, or where nothing helps.
    """
    error, margin = ds["rmse"].values, np.nan_to_num(ds["margin"].values)
    good = (ds["status"].values == STATUS_OK) & ~hunting(ds)
    if good[0]:
        good &= (error < BETTER * error[0]) & ~np.isin(names, REPAIRED)
    rank = np.where(np.isin(names, (DEAD_BAND, REPAIRED)), 2, np.where(margin > HUNTS_ABOVE, 1, 0))
    able = [k for k, name in enumerate(names) if good[k] and name != AS_IS]
    return min(able, key=lambda k: (rank[k], error[k]), default=0)
