"""How long can two programs agree?  A loop that hunts makes its whole swing of a difference of 1e-9 K.

Every loop runs twice on the same day; the second time the entering air is warmer by 1e-9 K, which is what another
order of the same sums amounts to.  How long the two traces agree, and what the difference does to the metrics of a day,
beside what another seed of the noise does to them.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import draw_backlash, draw_loop_parameters, progress_printer, share_of, write_table
from studies.days import CONSTANT, STEPPED, make_days
from studies.paper.grid import FIGURE_PRESETS
from studies.wear.runs import FAST_FACTORS

SEED, LOOPS, DAY_SEED, PRESET_DAYS = 20801, 512, 20811, 32
NUDGE_K = 1e-9  # rise of the temperature of the entering air, K
APART_LIMITS = (1e-6, 1e-3, 0.1)  # differences of the supply temperature whose first time is noted, K
BEGIN_SECOND = 1800  # seconds until the start has passed; the air is warmer from then on
METRICS = ("rmse", "hunting_swing", "hunting_period", "motor_travel", "switch_frequency", "hunts")
HUNTING, CALM = "hunts", "calm"


def loops(size: int = LOOPS, *, noise: bool = False) -> fc.Loop:
    """Loops with fast gains, of which many hunt, with or without noise of the sensor."""
    rng = np.random.default_rng(SEED)
    parameters = draw_loop_parameters(rng, size) | {"backlash": draw_backlash(rng, size)}
    parameters |= {name: parameters[name] * factor for name, factor in FAST_FACTORS.items()}
    parameters["noise_std"] = parameters["noise_std"] * noise
    return fc.Loop.preset("lbnl").assign(m_full=1.7, **{name: ("sample", list(v)) for name, v in parameters.items()})


def minutes_until_apart(trace: xr.DataArray, nudged_trace: xr.DataArray, limit: float) -> xr.DataArray:
    """Minutes from the nudge until two traces differ by more than a limit; inf if they never do."""
    is_apart = abs(trace - nudged_trace) > limit
    minutes = (trace.elapsed_time - BEGIN_SECOND) / 60.0
    return minutes.where(is_apart).min("elapsed_time").fillna(np.inf)


def simulate_pair(loop: fc.Loop, day: fc.Boundary) -> tuple[xr.Dataset, xr.Dataset]:
    """Simulate the loop on its day, and on the day that is warmer by the nudge."""
    T_a_in = np.array(day.series["T_a_in"], float)
    T_a_in[..., BEGIN_SECOND:] += NUDGE_K
    options = {"traces": ["T_sup"], "trace_interval": 5, "seed": SEED}
    return fc.simulate(loop, day, **options), fc.simulate(loop, day.assign(T_a_in=T_a_in), **options)


def format_minutes(times: xr.DataArray) -> str:
    """Median of the times and 5 to 95 % of them."""
    if not times.size:
        return "—"
    low, middle, high = (float(times.quantile(q, method="lower")) for q in (0.05, 0.5, 0.95))
    return f"{middle:.0f} ({low:.0f} to {high:.0f})"


def times_row(trace: xr.DataArray, nudged_trace: xr.DataArray) -> list[str]:
    """Format how many loops come apart, and when those do, as cells."""
    minutes_apart = minutes_until_apart(trace, nudged_trace, APART_LIMITS[-1])
    comes_apart = np.isfinite(minutes_apart)
    apart_loops = {"sample": np.flatnonzero(comes_apart)}
    times = (
        minutes_until_apart(trace.isel(apart_loops), nudged_trace.isel(apart_loops), limit) for limit in APART_LIMITS
    )
    return [f"{comes_apart.size}", f"{share_of(comes_apart)}", *map(format_minutes, times)]


def format_difference(values: xr.DataArray, other_values: xr.DataArray) -> str:
    """Format the median and 95 % quantile of the relative difference of a metric."""
    change = (abs(other_values - values) / abs(values)).where((values != 0.0) & values.notnull())
    return " · ".join(f"{100 * float(change.quantile(q)):.2g} %" for q in (0.5, 0.95))


def presets() -> fc.Loop:
    """The two presets that are the paper's, along ``preset``; both hunt."""
    parameters = {name: dict(fc.Loop.preset(name).items()) for name in FIGURE_PRESETS}
    names = [name for name, value in parameters[FIGURE_PRESETS[1]].items() if value != fc.Loop()[name]]
    return fc.Loop(**{name: ("preset", [preset[name] for preset in parameters.values()]) for name in names})


def main(size: int = LOOPS) -> None:
    """Write both tables."""
    report, times, changes = progress_printer(), [], []
    for kind in (CONSTANT, STEPPED):
        days = make_days(kind, list(range(DAY_SEED, DAY_SEED + PRESET_DAYS)))
        base, nudged = (ds.rename(day="sample") for ds in simulate_pair(presets(), days))
        for k, name in enumerate(FIGURE_PRESETS):
            traces = (ds.T_sup.isel(preset=k) for ds in (base, nudged))
            times.append([kind, f"`{name}`", "none", *times_row(*traces)])
        for noise in (False, True):
            loop, day = loops(size, noise=noise), make_days(kind, [DAY_SEED])
            base, nudged = (ds.squeeze("day", drop=True) for ds in simulate_pair(loop, day))
            reseeded = fc.simulate(loop, day, seed=SEED + 1).squeeze("day", drop=True)
            sensor = "to 0.05 K" if noise else "none"
            for group, among in ((HUNTING, base.hunts > 0.0), (CALM, base.hunts == 0.0)):
                members = {"sample": np.flatnonzero(among)}
                base_ds, nudged_ds, reseeded_ds = base.isel(members), nudged.isel(members), reseeded.isel(members)
                times.append([kind, group, sensor, *times_row(base_ds.T_sup, nudged_ds.T_sup)])
                for name in METRICS[:-1]:
                    seed_change = format_difference(base_ds[name], reseeded_ds[name]) if noise else "—"
                    changes.append(
                        [kind, group, sensor, name, format_difference(base_ds[name], nudged_ds[name]), seed_change]
                    )
                verdicts = [f"{share_of(base_ds.hunts != rerun.hunts)}" for rerun in (nudged_ds, reseeded_ds)]
                changes.append([kind, group, sensor, "`hunts` changes", verdicts[0], verdicts[1] if noise else "—"])
            report(f"{kind}, noise {sensor}")
    limits = (f"minutes to {limit:g} K, of these" for limit in APART_LIMITS)
    write_table(
        "numerics/traces",
        "Two runs whose entering air differs by 1e-9 K: share of supply temperatures that diverge, and time until they "
        "do, median (5 to 95 %)",
        ["days", "loops", "noise", "n", f"come apart by {APART_LIMITS[-1]:g} K in 8 h", *limits],
        times,
    )
    write_table(
        "numerics/traces_metrics",
        "Two runs that differ by 1e-9 K in the entering air, or in the seed of the noise: difference of the daily "
        "metrics, median · 95th percentile of the loops",
        ["days", "loops", "noise", "metric", "nudged by 1e-9 K", "another seed of the noise"],
        changes,
    )
