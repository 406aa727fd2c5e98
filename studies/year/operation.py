"""A year of days of weather with the operation of an air handler: schedule, economiser, resets, zones.

Each zone has a load, as a share of what it gets at full air flow and the lowest set-point.  It takes the air that keeps
its temperature, between a least and its full flow; at full flow it becomes warmer instead.  Zones store no heat: load,
flow and temperature of a minute belong together.

Sources of the defaults.  ASHRAE Guideline 36-2021, section 5.16.2.2 with its table: set-point from 13 to 18 degC (55 to
65 degF) over outdoor temperatures of 16 and 21 degC (60 and 70 degF); sections 5.1.14 and 5.6.8.1: trim and respond
from 10 min after the start, every 2 min, by 0.1, 0.2 and at most 0.6 K, 2 requests ignored; requests of zones.
ANSI/ASHRAE/IES 90.1: table 6.5.1.1.3, the fixed limit of an economiser (24 degC where it is dry); appendix G, sections
G3.1.3.4 and G3.1.3.9, outdoor temperatures between which water is reset (hot 20 and 50 degF, chilled 60 and 80 degF).
Return air and water are those of ``fc.design_day``; flows suit the presets.  The rest are usual values or guesses,
described in docs/years.md.

The noise of a day continues that of the day before, and each day can be made alone: its filters start in the white
noise of the day before.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date, timedelta
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

import fastcoil as fc
from fastcoil.base.arrays import Array, Mask
from fastcoil.loops.boundary.days import Drift, filter_white_noise
from fastcoil.loops.boundary.weather_files import read_weather
from fastcoil.model.moist_air import humidity_ratio, mix

Settings: TypeAlias = SimpleNamespace
"""Settings of the air handler; names and units as the arguments of `weather_year`."""
DAY_SECONDS = 86_400
DEFAULTS: dict[str, dict[str, Any]] = {
    "cooling": {
        "economiser": "differential", "economiser_limit": 24.0, "T_return": 24.0, "RH_return": 0.5, "T_balance": 12.0,
        "internal_load": 0.5, "set_point": "outdoor_reset", "T_set": 13.0, "T_set_min": 13.0, "T_set_max": 18.0,
        "T_out_min": 16.0, "T_out_max": 21.0, "T_w_in": 7.0, "T_w_min": 7.0, "T_w_max": 12.0, "T_out_w_min": 16.0,
        "T_out_w_max": 27.0,
    },
    "heating": {
        "economiser": "none", "economiser_limit": 24.0, "T_return": 21.0, "RH_return": 0.3, "T_balance": 15.0,
        "internal_load": 0.0, "set_point": "outdoor_reset", "T_set": 25.0, "T_set_min": 18.0, "T_set_max": 30.0,
        "T_out_min": -10.0, "T_out_max": 15.0, "T_w_in": 60.0, "T_w_min": 40.0, "T_w_max": 60.0, "T_out_w_min": -7.0,
        "T_out_w_max": 10.0,
    },
}  # fmt: skip
"""Defaults of `weather_year` by mode."""
PLANT_STEP_S = 10  # between the samples of the noise of the plant, straight between them
ZONE_STEP_S = 60  # the same of loads and flows
_PLANT_DRIFTS = {
    "m_a": Drift(0.013, 60), "T_a_in": Drift(0.10, 120), "W_a_in": Drift(0.009, 300), "T_w_in": Drift(0.05, 120),
}  # fmt: skip
"""As strong and as slow as that of `paper_day`; flow and humidity as a share.  The order numbers the random numbers."""
_ZONE_DRIFT = Drift(0.05, 1200)  # of the load of one zone, as a share: a guess


class Outdoors(NamedTuple):
    """Weather of a file: hour of the year, temperature [degC], humidity ratio, (n_rows,) each; mean pressure [Pa]."""

    hour_of_year: Array
    T: Array
    W: Array
    pressure: float

    @property
    def days(self) -> range:
        """Days of the year that the rows cover; before the first row its values hold, up to an hour."""
        first, last = float(self.hour_of_year[0]), float(self.hour_of_year[-1])
        return range(int(-(-(first - 1.0) // 24.0)) + 1, int(last // 24.0) + 1)

    def of_day(self, label: int) -> tuple[Array, Array]:
        """Return temperature and humidity ratio at the seconds of a day of the year, (86400,) each."""
        begin = 24.0 * (label - 1)
        low = max(int(np.searchsorted(self.hour_of_year, begin, side="right")) - 1, 0)
        rows = slice(low, int(np.searchsorted(self.hour_of_year, begin + 24.0)) + 1)
        hours_of_day = begin + np.arange(DAY_SECONDS) / 3600.0
        hours = self.hour_of_year[rows]
        return np.interp(hours_of_day, hours, self.T[rows]), np.interp(hours_of_day, hours, self.W[rows])


def weather_year(
    path: str | Path, *, year: int, mode: str = "cooling", days: Sequence[int] | None = None,
    fan_hours: tuple[float, float] = (6.0, 20.0), weekend_fan_hours: tuple[float, float] | None = None,
    m_a_design: float = 1.3, m_a_min: float = 0.5, outdoor_air_min: float = 0.25, T_design: float | None = None,
    zones: int = 20, zone_spread: float = 0.3, water: str = "fixed", disturbances: float = 1.0, seed: int = 1,
    **settings: Any,
) -> fc.Boundary:  # fmt: skip
    """Return days of a weather year, of 24 h each, with the operation of an air handler: a stream, made day by day.

    A day runs from midnight to midnight in the standard time of the site, its label is the day of the year.  Outside
    its hours the fan is off (``m_a`` = 0) and so is the loop (``enabled`` = 0).  The loop is also off where the mixture
    does not need the coil: from less than 0.2 K beyond the set-point until more than 0.5 K.

    Parameters
    ----------
    path
        An EPW, TMY3 or CSV file, as for ``fc.weather_day``; before its first row its values hold.
    year
        Year of the dates and of the days of the week.
    mode
        ``cooling`` or ``heating``: of the coil.
    days
        Days of the year, from 1; by default all.  A day below the one before it is one of the next year.
    fan_hours, weekend_fan_hours
        Hours of start and stop of the fan, Monday to Friday, and Saturday and Sunday (off by default).
    m_a_design, m_a_min, outdoor_air_min
        Air flow at full load, least air flow, and least flow of outdoor air while the fan runs [kg/s].
    T_design
        Outdoor temperature at which the building's shell has its full load [degC]; by default the one that 0.4 % of the
        hours of the file exceed, in heating fall below.
    zones, zone_spread
        Number of zones, and spread of their loads, as a share of their mean.
    water
        Entering water: ``fixed`` (``T_w_in``), ``load`` (from ``T_w_max`` without load to ``T_w_min`` at full load; in
        heating the other way round) or ``outdoor`` (``T_w_max`` up to the outdoor temperature ``T_out_w_min``,
        ``T_w_min`` from ``T_out_w_max`` on) [degC].
    disturbances, seed
        Noise faster than hours as a multiple of that of ``fc.paper_day`` (0: none), and its seed.
    **settings
        Others than `DEFAULTS`.  economiser: ``differential`` (more outdoor air where it is cooler than the return air),
        ``fixed`` (where it is cooler than ``economiser_limit`` [degC]) or ``none``.  set_point: ``fixed`` (``T_set``),
        ``outdoor_reset`` (``T_set_max`` up to the outdoor temperature ``T_out_min``, ``T_set_min`` from ``T_out_max``
        on, straight between) or ``trim_and_respond`` (the same, its ``T_set_max`` lowered by requests of the zones;
        cooling only) [degC].  T_return, RH_return: return air [degC, 1].  T_balance: outdoor temperature at which the
        shell has no load [degC].  internal_load: load by people and devices as a share of the design load; in heating
        it is subtracted.
    """
    if unknown := sorted(settings.keys() - DEFAULTS[mode].keys()):
        raise TypeError(f"weather_year takes no {', '.join(unknown)}")
    weather = read_weather(Path(path), None, None, None)
    p = weather.pressure(None)
    outdoors = Outdoors(
        weather.series["hour_of_year"], weather.series["T_drybulb"], weather.humidity(p), float(np.mean(p))
    )
    labels = list(outdoors.days) if days is None else list(days)
    dates = dates_of_labels(labels, year)
    s = Settings(
        **DEFAULTS[mode] | settings, cools=mode == "cooling", m_a_design=m_a_design, m_a_min=m_a_min,
        outdoor_air_min=outdoor_air_min, zones=zones, zone_spread=zone_spread, water=water, disturbances=disturbances,
        seed=seed, T_design=T_design,
    )  # fmt: skip
    if T_design is None:
        s.T_design = float(np.quantile(outdoors.T, 0.996 if s.cools else 0.004))
    if s.set_point == "fixed":
        s.T_set_min = s.T_set
    s.high_limit = {"differential": s.T_return, "fixed": s.economiser_limit, "none": -np.inf}[s.economiser]
    s.W_return = float(humidity_ratio(s.T_return, s.RH_return, outdoors.pressure))
    s.fan = {
        label: weekend_fan_hours if day.weekday() >= 5 else fan_hours for label, day in zip(labels, dates, strict=True)
    }
    start = [day.isoformat() for day in dates]
    make = partial(make_day_series, s, outdoors)
    return fc.Boundary.from_days(make, day=labels, hours=24, start=start, time_zone=weather.time_zone)


def dates_of_labels(labels: Sequence[int], first_year: int) -> list[date]:
    """Return the dates of days of the year; a day below the one before it is one of the next year."""
    year, previous_label, dates = first_year, 0, []
    for label in labels:
        year += label < previous_label
        # in the next year it is the same date, whatever the number of the day
        dates.append((date(first_year, 1, 1) + timedelta(days=label - 1)).replace(year=year))
        previous_label = label
    return dates


def make_day_series(s: Settings, outdoors: Outdoors, label: int) -> dict[str, Array]:
    """Return all series of a day by its label, the day of the year from 1: (86400,) each."""
    T_out, W_out = outdoors.of_day(label)
    begin, end = (round(3600 * hour) for hour in s.fan[label] or (0.0, 0.0))
    drifts = {name: s.disturbances * drift for name, drift in plant_drifts(s.seed, label).items()}
    minutes = slice(None, None, ZONE_STEP_S)
    mean_load = building_load(s, T_out[minutes], begin, end)
    loads = zone_loads(mean_load, s.zone_spread, s.disturbances * zone_drifts(s.seed, label, s.zones))
    T_set = set_point_series(s, T_out, loads, begin, end)
    flow = air_flow(s, loads, T_set[minutes])
    m_a = interpolate_to_seconds(np.append(flow, flow[-1]), ZONE_STEP_S) * (1.0 + drifts["m_a"])
    T_a_in, W_a_in = np.full(DAY_SECONDS, s.T_return), np.full(DAY_SECONDS, s.W_return)
    enabled = np.zeros(DAY_SECONDS)
    on = slice(begin, end)
    if end > begin:
        least = np.minimum(s.outdoor_air_min / m_a[on], 1.0)
        air = T_out[on], W_out[on], s.T_return, s.W_return
        requested_share = outdoor_share(*air, T_set[on], least, s.high_limit)
        T_mixed, W_mixed = mix(delay_by_dampers(requested_share), *air)
        # with the dampers at their target: the coil does not run only because they are still moving
        excess = s.T_return + requested_share * (T_out[on] - s.T_return) - T_set[on]
        enabled[on] = is_coil_needed(excess if s.cools else -excess)
        T_a_in[on] = T_mixed + drifts["T_a_in"][on]
        W_a_in[on] = W_mixed * (1.0 + drifts["W_a_in"][on])
    m_a[:begin] = m_a[end:] = 0.0
    T_w_in = water_temperature(s, T_out, loads) + drifts["T_w_in"]
    return {"m_a": m_a, "T_a_in": T_a_in, "W_a_in": W_a_in, "T_w_in": T_w_in, "T_set": T_set, "enabled": enabled}


def building_load(s: Settings, T_out: Array, begin: int, end: int) -> Array:
    """Load as a share of the design load each minute, 0 to 1; ``begin``, ``end``: seconds at which the fan runs.

    The internal load rises over two hours from the start of the fan, and falls over the last two.
    """
    outdoors = np.clip((T_out - s.T_balance) / (s.T_design - s.T_balance), 0.0, 1.0)
    hour = np.arange(T_out.size) * ZONE_STEP_S / 3600.0
    people = np.clip(np.minimum((hour - begin / 3600) / 2.0, (end / 3600 - hour) / 2.0), 0.0, 1.0)
    if not s.cools:
        return np.asarray(np.clip(outdoors - s.internal_load * people, 0.0, 1.0))
    return np.asarray((1.0 - s.internal_load) * outdoors + s.internal_load * people)


def set_point_series(s: Settings, T_out: Array, loads: Array, begin: int, end: int) -> Array:
    """Set-point at each second [degC]."""
    if s.set_point == "fixed":
        return np.full(DAY_SECONDS, s.T_set)
    top: Array | float = s.T_set_max
    if s.set_point == "trim_and_respond" and end > begin:
        step_seconds = np.arange(begin, end, TRIM_INTERVAL_S)
        limits = request_limits(loads[step_seconds // ZONE_STEP_S], s.T_return, s.T_set_min)
        reset_shares = reset_line(T_out[step_seconds], s.T_out_min, s.T_out_max, 0.0, 1.0)
        steps = trim_and_respond(s.T_set_min, s.T_set_max, reset_shares, limits)
        top = np.full(DAY_SECONDS, s.T_set_max)
        top[begin:end] = np.repeat(steps, TRIM_INTERVAL_S)[: end - begin]
    return reset_line(T_out, s.T_out_min, s.T_out_max, top, s.T_set_min)


def air_flow(s: Settings, loads: Array, T_set: Array) -> Array:
    """Air flow each minute [kg/s]."""
    if not s.cools:
        return np.asarray(s.m_a_min + (s.m_a_design - s.m_a_min) * np.clip(loads, 0.0, 1.0).mean(axis=1))
    return np.asarray(s.m_a_design * flow_share(loads, T_set, s.T_return, s.T_set_min, s.m_a_min / s.m_a_design))


def water_temperature(s: Settings, T_out: Array, loads: Array) -> Array:
    """Temperature of the entering water at each second [degC]."""
    if s.water == "fixed":
        return np.full(DAY_SECONDS, s.T_w_in)
    if s.water == "outdoor":
        return reset_line(T_out, s.T_out_w_min, s.T_out_w_max, s.T_w_max, s.T_w_min)
    mean = np.clip(loads, 0.0, 1.0).mean(axis=1)
    share = interpolate_to_seconds(np.append(mean, mean[-1]), ZONE_STEP_S)  # the last minute holds
    idle, full = (s.T_w_max, s.T_w_min) if s.cools else (s.T_w_min, s.T_w_max)
    return np.asarray(idle + share * (full - idle))


def plant_drifts(seed: int, day: int) -> dict[str, Array]:
    """Noise of the plant by series at the seconds of a day, (86400,) each."""
    white = _white_noise(PLANT_STEP_S, seed, day, 0, len(_PLANT_DRIFTS))
    return {
        name: interpolate_to_seconds(_drift_noise(drift, PLANT_STEP_S, row), PLANT_STEP_S)
        for (name, drift), row in zip(_PLANT_DRIFTS.items(), white, strict=True)
    }


def zone_drifts(seed: int, day: int, n_zones: int) -> Array:
    """Noise of the loads of the zones each `ZONE_STEP_S` seconds of a day, (1440, n_zones)."""
    white = _white_noise(ZONE_STEP_S, seed, day, 1, n_zones)
    return np.stack([_drift_noise(_ZONE_DRIFT, ZONE_STEP_S, row)[:-1] for row in white], axis=1)


def interpolate_to_seconds(values: Array, step: int) -> Array:
    """Interpolate values each ``step`` seconds, (n + 1,), to every second but the last one, (n step,)."""
    return np.asarray((values[:-1, None] + np.multiply.outer(np.diff(values), np.arange(step) / step)).ravel())


def _drift_noise(drift: Drift, step: int, white: Array) -> Array:
    """Filter white noise of two days: noise each ``step`` seconds of the second, (86400 / step + 1,)."""
    coarse = Drift(drift.std, drift.tau // step)
    return filter_white_noise(white[DAY_SECONDS // step - 10 * coarse.tau - 1 :].copy(), coarse)


def _white_noise(step: int, seed: int, day: int, stream: int, n: int) -> Array:
    """Draw white noise of the day before and of a day, (n, 2 x 86400 / step)."""
    sources = [np.random.SeedSequence(seed, spawn_key=(noise_day, stream)) for noise_day in (day - 1, day)]
    shape = (n, DAY_SECONDS // step)
    return np.concatenate([np.random.default_rng(source).standard_normal(shape) for source in sources], axis=1)


DAMPER_STROKE_S = 90  # of a full stroke of the dampers: usual for their motors
COIL_ON_K = 0.5  # deviation of the mixture from the set-point at which the loop of the coil is switched on
COIL_OFF_K = 0.2  # the same, switched off


def outdoor_share(
    T_out: Array, W_out: Array, T_return: float, W_return: float, T_set: Array, least: Array, limit: float
) -> Array:
    """Share of outdoor air in the dry air of the mixture that an economiser requests, (n,), from ``least`` to 1.

    Below the outdoor temperature ``limit`` [degC] it is the share whose mixture has the temperature ``T_set``, by the
    balance of enthalpy; elsewhere ``least``.
    """
    warm = (1.006 + 1.86 * W_return) * np.maximum(T_return - T_set, 0.0)
    cold = (1.006 + 1.86 * W_out) * np.maximum(T_set - T_out, 0.0)
    exact_share = np.divide(warm, warm + cold, out=np.ones_like(T_out), where=cold > 0.0)
    return np.where(T_out < limit, np.maximum(exact_share, least), least)


def delay_by_dampers(share: Array) -> Array:
    """Average a share, (n,), over the last ``DAMPER_STROKE_S`` seconds, as the dampers follow it from rest."""
    total = np.cumsum(np.concatenate((np.zeros(1), np.full(DAMPER_STROKE_S, share[0]), share)))
    return np.asarray((total[DAMPER_STROKE_S + 1 :] - total[1:-DAMPER_STROKE_S]) / DAMPER_STROKE_S)


def is_coil_needed(missing: Array) -> Mask:
    """Where the loop of the coil is on, (n,): from `COIL_ON_K` missing until less than `COIL_OFF_K` is."""
    decides = (missing > COIL_ON_K) | (missing < COIL_OFF_K)
    decides[0] = True
    return np.asarray(missing[np.maximum.accumulate(np.where(decides, np.arange(missing.size), 0))] > COIL_ON_K)


def zone_loads(mean: Array, spread: float, noise: Array) -> Array:
    """Loads of the zones, (n_times, n_zones), at least 0.

    mean: their mean, (n_times,).  spread: the zones lie evenly between 1 - spread and 1 + spread times the mean.
    noise: added to each zone, (n_times, n_zones), as a share of the mean.
    """
    n_zones = noise.shape[1]
    shares = np.linspace(1.0 - spread, 1.0 + spread, n_zones) if n_zones > 1 else np.ones(1)
    return np.asarray(np.maximum(mean[:, None] * (shares + noise), 0.0))


def flow_share(loads: Array, T_set: Array, T_zone: float, T_set_min: float, least: float) -> Array:
    """Mean flow of the zones over their full flow, (n_times,)."""
    return np.asarray(np.clip(loads * ((T_zone - T_set_min) / (T_zone - T_set))[:, None], least, 1.0).mean(axis=1))


def request_limits(loads: Array, T_zone: float, T_set_min: float) -> Array:
    """Set-points at which zones send one request, stop doing so, send two, and three, (n_times, 4, n_zones) [degC].

    Guideline 36, section 5.6.8.1: one request from 95 % of the full flow of the zone until it falls below 85 %, two
    where the zone is 2 K too warm, three from 3 K.  With the set-point T a zone of load L takes the share
    L (T_zone - T_set_min) / (T_zone - T) of its full flow, and at full flow its temperature is
    T + L (T_zone - T_set_min).
    """
    rise = loads * (T_zone - T_set_min)
    return np.stack([T_zone - rise / 0.95, T_zone - rise / 0.85, T_zone - rise + 2.0, T_zone - rise + 3.0], 1)


def reset_line(T_out: Array, T_out_min: float, T_out_max: float, at_min: Array | float, at_max: float) -> Array:
    """Return ``at_min`` up to ``T_out_min``, ``at_max`` from ``T_out_max`` on, and a straight line between them."""
    return np.asarray(at_min + np.clip((T_out - T_out_min) / (T_out_max - T_out_min), 0.0, 1.0) * (at_max - at_min))


TRIM_DELAY_S, TRIM_INTERVAL_S = 600, 120  # from the start of the fan to the first step, and from step to step
TRIM_K, RESPOND_K, RESPOND_MAX_K = 0.1, 0.2, 0.6  # up each time; down for each request that counts, and at most
IGNORED_REQUESTS = 2  # which do not count


def trim_and_respond(low: float, high: float, share: Array, limits: Array) -> Array:
    """Upper end of the reset line at each time step, (n_times,): starts at ``high``, lowered by requests to ``low``.

    share: position of the outdoor temperature on the reset line, (n_times,).  limits: see `request_limits`, at each
    step.
    """
    value, values = high, np.empty(share.size)
    is_requesting = np.zeros(limits.shape[2], dtype=bool)
    for k, reset_share in enumerate(share.tolist()):
        is_above = value + reset_share * (low - value) > limits[k]
        is_requesting = is_above[0] | (is_requesting & is_above[1])
        if k * TRIM_INTERVAL_S >= TRIM_DELAY_S:
            n_requests = int(np.count_nonzero(is_requesting) + np.count_nonzero(is_above[2:]))
            response = min(RESPOND_K * max(n_requests - IGNORED_REQUESTS, 0), RESPOND_MAX_K)
            value = min(max(value + TRIM_K - response, low), high)
        values[k] = value
    return values
