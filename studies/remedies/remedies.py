"""Remedies for backlash against the best plain PI: error, travel and harm, on every kind of day.

``runs.py``, ``tables.py``: what does every remedy do behind the best gains of its valve, and behind those of SIMC?
``front.py``: and behind gains tuned for the remedy itself?  Here: and behind gains as somebody left them, and on valves
with a neutral zone, stick-slip or a tight seat?  All remedies of a valve see the same days and the same noise.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import change_in_words, pooled, write_table
from studies.days import HEATING, kinds
from studies.remedies import front, runs
from studies.remedies import tables as remedies_tables
from studies.remedies.front import MAIN, draw
from studies.remedies.runs import DRAWN, FRESH_DAYS, SIMC, drawn_kp, of_remedies, on_days, picked, population, renamed
from studies.remedies.tables import LABELS, backlash_rows, cost_rows
from studies.robustness.best_pi import simc_gains

FOUND_VALVES = 256
OF_FOUND = (
    "pi",
    "dead_band_025",
    "inverse_80_buffer",
    "inverse_95_small_buffer",
    "inverse_95_noise_buffer",
    "additive_95",
    "hagglund_inverse",
    "gradient",
    "learner_growing",
)


def run_found(size: int) -> dict[str, xr.Dataset]:
    """Results by kind of day; only the plant's gain comes from a step."""
    loop = of_remedies(population(size), OF_FOUND)
    plain = picked(loop, controller=0)
    gain = {heats: simc_gains(plain, HEATING if heats else kinds()[0]).plant_gain for heats in (False, True)}
    found = {}
    for kind in kinds():
        gains = xr.Dataset({"kp": drawn_kp(plain, kind), "plant_gain": gain[kind == HEATING]})
        found[kind] = renamed(on_days(loop, gains, kind, FRESH_DAYS), DRAWN)
    print("ran gains as found", flush=True)
    return found


def write_found(found: dict[str, xr.Dataset]) -> None:
    """Write the table of gains as found."""
    ds, first = pooled(found), next(iter(found.values()))
    backlash = xr.DataArray(picked(population(ds.sizes["sample"]), controller=0)["backlash"])
    good = {row[0]: row[1] for row in backlash_rows(found, DRAWN, backlash)}
    cost = {row[0]: row for row in cost_rows(found, DRAWN)}
    write_table(
        "remedies/remedies_found",
        f"RMSE with existing gains: mean change against plain PI with these gains (95 %); "
        f"{ds.sizes['sample']} valves, {first.sizes['day']} days of each kind",
        [
            "remedy",
            "all",
            "stepped",
            "without backlash, median",
            "over 1 % worse in",
            "motor travel, median",
            "hunting",
        ],
        (
            [
                LABELS[name],
                change_in_words(ds, name, DRAWN),
                change_in_words(found["stepped"], name, DRAWN),
                good[LABELS[name]],
                cost[LABELS[name]][2],
                cost[LABELS[name]][4],
                cost[LABELS[name]][9],
            ]
            for name in [DRAWN, *OF_FOUND[1:]]
        ),
    )


VALVES = 256
NEUTRAL_ZONE, SLIP_SHARE, LEAKAGE = 0.01, 0.3, 0.001
"""Of the stroke; slip jump over backlash; of the fully open flow."""
OF_VALVES = (*MAIN[:-1], "hagglund_inverse", *MAIN[-1:])


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


def run_valves(size: int) -> dict[str, dict[str, xr.Dataset]]:
    """Results by variant and kind of day."""
    found: dict[str, dict[str, xr.Dataset]] = {}
    for name, loop in variants(of_remedies(population(size), OF_VALVES)).items():
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
    for remedy in OF_VALVES[1:]:
        cells = (
            f"{change_in_words(ds, remedy, SIMC)}, × {float(travels[name].sel(controller=remedy)):.2f}, "
            f"{int(means[name][remedy])}."
            for name, ds in of_variants.items()
        )
        table.append([LABELS[remedy], *cells])
    return table


def write_valves(found: dict[str, dict[str, xr.Dataset]]) -> None:
    """Write the table of valves as they are."""
    ds = next(iter(next(iter(found.values())).values()))
    write_table(
        "remedies/remedies_valves",
        f"Valves with neutral zone, slip or leakage, SIMC gains: mean change of RMSE against plain PI on the same "
        f"valve (95 %), motor travel of the median valve, rank by RMSE; {ds.sizes['sample']} valves, {ds.sizes['day']} "
        "days of each kind",
        ["remedy", *found],
        rows(found),
    )


def sample() -> None:
    """The gains as found."""
    write_found(run_found(FOUND_VALVES))


def main(size: int | None = None) -> None:
    """Run everything, write the tables and draw the figure; ``size``: only so many valves."""
    plain = runs.picked(runs.population(size), controller=0)
    remedies_tables.write(*runs.run(size), backlash=xr.DataArray(plain["backlash"]))
    own, by_simc = front.run_front(size or front.VALVES)
    front.write_front(own, by_simc)
    draw(own, by_simc)
    write_found(run_found(size or FOUND_VALVES))
    write_valves(run_valves(size or VALVES))
