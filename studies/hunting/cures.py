"""What a rule costs against the best gains of all, and which gain of a loop that hunts to change."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import concat_along, format_spread, mean_of, share_of, write_table
from studies.days import CONSTANT, DESIGN, HEATING, kinds, make_days
from studies.hunting.loops import Rule, adapt_to_kind, loop_properties, share_or_dash, valves

KP_FACTORS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0)  # multiples of the gain kp of SIMC that are tried
TI_FACTORS = (0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0)  # and of its ti
ANY_GAINS, SIMC, TWICE_SIMC = "any", "SIMC", "kp and ti twice those of SIMC"
SEARCH_DAYS, FRESH_DAYS = (15601,), range(15611, 15614)


def kind_groups() -> list[list[str]]:
    """Kinds of days that share their gains."""
    return [[kind for kind in kinds() if kind not in (HEATING, DESIGN)], [HEATING]]


def run_cost(seed: int, size: int, rules: Mapping[str, Rule]) -> tuple[xr.Dataset, list[str]]:
    """Metrics by rule on fresh days of all kinds: (rule, sample, day); and the kinds."""
    noise = np.random.default_rng([seed, 7]).uniform(0.0, 0.05, size)
    loop = valves(seed, size).assign(noise_std=("sample", noise))
    parts, kinds_run = [], []
    for group in kind_groups():
        still_day = make_days(HEATING if HEATING in group else CONSTANT, SEARCH_DAYS)
        gains = tune_gains(loop, group, still_day, rules)
        for kind in group:
            ds = fc.simulate(
                adapt_to_kind(loop, kind).assign(kp=gains.kp, ti=gains.ti), make_days(kind, FRESH_DAYS), seed=seed
            )
            metrics = ds[["rmse", "motor_travel", "hunts"]].reset_coords(drop=True)
            parts.append(
                metrics.assign_coords(day=[f"{kind} {day}" for day in FRESH_DAYS], rule=list(gains.rule.values))
            )
            kinds_run.append(kind)
    return xr.concat(parts, "day"), kinds_run


def tune_gains(loop: fc.Loop, group: list[str], still_day: fc.Boundary, rules: Mapping[str, Rule]) -> xr.Dataset:
    """kp and ti of every valve and rule: the lowest mean logarithm of the RMSE on search days, among what obeys."""
    unit_loop = adapt_to_kind(loop.assign(kp=1.0), group[0])
    scale = 1.0 / xr.DataArray(unit_loop["kp"])  # the drawn kp of a heating loop is scaled down
    plant = loop_properties(unit_loop, still_day).isel(day=0, drop=True)
    model = plant[["K", "T", "theta"]].drop_attrs()  # or kp would carry units of s
    kp0, ti0 = model["T"] / (2.0 * model.K * model.theta), np.minimum(model["T"], 8.0 * model.theta)
    kp = (kp0 * scale * xr.DataArray(list(KP_FACTORS), dims="kp_factor")).clip(1e-4, 3.0)
    ti = (ti0 * xr.DataArray(list(TI_FACTORS), dims="ti_factor")).clip(1.0, 3600.0)
    swept = adapt_to_kind(loop.assign(kp=kp, ti=ti), group[0])
    error = 0.0
    for kind in group:
        rmse = fc.simulate(swept, make_days(kind, SEARCH_DAYS)).rmse.mean("day").reset_coords(drop=True)
        error = error + np.log(rmse.fillna(np.inf))
    acting_kp = xr.DataArray(swept["kp"])
    # hunting indices are proportional to kp, and depend on ti
    hunting_index = acting_kp * _index_per_kp(loop, group[0], ti, still_day)
    candidates = model.assign(kp=acting_kp, ti=ti, hunting_index=hunting_index)
    by_rule = {}
    for name in [ANY_GAINS, *rules]:
        is_allowed = (
            xr.ones_like(error, dtype=bool)
            if name == ANY_GAINS
            else rules[name].indicator(candidates) <= rules[name].limit
        )
        best_index = xr.where(is_allowed, error, np.inf).argmin(["kp_factor", "ti_factor"])
        by_rule[name] = xr.Dataset({"kp": kp, "ti": ti.broadcast_like(kp)}).isel(best_index)
    by_rule[SIMC] = xr.Dataset({"kp": kp0 * scale, "ti": ti0})
    by_rule[TWICE_SIMC] = xr.Dataset({"kp": 2.0 * kp0 * scale, "ti": 2.0 * ti0})
    best = concat_along("rule", by_rule, coords="minimal", compat="override")
    return best.assign(kp=xr.DataArray(adapt_to_kind(loop.assign(kp=best.kp), group[0])["kp"])).reset_coords(drop=True)


def _index_per_kp(loop: fc.Loop, kind: str, ti: xr.DataArray, still_day: fc.Boundary) -> xr.DataArray:
    """Hunting index of each ti at kp = 1."""
    unit_loop = adapt_to_kind(loop.assign(kp=1.0, ti=ti), kind)
    return loop_properties(unit_loop, still_day).hunting_index.isel(day=0, drop=True) / xr.DataArray(unit_loop["kp"])


def format_cost(values: xr.DataArray, base: xr.DataArray) -> str:
    """Format the geometric mean change against the best gains, with its interval over valves and days."""
    logarithms = np.log(values / base)
    middle, half = mean_of(logarithms)
    value, low, high = (f"{100 * float(np.expm1(x)):+.0f}" for x in (middle, middle - half, middle + half))
    return "0" if middle == half == 0.0 else f"{value} % ({low} to {high})"


def write_cost(ds: xr.Dataset, names: list[str]) -> None:
    """Write the cost of each rule."""
    best, table = ds.sel(rule=ANY_GAINS, drop=True), []
    for name in ds.rule.values:
        rule_ds = ds.sel(rule=name, drop=True)
        row = [f"best gains of {name}" if name == ANY_GAINS else str(name)]
        for kind in names:
            days = [k for k, day in enumerate(ds.day.values) if str(day).startswith(kind)]
            row.append(format_cost(rule_ds.rmse.isel(day=days), best.rmse.isel(day=days)))
        travel = rule_ds.motor_travel.mean("day") / best.motor_travel.mean("day")
        table.append(
            [*row, f"× {float(travel.median()):.2f}", share_of(rule_ds.hunts > 0, rule_ds.hunts.notnull()).to_text(1)]
        )
    write_table(
        "hunting/hunting_cost",
        f"RMSE with the best gains that meet a rule, against the best of {len(KP_FACTORS) * len(TI_FACTORS)} without "
        "one: geometric "
        f"mean (95 % over valves and days); {ds.sizes['sample']} valves, {len(FRESH_DAYS)} fresh days of each kind",
        ["gains", *names, "motor travel, median", "hunt"],
        table,
    )


AS_FOUND, BY_SIMC = "as found", "gains of SIMC"
HALF_KP = "half of kp"


def cured_gains(
    loop: fc.Loop, plant: xr.Dataset, power: float, delays: float, limit: float
) -> dict[str, tuple[object, object]]:
    """kp and ti after each cure; limit: what the formula is brought down to."""
    kp, ti = xr.DataArray(loop["kp"]), xr.DataArray(loop["ti"])
    plant = plant.drop_attrs()  # or the gains would carry units of s
    time_scale = plant["T"] + delays * plant.theta
    slower_ti = np.maximum(ti, (kp * plant.K) ** power * time_scale / limit)
    weaker_kp = np.minimum(kp, (limit * ti / time_scale) ** (1.0 / power) / plant.K)
    return {
        AS_FOUND: (kp, ti),
        "Ti by the formula, kp as found": (kp, slower_ti),
        "kp by the formula, Ti as found": (weaker_kp, ti),
        "Ti at least T, kp as found": (kp, np.maximum(ti, plant["T"])),
        HALF_KP: (0.5 * kp, ti),
        BY_SIMC: (plant["T"] / (2.0 * plant.K * plant.theta), np.minimum(plant["T"], 8.0 * plant.theta)),
    }


def run_cures(
    seed: int, size: int, formula: Rule, power_and_delays: tuple[float, float], limit: float
) -> tuple[xr.Dataset, list[str]]:
    """Metrics by cure: (cure, sample, day); ``is_ill``: said to hunt by the formula; ``is_short``: not so, but Ti < T.

    The model is that of one condition, a day on which the set-point stands still.
    limit: what a cure by the formula brings it down to.
    """
    parts, kinds_run = [], [kind for kind in kinds() if kind != DESIGN]
    noise = np.random.default_rng([seed, 7]).uniform(0.0, 0.05, size)
    for kind in kinds_run:
        loop = adapt_to_kind(valves(seed, size), kind).assign(noise_std=("sample", noise))
        plant = loop_properties(loop, make_days(HEATING if kind == HEATING else CONSTANT, FRESH_DAYS[:1])).isel(
            day=0, drop=True
        )
        gains = cured_gains(loop, plant, *power_and_delays, limit)
        is_worn = plant.reachable.astype(bool) & (xr.DataArray(loop["backlash"]) > 0.0)
        hunts = formula.indicator(plant.assign(kp=gains[AS_FOUND][0], ti=gains[AS_FOUND][1])) > formula.limit
        is_ill, is_short = is_worn & hunts, is_worn & ~hunts & (gains[AS_FOUND][1] < plant["T"])
        kp, ti = (
            concat_along("cure", {name: xr.DataArray(kp_and_ti[k]) for name, kp_and_ti in gains.items()})
            for k in (0, 1)
        )
        ds = fc.simulate(loop.assign(kp=kp, ti=ti), make_days(kind, FRESH_DAYS), seed=seed)
        metrics = ds[["rmse", "motor_travel", "hunts"]].reset_coords(drop=True)
        metrics = metrics.assign_coords(day=[f"{kind} {day}" for day in FRESH_DAYS], cure=list(gains))
        every_day = xr.ones_like(metrics.day, dtype=bool)
        parts.append(
            metrics.assign(
                ill=is_ill.reset_coords(drop=True) & every_day, short=is_short.reset_coords(drop=True) & every_day
            )
        )
    return xr.concat(parts, "day"), kinds_run


def write_cures(ds: xr.Dataset, names: list[str]) -> None:
    """Write what becomes of the loops after each cure."""
    uncured, table = ds.sel(cure=AS_FOUND, drop=True), []
    for name in ds.cure.values:
        cure_ds = ds.sel(cure=name, drop=True)
        row = [str(name), share_or_dash(cure_ds.hunts > 0, cure_ds.hunts.notnull() & ds.ill)]
        change = cure_ds.rmse / uncured.rmse
        for kind in names:
            days = [k for k, day in enumerate(ds.day.values) if str(day).startswith(kind)]
            row.append(f"{100 * float(change.where(ds.ill).isel(day=days).median()) - 100:+.0f} %")
        travel = (cure_ds.motor_travel / uncured.motor_travel).where(ds.ill).median()
        calm_change = change.where(ds.short)
        table.append([*row, f"× {float(travel):.2f}", format_spread(calm_change)])
    n, m = (int(group.any("day").sum()) for group in (ds.ill, ds.short))
    write_table(
        "hunting/hunting_cures",
        f"Effect of each cure, {ds.sizes['sample']} valves on {len(FRESH_DAYS)} days of each kind: on the {n} that the "
        f"formula expects to hunt, and on {m} that it does not but that have Ti < T; shares with 95 % intervals over "
        "valves and days",
        ["gains", "hunt", *(f"RMSE {kind}, median" for kind in names), "motor travel, median",
         "RMSE of those that do not hunt, but have Ti < T: 5 %, median, 95 %"],
        table,
    )  # fmt: skip
