"""The runs of ``wear.py``: every controller through every sequence of days, and what came of the gap."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.learning.learners_run import ONE, ROUND_OFF, TWENTY
from studies.wear.valves import PI, Sequence, controllers, days_of, growths, loops_of, rates, sequences

SEED = 20261122
FRESH = 7301
"""Of the first day."""
METRICS = (
    "rmse", "estimate_final", "backlash_final", "stem_travel", "motor_travel", "reversals", "coil_energy",
    "reheat_energy", "recool_energy", "hunts", "status",
)  # fmt: skip


class Run(NamedTuple):
    """What came of a sequence."""

    sequence: Sequence
    ds: xr.Dataset
    """Metrics over controller, sample, day."""
    plain: xr.Dataset
    """Of the plain PI whose gap does not grow."""
    first: xr.DataArray
    """Gap of the first day, fraction of stroke."""
    growth: xr.DataArray
    """That it was given, fraction of stroke in the year."""


def run(size: int | None = None, first: int = FRESH, chosen: list[str] | None = None) -> list[Run]:
    """Every controller on every sequence; ``size``: only so many valves; ``chosen``: only these sequences."""
    started, found = time.monotonic(), []
    for sequence in sequences(first):
        if chosen is None or sequence.name in chosen:
            found.append(lived(sequence, size))
            print(f"{sequence.name} after {time.monotonic() - started:.0f} s", flush=True)
    return found


def lived(sequence: Sequence, size: int | None = None) -> Run:
    """Every controller through a sequence.  The rate of wear of a valve follows from its travel under plain PI."""
    loop, days = loops_of(sequence, size), days_of(sequence)
    plain = _metrics(loop, days)
    growth = growths(loop) * (0.0 if sequence.in_steps or sequence.is_good else 1.0)
    loop = loop.assign(wear_rate=rates(growth, plain))
    found = [_metrics(loop.assign(**values), days) for values in controllers().values()]
    ds = xr.concat(found, xr.DataArray(list(controllers()), dims="controller", name="controller"))
    return Run(sequence, ds, plain, xr.DataArray(loop["backlash"]), growth)


def _metrics(loop: fc.Loop, days: fc.Boundary) -> xr.Dataset:
    ds = fc.simulate(loop, days, carry_over=True, seed=SEED)
    return ds[list(METRICS)].reset_coords(drop=True).assign_coords(day=np.arange(ds.sizes["day"]))


def wrong(run: Run, name: str) -> xr.DataArray:
    """Whether the estimate at the end of a day is off by over 20 % of the gap and 1 % of the stroke, or missing."""
    ds = run.ds.sel(controller=name)
    tolerance = np.maximum(TWENTY * ds.backlash_final, ONE) + ROUND_OFF
    return ~(abs(ds.estimate_final - ds.backlash_final) <= tolerance)


def change(run: Run, name: str, metric: str = "rmse") -> xr.DataArray:
    """By how much a metric of every valve and day differs from that under plain PI; as a share of it."""
    return run.ds[metric].sel(controller=name) / run.ds[metric].sel(controller=PI) - 1.0


def of_year(run: Run, name: str, metric: str) -> xr.DataArray:
    """The change of a metric summed over the days of the sequence, by valve, as a share of that under plain PI."""
    total = run.ds[metric].sum("day")
    return total.sel(controller=name) / total.sel(controller=PI) - 1.0


def grown(run: Run, name: str) -> xr.DataArray:
    """Growth of the gap from the first to the last day, fraction of stroke, by valve."""
    return run.ds.backlash_final.sel(controller=name).isel(day=-1) - run.first
