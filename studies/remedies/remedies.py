"""Remedies for backlash against the best plain PI: error, travel and harm, on every kind of day.

``runs.py``, ``tables.py``: what does every remedy do behind the best gains of its valve, and behind those of SIMC?
``front.py``: and behind gains tuned for the remedy itself?  Here: and behind gains as somebody left them, and on valves
with a neutral zone, stick-slip or a tight seat?  All remedies of a valve see the same days and the same noise.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import change_in_words, pool_days, write_table
from studies.days import HEATING, kinds
from studies.remedies import front, runs
from studies.remedies import tables as remedies_tables
from studies.remedies.front import MAIN_REMEDIES, draw
from studies.remedies.runs import (
    AS_FOUND,
    FRESH_DAYS,
    SIMC,
    kp_as_found,
    population,
    rename_plain_pi,
    select_loop,
    select_remedies,
    simulate_days,
)
from studies.remedies.tables import REMEDY_LABELS, backlash_rows, cost_rows
from studies.robustness.best_pi import simc_gains

FOUND_VALVES = 256
FOUND_REMEDIES = (
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


def run_existing_gains(size: int) -> dict[str, xr.Dataset]:
    """Results by kind of day; only the plant's gain comes from a step."""
    loop = select_remedies(population(size), FOUND_REMEDIES)
    plain = select_loop(loop, controller=0)
    plant_gains = {
        is_heating: simc_gains(plain, HEATING if is_heating else kinds()[0]).plant_gain for is_heating in (False, True)
    }
    by_kind = {}
    for kind in kinds():
        gains = xr.Dataset({"kp": kp_as_found(plain, kind), "plant_gain": plant_gains[kind == HEATING]})
        by_kind[kind] = rename_plain_pi(simulate_days(loop, gains, kind, FRESH_DAYS), AS_FOUND)
    print("ran gains as found", flush=True)
    return by_kind


def write_existing_gains(by_kind: dict[str, xr.Dataset]) -> None:
    """Write the table of gains as found."""
    ds, first_ds = pool_days(by_kind), next(iter(by_kind.values()))
    backlash = xr.DataArray(select_loop(population(ds.sizes["sample"]), controller=0)["backlash"])
    change_without_backlash = {row[0]: row[1] for row in backlash_rows(by_kind, AS_FOUND, backlash)}
    cost_cells = {row[0]: row for row in cost_rows(by_kind, AS_FOUND)}
    write_table(
        "remedies/remedies_found",
        f"RMSE with existing gains: mean change against plain PI with these gains (95 %); "
        f"{ds.sizes['sample']} valves, {first_ds.sizes['day']} days of each kind",
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
                REMEDY_LABELS[name],
                change_in_words(ds, name, AS_FOUND),
                change_in_words(by_kind["stepped"], name, AS_FOUND),
                change_without_backlash[REMEDY_LABELS[name]],
                cost_cells[REMEDY_LABELS[name]][2],
                cost_cells[REMEDY_LABELS[name]][4],
                cost_cells[REMEDY_LABELS[name]][9],
            ]
            for name in [AS_FOUND, *FOUND_REMEDIES[1:]]
        ),
    )


VALVES = 256
NEUTRAL_ZONE, SLIP_SHARE, LEAKAGE = 0.01, 0.3, 0.001
"""Of the stroke; slip jump over backlash; of the fully open flow."""
VALVE_REMEDIES = (*MAIN_REMEDIES[:-1], "hagglund_inverse", *MAIN_REMEDIES[-1:])


def variants(loop: fc.Loop) -> dict[str, fc.Loop]:
    """The same valves as the model has them, and with one imperfection each, then with all."""
    jump = SLIP_SHARE * xr.DataArray(loop["backlash"])
    parameters_by_variant: dict[str, dict[str, object]] = {
        "play alone": {},
        "neutral zone 1 %": {"neutral_zone": NEUTRAL_ZONE},
        "slip jump 0.3 X": {"slip_jump": jump},
        "leakage 0.1 %": {"leakage": LEAKAGE},
        "all three": {"neutral_zone": NEUTRAL_ZONE, "slip_jump": jump, "leakage": LEAKAGE},
    }
    return {name: loop.assign(**values) for name, values in parameters_by_variant.items()}


