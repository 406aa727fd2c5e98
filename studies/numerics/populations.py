"""Populations of valves and loops as printed and converged, and the coil at rest."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.model.moist_air import humidity_ratio
from studies.common import concat_along, share_of, write_table
from studies.days import HEATING, WEATHER_FILE, kinds, loop_settings, make_days
from studies.hunting.loops import adapt_to_kind, valves
from studies.inverse.conditions import GROWING_RULE
from studies.learning.identify_online import GOOD_BACKLASH, IDENTIFY_SETTINGS, SIZE_TOLERANCE, population

SEED, VALVES, REMEDY_VALVES = 9420, 384, 192
DAYS = range(94201, 94205)
WAYS = {"as printed": {"air_march": "lagged", "substeps": 1}, "converged": {"converged": True}}
BACKLASH_GROUPS = ((0.0,), (0.01, 0.02, 0.03), (0.05, 0.07), (0.10, 0.15))
CONTROLLERS = {
    "inverse, 95 %, buffer 1 %": {"estimate_ratio": 0.95, "buffer": 0.01},
    "growing rule": {"estimator": "learner"} | GROWING_RULE,
    "identify": IDENTIFY_SETTINGS,
}
RH, OPENINGS = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.8), (0.05, 0.15, 0.25, 0.35, 0.5, 0.75, 1.0)
VOLUMES = (4, 8, 16, 32, 64)


def simulate_both_ways(loop: fc.Loop, day: fc.Boundary) -> xr.Dataset:
    """Simulate a loop as printed and converged, along ``way``."""
    datasets = {way: fc.simulate(loop.assign(**parameters), day, seed=SEED) for way, parameters in WAYS.items()}
    parts = {way: ds.drop_vars(("air_march", "substeps"), errors="ignore") for way, ds in datasets.items()}
    return concat_along("way", parts, coords="minimal", compat="override")


def simulate_hunting(size: int = VALVES, days: range = DAYS, weather: Path = WEATHER_FILE) -> dict[str, xr.Dataset]:
    """Simulate loops of which a third hunts, on every kind of day: (way, sample, day)."""
    loop = valves(SEED, size).assign(noise_std=0.01)
    return {
        kind: simulate_both_ways(adapt_to_kind(loop, kind), make_days(kind, days, weather)) for kind in kinds(weather)
    }


def simulate_remedies(
    size: int = REMEDY_VALVES, days: range = DAYS, weather: Path = WEATHER_FILE
) -> dict[str, dict[str, xr.Dataset]]:
    """Simulate loops with existing gains, plain, with an inverse and with estimators: by kind of day and controller."""
    by_kind: dict[str, dict[str, xr.Dataset]] = {}
    for kind in kinds(weather):
        loop = population(SEED, size, heating=kind == HEATING).assign(**loop_settings(kind))
        day = make_days(kind, days, weather)
        by_kind[kind] = {"plain PI": simulate_both_ways(loop, day)}
        by_kind[kind] |= {
            name: simulate_both_ways(loop.assign(**parameters), day) for name, parameters in CONTROLLERS.items()
        }
    return by_kind


def write_hunting(by_kind: Mapping[str, xr.Dataset]) -> None:
    """Write in how many loops the verdict changes, by kind of day and by backlash."""
    rows = [_verdict_row(kind, ds.hunts, ds.rmse, ds.motor_travel) for kind, ds in by_kind.items()]
    pooled_days = xr.concat(
        [ds[["hunts", "rmse", "motor_travel"]].assign_coords(day=[f"{kind} {d}" for d in ds.day.values])
         for kind, ds in by_kind.items()], "day", coords="minimal", compat="override",
    )  # fmt: skip
    X = next(iter(by_kind.values())).backlash
    for sizes in BACKLASH_GROUPS:
        part = pooled_days.isel(sample=np.flatnonzero(np.isin(X.values, sizes)))
        name = " to ".join(dict.fromkeys(f"{x:.0%}" for x in (sizes[0], sizes[-1])))
        rows.append(_verdict_row(f"X = {name}".replace("%", " %"), part.hunts, part.rmse, part.motor_travel))
    first_ds = next(iter(by_kind.values()))
    write_table(
        "numerics/convergence_hunting",
        f"Does the verdict change?  {first_ds.sizes['sample']} loops × {first_ds.sizes['day']} days of each kind, as "
        "printed and "
        "converged; shares with 95 % intervals over loops and days, changes as median (5 to 95 % of the cases)",
        [
            "days, or backlash",
            "hunt as printed",
            "hunt converged",
            "hunt only as printed",
            "hunt only converged",
            "change of RMSE",
            "change of motor travel",
        ],
        rows,
    )


def _verdict_row(name: str, hunts: xr.DataArray, rmse: xr.DataArray, travel: xr.DataArray) -> list[str]:
    hunts_printed, hunts_converged = (hunts.sel(way=way) > 0.0 for way in WAYS)
    is_known = hunts.notnull().all("way")
    shares = [hunts_printed, hunts_converged, hunts_printed & ~hunts_converged, hunts_converged & ~hunts_printed]
    return [
        name,
        *(share_of(s, is_known).to_text(1) for s in shares),
        _format_spread(_percent_change(rmse)),
        _format_spread(_percent_change(travel)),
    ]


def _percent_change(values: xr.DataArray) -> xr.DataArray:
    printed, converged = (values.sel(way=way, drop=True) for way in WAYS)
    return (converged / printed.where(printed > 0.0) - 1.0) * 100.0


def _format_spread(percent: xr.DataArray) -> str:
    low, middle, high = (float(percent.quantile(q)) for q in (0.05, 0.5, 0.95))
    return f"{middle:+.1f} % ({low:+.1f} to {high:+.1f})"


def is_right(ds: xr.Dataset) -> xr.DataArray:
    """Whether the settled estimate is within 20 % of the backlash or 1 % of the stroke."""
    return abs(ds.estimate_settled - ds.backlash) <= np.maximum(SIZE_TOLERANCE * ds.backlash, GOOD_BACKLASH)


def write_remedies(by_kind: Mapping[str, Mapping[str, xr.Dataset]]) -> None:
    """Write what each controller gains, and how often each estimate is right, as printed and converged."""
    rows = []
    for kind, by_controller in by_kind.items():
        plain = by_controller["plain PI"]
        for name in CONTROLLERS:
            ds = by_controller[name]
            gain = (ds.rmse / plain.rmse - 1.0) * 100.0
            gains = [float(gain.sel(way=way).median()) for way in WAYS]
            is_lower = [ds.rmse.sel(way=w) < plain.rmse.sel(way=w) for w in WAYS]  # than with the plain PI
            lower = f"{is_lower[0].mean():.0%} → {is_lower[1].mean():.0%}".replace("%", " %")
            cells = [f"{gains[0]:+.1f} → {gains[1]:+.1f} %", lower, share_of(is_lower[0] != is_lower[1]).to_text(1)]
            if name.startswith("inverse"):
                rows.append([kind, name, *cells, "—", "—"])
                continue
            is_right_by_way = [is_right(ds.sel(way=way)) for way in WAYS]
            cells += [f"{is_right_by_way[0].mean():.1%} → {is_right_by_way[1].mean():.1%}".replace("%", " %"),
                      share_of(is_right_by_way[0] != is_right_by_way[1]).to_text(1)]  # fmt: skip
            rows.append([kind, name, *cells])
    first_ds = next(iter(by_kind.values()))["plain PI"]
    write_table(
        "numerics/convergence_remedies",
        f"Benefit of controllers and accuracy of estimators, as printed → converged: {first_ds.sizes['sample']} "
        "valves with "
        f"existing gains × {first_ds.sizes['day']} days of each kind; an estimate is right within 20 % of the "
        "backlash or "
        "1 % of the stroke",
        [
            "days",
            "controller",
            "RMSE against the plain PI, median",
            "lower RMSE",
            "better or worse changes",
            "estimate right",
            "right or wrong changes",
        ],
        rows,
    )


def simulate_rest() -> xr.Dataset:
    """Simulate coils of more and more volumes at rest, at openings and humidities from dry to wet: (n_volumes, day)."""
    rh, opening = (grid.ravel() for grid in np.meshgrid(RH, OPENINGS))
    seconds = 3000
    constants = {"m_a": 1.15, "T_a_in": 26.0, "T_w_in": 7.0, "T_set": 14.0}
    series = {name: np.full((rh.size, seconds), value) for name, value in constants.items()}
    series["W_a_in"] = np.repeat(humidity_ratio(26.0, rh)[:, None], seconds, 1)
    loop = fc.Loop(n_volumes=list(VOLUMES), substeps=8, backlash=0.0, converged=True)
    command = np.repeat(opening[:, None], seconds, 1)
    ds = fc.simulate(loop, fc.Boundary(**series), command=command, traces=["T_sup", "wet_volumes", "power"],
                     trace_interval=5, warm_up=2400)  # fmt: skip
    steady = ds.isel(elapsed_time=slice(480, None)).mean("elapsed_time")
    return steady[["T_sup", "power", "wet_volumes"]].assign(condensate=ds.condensate)


def write_rest(ds: xr.Dataset) -> None:
    """Write how far coils of few volumes are from 64, by how wet they are."""
    finest = ds.sel(n_volumes=64, drop=True)
    wet_share = finest.wet_volumes / 64.0
    groups = {"dry": wet_share == 0.0, "partly wet": (wet_share > 0.0) & (wet_share < 1.0), "wet": wet_share >= 1.0}
    rows = []
    for name, among in groups.items():
        for n in VOLUMES[:-1]:
            coarse = ds.sel(n_volumes=n)
            heat = 100.0 * abs(coarse.power / finest.power - 1.0).where(among)
            water = 100.0 * (abs(coarse.condensate - finest.condensate) * 2465.0 / 600.0 / finest.power).where(among)
            T = abs(coarse.T_sup - finest.T_sup).where(among)
            cells = [f"{float(x.median()):.2f}, {float(x.max()):.2f}" for x in (heat, water, T)]
            rows.append([f"{name} ({int(among.sum())})", str(n), *cells])
    write_table(
        "numerics/convergence_wet",
        f"Steady state of coils with N volumes compared with 64, over {ds.sizes['day']} combinations of opening and "
        "humidity: difference, median, largest",
        ["with 64 volumes (cases)", "N", "heat, % of the heat", "heat of condensation, % of the heat", "T_sup, K"],
        rows,
    )


def main(
    size: int = VALVES, remedy_size: int = REMEDY_VALVES, days: range = DAYS, weather: Path = WEATHER_FILE
) -> None:
    """Run everything and write every table."""
    write_rest(simulate_rest())
    write_hunting(simulate_hunting(size, days, weather))
    write_remedies(simulate_remedies(remedy_size, days, weather))
