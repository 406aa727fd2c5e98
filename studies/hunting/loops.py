"""Valves, loops and conditions of ``hunting.py``, and what becomes of them: simulated, and foreseen.

A condition is air, water and set-point that stand still for a day: nothing but the loop itself can keep it swinging.
Each day starts with a cold plant and a closed valve, so every loop gets its kick.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.model.metric_table import HUNTING_PERIODS, HUNTING_SWING
from fastcoil.model.moist_air import humidity_ratio
from studies.days import HEATING, of_kind, settings
from studies.hunting.plants import foreseen

WET, DRY = "wet cooling", "dry cooling"
OPERATING = (WET, DRY, HEATING)
HOURS, WARM_UP = 8, 3 * 3600
BACKLASH = (0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15)
HEATING_GAIN = 0.3
"""The drawn kp is for cooling; a loop with warm water responds about three times as much."""
SERIES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")
STEP, STEP_AT, STEP_LASTS = 0.3, 2, 1
"""Of the set-point, K; hours before and after it."""


def valves(seed: int, size: int, wide: bool = False) -> fc.Loop:
    """Valves and loops along ``sample``: a third to a half of them hunt.

    wide: other plants than those that the rules are chosen on: small and large coils, fast and slow sensors, motors and
    controllers, most of them beyond the ranges of the others.
    """
    draw = np.random.default_rng(seed)

    def loguniform(low: float, high: float) -> np.ndarray:
        return np.exp(draw.uniform(np.log(low), np.log(high), size))

    m_full = loguniform(0.8, 3.0) if wide else np.full(size, 1.7)
    drawn = {
        "backlash": draw.choice(BACKLASH, size),
        "rangeability": loguniform(20, 100),
        "authority": loguniform(0.05, 0.9),
        "C_w": m_full * loguniform(4.5, 15.0) if wide else draw.uniform(8.8, 14.0, size),
        "C_c": loguniform(8.0, 80.0) if wide else loguniform(10.0, 30.0),
        "m_full": m_full,
        "sample_time": draw.choice([1.0, 2.0, 20.0, 60.0] if wide else [5.0, 10.0, 15.0, 30.0], size),
        "sensor_time_constant": draw.uniform(0.0, 120.0, size) if wide else draw.uniform(5.0, 60.0, size),
        "stroke_time": draw.uniform(0.0, 300.0, size) if wide else draw.uniform(30.0, 150.0, size),
        "kp": loguniform(0.003, 0.2) if wide else loguniform(0.005, 0.15),
        "ti": loguniform(3.0, 600.0) if wide else loguniform(4.0, 300.0),
    }
    return fc.Loop.preset("lbnl").assign(**{name: ("sample", values) for name, values in drawn.items()})


def conditions(kind: str, seed: int, size: int, hours: int = HOURS) -> fc.Boundary:
    """Days on which air, water and set-point stand still, as the seed draws them."""
    draw = np.random.default_rng([seed, OPERATING.index(kind)])

    def uniform(low: float, high: float) -> np.ndarray:
        return draw.uniform(low, high, size)

    air, moist, water, T_set = {
        WET: ((23, 32), (0.5, 0.8), (5, 9), (12, 16)),
        DRY: ((20, 32), (0.1, 0.25), (5, 9), (12, 18)),
        HEATING: ((0, 18), (0.2, 0.4), (35, 60), (18, 28)),
    }[kind]
    T_a_in = uniform(*air)
    drawn = {"T_a_in": T_a_in, "W_a_in": humidity_ratio(T_a_in, uniform(*moist)), "T_w_in": uniform(*water),
             "T_set": uniform(*T_set), "m_a": uniform(0.6, 1.4)}  # fmt: skip
    still = {name: np.repeat(values[:, None], 3600 * hours, axis=1) for name, values in drawn.items()}
    return fc.Boundary(**still, day=list(range(size)))


def acting(loop: fc.Loop, kind: str) -> fc.Loop:
    """The loop as it is on such a day: the controller of a heating coil acts the other way, with less gain."""
    if kind != HEATING:
        return loop
    return loop.assign(kp=HEATING_GAIN * xr.DataArray(loop["kp"]), **settings(HEATING))


def simulated(loop: fc.Loop, day: fc.Boundary) -> xr.Dataset:
    """Whether the loop hunts at such conditions, how much (K, peak to peak) and with which period (s)."""
    return hunting(fc.simulate(loop, day, warm_up=WARM_UP))


def hunting(ds: xr.Dataset) -> xr.Dataset:
    """The metrics of days that stand still; ``regular`` is the metric ``hunts``, and ``hunts`` asks for less.

    Where nothing moves a swing need not be regular to be the loop's own: over 0.1 K in ``HUNTING_PERIODS`` periods.
    """
    found = ds[["hunts", "hunting_swing", "hunting_period"]].reset_coords(drop=True)
    found = found.rename(hunts="regular", hunting_swing="swing", hunting_period="period")
    longest = (3600 * HOURS - WARM_UP) / HUNTING_PERIODS
    own = (found.swing > HUNTING_SWING) & (found.period <= longest)
    return found.assign(hunts=own.astype(float).where(found.regular.notnull()))


def of_loop(loop: fc.Loop, *names: str) -> xr.Dataset:
    """Parameters of a loop as a Dataset."""
    return xr.Dataset({name: xr.DataArray(loop[name]) for name in names}).reset_coords(drop=True)


def both(loop: fc.Loop, day: fc.Boundary, found: xr.Dataset) -> xr.Dataset:
    """What is foreseen, what was simulated, and the tuning, over the dims of the loop and ``day``.

    foretold: ``hunts`` of ``fc.limit_cycle``, which counts the motor, the limits of the stroke and the curve, too.
    """
    tuning = of_loop(loop, "kp", "ti", "backlash")
    foretold = fc.limit_cycle(loop, day).hunts.reset_coords(drop=True).rename("foretold")
    return xr.merge([foreseen(loop, day), foretold, found, tuning], compat="override")


def joined(parts: dict[str, xr.Dataset]) -> xr.Dataset:
    """Parts by kind along ``day``, whose labels tell the kind."""
    named = [ds.assign_coords(day=[f"{kind} {day}" for day in ds.day.values]) for kind, ds in parts.items()]
    return xr.concat(named, "day", data_vars="all")


def population(seed: int, size: int, days: int, wide: bool = False) -> xr.Dataset:
    """Loops in wet and dry cooling and in heating, at conditions of their own: (sample, day)."""
    loop, parts = valves(seed, size, wide), {}
    for kind in OPERATING:
        one, day = acting(loop, kind), conditions(kind, seed + 1, days)
        parts[kind] = both(one, day, simulated(one, day)).assign(overshoot=overshoot(one, kind, seed + 1, days))
    return joined(parts)


def overshoot(loop: fc.Loop, kind: str, seed: int, days: int) -> xr.DataArray:
    """Overshoot of a small set-point step without backlash, as a share of the step: (sample, day)."""
    still = conditions(kind, seed, days, STEP_AT + STEP_LASTS).series
    sign = 1.0 if kind == HEATING else -1.0
    after = np.arange(still["T_set"].shape[1]) >= 3600 * STEP_AT
    day = fc.Boundary(**{**{n: still[n] for n in SERIES}, "T_set": still["T_set"] + sign * STEP * after})
    T = fc.simulate(loop.assign(backlash=0.0), day, traces=["T_sup"], trace_interval=20, warm_up=0).T_sup
    T = T.isel(elapsed_time=slice(3600 * STEP_AT // 20, None)).drop_vars("day")
    target = xr.DataArray(still["T_set"][:, 0] + sign * STEP, dims="day")
    return (sign * (T - target)).max("elapsed_time").reset_coords(drop=True) / STEP


def on_days(seed: int, size: int, kind: str, seeds: range) -> xr.Dataset:
    """Other valves on days of a kind of ``kinds.py``, with noise: (sample, day); ``hunts`` is the metric."""
    loop = acting(valves(seed, size), kind)
    loop = loop.assign(noise_std=("sample", np.random.default_rng([seed, 7]).uniform(0.0, 0.05, size)))
    day = of_kind(kind, seeds)
    return both(loop, day, fc.simulate(loop, day, seed=seed)[["hunts"]].reset_coords(drop=True))
