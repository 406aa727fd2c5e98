"""How soon a controller finds its own backlash while it works, how often it is right, and what harm it does.

A second table asks every estimator what it does to good valves.

Valves and loops are drawn like those of ``remedies.toml``, with the
gains as somebody left them, on valves and days that no threshold was chosen on.  Right means: within 20 % of the true
backlash or 1 % of the stroke.  Harm is measured against plain PI with the same gains, days and noise.

The good valves have the plants of three presets, each in its own march, with its gains or those after SIMC.  On days
whose set-point is constant otherwise it steps every half hour, by 0.25 to 2 K.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from studies.common import (
    BACKLASH_SIZES,
    HEATING_GAIN,
    compare_rows,
    draw_loguniform,
    draw_loop_parameters,
    failures_in_words,
    pool_days,
    share_of,
    write_table,
)
from studies.days import HEATING, STEPPED, kinds, loop_settings, make_days
from studies.diagnosis.diagnosis import share_or_none
from studies.learning.learners import CONTROLLER_LABELS, PI
from studies.learning.learners_runs import controllers
from studies.robustness.best_pi import simc_gains

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
HARM_RISE, LARGE_RISE = 0.01, 0.03  # rises of the RMSE that count as harm and as large harm
LOW_AUTHORITY = (0.02, 0.1)
ESTIMATE_INTERVAL = 300  # seconds between the estimates that are looked at

GOOD_SEED, GOOD_VALVES = 11803, 200
GOOD_DAYS = range(118031, 118036)
GOOD_PRESETS = ("paper_like", "lbnl", "g36")
GOOD_CONTROLLERS = ("identify", "gradient", "hagglund", "paper", "growing")
GAINS = ("those of the preset", "SIMC")
STEP_INTERVAL_S, STEP_RANGE_K = 1800, (0.25, 2.0)
"""Time between steps of the set-point of a good valve, and their sizes: one on each day."""


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


def good_valves(kind: str, gains: str) -> fc.Loop:
    """Good valves along ``sample``, with the gains of their presets or after SIMC."""
    rng, heating = np.random.default_rng([GOOD_SEED, 5]), kind == HEATING
    presets = [fc.Loop.preset(name) for name in rng.choice(GOOD_PRESETS, GOOD_VALVES)]
    names = ("C_c", "sensor_time_constant", "stroke_time", "air_march", "kp", "ti")
    parameters = {name: np.array([preset[name] for preset in presets]) for name in names}
    drawn = draw_loop_parameters(rng, GOOD_VALVES, sample_times=(5.0, 10.0, 15.0, 20.0))
    parameters |= {name: drawn[name] for name in ("rangeability", "authority", "C_w", "sample_time", "noise_std")}
    parameters["kp"] = parameters["kp"] * (HEATING_GAIN if heating else 1.0)
    values = {name: ("sample", series) for name, series in parameters.items()}
    loop = fc.Loop(m_full=1.7, backlash=0.0, estimate_ratio=0.0, **values).assign(**loop_settings(kind))
    found = simc_gains(loop, HEATING if heating else STEPPED)
    loop = loop.assign(plant_gain=found.plant_gain)
    return loop.assign(kp=found.kp, ti=found.ti) if gains == "SIMC" else loop


def stepping_days(kind: str) -> fc.Boundary:
    """Days of a kind whose set-point steps, to and fro at random, by a size that the day draws."""
    days = make_days(kind, GOOD_DAYS)
    if kind == STEPPED:
        return days
    T_set = days.series["T_set"].copy()
    n_levels = T_set.shape[-1] // STEP_INTERVAL_S
    for row, seed in zip(T_set, GOOD_DAYS, strict=True):
        rng = np.random.default_rng([seed, 15])
        size, level = draw_loguniform(rng, *STEP_RANGE_K, 1)[0], 0
        for k in range(1, n_levels):
            level = int(rng.choice([-1, 1])) if level == 0 else 0
            row[k * STEP_INTERVAL_S : (k + 1) * STEP_INTERVAL_S] += level * size
    series = {name: days.series[name] for name in ("m_a", "T_a_in", "W_a_in", "T_w_in")}
    return fc.Boundary(**series, T_set=T_set, day=list(GOOD_DAYS))


def good_valve_rows(gains: str) -> tuple[list[list[str]], list[xr.Dataset]]:
    """Return a row of text for what each estimator does to good valves, and the results."""
    days = {kind: stepping_days(kind) for kind in kinds()}
    loops = {kind: good_valves(kind, gains) for kind in days}

    def simulate(name: str) -> xr.Dataset:
        by_kind = {
            kind: fc.simulate(loops[kind].assign(**controllers()[name]), days[kind], seed=GOOD_SEED) for kind in days
        }
        kept = ["rmse", "motor_travel", "estimate_largest", "estimate_final", "status"]
        return pool_days({kind: ds[kept].reset_coords(drop=True) for kind, ds in by_kind.items()})

    plain, results, rows = simulate(PI), [], []
    for name in GOOD_CONTROLLERS:
        ds = simulate(name)
        results.append(ds)
        rise, travel = ds.rmse / plain.rmse - 1.0, ds.motor_travel / plain.motor_travel
        highest, final = ds.estimate_largest, ds.estimate_final
        rows.append(
            [
                CONTROLLER_LABELS[name],
                gains,
                share_of(rise > HARM_RISE).to_text(1),
                share_of(rise > LARGE_RISE).to_text(1),
                f"{100 * float(rise.quantile(0.99)):+.1f}, {100 * float(rise.max()):+.1f}",
                f"{float(travel.quantile(0.99)):.2f}, {float(travel.max()):.2f}",
                share_of(highest > GOOD_BACKLASH).to_text(1),
                share_of(final > GOOD_BACKLASH).to_text(1),
                f"{100 * float(highest.quantile(0.99)):.1f}, {100 * float(highest.max()):.1f}",
            ]
        )
        print(*rows[-1], sep=" | ", flush=True)
    return rows, results


def write_good_valves() -> None:
    """Try every estimator on good valves and write the table."""
    rows, results = zip(*(good_valve_rows(gains) for gains in GAINS), strict=True)
    write_table(
        "learning/identify_good",
        f"Good valves: {GOOD_VALVES} × {len(GOOD_DAYS)} days of each kind with set-point steps of 0.25 to 2 K, samples "
        f"of 5 to 20 s, noise to 0.05 K ({failures_in_words(ds for part in results for ds in part)})",
        ["estimator", "gains", "RMSE more than 1 % above plain PI (95 %)", "more than 3 %",
         "RMSE: 99 % of them below, largest, %", "motor travel: 99 % below, largest, ×",
         "estimate above 1 % of the stroke at some time", "at the end", "largest estimate: 99 % below, largest, %"],
        [row for part in rows for row in part],
    )  # fmt: skip


def sample() -> None:
    """Run a sample of the study: the first condition."""
    name, (loop, days) = next(iter(conditions().items()))
    compare_rows("learning/identify_online", [condition_row(name, loop, days)])


def main() -> None:
    """Measure every condition and write the tables."""
    write_good_valves()
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
