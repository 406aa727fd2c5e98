"""Under which conditions the paper's observations hold: does backlash alone make a loop hunt, and what misleads the learner?

Run with ``python studies/conditions.py``; prints the tables of ``studies/README.md``.  Plants are generic (the
presets), days are constant with one set-point step, so that nothing but the loop itself can make it move.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc

HOURS = 5
STEP_AT = 3600
T_BEFORE, T_AFTER = 14.0, 15.0
HUNTS = 0.1
"""Peak-to-peak supply temperature, K, four hours after the step, that counts as hunting."""


def stepped_day() -> fc.Boundary:
    """Constant air and water, one set-point step after an hour."""
    T_set = np.full(HOURS * 3600, T_BEFORE)
    T_set[STEP_AT:] = T_AFTER
    return fc.constant_day(hours=HOURS, T_set=T_set)


def tunings() -> xr.Dataset:
    """Overshoot of a set-point step without backlash, and hunting amplitude with it, over a grid of tunings."""
    kp, ti = np.geomspace(0.005, 0.12, 12), np.geomspace(4.0, 600.0, 12)
    plants = {"paper_like coil": ("paper_like", {}), "with sensor lag and stroke": ("lbnl", {"sample_time": 30.0})}
    found = []
    for preset, _ in plants.values():
        loop = fc.Loop.preset(preset).assign(kp=kp, ti=ti, sample_time=[1.0, 5.0, 10.0, 30.0])
        smooth = fc.simulate(loop.assign(backlash=0.0), stepped_day(), traces=["T_sup"], trace_interval=5)
        rough = fc.simulate(loop.assign(backlash=0.07), stepped_day(), traces=["T_sup"], trace_interval=5)
        after = smooth.T_sup.sel(elapsed_time=slice(STEP_AT, None))
        late = slice((HOURS - 1) * 3600, None)
        found.append(
            xr.Dataset(
                {
                    "overshoot": (after.max("elapsed_time") - T_AFTER) / (T_AFTER - T_BEFORE),
                    "swing_without": _swing(smooth.T_sup.sel(elapsed_time=late)),
                    "swing_with": _swing(rough.T_sup.sel(elapsed_time=late)),
                }
            )
        )
    return xr.concat(found, xr.DataArray(list(plants), dims="plant", name="plant"))


def _swing(T: xr.DataArray) -> xr.DataArray:
    return T.max("elapsed_time") - T.min("elapsed_time")


def hunting_table(ds: xr.Dataset) -> list[str]:
    """Share of tunings that hunt with 7 % backlash, by their overshoot without."""
    lines = [
        "| overshoot without backlash | " + " | ".join(ds.plant.values) + " |",
        "|---" * (1 + ds.sizes["plant"]) + "|",
    ]
    steady = ds.swing_without < HUNTS
    for low, high in ((-np.inf, 0.05), (0.05, 0.2), (0.2, 0.4), (0.4, 0.7), (0.7, np.inf)):
        cells = []
        for plant in ds.plant.values:
            part = ds.sel(plant=plant)
            chosen = (part.overshoot >= low) & (part.overshoot < high) & steady.sel(plant=plant)
            hunting = int((chosen & (part.swing_with > HUNTS)).sum())
            cells.append(f"{hunting} of {int(chosen.sum())} hunt")
        name = f"{max(low, 0):.0%} to {high:.0%}" if np.isfinite(high) else f"above {low:.0%}"
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    rings = [f"{int((~steady.sel(plant=p)).sum())}" for p in ds.plant.values]
    lines.append("| (unstable or ringing for hours by itself) | " + " | ".join(rings) + " |")
    return lines


def quiet_loop() -> list[str]:
    """The learner on a perfectly quiet loop: no switch, so no reason to stop."""
    loop = fc.Loop.preset("lbnl").assign(backlash=0.07, learning_step=0.007, backlash_estimate=0.007)
    ds = fc.simulate(loop, fc.constant_day(hours=24))
    return [
        f"A constant day of 24 h: estimate {float(ds.estimate_final):.3f} at the end (true 0.07, cap {loop['learning_cap']}), "
        f"{float(ds.switch_frequency):.2f} switches per 10 min, first step down: "
        + ("never" if np.isnan(ds.learn_time_first_down) else f"{float(ds.learn_time_first_down):.0f} s")
        + "."
    ]


def overestimate_table() -> list[str]:
    """In how many tunings the error rises above the exact size, by sample time."""
    kp, ti = np.geomspace(0.01, 0.08, 6), np.geomspace(8.0, 120.0, 6)
    loop = fc.Loop().assign(
        backlash=0.07, estimate_ratio=[1.0, 1.2, 1.5], kp=kp, ti=ti, sample_time=[1.0, 5.0, 15.0, 30.0, 60.0]
    )
    ds = fc.simulate(loop, fc.paper_day(hours=8, seed=1))
    exact = ds.sel(estimate_ratio=1.0)
    lines = [
        "| sample time | RMSE at 120 % above that at 100 % | settled RMSE at 120 % above | at 150 % | settled at 150 % |",
        "|---|---|---|---|---|",
    ]
    for sample_time in ds.sample_time.values:
        cells = []
        for ratio in (1.2, 1.5):
            for metric in ("rmse", "rmse_settled"):
                above = ds[metric].sel(estimate_ratio=ratio, sample_time=sample_time) > exact[metric].sel(
                    sample_time=sample_time
                )
                cells.append(f"{float(above.mean()):.0%}")
        lines.append(f"| {sample_time:g} s | " + " | ".join(cells) + " |")
    return lines


def main() -> None:
    """Print every table."""
    ds = tunings()
    mild = (ds.overshoot < 0.2) & (ds.swing_without < HUNTS)
    print(f"### Does backlash alone make a loop hunt? ({ds.overshoot.size:,} tunings, backlash 7 %)\n")
    print(*hunting_table(ds), sep="\n")
    print(
        f"\nOf {int(mild.sum())} tunings with less than 20 % overshoot, {int((mild & (ds.swing_with > HUNTS)).sum())} hunt.\n"
    )
    print("### Does the error rise above the exact size? (36 tunings per sample time, paper_like coil, paper_day)\n")
    print(*overestimate_table(), sep="\n")
    print("\n### The learner on a quiet loop\n")
    print(*quiet_loop(), sep="\n")


if __name__ == "__main__":
    main()
