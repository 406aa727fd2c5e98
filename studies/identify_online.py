"""What ``estimator = "identify"`` does over a population of valves: does it find the backlash, how soon, what harm?

Run with ``python studies/identify_online.py``.  Valves and loops are drawn like those of ``remedies.toml``, with the
gains as somebody left them, on days that no threshold was chosen on.  Right means: within 20 % of the true backlash or
1 % of the stroke.  Harm is measured against plain PI with the same gains, days and noise.
"""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from kinds import HEATING, STEPPED, kinds, of_kind, settings
from population import share
from report import write_table

import fastcoil as fc

SEED, VALVES = 9214, 512
DAYS = range(92141, 92144)
LONG_HOURS = 24
"""Stepped days of this length stand for three of 8 h."""
HEATING_GAIN = 0.3
"""The drawn kp is for cooling; a loop with water of 40 °C responds about three times as much."""
IDENTIFY = {
    "estimator": "identify", "estimate_share": 0.95, "buffer_ratio": 6.0, "buffer_noise": "measured",
    "buffer_swing": 0.1,
}  # fmt: skip
"""The recommended setting; ``plant_gain`` limits the buffer."""
PLANT_GAIN = 20.0
WORSE = 0.01
"""Rise of the RMSE that counts as harm."""


def population(seed: int = SEED, size: int = VALVES, heating: bool = False) -> fc.Loop:
    """Valves and loops along ``sample``."""
    draw = np.random.default_rng([seed, 5])

    def loguniform(low: float, high: float) -> np.ndarray:
        return np.exp(draw.uniform(np.log(low), np.log(high), size))

    drawn = {
        "backlash": draw.choice([0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15], size),
        "rangeability": loguniform(20, 100),
        "authority": loguniform(0.05, 0.9),
        "C_w": draw.uniform(8.8, 14.0, size),
        "C_c": loguniform(10, 30),
        "kp": loguniform(0.005, 0.06) * (HEATING_GAIN if heating else 1.0),
        "ti": loguniform(20, 300),
        "sample_time": draw.choice([5.0, 10.0, 15.0, 30.0], size),
        "noise_std": draw.uniform(0.0, 0.05, size),
        "sensor_time_constant": draw.uniform(5, 60, size),
        "stroke_time": draw.uniform(30, 150, size),
    }
    values = {name: ("sample", each) for name, each in drawn.items()}
    return fc.Loop.preset("lbnl").assign(m_full=1.7, estimate_ratio=0.0, **values)
