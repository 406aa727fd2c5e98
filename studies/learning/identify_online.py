"""How soon a controller finds its own backlash while it works, how often it is right, and what harm it does.

Valves and loops are drawn like those of ``remedies.toml``, with the
gains as somebody left them, on valves and days that no threshold was chosen on.  Right means: within 20 % of the true
backlash or 1 % of the stroke.  Harm is measured against plain PI with the same gains, days and noise.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import SIZES, compare_rows, drawn_loops, write_table
from studies.days import HEATING, STEPPED, kinds, of_kind, settings
from studies.diagnosis.diagnosis import share

SEED, VALVES = 9214, 512
DAYS = range(92141, 92146)
LONG, LONG_HOURS = "stepped, 24 h", 24
"""A day of 24 h with a set-point step every half hour, for three of 8 h."""
IDENTIFY = {
    "estimator": "identify", "estimate_share": 0.95, "buffer_ratio": 6.0, "buffer_noise": "measured",
    "buffer_swing": 0.1, "plant_gain": 20.0,
}  # fmt: skip
"""The recommended setting."""
GOOD, TOLERANCE = 0.01, 0.2
WORSE = 0.01
"""Rise of the RMSE that counts as harm."""
LOW_AUTHORITY = (0.02, 0.1)
ESTIMATES = 300
"""Seconds between the estimates that are looked at."""


def population(seed: int = SEED, size: int = VALVES, heating: bool = False) -> fc.Loop:
    """Valves and loops along ``sample``."""
    draw = np.random.default_rng([seed, 5])

    drawn = {"backlash": draw.choice([0.0, *SIZES], size), **drawn_loops(draw, size, heating=heating)}
    values = {name: ("sample", each) for name, each in drawn.items()}
    return fc.Loop.preset("lbnl").assign(m_full=1.7, estimate_ratio=0.0, **values)


def conditions() -> dict[str, tuple[fc.Loop, fc.Boundary]]:
    """Loops and days by name: every kind of day, long days, good valves, low authority, an unhurried heating coil."""
    loop = population()
    of_kinds = {
        kind: (population(heating=kind == HEATING).assign(**settings(kind)), of_kind(kind, DAYS)) for kind in kinds()
    }
    stepped = of_kinds.pop(STEPPED)[1]
    low = np.exp(np.random.default_rng([SEED, 6]).uniform(*np.log(LOW_AUTHORITY), VALVES))
    heating, day = of_kinds[HEATING]
    steps = {name: day.series[name] for name in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
    T_set = day.series["T_set"] + stepped.series["T_set"] - stepped.series["T_set"].mean()
    return {
        STEPPED: (loop, stepped),
        LONG: (loop, fc.paper_day(hours=LONG_HOURS, seed=list(DAYS))),
        "stepped, all valves good": (loop.assign(backlash=0.0), stepped),
        "stepped, authority 0.02–0.1": (loop.assign(authority=("sample", low)), stepped),
        "stepped, sampled every 2 min": (loop.assign(sample_time=120.0), stepped),
        "stepped, air flow in steps": (loop, stepping_air(stepped)),
        **of_kinds,
        "heating, stepped": (heating, fc.Boundary(**steps, T_set=T_set, day=list(DAYS))),
    }


def stepping_air(days: fc.Boundary) -> fc.Boundary:
    """Days whose air flow steps every 25 minutes, to 60–130 % of what it was."""
    n = days.series["m_a"].shape[-1]
    draw = np.random.default_rng([SEED, 7]).uniform(0.6, 1.3, (len(DAYS), n // 1500 + 1))
    series = {name: days.series[name] for name in ("T_a_in", "W_a_in", "T_w_in", "T_set")}
    return fc.Boundary(**series, m_a=days.series["m_a"] * np.repeat(draw, 1500, axis=1)[:, :n], day=list(DAYS))


def measured(loop: fc.Loop, days: fc.Boundary) -> xr.Dataset:
    """What identification does to each valve on each day, beside plain PI."""
    plain = fc.simulate(loop, days, seed=SEED)
    found = fc.simulate(loop.assign(**IDENTIFY), days, seed=SEED, traces=["estimate"], trace_interval=ESTIMATES)
    true = plain.backlash if "backlash" in plain.coords else xr.full_like(plain.sample, 0.0, float)
    tolerance = np.maximum(TOLERANCE * true, GOOD) + 1e-9
    right = abs(found.estimate - true) <= tolerance
    hours = right.elapsed_time / 3600.0
    ds = xr.Dataset(
        {
            "right": right.isel(elapsed_time=-1),
            "first": hours.where(right).min("elapsed_time").fillna(np.inf),
            "high": (found.estimate > true + tolerance).any("elapsed_time"),
            "acted": (found.estimate > 0.0).any("elapsed_time"),
            "rise": found.rmse / plain.rmse - 1.0,
            "travel": found.motor_travel / plain.motor_travel,
        }
    ).reset_coords(drop=True)
    return ds.assign(true=true.reset_coords(drop=True))


def row(name: str, ds: xr.Dataset) -> list[str]:
    """What a condition shows."""
    worn = ds.where(ds.true > GOOD, drop=True)
    first = [float(d["first"].median()) if d.sizes["sample"] else np.inf for d in (ds, worn)]
    good = ds.rise.where(ds.true == 0.0, drop=True)
    return [
        name,
        share(ds.right),
        share(worn.right) if worn.sizes["sample"] else "–",
        ", ".join(f"{hours:.1f}" if np.isfinite(hours) else "–" for hours in first),
        share(ds.high),
        share(ds.rise > WORSE),
        share(good > WORSE) if good.sizes["sample"] else "–",
        f"{100 * float(ds.rise.quantile(0.99)):+.1f}, {100 * float(ds.rise.max()):+.1f}",
        f"{100 * float(ds.rise.median()):+.1f}, {100 * float(ds.rise.mean()):+.1f}",
        f"{float(ds.travel.where(ds.acted).median()):.2f}" if bool(ds.acted.any()) else "–",
    ]


def cells(name: str, loop: fc.Loop, days: fc.Boundary) -> list[str]:
    """The row of a condition."""
    return [cell.replace("(-0.0", "(0.0") for cell in row(name, measured(loop, days))]


def sample() -> None:
    """The first condition."""
    name, (loop, days) = next(iter(conditions().items()))
    compare_rows("learning/identify_online", [cells(name, loop, days)])


def main() -> None:
    """Measure every condition and write the table."""
    rows = []
    for name, (loop, days) in conditions().items():
        rows.append(cells(name, loop, days))
        print(*rows[-1], sep=" | ", flush=True)
    write_table(
        "learning/identify_online",
        f"`estimator = \"identify\"` over {VALVES} valves and loops × {len(DAYS)} days of each kind",
        ["days", "right at the end (95 %)", "of those above 1 %",
         "median time to the first right one, all and above 1 %, h", "once too high",
         "RMSE more than 1 % above plain PI", "the same, good valves",
         "RMSE: 99 % of them below, largest, %", "RMSE: median, mean, %", "travel where it acted"],
        rows,
    )  # fmt: skip
