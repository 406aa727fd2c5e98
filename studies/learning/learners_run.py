"""The runs of ``learners.py``, and what is counted of them: right estimates, and loops that get worse."""

from __future__ import annotations

import time
from functools import cache
from typing import NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.study.analysis.paired import Share, share_of
from fastcoil.study.file.spec import read_study
from studies.days import HEATING, STEPPED
from studies.learning.learners_conditions import GOOD, STUDY, Condition, conditions
from studies.robustness.best_pi import simc_gains

PI, KNOWN, KNOWN_STROKE = "pi", "fixed_95", "identify_stroke"
METRICS = ("rmse", "rmse_settled", "motor_travel", "estimate_final", "time_identified", "status")
TWENTY, ONE = 0.2, 0.01
"""Right is what lies within 20 % of the backlash or, where the study says so, 1 % of the stroke."""
ROUND_OFF = 1e-9
HARM, WORSE = 0.01, 0.02
"""Rise of the RMSE of a loop that counts on a good valve, and on one with backlash."""


class Run(NamedTuple):
    """What came of a condition."""

    condition: Condition
    ds: xr.Dataset
    backlash: xr.DataArray

    @property
    def is_good(self) -> bool:
        """Whether the valves have no backlash."""
        return self.condition.name.startswith(GOOD)


@cache
def controllers() -> dict[str, dict[str, object]]:
    """The rows of the study: parameters by name."""
    return read_study(STUDY).tables["cases"]["controller"]  # type: ignore[no-any-return]


def run(size: int | None = None) -> list[Run]:
    """Every controller under every condition; ``size``: only so many loops and valves."""
    started, found = time.monotonic(), []
    for condition in conditions(size):
        ds = tried(condition)
        backlash = xr.DataArray(condition.loop["backlash"]).broadcast_like(ds.rmse.isel(controller=0, day=0, drop=True))
        found.append(Run(condition, ds, backlash))
        print(f"{condition.name} after {time.monotonic() - started:.0f} s", flush=True)
    return found


def tried(condition: Condition) -> xr.Dataset:
    """Metrics of every controller under a condition; the plant's gain comes from a step of the command."""
    gain = simc_gains(condition.loop, HEATING if condition.kind == HEATING else STEPPED).plant_gain
    loop, days = condition.loop.assign(plant_gain=gain), condition.days()
    stroke = {KNOWN_STROKE: {"identify_stroke_time": loop["stroke_time"]}}
    found = [
        fc.simulate(loop.assign(**values | stroke.get(name, {})), days)[list(METRICS)].reset_coords(drop=True)
        for name, values in controllers().items()
    ]
    names = list(controllers())
    return xr.concat(found, xr.DataArray(names, dims="controller", name="controller"))


def fails(run: Run, name: str, *, one: float = ONE) -> xr.DataArray:
    """Whether the last estimate of a day is wrong; one of NaN is.  one: what is always right, of the stroke."""
    tolerance = np.maximum(TWENTY * run.backlash, one) + ROUND_OFF
    return ~(abs(run.ds.estimate_final.sel(controller=name) - run.backlash) <= tolerance)


def change(run: Run, name: str, metric: str = "rmse") -> xr.DataArray:
    """By how much a metric of every loop, the mean of its days, differs from that of its plain PI; as a share of it."""
    of_loop = run.ds[metric].mean("day")
    return of_loop.sel(controller=name) / of_loop.sel(controller=PI) - 1.0


def harmed(run: Run, name: str) -> Share:
    """The share of loops that are worse than plain PI by more than may be."""
    return share_of(change(run, name) > (HARM if run.is_good else WORSE))
