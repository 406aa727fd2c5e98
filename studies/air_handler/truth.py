"""What shows in a simulated air handler, and when: signs of faults, loops and set-points that swing or are missed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from fastcoil.model.numerics.jit import kernel
from studies.air_handler.plant import LOG_STEPS, STEP

COOLING, HEATING, SUPPLY, ENTERING, SET_POINT, FAN, BOTH = (
    "cooling valve", "heating valve", "supply air", "entering air", "set-point", "fan", "both valves"
)  # fmt: skip
SIDES = {COOLING: "cooling", HEATING: "heating"}
LEAK, STUCK_OPEN, STUCK, STUCK_SHUT, UNDERSIZED, NO_WATER = (
    "leak", "stuck_open", "stuck", "stuck_shut", "undersized", "no_water"
)  # fmt: skip
FIGHT, SWINGS, HUNT, FROZEN, OFFSET, UNOCCUPIED = (
    "fight", "set_point_swings", "hunt", "sensor_stuck", "sensor_offset", "unoccupied"
)  # fmt: skip
ROWS_PER_DAY = int(86400 / STEP) // LOG_STEPS
SHOWS_MINUTES = 90  # a fault shows on a day if its signs last so long
LEAK_KELVIN = 4.0  # effect of a coil whose valve should be shut: sensors of mixed air are off by up to 2.3 K
HUNTS_MINUTES, HUNTS_KELVIN, SWINGS_KELVIN = 60, 1.5, 2.5  # swings from peak to peak
"""A loop hunts, or a set-point swings, on a day whose regular swings above a size last so long; without any of half the
size it is calm."""
UNMET_MINUTES, UNMET_KELVIN = 60, 1.0

Days = dict[str, tuple[int, ...]]


class Truth(NamedTuple):
    """What is wrong with a unit."""

    component: str
    kind: str
    size: float
    cause: str  # of hunting
    days: tuple[int, ...]
    """Days on which the fault is there, from 0."""
    windows: list[tuple[pd.Timestamp, pd.Timestamp]]
    """When it shows."""
    shown_days: tuple[int, ...]
    """Days on which it shows for ``SHOWS_MINUTES``, or for hunting ``HUNTS_MINUTES``."""


class Observed(NamedTuple):
    """Days on which something really happens, whatever the fault, by component."""

    hunting: Days
    """Loops of the valves hunt; the set-point swings."""
    calm: Days
    """The same are calm, the loops while in control for an hour."""
    unmet: Days
    """Set-points of the valves are missed by ``UNMET_KELVIN`` for ``UNMET_MINUTES``."""
    fighting: tuple[int, ...]
    """Both valves are open, as where one of the loops hunts."""


@kernel
def regular_swings(x: np.ndarray, moves: np.ndarray, kelvin: float, least: int, most: int) -> np.ndarray:
    """Minutes of regular swings of more than ``kelvin`` from peak to peak.

    Regular: at least six extremes in a row, ``least`` to ``most`` minutes apart, of which neighbours differ by a factor
    of 2 at most.  moves: a signal that must not stand still between two of them; NaN forbids a minute.
    """
    swings, extremes = np.zeros(x.size, np.bool_), [0]
    low, high, last_low, last_high, rises = np.inf, -np.inf, 0, 0, True
    for k in range(x.size):
        if x[k] < low:
            low, last_low = x[k], k
        if x[k] > high:
            high, last_high = x[k], k
        if (rises and x[k] < high - kelvin) or (not rises and x[k] > low + kelvin):
            extremes.append(last_high if rises else last_low)
            low, high, last_low, last_high, rises = x[k], x[k], k, k, not rises
    first, previous = 1, 0
    for j in range(1, len(extremes)):
        apart, part = (0, moves[:1]) if j + 1 == len(extremes) else (
            extremes[j + 1] - extremes[j], moves[extremes[j] : extremes[j + 1] + 1]
        )  # fmt: skip
        is_like_before = j == first or (0.5 * previous <= apart <= 2.0 * previous)
        if not (is_like_before and least <= apart <= most and part.max() - part.min() > 0.01):
            if j - first >= 5:
                swings[extremes[first] : extremes[j]] = True
            first = j + 1
        previous = apart
    return swings


def swinging_minutes(s: pd.DataFrame, component: str, kelvin: float) -> np.ndarray:
    """Minutes in which a valve's loop swings about its set-point, every 2 to 50 min, or a set-point, 30 to 120 min."""
    x, moves, minutes = s.T_set_cooling, s.T_set_cooling, (15, 60)
    if component in SIDES:
        x, moves, minutes = missed_kelvin(s, component), s[f"{SIDES[component]}_command"], (1, 25)
    return regular_swings(x.to_numpy(), moves.where(s.enabled > 0.5).to_numpy(), kelvin, *minutes)


