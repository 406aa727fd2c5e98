"""What a rule costs against the best gains of all, and which gain of a loop that hunts to change."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import along, mean_of, share_of, spread, write_table
from studies.days import CONSTANT, DESIGN, HEATING, kinds, of_kind
from studies.hunting.loops import Rule, acting, foreseen, share_written, valves

KP = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0)
TI = (0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0)
"""Multiples of the gains of SIMC that are tried."""
ANY, SIMC, TWICE = "any", "SIMC", "kp and ti twice those of SIMC"
SEARCH_DAYS, FRESH_DAYS = (15601,), range(15611, 15614)


def groups() -> list[list[str]]:
    """Kinds of days that share their gains."""
    return [[kind for kind in kinds() if kind not in (HEATING, DESIGN)], [HEATING]]


def run_cost(seed: int, size: int, rules: Mapping[str, Rule]) -> tuple[xr.Dataset, list[str]]:
    """Metrics by rule on fresh days of all kinds: (rule, sample, day); and the kinds."""
    noise = np.random.default_rng([seed, 7]).uniform(0.0, 0.05, size)
    loop = valves(seed, size).assign(noise_std=("sample", noise))
    parts, names = [], []
    for group in groups():
        still = of_kind(HEATING if HEATING in group else CONSTANT, SEARCH_DAYS)
        gains = tuned(loop, group, still, rules)
        for kind in group:
            ds = fc.simulate(acting(loop, kind).assign(kp=gains.kp, ti=gains.ti), of_kind(kind, FRESH_DAYS), seed=seed)
            found = ds[["rmse", "motor_travel", "hunts"]].reset_coords(drop=True)
            parts.append(found.assign_coords(day=[f"{kind} {day}" for day in FRESH_DAYS], rule=list(gains.rule.values)))
            names.append(kind)
    return xr.concat(parts, "day"), names


def tuned(loop: fc.Loop, group: list[str], still: fc.Boundary, rules: Mapping[str, Rule]) -> xr.Dataset:
    """kp and ti of every valve and rule: the lowest mean logarithm of the RMSE on search days, among what obeys."""
    unit = acting(loop.assign(kp=1.0), group[0])
    scale = 1.0 / xr.DataArray(unit["kp"])  # the drawn kp of a heating loop is scaled down
    plant = foreseen(unit, still).isel(day=0, drop=True)
    model = plant[["K", "T", "theta"]]
    kp0, ti0 = model["T"] / (2.0 * model.K * model.theta), np.minimum(model["T"], 8.0 * model.theta)
    kp = (kp0 * scale * xr.DataArray(list(KP), dims="kp_factor")).clip(1e-4, 3.0)
    ti = (ti0 * xr.DataArray(list(TI), dims="ti_factor")).clip(1.0, 3600.0)
    swept = acting(loop.assign(kp=kp, ti=ti), group[0])
    error = 0.0
    for kind in group:
        rmse = fc.simulate(swept, of_kind(kind, SEARCH_DAYS)).rmse.mean("day").reset_coords(drop=True)
        error = error + np.log(rmse.fillna(np.inf))
    acts = xr.DataArray(swept["kp"])
    # margins are proportional to kp, and depend on ti
    hunting_index = acts * _per_kp(loop, group[0], ti, still)
    tried = model.assign(kp=acts, ti=ti, hunting_index=hunting_index)
    found = {}
    for name in [ANY, *rules]:
        obeys = xr.ones_like(error, dtype=bool) if name == ANY else rules[name].of(tried) <= rules[name].limit
        at = xr.where(obeys, error, np.inf).argmin(["kp_factor", "ti_factor"])
        found[name] = xr.Dataset({"kp": kp, "ti": ti.broadcast_like(kp)}).isel(at)
    found[SIMC] = xr.Dataset({"kp": kp0 * scale, "ti": ti0})
    found[TWICE] = xr.Dataset({"kp": 2.0 * kp0 * scale, "ti": 2.0 * ti0})
    best = along("rule", found, coords="minimal", compat="override")
    return best.assign(kp=xr.DataArray(acting(loop.assign(kp=best.kp), group[0])["kp"])).reset_coords(drop=True)


def _per_kp(loop: fc.Loop, kind: str, ti: xr.DataArray, still: fc.Boundary) -> xr.DataArray:
    """Hunting index of each ti at kp = 1."""
    one = acting(loop.assign(kp=1.0, ti=ti), kind)
    return foreseen(one, still).hunting_index.isel(day=0, drop=True) / xr.DataArray(one["kp"])


def cost(of: xr.DataArray, base: xr.DataArray) -> str:
    """Change against the best of all, geometric mean, with its interval over valves and days."""
    d = np.log(of / base)
    middle, half = mean_of(d)
    value, low, high = (f"{100 * float(np.expm1(x)):+.0f}" for x in (middle, middle - half, middle + half))
    return "0" if middle == half == 0.0 else f"{value} % ({low} to {high})"


def write_cost(ds: xr.Dataset, names: list[str]) -> None:
    """Write the cost of each rule."""
    best, table = ds.sel(rule=ANY, drop=True), []
    for name in ds.rule.values:
        at = ds.sel(rule=name, drop=True)
        row = [f"best gains of {name}" if name == ANY else str(name)]
        for kind in names:
            days = [k for k, day in enumerate(ds.day.values) if str(day).startswith(kind)]
            row.append(cost(at.rmse.isel(day=days), best.rmse.isel(day=days)))
        travel = at.motor_travel.mean("day") / best.motor_travel.mean("day")
        table.append([*row, f"× {float(travel.median()):.2f}", share_of(at.hunts > 0, at.hunts.notnull()).written(1)])
    write_table(
        "hunting/hunting_cost",
        f"RMSE with the best gains that meet a rule, against the best of {len(KP) * len(TI)} without one: geometric "
        f"mean (95 % over valves and days); {ds.sizes['sample']} valves, {len(FRESH_DAYS)} fresh days of each kind",
        ["gains", *names, "motor travel, median", "hunt"],
        table,
    )


AS_FOUND, BY_SIMC = "as found", "gains of SIMC"
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
        BY_SIMC: (plant["T"] / (2.0 * plant.K * plant.theta), np.minimum(plant["T"], 8.0 * plant.theta)),
    }


def run_cures(
    seed: int, size: int, formula: Rule, shape: tuple[float, float], limit: float
) -> tuple[xr.Dataset, list[str]]:
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
        kp, ti = (along("cure", {name: xr.DataArray(of[k]) for name, of in gains.items()}) for k in (0, 1))
        ds = fc.simulate(loop.assign(kp=kp, ti=ti), of_kind(kind, FRESH_DAYS), seed=seed)
        found = ds[["rmse", "motor_travel", "hunts"]].reset_coords(drop=True)
        found = found.assign_coords(day=[f"{kind} {day}" for day in FRESH_DAYS], cure=list(gains))
        one_a_day = xr.ones_like(found.day, dtype=bool)
        parts.append(
            found.assign(ill=ill.reset_coords(drop=True) & one_a_day, short=short.reset_coords(drop=True) & one_a_day)
        )
    return xr.concat(parts, "day"), names


def write_cures(ds: xr.Dataset, names: list[str]) -> None:
    """Write what becomes of the loops after each cure."""
    found, table = ds.sel(cure=AS_FOUND, drop=True), []
    for name in ds.cure.values:
        at = ds.sel(cure=name, drop=True)
        row = [str(name), share_written(at.hunts > 0, at.hunts.notnull() & ds.ill)]
        change = at.rmse / found.rmse
        for kind in names:
            days = [k for k, day in enumerate(ds.day.values) if str(day).startswith(kind)]
            row.append(f"{100 * float(change.where(ds.ill).isel(day=days).median()) - 100:+.0f} %")
        travel = (at.motor_travel / found.motor_travel).where(ds.ill).median()
        calm = change.where(ds.short)
        table.append([*row, f"× {float(travel):.2f}", spread(calm)])
    n, m = (int(of.any("day").sum()) for of in (ds.ill, ds.short))
    write_table(
        "hunting/hunting_cures",
        f"Effect of each cure, {ds.sizes['sample']} valves on {len(FRESH_DAYS)} days of each kind: on the {n} that the "
        f"formula expects to hunt, and on {m} that it does not but that have Ti < T; shares with 95 % intervals over "
        "valves and days",
        ["gains", "hunt", *(f"RMSE {kind}, median" for kind in names), "motor travel, median",
         "RMSE of those that do not hunt, but have Ti < T: 5 %, median, 95 %"],
        table,
    )  # fmt: skip
