"""What backlash costs: whether it raises power, demand and the cost of energy, as the paper's introduction has it.

Valves and loops that the studies of hunting have not seen run without and with a gap, under plain PI as it was found,
PI with the gains of SIMC, and an inverse of 95 % of the gap, on days of every kind.  ``fc.cost`` values them.  Run
with ``python -m studies cost``; ``energy_cost_tables.py`` writes the tables.
"""

from __future__ import annotations

import time

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.cost.tables import write_by_backlash, write_claim, write_remedies, write_sums
from studies.days import CONSTANT, HEATING, kinds, of_kind
from studies.hunting.loops import acting, valves
from studies.robustness.best_pi import simc_gains

SEED = 16401
FRESH_DAYS = range(16411, 16421)
BACKLASH = (0.0, 0.02, 0.05, 0.07, 0.10, 0.15)
AS_FOUND, SIMC, INVERSE = "PI as found", "PI by SIMC", "inverse of 95 %"
BUFFER = 0.0025
"""Of the inverse, fraction of stroke."""
NOISE = (0.0, 0.05)
"""Limits of what is drawn, K."""
KEPT = (*("coil_energy", "coil_peak_power", "reheat_energy", "recool_energy"), "motor_travel", "share_off", "hunts")


def loops(seed: int, size: int, kind: str) -> fc.Loop:
    """Valves and loops along ``sample``, with every gap, under every controller."""
    noise = np.random.default_rng([seed, 7]).uniform(*NOISE, size)
    loop = acting(valves(seed, size), kind).assign(noise_std=("sample", noise), backlash=0.0)
    # a step of the command finds the plant, and the gap is no part of it
    found = simc_gains(loop, HEATING if kind == HEATING else CONSTANT)
    names = xr.DataArray([AS_FOUND, SIMC, INVERSE], dims="controller", name="controller")
    gains = {
        name: xr.concat([xr.DataArray(loop[name]), found[name], xr.DataArray(loop[name])], names)
        for name in ("kp", "ti")
    }
    return loop.assign(
        backlash=list(BACKLASH),
        estimate_ratio=xr.DataArray([0.0, 0.0, 0.95], dims="controller"),
        buffer=xr.DataArray([1e-9, 1e-9, BUFFER], dims="controller"),
        **gains,
    )


def of_days(seed: int, size: int, kind: str) -> xr.Dataset:
    """Metrics on fresh days of a kind: (day, sample, controller, backlash)."""
    ds = fc.simulate(loops(seed, size, kind), of_kind(kind, FRESH_DAYS), seed=seed)
    return ds[[*KEPT, "status"]]


def main(size: int = 384) -> None:
    """Run every kind of day and write the tables."""
    began = time.monotonic()
    found = {}
    for kind in kinds():
        found[kind] = of_days(SEED, size, kind)
        print(f"ran {kind} after {time.monotonic() - began:.0f} s", flush=True)
    write_claim(found)
    write_sums(found)
    write_by_backlash(found)
    write_remedies(found)
