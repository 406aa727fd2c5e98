"""Tables of remedies: changes of error with their intervals, what they cost, and harm on good valves."""

from __future__ import annotations

import numpy as np
import xarray as xr

from studies.common import change_in_words, failures_in_words, format_spread, pool_days, write_table
from studies.remedies.runs import BASELINE, SIMC

REMEDY_LABELS = {
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
HARM_SHARE = 0.01  # share of the error, above which a remedy counts as harm


def ordered_remedies(ds: xr.Dataset) -> list[str]:
    """The remedies of a result in the order of the tables."""
    return [name for name in REMEDY_LABELS if name in ds.controller.values]


def error_rows(by_kind: dict[str, xr.Dataset], baseline: str) -> list[list[str]]:
    """A row for each remedy: the change of RMSE on each kind of day, and on all; the last row is what it changes."""
    datasets = [*by_kind.values(), pool_days(by_kind)]
    size_row = [
        "(RMSE of plain PI, median)",
        *(f"{float(ds.rmse.sel(controller=baseline).median()):.3f} K" for ds in datasets),
    ]
    return [
        *(
            [REMEDY_LABELS[name], *(change_in_words(ds, name, baseline) for ds in datasets)]
            for name in ordered_remedies(datasets[0])
        ),
        size_row,
    ]


def cost_rows(by_kind: dict[str, xr.Dataset], baseline: str) -> list[list[str]]:
    """A row for each remedy: spread over single valves, and cost for the motor, over all kinds of days."""
    ds = pool_days(by_kind)
    base, table = ds.sel(controller=baseline), []
    for name in ordered_remedies(ds):
        remedy_ds = ds.sel(controller=name)
        error_ratio, settled_ratio, travel_ratio = (
            remedy_ds[m].mean("day") / base[m].mean("day") for m in ("rmse", "rmse_settled", "motor_travel")
        )
        table.append(
            [
                REMEDY_LABELS[name],
                format_spread(error_ratio),
                f"{float((error_ratio > 1.0 + HARM_SHARE).mean()):.0%}",
                f"{100 * float(settled_ratio.median()) - 100:+.0f} %",
                f"× {float(travel_ratio.median()):.2f}",
                f"× {float(travel_ratio.quantile(0.95)):.1f}",
                f"{float(remedy_ds.motor_travel.median()):.1f}",
                f"× {float(remedy_ds.reversals.sum() / base.reversals.sum()):.2f}",
                f"{float(remedy_ds.share_off.mean()):.1%}",
                f"{float(remedy_ds.hunts.mean()):.1%}",
            ]
        )
    return table


COST_HEAD = [
    "remedy", "RMSE: 5 %, median, 95 % of the valves", "over 1 % worse in", "settled RMSE, median",
    "motor travel, median", "travel, 95 % of the valves", "strokes in 7.5 h, median", "reversals",
    "time beyond 0.5 K", "hunting",
]  # fmt: skip


def backlash_rows(by_kind: dict[str, xr.Dataset], baseline: str, backlash: xr.DataArray) -> list[list[str]]:
    """Median change of RMSE by true backlash, over all kinds of days; 0 shows the harm."""
    error = pool_days(by_kind).rmse.mean("day")
    relative = error / error.sel(controller=baseline) - 1.0
    table = []
    for name in ordered_remedies(pool_days(by_kind)):
        of_remedy = relative.sel(controller=name)
        cells = (of_remedy.isel(sample=(backlash == x).values) for x in np.unique(backlash))
        table.append([REMEDY_LABELS[name], *(f"{100 * float(part.median()):+.0f} %" for part in cells)])
    return table


def write_tables(
    best_by_kind: dict[str, xr.Dataset],
    simc_by_kind: dict[str, xr.Dataset],
    edges: dict[str, float],
    backlash: xr.DataArray,
) -> None:
    """Write the tables of ``remedies.py``; ``edges``: share of the valves whose best gains lie at the grid's edge."""
    edge_text = ", ".join(
        f"{share:.0%} {'heating' if kind == 'heating' else 'cooling'}" for kind, share in edges.items()
    )
    for table_name, by_kind, baseline, notes in (
        ("remedies", best_by_kind, BASELINE, f"; at the edge of the grid of gains: {edge_text}"),
        ("remedies_simc", simc_by_kind, SIMC, ""),
    ):
        first_ds, sizes = next(iter(by_kind.values())), backlash.isel(sample=slice(0, None))
        sizes = sizes.isel(sample=slice(0, first_ds.sizes["sample"]))
        sizes_text = f"{first_ds.sizes['sample']:,} valves and loops, {first_ds.sizes['day']} days of each kind"
        gains_text = "the best gains of each valve's plain PI" if baseline == BASELINE else "the gains of SIMC"
        write_table(
            f"remedies/{table_name}",
            f"RMSE with {gains_text}: mean change against plain PI with these gains (95 % over valves and days); "
            f"{sizes_text} "
            f"({failures_in_words(by_kind.values())}{notes})",
            ["remedy", *by_kind, "all"],
            error_rows(by_kind, baseline),
        )
        write_table(
            f"remedies/{table_name}_cost",
            f"Remedies with {gains_text} on all kinds of days: single valves, motor and hunting; {sizes_text}",
            COST_HEAD,
            cost_rows(by_kind, baseline),
        )
        write_table(
            f"remedies/{table_name}_by_backlash",
            f"Remedies with {gains_text} by true backlash: median change of RMSE on all kinds of days; {sizes_text}",
            ["remedy", *(f"{x:.0%}" for x in np.unique(sizes))],
            backlash_rows(by_kind, baseline, sizes),
        )
