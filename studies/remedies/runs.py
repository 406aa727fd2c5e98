"""Valves, gains, and every remedy behind the same gains on the same days.

The valves, loops and remedies are those of ``remedies.toml``: one row there is one remedy here; half the gain, the user
rule ``by_count`` of ``docs/own-rule.md`` and a perfect valve join them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.study.file.spec import read_study
from studies.common import HEATING_GAIN, STUDIES, concat_along, progress_printer
from studies.days import DESIGN, HEATING, kinds, loop_settings, make_days
from studies.robustness.best_pi import simc_gains


class Parameters(NamedTuple):
    """Parameters of the rule."""

    window: float = fc.parameter(900.0, unit="s", lower=60.0, text="time between two looks at the switches")
    climb: float = fc.parameter(0.005, lower=0.0, upper=0.1, text="step of the estimate")
    most: float = fc.parameter(10.0, lower=0.0, text="mode switches in a window that are not too many")


class Memory(NamedTuple):
    """Memory of the rule."""

    next_look: float = 0.0
    switches: float = 0.0


@fc.estimator(Parameters, Memory)
def by_count(now, p, memory):
    """Raise the estimate where switches are few, lower it where they are many."""
    if now.t < memory.next_look:
        return now.estimate, memory
    too_many = now.switches - memory.switches > p.most
    estimate = now.estimate - p.climb if too_many else now.estimate + p.climb
    return min(max(estimate, 0.0), 0.2), Memory(now.t + p.window, now.switches)


STUDY = STUDIES / "remedies" / "remedies.toml"
SEARCH_DAYS, FRESH_DAYS = (4101, 4102), range(4201, 4206)
GRID = {"kp": (0.6, 1.0, 1.6, 2.5, 4.0, 6.3, 10.0), "ti": (1.0, 2.0, 4.0, 8.0, 16.0)}
"""Gains that are tried, as multiples of SIMC's."""
NO_PRICE, SOME_PRICE = 0.0, 0.1
"""What motor travel costs: price × log(travel) adds to log(error), so 7 % of the error buys half the travel at 0.1."""
LEAST_TRAVEL = 0.1  # travel in 8 h below which nothing more is saved, strokes
SIMC_VALVES = 512  # the first so many valves run with the gains of SIMC, too
BASELINE, AS_FOUND, SIMC = "best PI", "PI as found", "PI by SIMC"
HALF_KP, FASTER, OWN_RULE, NO_BACKLASH = "half_kp", "faster", "own_rule", "no_backlash"
METRICS = ("rmse", "rmse_settled", "motor_travel", "reversals", "share_off", "hunts")


def population(size: int | None = None) -> fc.Loop:
    """The valves and loops of the study along ``sample``, with all its remedies along ``controller``."""
    loop = read_study(STUDY).plan.layout.loop
    return loop if size is None else select_loop(loop, sample=slice(0, size))


def select_loop(loop: fc.Loop, **at: int | slice | list[int]) -> fc.Loop:
    """Select a part of a loop along its dims."""
    values = {name: xr.DataArray(loop[name]) for name in fc.parameters() if loop[name] is not None}
    return fc.Loop(**{n: v.isel(at, missing_dims="ignore", drop=True) for n, v in values.items()})


def select_remedies(loop: fc.Loop, names: Sequence[str]) -> fc.Loop:
    """Select these remedies of a loop, in this order."""
    known = [str(n) for n in loop.coordinates()["controller"].values]
    return select_loop(loop, controller=[known.index(n) for n in names])


def tune_gains(
    loop: fc.Loop,
    simc: xr.Dataset,
    day_kinds: Sequence[str],
    grid: Mapping[str, Sequence[float]],
    prices: Sequence[float],
) -> xr.Dataset:
    """Find the best gains of every valve, and remedy where ``loop`` has several, at each price of travel.

    grid: multiples of SIMC's kp and ti that are tried.
    Best is the lowest mean, over the search days of these kinds, of log(RMSE) + price × log(motor travel).  The kinds
    of cooling give a day each; a design day is much like one with a constant set-point and is left out.
    """
    factors = {name: xr.DataArray(list(values), dims=f"{name}_factor") for name, values in grid.items()}
    swept = loop.assign(kp=simc.kp * factors["kp"], ti=simc.ti * factors["ti"], plant_gain=simc.plant_gain)
    error, travel = xr.DataArray(0.0), xr.DataArray(0.0)
    search_kinds = [kind for kind in day_kinds if kind != DESIGN] or list(day_kinds)
    for kind in search_kinds:
        days = make_days(kind, SEARCH_DAYS if len(search_kinds) == 1 else SEARCH_DAYS[:1])
        ds = fc.simulate(swept.assign(**loop_settings(kind)), days)[["rmse", "motor_travel"]].reset_coords(drop=True)
        error = error + np.log(ds.rmse.fillna(np.inf)).mean("day")
        travel = travel + np.log(ds.motor_travel.clip(LEAST_TRAVEL)).mean("day")
    by_price = {}
    for price in prices:
        best_index = (error + price * travel).argmin([f"{name}_factor" for name in grid])
        by_price[price] = xr.Dataset({n: simc[n] * factors[n].isel(best_index, missing_dims="ignore") for n in grid})
    best = concat_along("price", by_price).reset_coords(drop=True)
    return best.assign(plant_gain=simc.plant_gain).drop_vars("controller", errors="ignore")


