"""What changes faster than hourly weather: slow smooth noise of the plant and of the zones, day by day.

The noise of a day goes on where that of the day before ended, and each day can be made alone: its filters start in the
white noise of the day before.
"""

from __future__ import annotations

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.loops.boundary.drift import Drift, smooth
from fastcoil.loops.boundary.operation.weather import DAY

PLANT_STEP, ZONE_STEP = 10, 60
"""Seconds between the samples of the noise, straight between them."""
_PLANT = {
    "m_a": Drift(0.013, 60),
    "T_a_in": Drift(0.10, 120),
    "W_a_in": Drift(0.009, 300),
    "T_w_in": Drift(0.05, 120),
}
"""As strong and as slow as that of `paper_day`; flow and humidity as a share.  The order numbers the random numbers."""
_ZONE = Drift(0.05, 1200)
"""Of the load of one zone, as a share: a guess."""


def plant_drifts(seed: int, day: int) -> dict[str, Array]:
    """Noise of the plant by series at the seconds of a day, (86400,) each."""
    white = _white(PLANT_STEP, seed, day, 0, len(_PLANT))
    return {
        name: by_second(_noise(drift, PLANT_STEP, one), PLANT_STEP)
        for (name, drift), one in zip(_PLANT.items(), white, strict=True)
    }


def zone_drifts(seed: int, day: int, n_zones: int) -> Array:
    """Noise of the loads of the zones each `ZONE_STEP` seconds of a day, (1440, n_zones)."""
    white = _white(ZONE_STEP, seed, day, 1, n_zones)
    return np.stack([_noise(_ZONE, ZONE_STEP, one)[:-1] for one in white], axis=1)


def by_second(values: Array, step: int) -> Array:
    """Values each ``step`` seconds, (n + 1,), at every second up to the last one, (n step,), straight between them."""
    part = np.multiply.outer(np.diff(values), np.arange(step) / step)
    return np.asarray((values[:-1, None] + part).ravel())


def _noise(drift: Drift, step: int, white: Array) -> Array:
    """Noise each ``step`` seconds from midnight to midnight from the white noise of two days, (86400 / step + 1,)."""
    coarse = Drift(drift.std, drift.tau // step)
    return smooth(white[DAY // step - 10 * coarse.tau - 1 :].copy(), coarse)


def _white(step: int, seed: int, day: int, stream: int, n: int) -> Array:
    """White noise of the day before and of a day, (n, 2 x 86400 / step)."""
    draws = [
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(one, stream))).standard_normal((n, DAY // step))
        for one in (day - 1, day)
    ]
    return np.concatenate(draws, axis=1)
