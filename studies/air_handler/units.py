"""Simulated air handlers whose faults are known: a log as a building system writes it, and the truth about it.

``simulate_unit`` draws a unit from its seed: plant, valves, gains, schedule, weather, sensors and headers.  A fault is
there on some of its days.  ``Truth.windows`` are the times at which it shows: a leak while the valve should be shut,
a valve that stays shut while it should be open.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from studies.air_handler.plant import (
    CP_AIR, CP_WATER, LOG_STEPS, SIGNALS, STEP, Coil, CoilSeries, Plant, Series, coil_heat, simulate_plant, valve_flow,
)  # fmt: skip

COOLING, HEATING, SUPPLY, ENTERING, SET_POINT, FAN = (
    "cooling valve", "heating valve", "supply air", "entering air", "set-point", "fan"
)  # fmt: skip
VALVES = (COOLING, HEATING)
LEAK, STUCK_OPEN, STUCK, STUCK_SHUT, UNDERSIZED, NO_WATER = (
    "leak", "stuck_open", "stuck", "stuck_shut", "undersized", "no_water"
)  # fmt: skip
FIGHT, SWINGS, HUNT, FROZEN, OFFSET, UNOCCUPIED = (
    "fight", "set_point_swings", "hunt", "sensor_stuck", "sensor_offset", "unoccupied"
)  # fmt: skip
LOAD, INTEGRAL, GAP = "load", "integral", "gap"
"""Causes of hunting: gains too high for a low load, an integral too fast for the plant, a gap."""
DAY_STEPS, ROWS_PER_DAY = int(86400 / STEP), int(86400 / STEP) // LOG_STEPS
SHOWS_MINUTES = 20  # a fault shows on a day if its signs last so long
HUNTS_MINUTES, HUNTS_KELVIN, CALM_KELVIN = 60, 0.4, 0.2
"""A loop hunts on a day whose regular swings above the first size last so long; it is calm without any of the second."""
TRIES = 12  # gains tried until a loop hunts
HEADERS = (
    {"time": "Datetime", "T_sup": "AHU: Supply Air Temperature", "T_set": "AHU: Supply Air Temperature Set Point",
     "T_set_cooling": "AHU: Supply Air Temperature Cooling Set Point",
     "T_set_heating": "AHU: Supply Air Temperature Heating Set Point", "T_mixed": "AHU: Mixed Air Temperature",
     "T_out": "AHU: Outdoor Air Temperature", "T_return": "AHU: Return Air Temperature", "m_a": "AHU: Supply Air Flow",
     "cooling_command": "AHU: Cooling Coil Valve Control Signal",
     "heating_command": "AHU: Heating Coil Valve Control Signal", "damper": "AHU: Outdoor Air Damper Control Signal",
     "enabled": "AHU: Supply Air Fan Status", "occupied": "Occupancy Mode Indicator"},
    {"time": "Timestamp", "T_sup": "AHU1 Discharge Air Temp", "T_set": "AHU1 Discharge Air Temp Setpoint",
     "T_set_cooling": "AHU1 Discharge Air Temp Cooling Setpoint",
     "T_set_heating": "AHU1 Discharge Air Temp Heating Setpoint", "T_mixed": "AHU1 Mixed Air Temp",
     "T_out": "Outside Air Temp", "T_return": "AHU1 Return Air Temp", "m_a": "AHU1 Supply Air Flow",
     "cooling_command": "AHU1 Cooling Valve Command", "heating_command": "AHU1 Heating Valve Command",
     "damper": "AHU1 Outside Air Damper Command", "enabled": "AHU1 Supply Fan Status",
     "occupied": "AHU1 Occupied"},
    {"time": "Time", "T_sup": "AHU-3.SA-T", "T_set": "AHU-3.SA-T-SP", "T_set_cooling": "AHU-3.SA-T-CLG-SP",
     "T_set_heating": "AHU-3.SA-T-HTG-SP", "T_mixed": "AHU-3.MA-T", "T_out": "AHU-3.OA-T", "T_return": "AHU-3.RA-T",
     "m_a": "AHU-3.SA-FLOW", "cooling_command": "AHU-3.CHW-VLV", "heating_command": "AHU-3.HW-VLV",
     "damper": "AHU-3.OA-DMPR", "enabled": "AHU-3.SF-STS", "occupied": "AHU-3.OCC"},
)  # fmt: skip
"""Headers of building systems, by our names."""


class Truth(NamedTuple):
    """What is wrong with a unit."""

    component: str
    kind: str
    size: float
    cause: str
    days: tuple[int, ...]
    """Days on which the fault is there, from 0."""
    windows: list[tuple[pd.Timestamp, pd.Timestamp]]
    """When it shows."""
    shown_days: tuple[int, ...]
    """Days on which it shows for ``SHOWS_MINUTES``, or for hunting ``HUNTS_MINUTES``."""


class Unit(NamedTuple):
    """A log, its headers by our names, the truth (None if healthy), and what really happened, a row a minute."""

    log: pd.DataFrame
    columns: dict[str, str]
    truth: Truth | None
    signals: pd.DataFrame
    hunting: dict[str, tuple[int, ...]]
    """Days on which each valve's loop hunts, whatever the fault."""
    calm: dict[str, tuple[int, ...]]
    """Days on which each is in control for an hour and calm."""