def run_imperfect_valves(size: int) -> dict[str, dict[str, xr.Dataset]]:
    """Results by variant and kind of day."""
    by_variant: dict[str, dict[str, xr.Dataset]] = {}
    for name, loop in variants(select_remedies(population(size), VALVE_REMEDIES)).items():
        plain = select_loop(loop, controller=0)
        cooling, heating = (simc_gains(plain, kind) for kind in (kinds()[0], HEATING))
        by_variant[name] = {
            kind: rename_plain_pi(simulate_days(loop, heating if kind == HEATING else cooling, kind, FRESH_DAYS), SIMC)
            for kind in kinds()
        }
        print(f"ran valves: {name}", flush=True)
    return by_variant


def variant_rows(by_variant: dict[str, dict[str, xr.Dataset]]) -> list[list[str]]:
    """For each remedy and variant: change of RMSE with its interval and its place among the remedies, and travel."""
    pooled_by_variant = {name: pool_days(by_kind) for name, by_kind in by_variant.items()}
    base = {name: ds.sel(controller=SIMC) for name, ds in pooled_by_variant.items()}
    ranks = {
        name: (ds.rmse / base[name].rmse - 1.0).mean(["sample", "day"]).to_series().rank()
        for name, ds in pooled_by_variant.items()
    }
    median_travels = {
        name: (ds.motor_travel.mean("day") / base[name].motor_travel.mean("day")).median("sample")
        for name, ds in pooled_by_variant.items()
    }
    reference = np.median(base["play alone"].rmse), np.median(base["play alone"].motor_travel)
    pi_cells = [
        f"{100 * float(pi_ds.rmse.median() / reference[0]) - 100:+.0f} %, × "
        f"{float(pi_ds.motor_travel.median() / reference[1]):.2f}"
        for pi_ds in base.values()
    ]
    table = [["PI by SIMC, against that of play alone", *pi_cells]]
    for remedy in VALVE_REMEDIES[1:]:
        cells = (
            f"{change_in_words(ds, remedy, SIMC)}, × {float(median_travels[name].sel(controller=remedy)):.2f}, "
            f"{int(ranks[name][remedy])}."
            for name, ds in pooled_by_variant.items()
        )
        table.append([REMEDY_LABELS[remedy], *cells])
    return table


def write_imperfect_valves(by_variant: dict[str, dict[str, xr.Dataset]]) -> None:
    """Write the table of valves with imperfections."""
    ds = next(iter(next(iter(by_variant.values())).values()))
    write_table(
        "remedies/remedies_valves",
        f"Valves with neutral zone, slip or leakage, SIMC gains: mean change of RMSE against plain PI on the same "
        f"valve (95 %), motor travel of the median valve, rank by RMSE; {ds.sizes['sample']} valves, {ds.sizes['day']} "
        "days of each kind",
        ["remedy", *by_variant],
        variant_rows(by_variant),
    )


def sample() -> None:
    """Write the table of existing gains."""
    write_existing_gains(run_existing_gains(FOUND_VALVES))


def main(size: int | None = None) -> None:
    """Run everything, write the tables and draw the figure; ``size``: only so many valves."""
    plain = runs.select_loop(runs.population(size), controller=0)
    remedies_tables.write_tables(*runs.run(size), backlash=xr.DataArray(plain["backlash"]))
    by_own_gains, by_simc = front.run_front(size or front.VALVES)
    front.write_front(by_own_gains, by_simc)
    draw(by_own_gains, by_simc)
    write_existing_gains(run_existing_gains(size or FOUND_VALVES))
    write_imperfect_valves(run_imperfect_valves(size or VALVES))
