"""How soon a controller finds its own backlash while it works, how often it is right, and what harm it does.

Valves and loops are drawn like those of ``remedies.toml``, with the
gains as somebody left them, on valves and days that no threshold was chosen on.  Right means: within 20 % of the true
backlash or 1 % of the stroke.  Harm is measured against plain PI with the same gains, days and noise.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import BACKLASH_SIZES, compare_rows, draw_loop_parameters, write_table
from studies.days import HEATING, STEPPED, kinds, loop_settings, make_days
from studies.diagnosis.diagnosis import share_or_none

SEED, VALVES = 9214, 512
DAYS = range(92141, 92146)
LONG_DAY, LONG_HOURS = "stepped, 24 h", 24
"""A day of 24 h with a set-point step every half hour, for three of 8 h."""
IDENTIFY_SETTINGS = {
    "estimator": "identify", "estimate_share": 0.95, "buffer_ratio": 6.0, "buffer_noise": "measured",
    "buffer_swing": 0.1, "plant_gain": 20.0,
}  # fmt: skip
"""The recommended setting."""
GOOD_BACKLASH, SIZE_TOLERANCE = 0.01, 0.2
HARM_RISE = 0.01  # rise of the RMSE that counts as harm
LOW_AUTHORITY = (0.02, 0.1)
ESTIMATE_INTERVAL = 300  # seconds between the estimates that are looked at


def population(seed: int = SEED, size: int = VALVES, heating: bool = False) -> fc.Loop:
    """Valves and loops along ``sample``."""
    rng = np.random.default_rng([seed, 5])

    parameters = {
        "backlash": rng.choice([0.0, *BACKLASH_SIZES], size),
        **draw_loop_parameters(rng, size, heating=heating),
    }
    values = {name: ("sample", series) for name, series in parameters.items()}
    return fc.Loop.preset("lbnl").assign(m_full=1.7, estimate_ratio=0.0, **values)


def conditions() -> dict[str, tuple[fc.Loop, fc.Boundary]]:
    """Loops and days by name: every kind of day, long days, good valves, low authority, an unhurried heating coil."""
    loop = population()
    by_kind = {
        kind: (population(heating=kind == HEATING).assign(**loop_settings(kind)), make_days(kind, DAYS))
        for kind in kinds()
    }
    stepped_days = by_kind.pop(STEPPED)[1]
    low_authority = np.exp(np.random.default_rng([SEED, 6]).uniform(*np.log(LOW_AUTHORITY), VALVES))
    heating_loop, heating_days = by_kind[HEATING]
    heating_series = {name: heating_days.series[name] for name in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
    T_set = heating_days.series["T_set"] + stepped_days.series["T_set"] - stepped_days.series["T_set"].mean()
    return {
        STEPPED: (loop, stepped_days),
        LONG_DAY: (loop, fc.paper_day(hours=LONG_HOURS, seed=list(DAYS))),
        "stepped, all valves good": (loop.assign(backlash=0.0), stepped_days),
        "stepped, authority 0.02–0.1": (loop.assign(authority=("sample", low_authority)), stepped_days),
        "stepped, sampled every 2 min": (loop.assign(sample_time=120.0), stepped_days),
        "stepped, air flow in steps": (loop, with_air_steps(stepped_days)),
        **by_kind,
        "heating, stepped": (heating_loop, fc.Boundary(**heating_series, T_set=T_set, day=list(DAYS))),
    }


def with_air_steps(days: fc.Boundary) -> fc.Boundary:
    """Days whose air flow steps every 25 minutes, to 60–130 % of what it was."""
    n = days.series["m_a"].shape[-1]
    factors = np.random.default_rng([SEED, 7]).uniform(0.6, 1.3, (len(DAYS), n // 1500 + 1))
    series = {name: days.series[name] for name in ("T_a_in", "W_a_in", "T_w_in", "T_set")}
    return fc.Boundary(**series, m_a=days.series["m_a"] * np.repeat(factors, 1500, axis=1)[:, :n], day=list(DAYS))


def compare_with_pi(loop: fc.Loop, days: fc.Boundary) -> xr.Dataset:
    """Compare identification with plain PI, for each valve and day."""
    plain = fc.simulate(loop, days, seed=SEED)
    identified = fc.simulate(
        loop.assign(**IDENTIFY_SETTINGS), days, seed=SEED, traces=["estimate"], trace_interval=ESTIMATE_INTERVAL
    )
    true = plain.backlash if "backlash" in plain.coords else xr.full_like(plain.sample, 0.0, float)
    tolerance = np.maximum(SIZE_TOLERANCE * true, GOOD_BACKLASH) + 1e-9
    right = abs(identified.estimate - true) <= tolerance
    hours = right.elapsed_time / 3600.0
    ds = xr.Dataset(
        {
            "right": right.isel(elapsed_time=-1),
            "first": hours.where(right).min("elapsed_time").fillna(np.inf),
            "high": (identified.estimate > true + tolerance).any("elapsed_time"),
            "acted": (identified.estimate > 0.0).any("elapsed_time"),
            "rise": identified.rmse / plain.rmse - 1.0,
            "travel": identified.motor_travel / plain.motor_travel,
        }
    ).reset_coords(drop=True)
    return ds.assign(true=true.reset_coords(drop=True))


def metric_row(name: str, ds: xr.Dataset) -> list[str]:
    """Format a condition as a row: how often identification is right, how soon, and what harm it does."""
    worn = ds.where(ds.true > GOOD_BACKLASH, drop=True)
    median_hours = [float(part["first"].median()) if part.sizes["sample"] else np.inf for part in (ds, worn)]
    good_rise = ds.rise.where(ds.true == 0.0, drop=True)
    return [
        name,
        share_or_none(ds.right),
        share_or_none(worn.right) if worn.sizes["sample"] else "–",
        ", ".join(f"{hours:.1f}" if np.isfinite(hours) else "–" for hours in median_hours),
        share_or_none(ds.high),
        share_or_none(ds.rise > HARM_RISE),
        share_or_none(good_rise > HARM_RISE) if good_rise.sizes["sample"] else "–",
        f"{100 * float(ds.rise.quantile(0.99)):+.1f}, {100 * float(ds.rise.max()):+.1f}",
        f"{100 * float(ds.rise.median()):+.1f}, {100 * float(ds.rise.mean()):+.1f}",
        f"{float(ds.travel.where(ds.acted).median()):.2f}" if bool(ds.acted.any()) else "–",
    ]


def condition_row(name: str, loop: fc.Loop, days: fc.Boundary) -> list[str]:
    """Simulate a condition, and format it as a row."""
    return [cell.replace("(-0.0", "(0.0") for cell in metric_row(name, compare_with_pi(loop, days))]


def sample() -> None:
    """Run a sample of the study: the first condition."""
    name, (loop, days) = next(iter(conditions().items()))
    compare_rows("learning/identify_online", [condition_row(name, loop, days)])


def main() -> None:
    """Measure every condition and write the table."""
    rows = []
    for name, (loop, days) in conditions().items():
        rows.append(condition_row(name, loop, days))
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