def missed_kelvin(s: pd.DataFrame, valve: str) -> pd.Series:
    """Return by how much the air is too warm for the cooling loop, or too cold for the heating loop, K."""
    return s.T_sup - s.T_set_cooling if valve == COOLING else s.T_set_heating - s.T_sup


def signs_of(fault: str, component: str, s: pd.DataFrame, frozen_at: float) -> np.ndarray:
    """Minutes in which a fault that is there shows in what is logged.

    frozen_at: what a stuck sensor should have read when it stuck, °C.
    """
    if fault == HUNT:
        return swinging_minutes(s, component, HUNTS_KELVIN)
    if fault in (FROZEN, OFFSET):
        signs = abs((s.T_sup if component == SUPPLY else s.T_mixed) - frozen_at) > 1.0 if fault == FROZEN else True
    elif fault == FIGHT:
        signs = s[["cooling_command", "heating_command"]].min(axis=1) > 0.05
    elif fault == UNOCCUPIED:
        signs = s.occupied < 0.5
    elif fault == SWINGS:
        signs = True
    else:
        command = s[f"{SIDES[component]}_command"]
        # the air after both coils: what the other valve makes up for is seen by no sensor
        effect = (s.T_cooled - s.T_mixed) * (-1.0 if component == COOLING else 1.0)
        passes = (command < 0.01) & (effect > LEAK_KELVIN)
        lacks = (command > 0.9) & (missed_kelvin(s, component) > UNMET_KELVIN)
        signs = {LEAK: passes, STUCK_OPEN: passes, STUCK: passes | lacks}.get(fault, lacks)
    return np.asarray((s.enabled > 0.5) & signs)


def days_with(minutes: np.ndarray, least: int) -> tuple[int, ...]:
    """Days with at least so many minutes."""
    return tuple(int(k) for k in np.flatnonzero(minutes.reshape(-1, ROWS_PER_DAY).sum(1) >= least))


def windows_of(signs: np.ndarray, index: pd.DatetimeIndex) -> list[tuple[pd.Timestamp, pd.Timestamp]]:
    """Windows of the minutes that are true, those up to half an hour apart joined."""
    minutes = np.flatnonzero(signs)
    parts = np.split(minutes, np.flatnonzero(np.diff(minutes) > 30) + 1) if minutes.size else []
    return [(index[part[0]], index[part[-1]]) for part in parts]


def observe_days(s: pd.DataFrame) -> Observed:
    """Observe loops and set-points, without noise and offsets of sensors."""
    fighting = days_with(signs_of(FIGHT, BOTH, s, np.nan), SHOWS_MINUTES)
    observed, is_on = Observed({}, {}, {}, fighting), s.enabled > 0.5
    for name in (*SIDES, SET_POINT):
        controls, kelvin = is_on, SWINGS_KELVIN
        if name in SIDES:
            controls, kelvin = is_on & s[f"{SIDES[name]}_command"].between(0.02, 0.98), HUNTS_KELVIN
            missed = is_on & (missed_kelvin(s, name) > UNMET_KELVIN)
            observed.unmet[name] = days_with(missed.to_numpy(), UNMET_MINUTES)
        observed.hunting[name] = days_with(swinging_minutes(s, name, kelvin), HUNTS_MINUTES)
        stirred = days_with(swinging_minutes(s, name, 0.5 * kelvin), 1)
        observed.calm[name] = tuple(k for k in days_with(controls.to_numpy(), 60) if k not in stirred)
    return observed
