"""The zones behind an air handler, as far as its set-point and its air flow need them: a stand-in, not a building.

Each zone has a load, as a share of what it gets at full air flow and the lowest set-point.  It takes the air that keeps
its temperature, between a least and its full flow; at full flow it becomes warmer instead.  It holds no heat: load,
flow and temperature of a minute belong together.  Requests count as in ASHRAE Guideline 36-2021, section 5.6.8.1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array

LOOP_HIGH, LOOP_LOW = 0.95, 0.85
"""A zone asks once from the upper share of its full flow on until it is below the lower one."""
WARM, HOT = 2.0, 3.0
"""A zone so many kelvins too warm asks twice, and three times."""


class Limits(NamedTuple):
    """Set-points above which zones ask, each (n_times, n_zones) [degC]: once, until when, twice, three times."""

    once: Array
    until: Array
    twice: Array
    thrice: Array


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
    wanted = loads * ((T_zone - T_set_min) / (T_zone - T_set))[:, None]
    return np.asarray(np.clip(wanted, least, 1.0).mean(axis=1))


def request_limits(loads: Array, T_zone: float, T_set_min: float) -> Limits:
    """Set-points at which the zones begin to ask, and stop.

    With the set-point T a zone of load L wants the share L (T_zone - T_set_min) / (T_zone - T) of its full flow, and at
    full flow it has the temperature T + L (T_zone - T_set_min).
    """
    rise = loads * (T_zone - T_set_min)
    return Limits(T_zone - rise / LOOP_HIGH, T_zone - rise / LOOP_LOW, T_zone - rise + WARM, T_zone - rise + HOT)
