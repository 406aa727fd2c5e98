"""How long can two programs agree?  A loop that hunts makes its whole swing of a difference of 1e-9 K.

Every loop runs twice on the same day; the second time the entering air is warmer by 1e-9 K, which is what another
order of the same sums amounts to.  How long the two traces agree, and what the difference does to the metrics of a day,
beside what another seed of the noise does to them.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import drawn_loops, mixed_sizes, progress, share_of, write_table
from studies.days import CONSTANT, STEPPED, of_kind
from studies.paper.grid import FIGURE_PRESETS
from studies.wear.runs import FAST

SEED, LOOPS, DAY, PRESET_DAYS = 20801, 512, 20811, 32
NUDGE = 1e-9
"""Of the temperature of the entering air, K."""
APART = (1e-6, 1e-3, 0.1)
"""Differences of the supply temperature whose first time is noted, K."""
BEGIN = 1800
"""Seconds until the start has passed; the air is warmer from then on."""
METRICS = ("rmse", "hunting_swing", "hunting_period", "motor_travel", "switch_frequency", "hunts")
HUNTING, CALM = "hunts", "calm"


def loops(size: int = LOOPS, *, noise: bool = False) -> fc.Loop:
    """Loops with fast gains, of which many hunt, with or without noise of the sensor."""
    draw = np.random.default_rng(SEED)
    drawn = drawn_loops(draw, size) | {"backlash": mixed_sizes(draw, size)}
    drawn |= {name: drawn[name] * factor for name, factor in FAST.items()}
    drawn["noise_std"] = drawn["noise_std"] * noise
    return fc.Loop.preset("lbnl").assign(m_full=1.7, **{name: ("sample", list(v)) for name, v in drawn.items()})


def first_apart(one: xr.DataArray, other: xr.DataArray, limit: float) -> xr.DataArray:
    """Minutes from the nudge until two traces differ by more than a limit; inf if they never do."""
    apart = abs(one - other) > limit
    minutes = (one.elapsed_time - BEGIN) / 60.0
    return minutes.where(apart).min("elapsed_time").fillna(np.inf)


def pair(loop: fc.Loop, day: fc.Boundary) -> tuple[xr.Dataset, xr.Dataset]:
    """The loop on its day, and on the day that is warmer by the nudge."""
    warmer = np.array(day.series["T_a_in"], float)
    warmer[..., BEGIN:] += NUDGE
    traced = {"traces": ["T_sup"], "trace_interval": 5, "seed": SEED}
    return fc.simulate(loop, day, **traced), fc.simulate(loop, day.assign(T_a_in=warmer), **traced)


def minutes(times: xr.DataArray) -> str:
    """Median of the times and 5 to 95 % of them."""
    if not times.size:
        return "—"
    low, middle, high = (float(times.quantile(q, method="lower")) for q in (0.05, 0.5, 0.95))
    return f"{middle:.0f} ({low:.0f} to {high:.0f})"


def row_of_times(one: xr.DataArray, other: xr.DataArray) -> list[str]:
    """How many loops come apart, and when those do."""
    whole = first_apart(one, other, APART[-1])
    comes = np.isfinite(whole)
    at = {"sample": np.flatnonzero(comes)}
    times = (first_apart(one.isel(at), other.isel(at), limit) for limit in APART)
    return [f"{comes.size}", f"{share_of(comes)}", *map(minutes, times)]


def moved(one: xr.DataArray, other: xr.DataArray) -> str:
    """Median and 95 % of what a metric moved by, as a share of it."""
    change = (abs(other - one) / abs(one)).where((one != 0.0) & one.notnull())
    return " · ".join(f"{100 * float(change.quantile(q)):.2g} %" for q in (0.5, 0.95))


def presets() -> fc.Loop:
    """The two presets that are the paper's, along ``preset``; both hunt."""
    own = {name: dict(fc.Loop.preset(name).items()) for name in FIGURE_PRESETS}
    names = [name for name, value in own[FIGURE_PRESETS[1]].items() if value != fc.Loop()[name]]
    return fc.Loop(**{name: ("preset", [each[name] for each in own.values()]) for name in names})


def main(size: int = LOOPS) -> None:
    """Write both tables."""
    done, times, changes = progress(), [], []
    for kind in (CONSTANT, STEPPED):
        days = of_kind(kind, list(range(DAY, DAY + PRESET_DAYS)))
        one, other = (ds.rename(day="sample") for ds in pair(presets(), days))
        for k, name in enumerate(FIGURE_PRESETS):
            of = (ds.T_sup.isel(preset=k) for ds in (one, other))
            times.append([kind, f"`{name}`", "none", *row_of_times(*of)])
        for noise in (False, True):
            loop, day = loops(size, noise=noise), of_kind(kind, [DAY])
            one, other = (ds.squeeze("day", drop=True) for ds in pair(loop, day))
            again = fc.simulate(loop, day, seed=SEED + 1).squeeze("day", drop=True)
            sensor = "to 0.05 K" if noise else "none"
            for group, among in ((HUNTING, one.hunts > 0.0), (CALM, one.hunts == 0.0)):
                at = {"sample": np.flatnonzero(among)}
                a, b, c = one.isel(at), other.isel(at), again.isel(at)
                times.append([kind, group, sensor, *row_of_times(a.T_sup, b.T_sup)])
                for name in METRICS[:-1]:
                    seed = moved(a[name], c[name]) if noise else "—"
                    changes.append([kind, group, sensor, name, moved(a[name], b[name]), seed])
                verdicts = [f"{share_of(a.hunts != each.hunts)}" for each in (b, c)]
                changes.append([kind, group, sensor, "`hunts` changes", verdicts[0], verdicts[1] if noise else "—"])
            done(f"{kind}, noise {sensor}")
    limits = (f"minutes to {limit:g} K, of these" for limit in APART)
    write_table(
        "numerics/traces",
        "Two runs whose entering air differs by 1e-9 K: share of supply temperatures that diverge, and time until they "
        "do, median (5 to 95 %)",
        ["days", "loops", "noise", "n", f"come apart by {APART[-1]:g} K in 8 h", *limits],
        times,
    )
    write_table(
        "numerics/traces_metrics",
        "Two runs that differ by 1e-9 K in the entering air, or in the seed of the noise: difference of the daily "
        "metrics, median · 95th percentile of the loops",
        ["days", "loops", "noise", "metric", "nudged by 1e-9 K", "another seed of the noise"],
        changes,
    )
