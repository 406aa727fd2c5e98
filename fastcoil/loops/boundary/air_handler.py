"""How an air handler is run, and its operation on one day: everything that acts on its coil."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from fastcoil.base.arguments import checking, choice_of, whole_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.loops.boundary.air_handler_parts import (
    DAY,
    ZONE_STEP,
    Outdoors,
    Trim,
    between,
    by_second,
    coil_is_needed,
    flow_share,
    outdoor_share,
    plant_drifts,
    request_limits,
    through_dampers,
    trim_and_respond,
    zone_drifts,
    zone_loads,
)
from fastcoil.loops.boundary.conditions import CONDITIONS, condition_of
from fastcoil.model.moist_air import humidity_ratio, mix

_BY_MODE: dict[str, tuple[Any, Any]] = {
    "economiser": ("differential", "none"),
    "economiser_limit": (24.0, 24.0),
    "T_return": (24.0, 21.0),
    "RH_return": (0.5, 0.3),
    "T_balance": (12.0, 15.0),
    "internal_load": (0.5, 0.0),
    "set_point": ("outdoor_reset", "outdoor_reset"),
    "T_set": (13.0, 25.0),
    "T_set_min": (13.0, 18.0),
    "T_set_max": (18.0, 30.0),
    "T_out_min": (16.0, -10.0),
    "T_out_max": (21.0, 15.0),
    "T_w_in": (7.0, 60.0),
    "T_w_min": (7.0, 40.0),
    "T_w_max": (12.0, 60.0),
    "T_out_w_min": (16.0, -7.0),
    "T_out_w_max": (27.0, 10.0),
}
"""Defaults in cooling and in heating; the module `weather_year` names the sources."""
DEFAULTS = {mode: {n: pair[k] for n, pair in _BY_MODE.items()} for k, mode in enumerate(("cooling", "heating"))}
"""Defaults of `weather_year`, by mode."""
CHOICES = {
    "economiser": ("differential", "fixed", "none"),
    "set_point": ("fixed", "outdoor_reset", "trim_and_respond"),
    "water": ("fixed", "load", "outdoor"),
}
_WHOLE = {
    "zones": (1, 1000),
    "ignored_requests": (0, 3000),
    "trim_delay": (0, 86_400),
    "trim_interval": (1, 86_400),
    "seed": (0, 2**32 - 1),
}
_USED_WITH = {
    "economiser_limit": ("economiser", ("fixed",)),
    "T_set": ("set_point", ("fixed",)),
    **dict.fromkeys(
        ("T_set_min", "T_set_max", "T_out_min", "T_out_max"), ("set_point", ("outdoor_reset", "trim_and_respond"))
    ),
    "T_w_in": ("water", ("fixed",)),
    **dict.fromkeys(("T_w_min", "T_w_max"), ("water", ("load", "outdoor"))),
    **dict.fromkeys(("T_out_w_min", "T_out_w_max"), ("water", ("outdoor",))),
}
"""Arguments that only some choices read: which, and with what."""
_ORDERED = (
    ("m_a_min", "m_a_design"),
    ("outdoor_air_min", "m_a_design"),
    ("T_set_min", "T_set_max"),
    ("T_out_min", "T_out_max"),
    ("T_w_min", "T_w_max"),
    ("T_out_w_min", "T_out_w_max"),
)
LEAST_COOLING = 2.0
"""Kelvins by which the supply air must be cooler than the zones, which would take endless air otherwise."""


class Settings(SimpleNamespace):
    """How the air handler is run; names and units as the arguments of `weather_year`.

    fan: first and last hour of the fan by day label, None where it stands.  W_return: humidity ratio of the return air.
    trim: a `Trim`.
    """

    @property
    def cools(self) -> bool:
        return bool(self.mode == "cooling")

    @property
    def high_limit(self) -> float:
        """Outdoor temperature from which the economiser is locked out [degC]."""
        limits = {"differential": self.T_return, "fixed": self.economiser_limit, "none": -np.inf}
        return float(limits[self.economiser])


def chosen_settings(given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `weather_year`, checked and completed with the defaults of the mode.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    with checking() as check:
        mode = check(choice_of, "mode", given["mode"], DEFAULTS)
        chosen: dict[str, Any] = {
            name: check.unless_none(choice_of, name, given[name], choices) for name, choices in CHOICES.items()
        }
        for name in [name for name in given if name in CONDITIONS and name != "pressure"]:
            left_out = given[name] is None and (name in DEFAULTS["cooling"] or name == "T_design")
            chosen[name] = None if left_out else check(condition_of, name, given[name])
        chosen |= {name: check(whole_of, name, given[name], *bounds) for name, bounds in _WHOLE.items()}
    given_names = {name for name, value in chosen.items() if value is not None}
    chosen |= {name: value for name, value in DEFAULTS[mode].items() if name not in given_names}
    chosen["mode"] = mode
    if problems := _clashes(chosen, given_names):
        raise InputError(problems)
    return chosen


def settings_of(
    chosen: Mapping[str, Any], outdoors: Outdoors, fan: Mapping[int, tuple[float, float] | None], file: str
) -> Settings:
    """The settings at a site."""
    own = dict(chosen)
    warmest = chosen["mode"] == "cooling"
    if own["T_design"] is None:
        own["T_design"] = float(np.quantile(outdoors.T, 0.996 if warmest else 0.004))
    low, high = ("T_balance", "T_design") if warmest else ("T_design", "T_balance")
    if own[high] - own[low] < 1.0:
        raise InputError(
            f"T_balance = {own['T_balance']:g} degC, T_design = {own['T_design']:.4g} degC in {file}: give a "
            f"{low} at least 1 K below {high}"
        )
    if own["set_point"] == "fixed":
        own["T_set_min"] = own["T_set"]
    trim = Trim(**{name: own.pop(name) for name in Trim._fields})
    return Settings(
        **own,
        trim=trim,
        fan=fan,
        W_return=float(humidity_ratio(own["T_return"], chosen["RH_return"], outdoors.pressure)),
    )


def _clashes(chosen: Mapping[str, Any], given: set[str]) -> list[str]:
    """Arguments that contradict each other, a sentence each."""
    problems = [
        f"{name} = {chosen[name]:g} has no effect with {word} = {chosen[word]!r}: leave it out, or choose "
        + " or ".join(map(repr, choices))
        for name, (word, choices) in _USED_WITH.items()
        if name in given and chosen[word] not in choices
    ]
    problems += [
        f"{low} = {chosen[low]:g} is not below {high} = {chosen[high]:g}: exchange or change them"
        for low, high in _ORDERED
        if not chosen[low] < chosen[high]
    ]
    if chosen["mode"] == "heating":
        if chosen["economiser"] != "none":
            problems.append(f"economiser = {chosen['economiser']!r}: only cooling has one, choose 'none'")
        if chosen["set_point"] == "trim_and_respond":
            problems.append("set_point = 'trim_and_respond': only cooling has it, choose 'outdoor_reset' or 'fixed'")
        return problems
    top = "T_set" if chosen["set_point"] == "fixed" else "T_set_max"
    if chosen[top] > chosen["T_return"] - LEAST_COOLING:
        problems.append(
            f"{top} = {chosen[top]:g} degC: the zones need air at least {LEAST_COOLING:g} K cooler than T_return = "
            f"{chosen['T_return']:g} degC, lower it"
        )
    return problems


PEOPLE_COME, PEOPLE_GO = 2.0, 2.0
"""Hours after the start of the fan over which the internal load rises, and before its stop over which it falls."""


def series_of_day(s: Settings, outdoors: Outdoors, label: int) -> dict[str, Array]:
    """All series of a day by its label, the day of the year from 1: (86400,) each."""
    T_out, W_out = outdoors.of_day(label)
    begin, end = (round(3600 * hour) for hour in s.fan[label] or (0.0, 0.0))
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
    return np.asarray(s.m_a_design * flow_share(loads, T_set, s.T_return, s.T_set_min, s.m_a_min / s.m_a_design))


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
