"""The operation of an air handler on one day: everything that acts on its coil, from the weather and its settings."""

from __future__ import annotations

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.loops.boundary.operation.drifts import ZONE_STEP, by_second, plant_drifts, zone_drifts
from fastcoil.loops.boundary.operation.mixing import coil_is_needed, outdoor_share, through_dampers
from fastcoil.loops.boundary.operation.set_point import between, trim_and_respond
from fastcoil.loops.boundary.operation.settings import Settings
from fastcoil.loops.boundary.operation.weather import DAY, Outdoors
from fastcoil.loops.boundary.operation.zones import flow_share, request_limits, zone_loads
from fastcoil.model.moist_air import mix

PEOPLE_COME, PEOPLE_GO = 2.0, 2.0
"""Hours after the start of the fan over which the internal load rises, and before its stop over which it falls."""


def series_of_day(s: Settings, outdoors: Outdoors, label: int) -> dict[str, Array]:
    """All series of a day by its label, the day of the year from 1: (86400,) each."""
    T_out, W_out = outdoors.of_day(label)
    begin, end = (round(3600 * hour) for hour in s.fan.get(label, (0.0, 0.0)))
    drifts = {name: s.disturbances * drift for name, drift in plant_drifts(s.seed, label).items()}
    minutes = slice(None, None, ZONE_STEP)
    mean_load = load(s, T_out[minutes], begin, end)
    loads = zone_loads(mean_load, s.zone_spread, s.disturbances * zone_drifts(s.seed, label, s.zones))
    T_set = set_point(s, T_out, loads, begin, end)
    flow = air_flow(s, loads, T_set[minutes])
    m_a = _by_second(flow) * (1.0 + drifts["m_a"])
    T_a_in, W_a_in = np.full(DAY, s.T_return), np.full(DAY, s.W_return)
    enabled = np.zeros(DAY)
    on = slice(begin, end)
    if end > begin:
        least = np.minimum(s.outdoor_air_min / m_a[on], 1.0)
        air = T_out[on], W_out[on], s.T_return, s.W_return
        wanted = outdoor_share(*air, T_set[on], least, s.high_limit)
        T_mixed, W_mixed = mix(through_dampers(wanted), *air)
        # As the dampers will have it: the coil does not help out while they move.
        beyond = s.T_return + wanted * (T_out[on] - s.T_return) - T_set[on]
        enabled[on] = coil_is_needed(beyond if s.cools else -beyond)
        T_a_in[on] = T_mixed + drifts["T_a_in"][on]
        W_a_in[on] = W_mixed * (1.0 + drifts["W_a_in"][on])
    m_a[:begin] = m_a[end:] = 0.0
    return {
        "m_a": m_a,
        "T_a_in": T_a_in,
        "W_a_in": W_a_in,
        "T_w_in": water_temperature(s, T_out, loads) + drifts["T_w_in"],
        "T_set": T_set,
        "enabled": enabled,
    }


def load(s: Settings, T_out: Array, begin: int, end: int) -> Array:
    """Load as a share of the design load, from the outdoor temperature each minute, 0 to 1; seconds of the fan."""
    outdoors = np.clip((T_out - s.T_balance) / (s.T_design - s.T_balance), 0.0, 1.0)
    hour = np.arange(T_out.size) * ZONE_STEP / 3600.0
    people = np.clip(np.minimum((hour - begin / 3600) / PEOPLE_COME, (end / 3600 - hour) / PEOPLE_GO), 0.0, 1.0)
    if not s.cools:
        return np.asarray(np.clip(outdoors - s.internal_load * people, 0.0, 1.0))
    return np.asarray((1.0 - s.internal_load) * outdoors + s.internal_load * people)


def set_point(s: Settings, T_out: Array, loads: Array, begin: int, end: int) -> Array:
    """Set-point at each second [degC]."""
    if s.set_point == "fixed":
        return np.full(DAY, s.T_set)
    top: Array | float = s.T_set_max
    if s.set_point == "trim_and_respond" and end > begin:
        at = np.arange(begin, end, s.trim.trim_interval)
        limits = request_limits(loads[at // ZONE_STEP], s.T_return, s.T_set_min)
        share = between(T_out[at], s.T_out_min, s.T_out_max, 0.0, 1.0)
        steps = trim_and_respond(s.trim, s.T_set_min, s.T_set_max, share, limits)
        top = np.full(DAY, s.T_set_max)
        top[begin:end] = np.repeat(steps, s.trim.trim_interval)[: end - begin]
    return between(T_out, s.T_out_min, s.T_out_max, top, s.T_set_min)


def air_flow(s: Settings, loads: Array, T_set: Array) -> Array:
    """Air flow each minute [kg/s]."""
    if not s.cools:
        share = np.clip(loads, 0.0, 1.0).mean(axis=1)
        return np.asarray(s.m_a_min + (s.m_a_design - s.m_a_min) * share)
    return s.m_a_design * flow_share(loads, T_set, s.T_return, s.T_set_min, s.m_a_min / s.m_a_design)


def water_temperature(s: Settings, T_out: Array, loads: Array) -> Array:
    """Temperature of the entering water at each second [degC]."""
    if s.water == "fixed":
        return np.full(DAY, s.T_w_in)
    if s.water == "outdoor":
        return between(T_out, s.T_out_w_min, s.T_out_w_max, s.T_w_max, s.T_w_min)
    share = _by_second(np.clip(loads, 0.0, 1.0).mean(axis=1))
    idle, full = (s.T_w_max, s.T_w_min) if s.cools else (s.T_w_min, s.T_w_max)
    return np.asarray(idle + share * (full - idle))


def _by_second(each_minute: Array) -> Array:
    """Straight between the minutes of a day; the last one holds."""
    return by_second(np.append(each_minute, each_minute[-1]), ZONE_STEP)
