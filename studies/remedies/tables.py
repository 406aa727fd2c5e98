"""Tables of remedies: changes of error with their intervals, what they cost, and harm on good valves."""

from __future__ import annotations

import numpy as np
import xarray as xr

from studies.common import change_in_words, failures, pooled, spread, write_table
from studies.remedies.runs import BASELINE, SIMC

LABELS = {
    "PI as found": "PI as found",
    BASELINE: BASELINE,
    SIMC: SIMC,
    "pi": "PI",
    "half_kp": "PI, half its kp",
    "faster": "PI, kp and ti × 2",
    "dead_band_025": "PI, dead band 0.25 K",
    "dead_band_050": "PI, dead band 0.5 K",
    "inverse_80_buffer": "inverse 80 %, buffer 1 %",
    "inverse_95": "inverse 95 %, no buffer",
    "inverse_95_small_buffer": "inverse 95 %, buffer 0.25 %",
    "inverse_95_buffer": "inverse 95 %, buffer 1 %",
    "inverse_95_noise_buffer": "inverse 95 %, buffer by noise",
    "inverse_95_dead_band": "inverse 95 %, dead band 0.25 K",
    "inverse_120_buffer": "inverse 120 %, buffer 1 %",
    "additive_95": "additive 95 %",
    "smooth_95": "smooth inverse 95 %",
    "hagglund_additive": "Hägglund, additive",
    "hagglund_inverse": "Hägglund, inverse",
    "gradient": "gradient",
    "learner_growing": "learner (growing)",
    "own_rule": "a rule of your own",
    "no_backlash": "(a valve without backlash)",
}
"""The names of the remedies for readers, in the order of the tables."""
NO_CHANGE = 0.01
"""Share of the error, above which a remedy counts as harm."""


def ordered(ds: xr.Dataset) -> list[str]:
    """The remedies of a result in the order of the tables."""
    return [name for name in LABELS if name in ds.controller.values]


def error_rows(found: dict[str, xr.Dataset], baseline: str) -> list[list[str]]:
    """A row for each remedy: the change of RMSE on each kind of day, and on all; the last row is what it changes."""
    of_kinds = [*found.values(), pooled(found)]
    size = [
        "(RMSE of plain PI, median)",
        *(f"{float(ds.rmse.sel(controller=baseline).median()):.3f} K" for ds in of_kinds),
    ]
    return [
        *([LABELS[name], *(change_in_words(ds, name, baseline) for ds in of_kinds)] for name in ordered(of_kinds[0])),
        size,
    ]


def cost_rows(found: dict[str, xr.Dataset], baseline: str) -> list[list[str]]:
    """A row for each remedy: what becomes of single valves, and what the motor pays; all kinds of days alike."""
    ds = pooled(found)
    base, table = ds.sel(controller=baseline), []
    for name in ordered(ds):
        d = ds.sel(controller=name)
        of_valves, settled, travel = (
            d[m].mean("day") / base[m].mean("day") for m in ("rmse", "rmse_settled", "motor_travel")
        )
        table.append(
            [
                LABELS[name],
                spread(of_valves),
                f"{float((of_valves > 1.0 + NO_CHANGE).mean()):.0%}",
                f"{100 * float(settled.median()) - 100:+.0f} %",
                f"× {float(travel.median()):.2f}",
                f"× {float(travel.quantile(0.95)):.1f}",
                f"{float(d.motor_travel.median()):.1f}",
                f"× {float(d.reversals.sum() / base.reversals.sum()):.2f}",
                f"{float(d.share_off.mean()):.1%}",
                f"{float(d.hunts.mean()):.1%}",
            ]
        )
    return table


COST = [
    "remedy", "RMSE: 5 %, median, 95 % of the valves", "over 1 % worse in", "settled RMSE, median",
    "motor travel, median", "travel, 95 % of the valves", "strokes in 7.5 h, median", "reversals",
    "time beyond 0.5 K", "hunting",
]  # fmt: skip


def backlash_rows(found: dict[str, xr.Dataset], baseline: str, backlash: xr.DataArray) -> list[list[str]]:
    """Median change of RMSE by true backlash, over all kinds of days; 0 shows the harm."""
    error = pooled(found).rmse.mean("day")
    relative = error / error.sel(controller=baseline) - 1.0
    table = []
    for name in ordered(pooled(found)):
        of_remedy = relative.sel(controller=name)
        cells = (of_remedy.isel(sample=(backlash == x).values) for x in np.unique(backlash))
        table.append([LABELS[name], *(f"{100 * float(part.median()):+.0f} %" for part in cells)])
    return table


def write(
    best: dict[str, xr.Dataset], simc: dict[str, xr.Dataset], edges: dict[str, float], backlash: xr.DataArray
) -> None:
    """Write the tables of ``remedies.py``; ``edges``: share of the valves whose best gains lie at the grid's edge."""
    at_edge = ", ".join(f"{share:.0%} {'heating' if kind == 'heating' else 'cooling'}" for kind, share in edges.items())
    for of, found, baseline, notes in (
        ("remedies", best, BASELINE, f"; at the edge of the grid of gains: {at_edge}"),
        ("remedies_simc", simc, SIMC, ""),
    ):
        first, sizes = next(iter(found.values())), backlash.isel(sample=slice(0, None))
        sizes = sizes.isel(sample=slice(0, first.sizes["sample"]))
        where = f"{first.sizes['sample']:,} valves and loops, {first.sizes['day']} days of each kind"
        gains = "the best gains of each valve's plain PI" if baseline == BASELINE else "the gains of SIMC"
        write_table(
            f"remedies/{of}",
            f"RMSE with {gains}: mean change against plain PI with these gains (95 % over valves and days); {where} "
            f"({failures(found.values())}{notes})",
            ["remedy", *found, "all"],
            error_rows(found, baseline),
        )
        write_table(
            f"remedies/{of}_cost",
            f"Remedies with {gains} on all kinds of days: single valves, motor and hunting; {where}",
            COST,
            cost_rows(found, baseline),
        )
        write_table(
            f"remedies/{of}_by_backlash",
            f"Remedies with {gains} by true backlash: median change of RMSE on all kinds of days; {where}",
            ["remedy", *(f"{x:.0%}" for x in np.unique(sizes))],
            backlash_rows(found, baseline, sizes),
        )
