"""Valves as they are: whether a neutral zone, stick-slip or a tight seat changes which remedy is better.

Each valve of a part of the population gets the gains that SIMC gives from a step of its own, with the imperfection in
place, and plain PI with the same imperfection is what its remedies are compared with.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import write_table
from studies.days import HEATING, kinds
from studies.remedies.front import MAIN
from studies.remedies.run import FRESH_DAYS, SIMC, of_remedies, on_days, picked, population, renamed
from studies.remedies.tables import LABELS, cell, pooled
from studies.robustness.best_pi import simc_gains

VALVES = 256
NEUTRAL_ZONE, SLIP_SHARE, LEAKAGE = 0.01, 0.3, 0.001
"""Of the stroke; slip jump over backlash; of the fully open flow."""
REMEDIES = (*MAIN[:-1], "hagglund_inverse", *MAIN[-1:])


def variants(loop: fc.Loop) -> dict[str, fc.Loop]:
    """The same valves as the model has them, and with one imperfection each, then with all."""
    jump = SLIP_SHARE * xr.DataArray(loop["backlash"])
    given: dict[str, dict[str, object]] = {
        "play alone": {},
        "neutral zone 1 %": {"neutral_zone": NEUTRAL_ZONE},
        "slip jump 0.3 X": {"slip_jump": jump},
        "leakage 0.1 %": {"leakage": LEAKAGE},
        "all three": {"neutral_zone": NEUTRAL_ZONE, "slip_jump": jump, "leakage": LEAKAGE},
    }
    return {name: loop.assign(**values) for name, values in given.items()}


def run(size: int) -> dict[str, dict[str, xr.Dataset]]:
    """Results by variant and kind of day."""
    found: dict[str, dict[str, xr.Dataset]] = {}
    for name, loop in variants(of_remedies(population(size), REMEDIES)).items():
        plain = picked(loop, controller=0)
        cooling, heating = (simc_gains(plain, kind) for kind in (kinds()[0], HEATING))
        found[name] = {
            kind: renamed(on_days(loop, heating if kind == HEATING else cooling, kind, FRESH_DAYS), SIMC)
            for kind in kinds()
        }
        print(f"ran valves: {name}", flush=True)
    return found


def rows(found: dict[str, dict[str, xr.Dataset]]) -> list[list[str]]:
    """For each remedy and variant: change of RMSE with its interval and its place among the remedies, and travel."""
    of_variants = {name: pooled(of_kinds) for name, of_kinds in found.items()}
    base = {name: ds.sel(controller=SIMC) for name, ds in of_variants.items()}
    means = {
        name: (ds.rmse / base[name].rmse - 1.0).mean(["sample", "day"]).to_series().rank()
        for name, ds in of_variants.items()
    }
    travels = {
        name: (ds.motor_travel.mean("day") / base[name].motor_travel.mean("day")).median("sample")
        for name, ds in of_variants.items()
    }
    first = np.median(base["play alone"].rmse), np.median(base["play alone"].motor_travel)
    alone = [
        f"{100 * float(b.rmse.median() / first[0]) - 100:+.0f} %, × {float(b.motor_travel.median() / first[1]):.2f}"
        for b in base.values()
    ]
    table = [["PI by SIMC, against that of play alone", *alone]]
    for remedy in REMEDIES[1:]:
        cells = (
            f"{cell(ds, remedy, SIMC)}, × {float(travels[name].sel(controller=remedy)):.2f}, "
            f"{int(means[name][remedy])}."
            for name, ds in of_variants.items()
        )
        table.append([LABELS[remedy], *cells])
    return table


def write(found: dict[str, dict[str, xr.Dataset]]) -> None:
    """Write the table of valves as they are."""
    ds = next(iter(next(iter(found.values())).values()))
    write_table(
        "remedies/remedies_valves",
        f"Valves as they are, gains of SIMC: mean change of RMSE against plain PI on the same valve (95 %), motor "
        f"travel of the median valve, place by RMSE; {ds.sizes['sample']} valves, {ds.sizes['day']} days of each kind",
        ["remedy", *found],
        rows(found),
    )
