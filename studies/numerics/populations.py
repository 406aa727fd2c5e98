"""Populations of valves and loops as printed and converged, and the coil at rest."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.model.moist_air import humidity_ratio
from studies.common import along, share_of, write_table
from studies.days import HEATING, WEATHER_FILE, kinds, of_kind, settings
from studies.hunting.loops import acting, valves
from studies.inverse.conditions import GROWING
from studies.learning.identify_online import GOOD, IDENTIFY, TOLERANCE, population

SEED, VALVES, REMEDIED = 9420, 384, 192
DAYS = range(94201, 94205)
WAYS = {"as printed": {"air_march": "lagged", "substeps": 1}, "converged": {"converged": True}}
SIZES = ((0.0,), (0.01, 0.02, 0.03), (0.05, 0.07), (0.10, 0.15))
CONTROLLERS = {
    "inverse, 95 %, buffer 1 %": {"estimate_ratio": 0.95, "buffer": 0.01},
    "growing rule": {"estimator": "learner"} | GROWING,
    "identify": IDENTIFY,
}
RH, OPENINGS = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.8), (0.05, 0.15, 0.25, 0.35, 0.5, 0.75, 1.0)
VOLUMES = (4, 8, 16, 32, 64)


def both_ways(loop: fc.Loop, day: fc.Boundary) -> xr.Dataset:
    """A loop as printed and converged, along ``way``."""
    ran = {way: fc.simulate(loop.assign(**how), day, seed=SEED) for way, how in WAYS.items()}
    parts = {way: ds.drop_vars(("air_march", "substeps"), errors="ignore") for way, ds in ran.items()}
    return along("way", parts, coords="minimal", compat="override")


def hunting(size: int = VALVES, days: range = DAYS, weather: Path = WEATHER_FILE) -> dict[str, xr.Dataset]:
    """Loops of which a third hunts, on every kind of day: (way, sample, day)."""
    loop = valves(SEED, size).assign(noise_std=0.01)
    return {kind: both_ways(acting(loop, kind), of_kind(kind, days, weather)) for kind in kinds(weather)}


def remedies(
    size: int = REMEDIED, days: range = DAYS, weather: Path = WEATHER_FILE
) -> dict[str, dict[str, xr.Dataset]]:
    """Loops as somebody left them, plain, with an inverse and with estimators: by kind of day and controller."""
    found: dict[str, dict[str, xr.Dataset]] = {}
    for kind in kinds(weather):
        loop = population(SEED, size, heating=kind == HEATING).assign(**settings(kind))
        day = of_kind(kind, days, weather)
        found[kind] = {"plain PI": both_ways(loop, day)}
        found[kind] |= {name: both_ways(loop.assign(**how), day) for name, how in CONTROLLERS.items()}
    return found


def write_hunting(found: Mapping[str, xr.Dataset]) -> None:
    """Write in how many loops the verdict changes, by kind of day and by backlash."""
    rows = [_verdict(kind, ds.hunts, ds.rmse, ds.motor_travel) for kind, ds in found.items()]
    pooled = xr.concat(
        [ds[["hunts", "rmse", "motor_travel"]].assign_coords(day=[f"{kind} {d}" for d in ds.day.values])
         for kind, ds in found.items()], "day", coords="minimal", compat="override",
    )  # fmt: skip
    X = next(iter(found.values())).backlash
    for sizes in SIZES:
        part = pooled.isel(sample=np.flatnonzero(np.isin(X.values, sizes)))
        name = " to ".join(dict.fromkeys(f"{x:.0%}" for x in (sizes[0], sizes[-1])))
        rows.append(_verdict(f"X = {name}".replace("%", " %"), part.hunts, part.rmse, part.motor_travel))
    one = next(iter(found.values()))
    write_table(
        "numerics/convergence_hunting",
        f"Does the verdict change?  {one.sizes['sample']} loops × {one.sizes['day']} days of each kind, as printed and "
        "converged; shares with 95 % intervals over loops and days, changes as median (5 to 95 % of the cases)",
        ["days, or backlash", "hunt as printed", "hunt converged", "hunt only as printed", "hunt only converged",
         "change of RMSE", "change of motor travel"],
        rows,
    )  # fmt: skip


def _verdict(name: str, hunts: xr.DataArray, rmse: xr.DataArray, travel: xr.DataArray) -> list[str]:
    printed, converged = (hunts.sel(way=way) > 0.0 for way in WAYS)
    known = hunts.notnull().all("way")
    shares = [printed, converged, printed & ~converged, converged & ~printed]
    return [name, *(share_of(s, known).written(1) for s in shares), _spread(_ratio(rmse)), _spread(_ratio(travel))]


def _ratio(values: xr.DataArray) -> xr.DataArray:
    printed, converged = (values.sel(way=way, drop=True) for way in WAYS)
    return (converged / printed.where(printed > 0.0) - 1.0) * 100.0


def _spread(percent: xr.DataArray) -> str:
    low, middle, high = (float(percent.quantile(q)) for q in (0.05, 0.5, 0.95))
    return f"{middle:+.1f} % ({low:+.1f} to {high:+.1f})"


def is_right(ds: xr.Dataset) -> xr.DataArray:
    """Whether the settled estimate is within 20 % of the backlash or 1 % of the stroke."""
    return abs(ds.estimate_settled - ds.backlash) <= np.maximum(TOLERANCE * ds.backlash, GOOD)


def write_remedies(found: Mapping[str, Mapping[str, xr.Dataset]]) -> None:
    """Write what each controller gains, and how often each estimate is right, as printed and converged."""
    rows = []
    for kind, of in found.items():
        plain = of["plain PI"]
        for name in CONTROLLERS:
            ds = of[name]
            gain = (ds.rmse / plain.rmse - 1.0) * 100.0
            gains = [float(gain.sel(way=way).median()) for way in WAYS]
            printed, converged = (ds.rmse.sel(way=w) < plain.rmse.sel(way=w) for w in WAYS)
            lower = f"{printed.mean():.0%} → {converged.mean():.0%}".replace("%", " %")
            cells = [f"{gains[0]:+.1f} → {gains[1]:+.1f} %", lower, share_of(printed != converged).written(1)]
            if name.startswith("inverse"):
                rows.append([kind, name, *cells, "—", "—"])
                continue
            right = [is_right(ds.sel(way=way)) for way in WAYS]
            cells += [f"{right[0].mean():.1%} → {right[1].mean():.1%}".replace("%", " %"),
                      share_of(right[0] != right[1]).written(1)]  # fmt: skip
            rows.append([kind, name, *cells])
    one = next(iter(found.values()))["plain PI"]
    write_table(
        "numerics/convergence_remedies",
        f"Benefit of controllers and accuracy of estimators, as printed → converged: {one.sizes['sample']} valves with "
        f"existing gains × {one.sizes['day']} days of each kind; an estimate is right within 20 % of the backlash or "
        "1 % of the stroke",
        ["days", "controller", "RMSE against the plain PI, median", "lower RMSE", "better or worse changes",
         "estimate right", "right or wrong changes"],
        rows,
    )  # fmt: skip


def at_rest() -> xr.Dataset:
    """Coils of more and more volumes at rest, at openings and humidities from dry to wet: (n_volumes, day)."""
    rh, opening = (grid.ravel() for grid in np.meshgrid(RH, OPENINGS))
    seconds = 3000
    still = {"m_a": 1.15, "T_a_in": 26.0, "T_w_in": 7.0, "T_set": 14.0}
    series = {name: np.full((rh.size, seconds), value) for name, value in still.items()}
    series["W_a_in"] = np.repeat(humidity_ratio(26.0, rh)[:, None], seconds, 1)
    loop = fc.Loop(n_volumes=list(VOLUMES), backlash=0.0, converged=True)
    command = np.repeat(opening[:, None], seconds, 1)
    ds = fc.simulate(loop, fc.Boundary(**series), command=command, traces=["T_sup", "wet_volumes", "power"],
                     trace_interval=5, warm_up=2400)  # fmt: skip
    late = ds.isel(elapsed_time=slice(480, None)).mean("elapsed_time")
    return late[["T_sup", "power", "wet_volumes"]].assign(condensate=ds.condensate)


def write_rest(ds: xr.Dataset) -> None:
    """Write how far coils of few volumes are from 64, by how wet they are."""
    fine = ds.sel(n_volumes=64, drop=True)
    wet = fine.wet_volumes / 64.0
    groups = {"dry": wet == 0.0, "partly wet": (wet > 0.0) & (wet < 1.0), "wet": wet >= 1.0}
    rows = []
    for name, among in groups.items():
        for n in VOLUMES[:-1]:
            at = ds.sel(n_volumes=n)
            heat = 100.0 * abs(at.power / fine.power - 1.0).where(among)
            water = 100.0 * (abs(at.condensate - fine.condensate) * 2465.0 / 600.0 / fine.power).where(among)
            T = abs(at.T_sup - fine.T_sup).where(among)
            cells = [f"{float(x.median()):.2f}, {float(x.max()):.2f}" for x in (heat, water, T)]
            rows.append([f"{name} ({int(among.sum())})", str(n), *cells])
    write_table(
        "numerics/convergence_wet",
        f"Steady state of coils with N volumes compared with 64, over {ds.sizes['day']} combinations of opening and "
        "humidity: difference, median, largest",
        ["with 64 volumes (cases)", "N", "heat, % of the heat", "heat of condensation, % of the heat", "T_sup, K"],
        rows,
    )


def main(size: int = VALVES, remedied: int = REMEDIED, of: range = DAYS, weather: Path = WEATHER_FILE) -> None:
    """Run everything and write every table."""
    write_rest(at_rest())
    write_hunting(hunting(size, of, weather))
    write_remedies(remedies(remedied, of, weather))
