"""A loop hunts: which of its gains to change, and what becomes of it on other days."""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import write_table
from studies.days import CONSTANT, DESIGN, HEATING, kinds, of_kind
from studies.hunting.cost import FRESH_DAYS
from studies.hunting.loops import acting, valves
from studies.hunting.plants import foreseen
from studies.hunting.rules import Rule, written

AS_FOUND, SIMC = "as found", "gains of SIMC"
HALF = "half of kp"


def cured(
    loop: fc.Loop, plant: xr.Dataset, power: float, delays: float, limit: float
) -> dict[str, tuple[object, object]]:
    """kp and ti after each cure; limit: what the formula is brought down to."""
    kp, ti = xr.DataArray(loop["kp"]), xr.DataArray(loop["ti"])
    length = plant["T"] + delays * plant.theta
    slower = np.maximum(ti, (kp * plant.K) ** power * length / limit)
    weaker = np.minimum(kp, (limit * ti / length) ** (1.0 / power) / plant.K)
    return {
        AS_FOUND: (kp, ti),
        "Ti by the formula, kp as found": (kp, slower),
        "kp by the formula, Ti as found": (weaker, ti),
        "Ti at least T, kp as found": (kp, np.maximum(ti, plant["T"])),
        HALF: (0.5 * kp, ti),
        SIMC: (plant["T"] / (2.0 * plant.K * plant.theta), np.minimum(plant["T"], 8.0 * plant.theta)),
    }


def run(seed: int, size: int, formula: Rule, shape: tuple[float, float], limit: float) -> tuple[xr.Dataset, list[str]]:
    """Metrics by cure: (cure, sample, day); ``ill``: said to hunt by the formula; ``short``: not so, but Ti < T.

    The model is that of one condition, a day on which the set-point stands still.
    limit: what a cure by the formula brings it down to.
    """
    parts, names = [], [kind for kind in kinds() if kind != DESIGN]
    noise = np.random.default_rng([seed, 7]).uniform(0.0, 0.05, size)
    for kind in names:
        loop = acting(valves(seed, size), kind).assign(noise_std=("sample", noise))
        plant = foreseen(loop, of_kind(HEATING if kind == HEATING else CONSTANT, FRESH_DAYS[:1])).isel(day=0, drop=True)
        gains = cured(loop, plant, *shape, limit)
        worn = plant.reachable.astype(bool) & (xr.DataArray(loop["backlash"]) > 0.0)
        hunts = formula.of(plant.assign(kp=gains[AS_FOUND][0], ti=gains[AS_FOUND][1])) > formula.limit
        ill, short = worn & hunts, worn & ~hunts & (gains[AS_FOUND][1] < plant["T"])
        kp, ti = (
            xr.concat(
                [xr.DataArray(of[k]) for of in gains.values()], xr.DataArray(list(gains), dims="cure", name="cure")
            )
            for k in (0, 1)
        )
        ds = fc.simulate(loop.assign(kp=kp, ti=ti), of_kind(kind, FRESH_DAYS), seed=seed)
        found = ds[["rmse", "motor_travel", "hunts"]].reset_coords(drop=True)
        found = found.assign_coords(day=[f"{kind} {day}" for day in FRESH_DAYS], cure=list(gains))
        one_a_day = xr.ones_like(found.day, dtype=bool)
        parts.append(
            found.assign(ill=ill.reset_coords(drop=True) & one_a_day, short=short.reset_coords(drop=True) & one_a_day)
        )
    return xr.concat(parts, "day"), names


def write(ds: xr.Dataset, names: list[str]) -> None:
    """Write what becomes of the loops after each cure."""
    found, table = ds.sel(cure=AS_FOUND, drop=True), []
    for name in ds.cure.values:
        at = ds.sel(cure=name, drop=True)
        row = [str(name), written(at.hunts > 0, at.hunts.notnull() & ds.ill)]
        change = at.rmse / found.rmse
        for kind in names:
            days = [k for k, day in enumerate(ds.day.values) if str(day).startswith(kind)]
            row.append(f"{100 * float(change.where(ds.ill).isel(day=days).median()) - 100:+.0f} %")
        travel = (at.motor_travel / found.motor_travel).where(ds.ill).median()
        calm = change.where(ds.short)
        spread = ", ".join(f"{100 * float(calm.quantile(q)) - 100:+.0f} %" for q in (0.05, 0.5, 0.95))
        table.append([*row, f"× {float(travel):.2f}", spread])
    n, m = (int(of.any("day").sum()) for of in (ds.ill, ds.short))
    write_table(
        "hunting/hunting_cures",
        f"What becomes of {ds.sizes['sample']} valves on {len(FRESH_DAYS)} days of each kind: of {n} that the formula "
        f"expects to hunt, and of {m} that it does not, but with Ti < T; shares with 95 % over valves and days",
        ["gains", "hunt", *(f"RMSE {kind}, median" for kind in names), "motor travel, median",
         "RMSE of those that do not hunt, but have Ti < T: 5 %, median, 95 %"],
        table,
    )  # fmt: skip