def simulate_days(loop: fc.Loop, gains: xr.Dataset, kind: str, seeds: Sequence[int]) -> xr.Dataset:
    """Simulate a loop with these gains on days of a kind."""
    gain_parameters = {name: gains[name] for name in ("kp", "ti", "plant_gain") if name in gains}
    ds = fc.simulate(loop.assign(**gain_parameters, **loop_settings(kind)), make_days(kind, seeds))
    return ds[[*METRICS, "size_error", "status"]].reset_coords(drop=True)


def run_every_remedy(loop: fc.Loop, gains: xr.Dataset, kind: str, seeds: Sequence[int]) -> xr.Dataset:
    """Simulate all remedies of the study, half the gain, a user rule, and a perfect valve."""
    plain = select_loop(loop, controller=0)
    half_ds = simulate_days(plain, gains.assign(kp=0.5 * gains.kp), kind, seeds).expand_dims(controller=[HALF_KP])
    own_rule_ds = simulate_days(plain.assign(estimator=by_count, buffer=0.01), gains, kind, seeds).expand_dims(
        controller=[OWN_RULE]
    )
    perfect_ds = simulate_days(plain.assign(backlash=0.0), gains, kind, seeds).expand_dims(controller=[NO_BACKLASH])
    return xr.concat([simulate_days(loop, gains, kind, seeds), half_ds, own_rule_ds, perfect_ds], "controller")


def run_faster_pi(loop: fc.Loop, simc: xr.Dataset, kind: str, seeds: Sequence[int]) -> xr.Dataset:
    """Simulate plain PI with kp and ti twice those of SIMC: a rule that needs no search."""
    gains = simc.assign(kp=2.0 * simc.kp, ti=2.0 * simc.ti)
    return simulate_days(select_loop(loop, controller=0), gains, kind, seeds).expand_dims(controller=[FASTER])


def kp_as_found(plain: fc.Loop, kind: str) -> xr.DataArray:
    """Existing gain kp; in heating, scaled to that plant."""
    return xr.DataArray(plain["kp"]) * (HEATING_GAIN if kind == HEATING else 1.0)


def run_as_found(loop: fc.Loop, kind: str) -> xr.Dataset:
    """Simulate plain PI with the existing gains."""
    plain = select_loop(loop, controller=0)
    return simulate_days(plain, xr.Dataset({"kp": kp_as_found(plain, kind)}), kind, FRESH_DAYS).expand_dims(
        controller=[AS_FOUND]
    )


def rename_plain_pi(ds: xr.Dataset, plain: str) -> xr.Dataset:
    """Rename the plain PI of a result."""
    return ds.assign_coords(controller=[plain if n == "pi" else str(n) for n in ds.controller.values])


def kind_groups() -> list[list[str]]:
    """Kinds of days that share their gains: all of cooling, and heating."""
    return [[k for k in kinds() if k != HEATING], [HEATING]]


def run(size: int | None) -> tuple[dict[str, xr.Dataset], dict[str, xr.Dataset], dict[str, float]]:
    """Results by kind of day with the best gains and with those of SIMC; share of valves at the edge of the grid."""
    loop = population(size)
    plain, simc_valves = select_loop(loop, controller=0), select_loop(loop, sample=slice(0, SIMC_VALVES))
    best_by_kind: dict[str, xr.Dataset] = {}
    simc_by_kind: dict[str, xr.Dataset] = {}
    edges: dict[str, float] = {}
    report = progress_printer()
    for group in kind_groups():
        simc = simc_gains(plain, group[0])
        best = tune_gains(plain, simc, group, GRID, [NO_PRICE]).isel(price=0, drop=True)
        edges[group[0]] = edge_share(best, simc)
        report(f"tuned for {', '.join(group)}")
        for kind in group:
            best_ds = rename_plain_pi(run_every_remedy(loop, best, kind, FRESH_DAYS), BASELINE)
            best_by_kind[kind] = xr.concat([run_as_found(loop, kind), best_ds], "controller")
            first_valves = {"sample": slice(0, SIMC_VALVES)}
            simc_ds = rename_plain_pi(run_every_remedy(simc_valves, simc.isel(first_valves), kind, FRESH_DAYS), SIMC)
            faster_ds = run_faster_pi(simc_valves, simc.isel(first_valves), kind, FRESH_DAYS)
            base_ds = best_by_kind[kind].sel(controller=[AS_FOUND, BASELINE]).isel(first_valves)
            simc_by_kind[kind] = xr.concat([base_ds, simc_ds, faster_ds], "controller")
            report(f"ran {kind}")
    return best_by_kind, simc_by_kind, edges


def edge_share(best: xr.Dataset, simc: xr.Dataset) -> float:
    """Share of the valves whose gains lie at the upper edge of the grid: more might be better still."""
    is_at_edge = (best.kp / simc.kp > 0.99 * GRID["kp"][-1]) | (best.ti / simc.ti > 0.99 * GRID["ti"][-1])
    return float(is_at_edge.mean())
