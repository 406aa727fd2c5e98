"""What the rules for the buffer cost and bring in ``buffer.py``, and the loops on which no buffer fits."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.buffer.lower import lower_scales, no_buffer_fits
from studies.buffer.rule import LOWER_SCALE, PER_HOUR, UPPER_SCALE
from studies.buffer.run import ALLOWED, BY_TREND, LOWER, PI, RULES, SHIPPED, SHIPPED_RATIO, SLOWER, UPPER, Runs, Valves
from studies.buffer.upper import upper_scales
from studies.common import write_table
from studies.days import HEATING
from studies.remedies.run import LEAST_TRAVEL
from studies.remedies.tables import NO_CHANGE, pooled

CROSSING = (SHIPPED, BY_TREND, LOWER, UPPER, SLOWER)
"""Rules that are shown where the bounds cross."""
DRAWS = 400
"""Draws of the bootstrap over valves."""


def change(ds: xr.Dataset, rule: str, baseline: str, metric: str = "rmse") -> str:
    """Mean change of a metric in pairs against another rule, with its interval over valves and days.

    A travel below ``LEAST_TRAVEL`` counts as that: a valve that stays open has none to divide by.
    """
    if rule == baseline:
        return "0"
    pair = ds[[metric, "status"]].sel(controller=[baseline, rule])
    if metric == "motor_travel":
        pair = pair.assign(motor_travel=pair.motor_travel.clip(LEAST_TRAVEL))
    over: dict[str, Any] = {"over": ["sample", "day"], "metrics": metric, "relative": True}
    found = fc.compare(pair, baseline={"controller": baseline}, **over)[metric]
    mean, low, high = (100 * float(found.sel(controller=rule, statistic=s)) for s in ("mean", "low", "high"))
    return f"{mean:+.0f} % ({low:+.0f} to {high:+.0f})"


def travel_of(ds: xr.Dataset, rule: str, q: float = 0.5) -> float:
    """Motor travel over that of the plain PI, a quantile over the valves."""
    travel = ds.motor_travel.mean("day")
    return float((travel.sel(controller=rule) / travel.sel(controller=PI)).quantile(q))


def write_rules(runs: Runs) -> None:
    """Every rule for the buffer behind the same gains."""
    ds, good = pooled(runs.rules), runs.valves[False].backlash == 0.0
    table = []
    for rule in RULES:
        error = ds.rmse.sel(controller=rule).mean("day") / ds.rmse.sel(controller=PI).mean("day") - 1.0
        table.append(
            [
                rule,
                change(ds, rule, PI),
                change(ds, rule, SHIPPED),
                f"{100 * float(error.isel(sample=good).median()):+.0f} %",
                f"{float((error > NO_CHANGE).mean()):.0%}",
                f"× {travel_of(ds, rule):.2f}, × {travel_of(ds, rule, 0.95):.1f}",
                change(ds, rule, SHIPPED, "motor_travel"),
                f"{float(ds.hunts.sel(controller=rule).mean()):.1%}",
            ]
        )
    write_table(
        "buffer/buffer_rules",
        "The buffer of an inverse of 95 %: mean change of RMSE against plain PI with the same gains (95 % over valves "
        f"and days); {ds.sizes['sample']} fresh valves and loops, {ds.sizes['day'] // len(runs.rules)} days of each "
        f"kind ({int((ds.status > 0).sum())} of {ds.status.size:,} days failed)",
        ["buffer", "RMSE", "RMSE against the shipped rule", "without backlash, median", "over 1 % worse in",
         "motor travel, median, 95 % of the valves", "travel against the shipped rule, mean", "hunting"],
        table,
    )  # fmt: skip
    write_table(
        "buffer/buffer_rules_by_days",
        "The same by kind of days: mean change of RMSE against plain PI (95 %), and motor travel of the median valve",
        ["buffer", *runs.rules],
        ([rule, *(f"{change(d, rule, PI)}, × {travel_of(d, rule):.2f}" for d in runs.rules.values())]
         for rule in RULES[1:]),
    )  # fmt: skip


def shipped_width(valves: Valves) -> Any:
    """Buffer of the shipped rule with the noise as it is: 6 kp σ, up to ``ALLOWED`` over the plant's gain."""
    return np.minimum(SHIPPED_RATIO * valves.kp * valves.sigma, ALLOWED / valves.plant.gain)


def write_crossing(runs: Runs) -> None:
    """Loops on which no buffer fits: the lower bound lies above the upper one."""
    table = []
    for heats, valves in runs.valves.items():
        ds = pooled({kind: ds for kind, ds in runs.rules.items() if (kind == HEATING) == heats})
        lower, upper, shipped = valves.lower, valves.upper(ALLOWED), shipped_width(valves)
        for which, words in ((no_buffer_fits(valves), "none fits"), (~no_buffer_fits(valves), "some fit")):
            if which.sum() < 2:
                continue
            d, loop_gain = ds.isel(sample=which), (valves.kp * valves.plant.gain)[which]
            table.append(
                [
                    f"{'heating' if heats else 'cooling'}, {words}",
                    f"{which.mean():.0%}",
                    f"{np.median(valves.sigma[which]):.3f}, {np.median(loop_gain):.2f}",
                    f"{(shipped < lower)[which].mean():.0%}, {(shipped > upper)[which].mean():.0%}",
                    *(f"{change(d, rule, PI)}, × {travel_of(d, rule):.2f}" for rule in CROSSING),
                ]
            )
    write_table(
        "buffer/buffer_crossing",
        f"Where no buffer fits: {PER_HOUR:g} false turns per hour need more than {ALLOWED:g} K of swing allows; "
        "change of RMSE against plain PI with the gains as they are (95 %), and motor travel of the median valve",
        ["loops", "share", "median noise in K, kp K", "shipped below the lower, above the upper bound", *CROSSING],
        table,
    )


def median_of(values: Any) -> str:
    """Median of (n_valves, n) cases and its 95 % interval by a bootstrap over the valves; NaN does not count."""
    rng = np.random.default_rng(1)
    picks = rng.integers(len(values), size=(DRAWS, len(values)))
    drawn = [np.nanquantile(values[pick], 0.5, method="nearest") for pick in picks]
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{np.nanquantile(values, 0.5, method='nearest'):.2f} ({low:.2f} to {high:.2f})"


def write_constants(choice: Runs, fresh: Runs) -> None:
    """The constants as the choice gives them, and as fresh valves would."""
    found = [
        ["lower bound", f"{LOWER_SCALE:g}", *(median_of(lower_scales(runs)) for runs in (choice, fresh))],
        ["swing", f"{UPPER_SCALE:g}", *(median_of(upper_scales(runs)) for runs in (choice, fresh))],
    ]
    n = [len(runs.valves[False].kp) for runs in (choice, fresh)]
    write_table(
        "buffer/buffer_constants",
        f"The two constants: in use, as {n[0]} valves of the choice give them (95 % over valves), as {n[1]} fresh ones "
        "would",
        ["of", "in use", "choice", "fresh"],
        found,
    )
