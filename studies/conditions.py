"""Under which conditions the observations of the paper hold.

Does backlash alone make a loop hunt, does the error rise above the exact size, does the learner find it on a
quiet day?  Run with ``python studies/conditions.py``; it prints the tables of ``studies/README.md``.  Plants are
generic (the presets); the days are constant but for one set-point step, or ``paper_day``.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc

PLANTS = {"paper_like coil": "paper_like", "lbnl: sensor lag 30 s, stroke 90 s": "lbnl"}
HOURS = 5
STEP_AT = 3600
T_BEFORE, T_AFTER = 14.0, 15.0
HUNTS = 0.1
"""Peak-to-peak supply temperature, K, in the last hour that counts as hunting, if it crosses the set-point."""


def stepped_day() -> fc.Boundary:
    """Constant air and water, one set-point step after an hour."""
    T_set = np.full(HOURS * 3600, T_BEFORE)
    T_set[STEP_AT:] = T_AFTER
    return fc.constant_day(hours=HOURS, T_set=T_set)


def tunings(n: int = 12) -> xr.Dataset:
    """Overshoot of a set-point step without backlash, and whether the loop hunts without and with 7 %."""
    kp, ti = np.geomspace(0.005, 0.12, n), np.geomspace(4.0, 600.0, n)
    found = []
    for preset in PLANTS.values():
        loop = fc.Loop.preset(preset).assign(kp=kp, ti=ti, sample_time=[1.0, 5.0, 10.0, 30.0])
        T = {
            x_bl: fc.simulate(loop.assign(backlash=x_bl), stepped_day(), traces=["T_sup"], trace_interval=5).T_sup
            for x_bl in (0.0, 0.07)
        }
        peak = T[0.0].sel(elapsed_time=slice(STEP_AT, None)).max("elapsed_time")
        overshoot = (peak - T_AFTER) / (T_AFTER - T_BEFORE)
        found.append(xr.Dataset({"overshoot": overshoot, "alone": _hunts(T[0.0]), "hunts": _hunts(T[0.07])}))
    return xr.concat(found, xr.DataArray(list(PLANTS), dims="plant", name="plant"))


def _hunts(T_sup: xr.DataArray) -> xr.DataArray:
    late = T_sup.sel(elapsed_time=slice((HOURS - 1) * 3600, None))
    low, high = late.min("elapsed_time"), late.max("elapsed_time")
    return (high - low > HUNTS) & (low < T_AFTER) & (high > T_AFTER)


def hunting_table(ds: xr.Dataset) -> list[str]:
    """Share of tunings that hunt with 7 % backlash, by their overshoot without."""
    lines = ["| overshoot without backlash | " + " | ".join(ds.plant.values) + " |", "|---" * 3 + "|"]
    for low, high in ((-np.inf, 0.05), (0.05, 0.2), (0.2, 0.4), (0.4, 0.7), (0.7, np.inf)):
        chosen = (ds.overshoot >= low) & (ds.overshoot < high) & ~ds.alone
        cells = [
            f"{int((chosen & ds.hunts).sel(plant=p).sum())} of {int(chosen.sel(plant=p).sum())} hunt"
            for p in ds.plant.values
        ]
        name = f"{max(low, 0):.0%} to {high:.0%}" if np.isfinite(high) else f"above {low:.0%}"
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    alone = [f"{int(ds.alone.sel(plant=p).sum())}" for p in ds.plant.values]
    lines.append("| (hunts without backlash, too) | " + " | ".join(alone) + " |")
    return lines


def learned_when_quiet(n: int = 8) -> xr.DataArray:
    """Where the learner ends on a constant day, with few switches and little evidence: n × n gains."""
    kp, ti = np.geomspace(0.005, 0.08, n), np.geomspace(8.0, 600.0, n)
    found = []
    for preset in PLANTS.values():
        loop = fc.Loop.preset(preset).assign(backlash=0.07, learning_step=0.007, backlash_estimate=0.007)
        loop = loop.assign(buffer=[1e-9, 0.001, 0.01], kp=kp, ti=ti, sample_time=[1.0, 5.0, 15.0, 30.0])
        found.append(fc.simulate(loop, fc.constant_day(hours=24)).estimate_final)
    return xr.concat(found, xr.DataArray(list(PLANTS), dims="plant", name="plant"))


def quiet_table(end: xr.DataArray) -> list[str]:
    """Shares that end at the size and far above it, by plant and buffer."""
    lines = ["| plant | buffer | ends within a step of the size | ends above 20 % |", "|---|---|---|---|"]
    for name in end.plant.values:
        for buffer in end.buffer.values:
            part = end.sel(plant=name, buffer=buffer)
            found, ran_away = abs(part - 0.07) < 0.0071, part > 0.2
            lines.append(f"| {name} | {buffer:g} | {float(found.mean()):.0%} | {float(ran_away.mean()):.0%} |")
    return lines


def overestimates(n: int = 6) -> xr.Dataset:
    """Errors with the exact size and above it: n × n gains."""
    kp, ti = np.geomspace(0.01, 0.08, n), np.geomspace(8.0, 120.0, n)
    loop = fc.Loop().assign(backlash=0.07, estimate_ratio=[1.0, 1.2, 1.5], kp=kp, ti=ti)
    return fc.simulate(loop.assign(sample_time=[1.0, 5.0, 15.0, 30.0, 60.0]), fc.paper_day(hours=8, seed=1))


def overestimate_table(ds: xr.Dataset) -> list[str]:
    """In how many tunings the error rises above the exact size, by sample time."""
    lines = [
        "| sample time | RMSE, 120 % | settled RMSE, 120 % | RMSE, 150 % | settled RMSE, 150 % |",
        "|---" * 5 + "|",
    ]
    for sample_time in ds.sample_time.values:
        part = ds[["rmse", "rmse_settled"]].sel(sample_time=sample_time)
        above = (part.sel(estimate_ratio=[1.2, 1.5]) > part.sel(estimate_ratio=1.0)).mean(["kp", "ti"])
        shares = [above[m].sel(estimate_ratio=r) for r in (1.2, 1.5) for m in ("rmse", "rmse_settled")]
        lines.append(f"| {sample_time:g} s | " + " | ".join(f"{float(share):.0%}" for share in shares) + " |")
    return lines


def main() -> None:
    """Print every table."""
    ds, above, end = tunings(), overestimates(), learned_when_quiet()
    mild = (ds.overshoot < 0.2) & ~ds.alone
    print(f"### Does backlash alone make a loop hunt? ({ds.overshoot.size:,} tunings, backlash 7 %)\n")
    print(*hunting_table(ds), sep="\n")
    print(f"\nOf {int(mild.sum())} tunings with less than 20 % overshoot, {int((mild & ds.hunts).sum())} hunt.\n")
    n = above.sizes["kp"] * above.sizes["ti"]
    print(f"### In how many tunings is the error larger than with the exact size? ({n} per sample time)\n")
    print(*overestimate_table(above), sep="\n")
    n = end.isel(plant=0, buffer=0).size
    print(f"\n### Does the learner find 7 % on a constant day of 24 h? ({n} tunings per line)\n")
    print(*quiet_table(end), sep="\n")


if __name__ == "__main__":
    main()
