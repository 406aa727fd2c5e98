"""A made-up record that takes a controller through all that it does: what it would see, cycle by cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fastcoil.arrays import Array
from fastcoil.handover.settings import Settings

LARGEST_ERROR = 25.0
"""K; a reading stays plausible."""
MOST_CYCLES = 6000


@dataclass(frozen=True)
class Inputs:
    """What a controller sees, a value for each cycle: °C, °C, kg/s (NaN: not known), 0 or 1."""

    T_sup: Array
    T_set: Array
    m_a: Array
    enabled: Array


def made_record(settings: Settings) -> Inputs:
    """A record whose errors make u go where it should: up and down the stroke, to its ends, back and forth, off and on.

    The errors are those that the PI answers with the openings wanted; a dead band or a limit of the error takes it
    elsewhere, which does no harm.
    """
    number = settings.number
    wanted = np.concatenate([_tour(), _wear_of_intervals(settings)])[:MOST_CYCLES]
    enabled = np.ones(wanted.size)
    for start in (95, 103, 150):
        enabled[start : start + 4] = 0.0
    kp, ki = number["kp"], number["kp"] * number["sample_time"] / number["ti"]
    e, integral = np.zeros(wanted.size), 0.0
    for k, u in enumerate(wanted):
        e[k] = min(max((u - integral) / (kp + ki), -LARGEST_ERROR), LARGEST_ERROR) if kp != 0.0 else 0.1 * u
        integral = min(max(integral + ki * e[k], 0.0), 1.0) if enabled[k] else 0.0
    band = number["error_dead_band"]
    e[110:120] = np.linspace(-1.2, 1.2, 10) * band if band > 0.0 else e[110:120]
    e = np.concatenate([e, _square_waves(settings)])
    enabled = np.concatenate([enabled, np.ones(e.size - enabled.size)])
    T_set = np.full(e.size, 24.0 if settings.heats else 14.0)
    T_set[60:] += 1.0 + 2.0 * band
    T_set[130:] -= 0.5
    m_a = np.where(np.arange(e.size) % 400 < 250, 1.2, 1.0)
    T_sup = T_set - e if settings.heats else T_set + e
    resolution = number["sensor_resolution"]
    T_sup = resolution * np.floor(T_sup / resolution + 0.5) if resolution > 0.0 else T_sup
    return Inputs(T_sup, T_set, m_a, enabled)


def _tour() -> Array:
    """Openings wanted in the first 200 cycles."""
    k = np.arange(30)
    waves = 0.5 + 0.3 * np.sin(2.0 * np.pi * k / 15.0)
    small = 0.4 + 0.01 * np.sin(2.0 * np.pi * k / 3.0 + 0.5) + 0.001 * k
    round_off = np.full(10, 0.6) + 1e-12 * (-1.0) ** np.arange(10)
    return np.concatenate(
        [
            np.linspace(0.05, 0.7, 15), np.linspace(0.68, 0.3, 15), np.linspace(0.4, 1.4, 10), np.linspace(0.9, -0.4, 20),
            waves, small, round_off, 0.5 + 0.02 * (-1.0) ** np.arange(30), np.linspace(0.5, 0.9, 20),
            np.random.default_rng(17).uniform(0.2, 0.8, 20),
        ]
    )  # fmt: skip


def _wear_of_intervals(settings: Settings) -> Array:
    """Openings wanted in the intervals of a learner: some turns in the first ones, then none, many, none, many."""
    if settings.estimator != "learner":
        return np.empty(0)
    number = settings.number
    n = int(number["learning_interval"] / number["sample_time"])
    k = np.arange(n)
    some = 0.5 + 0.02 * np.where(k % 8 < 4, k % 4, 4 - k % 4)
    none = 0.45 + 0.1 * k / n
    many = 0.5 + 0.02 * (-1.0) ** k
    first = int(number["learning_reference"]) + 1
    used = math.ceil(_tour().size / n) * n - _tour().size
    return np.concatenate([some[:used] if used <= n else some, *[some] * first, none, none, many, none, many, many, none])


def _square_waves(settings: Settings) -> Array:
    """Errors of half periods that Hägglund's rule counts, K: each as long as the PI needs to cross a gap."""
    if settings.estimator != "hagglund":
        return np.empty(0)
    number = settings.number
    n = math.ceil(7.0 * number["ti"] / number["sample_time"]) + 2
    halves = int(number["hagglund_least_half_periods"]) + 4
    size = 0.15 * number["ti"] / (abs(number["kp"]) * n * number["sample_time"])
    sides = [np.full(n + side % 3, size * (1.0 + 0.1 * (side % 4)) * (-1.0) ** side) for side in range(halves)]
    return np.concatenate([np.full(n, 0.35 / 0.15 * size), *sides])[:MOST_CYCLES]
