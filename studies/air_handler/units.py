"""Simulated air handlers whose faults are known: a log as a building system writes it, and the truth about it.

``simulate_unit`` draws a unit from its seed: plant, valves, gains, schedule, weather, sensors and headers.  A fault is
there on some of its days.  ``Truth.windows`` are the times at which it shows: a leak while the valve should be shut,
a valve that stays shut while it should be open.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from studies.air_handler.logs import write_log

from studies.air_handler.truth import (  # isort: skip
    BOTH, COOLING, ENTERING, FAN, FIGHT, FROZEN, HEATING, HUNT, HUNTS_KELVIN, HUNTS_MINUTES, LEAK, NO_WATER,
    ROWS_PER_DAY, SET_POINT, SHOWS_MINUTES, STUCK, STUCK_OPEN, STUCK_SHUT, SUPPLY, SWINGS, UNDERSIZED, UNOCCUPIED,
    Observed, Truth, days_with, observe_days, signs_of, swinging_minutes, windows_of,
)  # fmt: skip
from studies.air_handler.plant import (  # isort: skip
    CP_AIR, CP_WATER, LOG_STEPS, SIGNALS, STEP, Coil, CoilSeries, Plant, Series, coil_heat, simulate_plant,
    valve_flow,
)  # fmt: skip

LOAD, INTEGRAL, GAP = "load", "integral", "gap"
"""Causes of hunting: gains too high for a low load, an integral too fast for the plant, a gap."""
DAY_STEPS = int(86400 / STEP)
TRIES = 12  # gains tried until a loop hunts
CALM_MINUTES = 20  # most that a loop swings without the gap that makes it hunt


class Unit(NamedTuple):
    """A log, its headers by our names, the truth (None if healthy), and what really happened, a row a minute."""

    log: pd.DataFrame
    columns: dict[str, str]
    truth: Truth | None
    signals: pd.DataFrame
    observed: Observed


class Settings(NamedTuple):
    """Drawn plant with its series: coils, their series and steepest gains, K, cooling first."""

    plant: Plant
    coils: tuple[Coil, Coil]
    coil_series: tuple[CoilSeries, CoilSeries]
    gains: tuple[float, float]
    series: Series
    start: pd.Timestamp

    def replace_where(self, is_faulty: np.ndarray, i: int, **values: object) -> Settings:
        """Return it with other values of series of coil ``i`` at the steps that are faulty."""
        own = self.coil_series[i]
        changes = {name: np.where(is_faulty, value, getattr(own, name)) for name, value in values.items()}
        pair = [*self.coil_series]
        pair[i] = own._replace(**changes)
        return self._replace(coil_series=tuple(pair))


def draw_coil(rng: np.random.Generator, m_a: float, *, heating: bool) -> Coil:
    """Draw a coil for an air flow in kg/s."""
    transfer_units, water = (rng.uniform(0.6, 1.3), (0.2, 0.6)) if heating else (rng.uniform(2.0, 3.5), (1.2, 2.4))
    return Coil(
        m_a=m_a, m_w=m_a * CP_AIR / CP_WATER * rng.uniform(*water), UA=transfer_units * m_a * CP_AIR,
        lag=rng.uniform(60.0, 240.0), sensible_share=1.0 if heating else rng.uniform(0.75, 1.0),
        rangeability=rng.uniform(20.0, 100.0), authority=rng.uniform(0.2, 0.8), travel=STEP / rng.uniform(40.0, 150.0),
    )  # fmt: skip


def steepest_gain(coil: Coil, T_a: float, T_w: float, m_a: float) -> float:
    """Largest change of the air temperature per unit of command at an air flow in kg/s, K."""
    effects = [coil_heat(coil, coil.m_w * valve_flow(coil, u, 0.0), m_a, T_a, T_w, 1.0) for u in np.linspace(0, 1, 21)]
    return float(np.max(np.abs(np.diff(effects))) * 20.0 / (CP_AIR * m_a))


def smooth_noise(rng: np.random.Generator, n: int, seconds: float) -> np.ndarray:
    """Noise of a standard deviation of about 1 that is interpolated between values so many seconds apart."""
    knots = rng.normal(size=int(n * STEP / seconds) + 2)
    return np.interp(np.arange(n) * STEP, seconds * np.arange(knots.size), knots)


def draw_unit(seed: int, days: int, *, fan_stops: bool = False, season_of: str = "") -> Settings:
    """Draw a healthy unit and its weather.

    fan_stops: the fan rests at night; otherwise drawn.  season_of: valve in whose season the days are.
    """
    rng = np.random.default_rng([seed, 1])
    n, hour = days * DAY_STEPS, np.arange(days * DAY_STEPS) * STEP / 3600.0
    first_day = {COOLING: rng.integers(135, 250), HEATING: rng.integers(315, 430)}.get(season_of, rng.integers(0, 360))
    start = pd.Timestamp("2023-01-01") + pd.Timedelta(days=int(first_day))
    m_a, is_cascade = float(np.exp(rng.uniform(np.log(0.5), np.log(12.0)))), bool(rng.uniform() < 0.6)
    stops = bool(rng.uniform() < 0.6) or fan_stops
    C_air, opens, closes = m_a * CP_AIR, rng.uniform(5.5, 8.0), rng.uniform(17.0, 20.0)
    weekday = np.array([(start + pd.Timedelta(days=k)).day_of_week < 5 for k in range(days)])
    works = np.repeat(weekday | bool(rng.uniform() < 0.5), DAY_STEPS)
    occupied = works & (hour % 24 >= opens) & (hour % 24 < closes)
    fan = works & (hour % 24 >= opens - rng.uniform(0.0, 2.0)) & (hour % 24 < closes) if stops else np.ones(n, bool)
    season = -np.cos(2.0 * np.pi * (start.day_of_year - 15) / 365.0)
    T_out = rng.uniform(6.0, 18.0) + rng.uniform(5.0, 11.0) * season + 2.0 * smooth_noise(rng, n, 86400.0)
    T_out += rng.uniform(2.0, 6.0) * np.sin(2.0 * np.pi * (hour - 9.0) / 24.0) + 0.3 * smooth_noise(rng, n, 1800.0)
    people = occupied * np.clip(0.6 + 0.15 * smooth_noise(rng, n, 1800.0), 0.1, 1.0)
    sun = np.clip(np.sin(np.pi * (hour % 24 - 6.0) / 12.0), 0.0, None) * np.clip(
        0.5 + 0.3 * smooth_noise(rng, n, 1200.0), 0, 1
    )
    load = C_air * rng.uniform(3.0, 8.0) * (0.1 + people + rng.uniform(0.1, 0.5) * sun)
    # the one set-point falls from its winter value as it gets warmer outdoors
    reset = 0.0 if is_cascade else float(rng.choice([0.0, 0.2, 0.3]))
    plant = Plant(
        m_a=m_a, least_flow=1.0 if rng.uniform() < 0.4 else rng.uniform(0.25, 0.5), fan_heat=rng.uniform(0.2, 1.5),
        outdoor_share=rng.uniform(0.1, 0.3), has_economiser=bool(rng.uniform() < 0.7), damper_lag=rng.uniform(60, 180),
        duct_lag=rng.uniform(15.0, 60.0), sensor_lag=rng.uniform(15.0, 60.0), supply_offset=rng.normal(0.0, 0.5),
        mixed_offset=rng.normal(0.0, 0.8), zone_capacity=C_air * rng.uniform(4000.0, 15000.0),
        zone_UA=C_air * rng.uniform(0.1, 0.4), is_cascade=is_cascade, T_set=rng.uniform(12.0, 14.5) + 14.0 * reset,
        reset=reset, band=rng.uniform(0.5, 2.0), zone_kp=rng.uniform(0.05, 0.2), zone_ti=rng.uniform(2400.0, 7200.0),
        sample_steps=int(rng.choice([1, 1, 2, 3])),
    )  # fmt: skip
    coils = draw_coil(rng, m_a, heating=False), draw_coil(rng, m_a, heating=True)
    T_water = rng.uniform(6.0, 9.0), rng.uniform(45.0, 75.0)
    wakes = np.repeat(np.where(rng.uniform(size=days) < 0.25, rng.uniform(7.0, 10.0, days), 0.0), DAY_STEPS)
    coil_series, gains = [], []
    for i, (coil, T_w, T_a) in enumerate(zip(coils, T_water, (25.0, 14.0), strict=True)):
        kappa = np.exp(rng.uniform(np.log(0.2), np.log(4.0)))
        slow = coil.lag + 2.0 * (plant.duct_lag + plant.sensor_lag + 0.1 * STEP / coil.travel)
        gains.append(steepest_gain(coil, T_a, T_w, m_a * plant.least_flow))
        coil_series.append(CoilSeries(
            T_w=T_w + 0.4 * smooth_noise(rng, n, 1800.0), leakage=np.full(n, rng.choice([0.0, 0.001, 0.005])),
            capacity=np.where((i == 0) & (hour % 24 < wakes), 0.0, 1.0),  # on some mornings there is no chilled water
            stuck=np.full(n, -1.0), gap=np.full(n, rng.uniform(0.0, 0.06)),
            kp=np.full(n, kappa / gains[i]),
            ti=np.full(n, slow * np.exp(rng.uniform(np.log(0.1), np.log(3.0)))),
        ))  # fmt: skip
    noise = rng.normal(0.0, rng.uniform(0.02, 0.06), n)
    zeros = np.zeros(n)
    series = Series(T_out, load, occupied * 1.0, fan * 1.0, 1.0 + 0.01 * smooth_noise(rng, n, 120.0), noise, zeros,
                    zeros, zeros)  # fmt: skip
    return Settings(plant, coils, (coil_series[0], coil_series[1]), (gains[0], gains[1]), series, start)


def run_settings(unit: Settings) -> pd.DataFrame:
    """Simulate a unit; signals with a row a minute, schedule included."""
    record = simulate_plant(unit.plant, *unit.coils, *unit.coil_series, unit.series)
    index = pd.date_range(unit.start, periods=len(record), freq=f"{int(STEP * LOG_STEPS)}s")
    schedule = {"enabled": unit.series.fan[::LOG_STEPS], "occupied": unit.series.occupied[::LOG_STEPS]}
    return pd.DataFrame(record, index, list(SIGNALS)).assign(**schedule)


def add_fault(unit: Settings, fault: str, size: float, component: str, is_faulty: np.ndarray, seed: int) -> Settings:
    """Return the unit with a fault at the steps that are faulty; for ``HUNT`` see ``make_hunt``."""
    i, rng, series = int(component == HEATING), np.random.default_rng([seed, 2]), unit.series
    valve_changes = {
        LEAK: {"leakage": size}, STUCK_OPEN: {"stuck": 1.0}, STUCK: {"stuck": size}, STUCK_SHUT: {"stuck": 0.0},
        UNDERSIZED: {"capacity": size * unit.coil_series[i].capacity}, NO_WATER: {"capacity": 0.0},
    }  # fmt: skip
    if fault in valve_changes:
        return unit.replace_where(is_faulty, i, **valve_changes[fault])
    if fault == FIGHT:
        series = series._replace(overlap=is_faulty * size)
    elif fault == SWINGS:  # an outer loop hunts: the period wanders
        period = rng.uniform(2400.0, 4800.0) * (1.0 + 0.08 * smooth_noise(rng, is_faulty.size, 3600.0))
        series = series._replace(swing=is_faulty * size * np.sin(np.cumsum(2.0 * np.pi * STEP / period)))
    elif fault == FROZEN and component == SUPPLY:
        series = series._replace(frozen=is_faulty * 1.0)
    elif fault == UNOCCUPIED:
        series = series._replace(fan=np.maximum(series.fan, is_faulty))
    return unit._replace(series=series)


def make_hunt(unit: Settings, cause: str, component: str, is_faulty: np.ndarray, seed: int) -> Settings:
    """Return the unit with the first gains, of ever faster ones, with which the loop hunts on a faulty day.

    Where the cause is the gap, the loop must be calm without it.  Without such gains the unit stays as it is.
    """
    rng, i, rows = np.random.default_rng([seed, 3]), int(component == HEATING), is_faulty[::LOG_STEPS]
    gap = rng.uniform(0.06, 0.15) if cause == GAP else unit.coil_series[i].gap
    kappa, ti = 1.0, unit.coils[i].lag
    if cause != GAP:
        kappa, ti = (2.0, ti * rng.uniform(0.6, 1.2)) if cause == LOAD else (rng.uniform(0.3, 0.6), 40.0)

    def minutes_of(trial: Settings) -> int:
        return int((swinging_minutes(run_settings(trial), component, HUNTS_KELVIN) & rows).sum())

    for _ in range(TRIES):
        trial = unit.replace_where(is_faulty, i, kp=kappa / unit.gains[i], ti=ti, gap=gap)
        if minutes_of(trial) >= HUNTS_MINUTES and (
            cause != GAP or minutes_of(trial.replace_where(is_faulty, i, gap=0.0)) < CALM_MINUTES
        ):
            return trial
        kappa, ti = (kappa * 1.3, ti) if cause == LOAD else (kappa, ti * 0.85)
    return unit


def simulate_unit(
    seed: int, fault: str | None = None, size: float = 0.0, component: str = COOLING, days: int = 4, cause: str = LOAD
) -> Unit:
    """Simulate a unit that is drawn from a seed, with a fault on some of its days.

    size: ``LEAK``: share of the full flow; ``STUCK``: opening; ``UNDERSIZED``: share of the capacity left; ``FIGHT``:
    overlap of the set-points, K; ``SWINGS``: amplitude, K; ``OFFSET``: error, K; others ignore it.  component: valve,
    or sensor: ``SUPPLY`` (``FROZEN`` only) or ``ENTERING``; others ignore it.  cause: of ``HUNT``.
    """
    season_of = component if fault in (STUCK_SHUT, UNDERSIZED, NO_WATER, HUNT) else ""  # those show while it is wanted
    unit = draw_unit(seed, days, fan_stops=fault == UNOCCUPIED, season_of=season_of)
    rng = np.random.default_rng([seed, 5])
    length = int(rng.integers(1, days)) if days > 1 else 1
    first = int(rng.integers(0, days - length + 1))
    faulty_days = tuple(range(first, first + length))
    is_faulty = np.repeat(np.isin(np.arange(days), faulty_days), DAY_STEPS)
    if fault == HUNT:
        unit = make_hunt(unit, cause, component, is_faulty, seed)
    elif fault is not None:
        unit = add_fault(unit, fault, size, component, is_faulty, seed)
    s, rows, before = run_settings(unit), is_faulty[::LOG_STEPS], max(first * ROWS_PER_DAY - 1, 0)
    # a mixed-air sensor stands in streaks of outdoor and return air
    streak = rng.uniform(-0.15, 0.15) * s.damper * (1.0 - s.damper) * (s.T_out - s.T_return)
    reading = s.T_mixed + unit.plant.mixed_offset + streak + rng.normal(0.0, rng.uniform(0.02, 0.1), len(s))
    if component == ENTERING and fault is not None:
        reading = reading.where(~rows, reading.iloc[before] if fault == FROZEN else reading + size)
    s = s.assign(T_mixed_reading=reading)
    truth = None
    if fault is not None:
        frozen_at = (s.T_sup if component == SUPPLY else s.T_mixed).iloc[before]
        signs = rows & signs_of(fault, component, s, float(frozen_at))
        truth = Truth(
            {FIGHT: BOTH, SWINGS: SET_POINT, UNOCCUPIED: FAN}.get(fault, component), fault, size,
            cause if fault == HUNT else "", faulty_days, windows_of(signs, s.index),
            days_with(signs, HUNTS_MINUTES if fault == HUNT else SHOWS_MINUTES),
        )  # fmt: skip
    log, columns = write_log(s, seed, has_one_set_point=not unit.plant.is_cascade)
    return Unit(log, columns, truth, s, observe_days(s))