class Settings(NamedTuple):
    """Drawn plant with its series, before any fault."""

    plant: Plant
    coils: tuple[Coil, Coil]
    coil_series: tuple[CoilSeries, CoilSeries]
    series: Series
    start: pd.Timestamp


def draw_coil(rng: np.random.Generator, m_a: float, *, heating: bool) -> Coil:
    """Draw a coil for an air flow in kg/s."""
    transfer_units, water = (rng.uniform(0.6, 1.3), (0.2, 0.6)) if heating else (rng.uniform(1.5, 2.8), (0.9, 1.8))
    return Coil(
        m_a=m_a, m_w=m_a * CP_AIR / CP_WATER * rng.uniform(*water), UA=transfer_units * m_a * CP_AIR,
        lag=rng.uniform(60.0, 180.0), sensible_share=1.0 if heating else rng.uniform(0.75, 1.0),
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


def draw_unit(seed: int, days: int, *, fan_stops: bool | None = None) -> Settings:
    """Draw a healthy unit and its weather.  fan_stops: whether the fan rests at night; drawn if None."""
    rng = np.random.default_rng([seed, 1])
    n, hour = days * DAY_STEPS, np.arange(days * DAY_STEPS) * STEP / 3600.0
    start = pd.Timestamp("2023-01-01") + pd.Timedelta(days=int(rng.integers(0, 360)))
    m_a, is_cascade = float(np.exp(rng.uniform(np.log(0.5), np.log(12.0)))), bool(rng.uniform() < 0.5)
    stops = bool(rng.uniform() < 0.6) if fan_stops is None else fan_stops
    C_air, opens, closes = m_a * CP_AIR, rng.uniform(5.5, 8.0), rng.uniform(17.0, 20.0)
    weekday = np.array([(start + pd.Timedelta(days=k)).dayofweek < 5 for k in range(days)])
    works = np.repeat(weekday | bool(rng.uniform() < 0.5), DAY_STEPS)
    occupied = works & (hour % 24 >= opens) & (hour % 24 < closes)
    fan = works & (hour % 24 >= opens - rng.uniform(0.0, 2.0)) & (hour % 24 < closes) if stops else np.ones(n, bool)
    season = -np.cos(2.0 * np.pi * (start.dayofyear - 15) / 365.0)
    T_out = rng.uniform(6.0, 18.0) + rng.uniform(5.0, 11.0) * season + 2.0 * smooth_noise(rng, n, 86400.0)
    T_out += rng.uniform(2.0, 6.0) * np.sin(2.0 * np.pi * (hour - 9.0) / 24.0) + 0.3 * smooth_noise(rng, n, 1800.0)
    people = occupied * np.clip(0.6 + 0.15 * smooth_noise(rng, n, 1800.0), 0.1, 1.0)
    sun = np.clip(np.sin(np.pi * (hour % 24 - 6.0) / 12.0), 0.0, None) * np.clip(
        0.5 + 0.3 * smooth_noise(rng, n, 1200.0), 0, 1
    )
    load = C_air * rng.uniform(4.0, 10.0) * (0.1 + people + rng.uniform(0.1, 0.5) * sun)
    plant = Plant(
        m_a=m_a, least_flow=1.0 if rng.uniform() < 0.4 else rng.uniform(0.25, 0.5), fan_heat=rng.uniform(0.2, 1.5),
        outdoor_share=rng.uniform(0.1, 0.3), has_economiser=bool(rng.uniform() < 0.7), damper_lag=rng.uniform(60, 180),
        sensor_lag=rng.uniform(15.0, 60.0), supply_offset=rng.normal(0.0, 0.5), mixed_offset=rng.normal(0.0, 0.8),
        zone_capacity=C_air * rng.uniform(2000.0, 9000.0), zone_UA=C_air * rng.uniform(0.1, 0.4),
        is_cascade=is_cascade, T_set=rng.uniform(12.0, 14.5), reset=-float(rng.choice([0.0, 0.2, 0.3])),
        band=rng.uniform(0.5, 2.0), zone_kp=rng.uniform(0.15, 0.4), zone_ti=rng.uniform(1800.0, 6000.0),
        sample_steps=int(rng.choice([1, 1, 2, 3])),
    )  # fmt: skip
    if not is_cascade:  # the set-point falls from its winter value as it gets warmer outdoors
        plant = plant._replace(reset=-plant.reset, T_set=plant.T_set - 14.0 * plant.reset)
    coils = draw_coil(rng, m_a, heating=False), draw_coil(rng, m_a, heating=True)
    T_water = rng.uniform(6.0, 9.0), rng.uniform(45.0, 75.0)
    wakes = np.repeat(np.where(rng.uniform(size=days) < 0.25, rng.uniform(7.0, 10.0, days), 0.0), DAY_STEPS)
    coil_series = []
    for i, (coil, T_w, T_a) in enumerate(zip(coils, T_water, (25.0, 14.0), strict=True)):
        kappa = rng.uniform(0.2, 1.0)
        slow = coil.lag + 2.0 * (plant.sensor_lag + 0.1 * STEP / coil.travel)
        coil_series.append(CoilSeries(
            T_w=T_w + 0.4 * smooth_noise(rng, n, 1800.0), leakage=np.full(n, rng.choice([0.0, 0.001, 0.005])),
            capacity=np.where((i == 0) & (hour % 24 < wakes), 0.0, 1.0),  # on some mornings there is no chilled water
            stuck=np.full(n, -1.0), gap=np.full(n, rng.uniform(0.0, 0.04)),
            kp=np.full(n, kappa / steepest_gain(coil, T_a, T_w, m_a * plant.least_flow)),
            ti=np.full(n, slow * rng.uniform(0.8, 3.0)),
        ))  # fmt: skip
    noise = rng.normal(0.0, rng.uniform(0.02, 0.06), n)
    zeros = np.zeros(n)
    series = Series(T_out, load, occupied * 1.0, fan * 1.0, 1.0 + 0.01 * smooth_noise(rng, n, 120.0), noise, zeros,
                    zeros, zeros)  # fmt: skip
    return Settings(plant, coils, (coil_series[0], coil_series[1]), series, start)


def add_fault(unit: Settings, fault: str, size: float, component: str, is_faulty: np.ndarray, seed: int) -> Settings:
    """Return the unit with a fault of a given size at the steps that are faulty; not for ``HUNT`` and sensors' logs."""
    i, rng, series = VALVES.index(component) if component in VALVES else 0, np.random.default_rng([seed, 2]), unit.series
    own = unit.coil_series[i]
    if fault == LEAK:
        own = own._replace(leakage=np.where(is_faulty, size, own.leakage))
    elif fault in (STUCK_OPEN, STUCK, STUCK_SHUT):
        own = own._replace(stuck=np.where(is_faulty, size, own.stuck))
    elif fault in (UNDERSIZED, NO_WATER):
        own = own._replace(capacity=np.where(is_faulty, size * own.capacity, own.capacity))
    elif fault == FIGHT:
        series = series._replace(overlap=np.where(is_faulty, size, 0.0))
    elif fault == SWINGS:  # an outer loop hunts: a rounded swing whose period wanders
        period = rng.uniform(2400.0, 4800.0) * (1.0 + 0.08 * smooth_noise(rng, is_faulty.size, 3600.0))
        series = series._replace(swing=is_faulty * size * np.sin(np.cumsum(2.0 * np.pi * STEP / period)))
    elif fault == FROZEN and component == SUPPLY:
        series = series._replace(frozen=is_faulty * 1.0)
    elif fault == UNOCCUPIED:
        series = series._replace(fan=np.maximum(series.fan, is_faulty))
    pair = (own, unit.coil_series[1]) if i == 0 else (unit.coil_series[0], own)
    return unit._replace(coil_series=pair, series=series)


def run_settings(unit: Settings) -> pd.DataFrame:
    """Simulate a unit; signals with a row a minute, schedule included."""
    c, h = unit.coil_series
    record = simulate_plant(unit.plant, *unit.coils, c, h, unit.series)
    index = pd.date_range(unit.start, periods=len(record), freq=f"{int(STEP * LOG_STEPS)}s")
    schedule = {"enabled": unit.series.fan[::LOG_STEPS], "occupied": unit.series.occupied[::LOG_STEPS]}
    return pd.DataFrame(record, index, list(SIGNALS)).assign(**schedule)


def swinging_minutes(signals: pd.DataFrame, valve: str, kelvin: float) -> np.ndarray:
    """Minutes in which a loop swings regularly about its set-point by more than ``kelvin`` from peak to peak.

    Regular: at least six extremes in a row, 1 to 25 min apart, of which neighbours differ by a factor of 2 at most;
    the command moves with them.
    """
    side = valve.split()[0]
    error = (signals.T_sup - signals[f"T_set_{side}"]).to_numpy()
    command, is_on = signals[f"{side}_command"].to_numpy(), signals.enabled.to_numpy() > 0.5
    extremes, low, high, last_low, last_high, rises = [], np.inf, -np.inf, 0, 0, True
    for k, e in enumerate(error):
        low, last_low = (e, k) if e < low else (low, last_low)
        high, last_high = (e, k) if e > high else (high, last_high)
        if rises and e < high - kelvin:
            extremes.append(last_high)
            low, last_low, rises = e, k, False
        elif not rises and e > low + kelvin:
            extremes.append(last_low)
            high, last_high, rises = e, k, True
    swings, run = np.zeros(error.size, bool), extremes[:1]
    for a, b in zip(extremes, [*extremes[1:], error.size + 10_000], strict=True):
        previous = run[-1] - run[-2] if len(run) > 1 else b - a
        moves = b < error.size and bool(is_on[a:b].all()) and np.ptp(command[a : b + 1]) > 0.01
        if moves and 1 <= b - a <= 25 and 0.5 <= (b - a) / previous <= 2.0:
            run.append(b)
            continue
        if len(run) >= 6:
            swings[run[0] : run[-1]] = True
        run = [b]
    return swings


def days_with(minutes: np.ndarray, least: int) -> tuple[int, ...]:
    """Days with at least so many minutes."""
    return tuple(int(k) for k in np.flatnonzero(minutes.reshape(-1, ROWS_PER_DAY).sum(1) >= least))


def make_hunt(unit: Settings, cause: str, component: str, is_faulty: np.ndarray, seed: int) -> Settings:
    """Return the unit with the first gains, of ever faster ones, with which the loop hunts on a faulty day.

    Where the cause is the gap, the loop must be calm without it.
    """
    rng, i = np.random.default_rng([seed, 3]), VALVES.index(component)
    own, lag = unit.coil_series[i], unit.coils[i].lag
    gap = np.where(is_faulty, rng.uniform(0.06, 0.15), own.gap) if cause == GAP else own.gap
    gain = own.kp[0] * steepest_gain(unit.coils[i], *((25.0, 7.0) if i == 0 else (14.0, 60.0)),
                                     unit.plant.m_a * unit.plant.least_flow)  # fmt: skip
    kappa, ti = {LOAD: (4.0, lag * rng.uniform(1.0, 2.0)), INTEGRAL: (rng.uniform(0.3, 0.6), 40.0), GAP: (1.0, lag)}[cause]
    for _ in range(TRIES):
        kp, fast = own.kp * kappa / gain, np.full(own.ti.size, ti)
        trials = []
        for trial_gap in (gap, np.zeros_like(gap)):
            changed = own._replace(kp=np.where(is_faulty, kp, own.kp), ti=np.where(is_faulty, fast, own.ti), gap=trial_gap)
            pair = (changed, unit.coil_series[1]) if i == 0 else (unit.coil_series[0], changed)
            trials.append(unit._replace(coil_series=pair))
        swings = [swinging_minutes(run_settings(trial), component, HUNTS_KELVIN) for trial in trials]
        with_gap, without = ((s & is_faulty[::LOG_STEPS]).sum() for s in swings)
        if with_gap >= HUNTS_MINUTES and (cause != GAP or without < 20):
            break
        kappa, ti = (kappa * 1.3, ti) if cause == LOAD else (kappa, ti * 0.85)
    return trials[0]


def signs_of(fault: str, component: str, s: pd.DataFrame, frozen_at: float) -> np.ndarray:
    """Minutes in which a fault shows in what is logged, given that it is there."""
    side = component.split()[0]
    is_on = (s.enabled > 0.5).to_numpy()
    if fault in (LEAK, STUCK_OPEN, STUCK, STUCK_SHUT, UNDERSIZED, NO_WATER):
        command = s[f"{side}_command"].to_numpy()
        effect = abs(s.T_cooled - s.T_heated if side == "cooling" else s.T_heated - s.T_mixed)
        missed = (s.T_sup - s.T_set_cooling if side == "cooling" else s.T_set_heating - s.T_sup) > 1.0
        passes, lacks = is_on & (command < 0.01) & (effect > 1.0), is_on & (command > 0.9) & missed
        return {LEAK: passes, STUCK_OPEN: passes, STUCK: passes | lacks}.get(fault, lacks).to_numpy()
    if fault == FIGHT:
        return is_on & (np.minimum(s.cooling_command, s.heating_command) > 0.05).to_numpy()
    if fault == HUNT:
        return swinging_minutes(s, component, HUNTS_KELVIN)
    if fault == FROZEN:
        true = s.T_sup if component == SUPPLY else s.T_mixed
        return is_on & (abs(true - frozen_at) > 1.0).to_numpy()
    if fault == UNOCCUPIED:
        return is_on & (s.occupied < 0.5).to_numpy()
    return is_on


def write_log(unit: Settings, s: pd.DataFrame, seed: int) -> tuple[pd.DataFrame, dict[str, str]]:
    """Write a log as building systems do: sensors with offset, noise and resolution, units, headers, rows that lack."""
    rng = np.random.default_rng([seed, 4])
    names, is_fahrenheit = HEADERS[rng.integers(len(HEADERS))], bool(rng.uniform() < 0.5)
    resolution, scale = rng.choice([0.01, 0.05, 0.1]), rng.choice([0.1, 1.0])
    values = {"T_sup": s.T_reading, "T_mixed": s.T_mixed_reading}
    values["T_out"], values["T_return"] = s.T_out + rng.normal(0.0, 0.5), s.T_return + rng.normal(0.0, 0.5)
    both = {n: s[n] for n in ("T_set_cooling", "T_set_heating")}
    values |= both if unit.plant.is_cascade else {"T_set": s.T_set_cooling}
    values |= {n: (100.0 * s[n] / scale).round() * scale for n in ("cooling_command", "heating_command", "damper")}
    values |= {"m_a": s.m_a.round(3)} if rng.uniform() < 0.6 else {}
    values |= {"enabled": s.enabled.astype(int), "occupied": s.occupied.astype(int)}
    log, columns = pd.DataFrame({names["time"]: s.index.strftime("%Y-%m-%d %H:%M")}), {}
    for name, series in values.items():
        mark = "[kg/s]" if name == "m_a" else "[%]" if name in ("cooling_command", "heating_command", "damper") else ""
        x = series.to_numpy()
        if name.startswith("T_"):
            mark, x = ("[°F]", 1.8 * x + 32.0) if is_fahrenheit else ("[°C]", x)
            x = (x / resolution).round() * resolution
        columns[name] = f"{names[name]} {mark}".strip()
        log[columns[name]] = x.round(3) if x.dtype.kind == "f" else x
    lost = rng.uniform(size=len(log)) < rng.choice([0.0, 0.001])
    return log[~lost].reset_index(drop=True), columns


def runs_of(signs: np.ndarray, index: pd.DatetimeIndex, bridge: int = 30) -> list[tuple[pd.Timestamp, pd.Timestamp]]:
    """Windows of the minutes that are true, those closer than ``bridge`` minutes joined."""
    minutes = np.flatnonzero(signs)
    parts = np.split(minutes, np.flatnonzero(np.diff(minutes) > bridge) + 1) if minutes.size else []
    return [(index[part[0]], index[part[-1]]) for part in parts]


def simulate_unit(
    seed: int, fault: str | None = None, size: float = 0.0, component: str = COOLING, days: int = 4, cause: str = LOAD
) -> Unit:
    """Simulate a unit that is drawn from a seed, with a fault on some of its days.

    size: ``LEAK``: share of the full flow; ``STUCK``: opening; ``UNDERSIZED`` and ``NO_WATER``: share of the capacity
    left; ``FIGHT``: overlap of the set-points, K; ``SWINGS``: amplitude, K; ``OFFSET``: error, K; others ignore it.
    component: valve, ``SUPPLY`` or ``ENTERING`` sensor; others ignore it.  cause: of ``HUNT`` only.
    """
    unit, rng = draw_unit(seed, days, fan_stops=True if fault == UNOCCUPIED else None), np.random.default_rng([seed, 5])
    length = int(rng.integers(1, days)) if days > 1 else 1
    first = int(rng.integers(0, days - length + 1))
    is_faulty = np.repeat((np.arange(days) >= first) & (np.arange(days) < first + length), DAY_STEPS)
    size = {STUCK_OPEN: 1.0, STUCK_SHUT: 0.0, NO_WATER: 0.0}.get(fault or "", size)
    if fault == HUNT:
        unit = make_hunt(unit, cause, component, is_faulty, seed)
    elif fault is not None:
        unit = add_fault(unit, fault, size, component, is_faulty, seed)
    s, rows = run_settings(unit), is_faulty[::LOG_STEPS]
    stratified = rng.uniform(-0.15, 0.15) * s.damper * (1.0 - s.damper) * (s.T_out - s.T_return)
    noise = rng.normal(0.0, rng.uniform(0.02, 0.1), len(s))
    reading = (s.T_mixed + unit.plant.mixed_offset + stratified + noise).to_numpy()
    before = max(first * ROWS_PER_DAY - 1, 0)
    if component == ENTERING:
        faulty_reading = np.full(len(s), reading[before]) if fault == FROZEN else reading + size
        reading = np.where(rows, faulty_reading, reading)
    s = s.assign(T_mixed_reading=reading)
    truth = None
    if fault is not None:
        frozen_at = (s.T_sup if component == SUPPLY else s.T_mixed).iloc[before]
        signs = rows & signs_of(fault, component, s, float(frozen_at))
        shown_days = days_with(signs, HUNTS_MINUTES if fault == HUNT else SHOWS_MINUTES)
        named = {FIGHT: "both valves", SWINGS: SET_POINT, UNOCCUPIED: FAN}.get(fault, component)
        faulty_days = tuple(range(first, first + length))
        truth = Truth(named, fault, size, cause if fault == HUNT else "", faulty_days, runs_of(signs, s.index), shown_days)
    hunting, calm = {}, {}
    for valve in VALVES:
        command = s[f"{valve.split()[0]}_command"].to_numpy()
        controls = (command > 0.02) & (command < 0.98) & (s.enabled > 0.5).to_numpy()
        hunting[valve] = days_with(swinging_minutes(s, valve, HUNTS_KELVIN), HUNTS_MINUTES)
        stirred = days_with(swinging_minutes(s, valve, CALM_KELVIN), 1)
        calm[valve] = tuple(k for k in days_with(controls, 60) if k not in stirred)
    log, columns = write_log(unit, s, seed)
    return Unit(log, columns, truth, s, hunting, calm)
