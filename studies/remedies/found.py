"""Remedies behind the gains as somebody left them: what to take where nobody may retune the loop."""

from __future__ import annotations

import xarray as xr

from studies.common import write_table
from studies.days import HEATING, kinds
from studies.remedies.run import DRAWN, FRESH_DAYS, drawn_kp, of_remedies, on_days, picked, population, renamed
from studies.remedies.tables import LABELS, backlash_rows, cell, cost_rows, pooled
from studies.robustness.best_pi import simc_gains

VALVES = 256
REMEDIES = (
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


def run(size: int) -> dict[str, xr.Dataset]:
    """Results by kind of day; only the plant's gain comes from a step."""
    loop = of_remedies(population(size), REMEDIES)
    plain = picked(loop, controller=0)
    gain = {heats: simc_gains(plain, HEATING if heats else kinds()[0]).plant_gain for heats in (False, True)}
    found = {}
    for kind in kinds():
        gains = xr.Dataset({"kp": drawn_kp(plain, kind), "plant_gain": gain[kind == HEATING]})
        found[kind] = renamed(on_days(loop, gains, kind, FRESH_DAYS), DRAWN)
    print("ran gains as found", flush=True)
    return found


def write(found: dict[str, xr.Dataset]) -> None:
    """Write the table of gains as found."""
    ds, first = pooled(found), next(iter(found.values()))
    backlash = xr.DataArray(picked(population(ds.sizes["sample"]), controller=0)["backlash"])
    good = {row[0]: row[1] for row in backlash_rows(found, DRAWN, backlash)}
    cost = {row[0]: row for row in cost_rows(found, DRAWN)}
    write_table(
        "remedies/remedies_found",
        f"RMSE with the gains as found: mean change against plain PI with these gains (95 %); "
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
                cell(ds, name, DRAWN),
                cell(found["stepped"], name, DRAWN),
                good[LABELS[name]],
                cost[LABELS[name]][2],
                cost[LABELS[name]][4],
                cost[LABELS[name]][9],
            ]
            for name in [DRAWN, *REMEDIES[1:]]
        ),
    )
