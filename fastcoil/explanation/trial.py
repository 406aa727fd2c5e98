"""The cures, simulated: one sweep on the given day."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fastcoil.boundary import Boundary
from fastcoil.explanation.cures import AS_IS, DEAD_BAND, REPAIRED, Cure, with_cures
from fastcoil.explanation.foretold import HUNTS_ABOVE
from fastcoil.outputs import STATUS_OK
from fastcoil.simulation.loop import Loop
from fastcoil.simulation.simulate import simulate

_POINTS = 43200
"""Most samples of a trace: one every 2 s of a day."""
WORSE, BETTER = 1.05, 0.95
"""RMSE relative to now from which a cure counts as worse, and up to which as better."""


def try_cures(loop: Loop, boundary: Boundary, cures: list[Cure], warm_up: int, seed: int) -> xr.Dataset:
    """Simulate every cure on one day: metrics and the trace T_sup, over ``cure``."""
    every = max(2, -(-boundary.n_steps // _POINTS))
    swept = with_cures(loop, cures)
    ds = simulate(
        swept, boundary, traces=["T_sup"], trace_interval=every, warm_up=warm_up, seed=seed, n_jobs=1
    )  # fmt: skip
    ds = ds.isel(day=0, drop=True) if "day" in ds.dims else ds
    return ds if "cure" in ds.dims else ds.expand_dims("cure")


def verdict(ds: xr.Dataset, k: int) -> str:
    """What a cure did, in a few words; as it is first in ``ds``."""
    if int(ds["status"][k]) != STATUS_OK:
        return "failed"
    now, then = ds.isel(cure=0), ds.isel(cure=k)
    error = float(then["rmse"] / now["rmse"])
    if not now["hunts"] > 0:
        if then["hunts"] > 0:
            return "makes it hunt"
        return "worse" if error > WORSE else "better" if error < BETTER else "no gain"
    if not then["hunts"] > 0:
        return "cures it, at a larger error" if error > WORSE else "cures it"
    swing = float(then["hunting_swing"] / now["hunting_swing"])
    return "still hunts, and worse" if swing > 1.1 else "still hunts, but less" if swing < 0.7 else "still hunts"


def recommended(ds: xr.Dataset, names: list[str]) -> int:
    """Which cure to take: of those that leave no hunting, neither simulated nor foretold, the one with the least RMSE.

    A cure whose margin stays too large comes after these, a dead band or a repaired valve last.  0 where the loop is
    good as it is, or where nothing helps.
    """
    error, margin = ds["rmse"].values, np.nan_to_num(ds["margin"].values)
    good = (ds["status"].values == STATUS_OK) & (ds["hunts"].values == 0)
    if good[0]:
        good &= (error < BETTER * error[0]) & ~np.isin(names, REPAIRED)
    rank = np.where(np.isin(names, (DEAD_BAND, REPAIRED)), 2, np.where(margin > HUNTS_ABOVE, 1, 0))
    able = [k for k, name in enumerate(names) if good[k] and name != AS_IS]
    return min(able, key=lambda k: (rank[k], error[k]), default=0)
