"""Made-up records that take a controller through all that it does: what it would see, cycle by cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.deliver.export.controller import Controller

LARGEST_ERROR = 25.0
"""K; a reading stays plausible."""
MOST_CYCLES = 6000
"""Of a record: intervals of a day would fill a disk."""
OFF = (95, 103, 150)
"""Cycles at which the plant goes off for the next four."""


@dataclass(frozen=True)
class Inputs:
    """What a controller sees, a value for each cycle: °C, °C, kg/s, 0 or 1."""

    T_sup: Array
    T_set: Array
    m_a: Array
    enabled: Array


def made_records(controller: Controller) -> list[Inputs]:
    """A tour of PI and inverse for every controller, and a record for estimators that need another."""
    e, enabled = _tour(controller)
    T_set = np.full(e.size, 24.0 if controller.heats else 14.0)
    T_set[60:] += 1.0 + 2.0 * controller.number["error_dead_band"]
    T_set[130:] -= 0.5
    found = [_seen(controller, e, T_set, enabled)]
    special = {"learner": _intervals, "hagglund": _square_waves}.get(controller.estimator)
    if special is not None:
        e = special(controller)[:MOST_CYCLES]
        found.append(_seen(controller, e, np.full(e.size, T_set[0]), np.ones(e.size)))
    return found


def _seen(controller: Controller, e: Array, T_set: Array, enabled: Array) -> Inputs:
    T_sup = T_set - e if controller.heats else T_set + e
    resolution = controller.number["sensor_resolution"]
    T_sup = resolution * np.floor(T_sup / resolution + 0.5) if resolution > 0.0 else T_sup
    return Inputs(T_sup, T_set, np.where(np.arange(e.size) % 400 < 250, 1.2, 1.0), enabled)


def _tour(controller: Controller) -> tuple[Array, Array]:
    """Errors, K, and when the plant is on: along the stroke to its ends, back and forth, off and on."""
    number = controller.number
    k, band = np.arange(30), number["error_dead_band"]
    # a weak or slow PI takes its time from one end to the other
    slowly = 1.5 * number["ti"] / max(abs(number["kp"]) * number["sample_time"] * LARGEST_ERROR, 1e-9)
    crossing = min(math.ceil(slowly), MOST_CYCLES // 4)
    wanted = np.concatenate(
        [
            *(np.linspace(0.05, 0.7, 15), np.linspace(0.68, 0.3, 15)),
            *(np.linspace(0.4, 1.4, 10), np.linspace(0.9, -0.4, 20)),
            0.5 + 0.3 * np.sin(2.0 * np.pi * k / 15.0),
            0.4 + 0.01 * np.sin(2.0 * np.pi * k / 3.0 + 0.5) + 0.001 * k,
            0.6 + 1e-12 * (-1.0) ** k[:10],  # round-off, which is no turn
            0.5 + 0.02 * (-1.0) ** k,
            np.linspace(0.5, 0.9, 20),
            np.random.default_rng(17).uniform(0.2, 0.8, 40),
            *(np.full(crossing, 1.5), np.full(crossing, -0.5)),
        ]
    )
    enabled = np.ones(wanted.size)
    for start in OFF:
        enabled[start : start + 4] = 0.0
    e = _errors(controller, wanted, enabled)
    e[110:120] = np.linspace(-1.2, 1.2, 10) * band if band > 0.0 else e[110:120]
    return e, enabled


def _errors(controller: Controller, wanted: Array, enabled: Array) -> Array:
    """The errors that the PI answers with the openings wanted, K.

    A dead band, or the limit of the error, takes it elsewhere, which does no harm.
    """
    number = controller.number
    kp, ki = number["kp"], number["kp"] * number["sample_time"] / number["ti"]
    e, integral = np.zeros(wanted.size), 0.0
    for k, u in enumerate(wanted):
        e[k] = min(max((u - integral) / (kp + ki), -LARGEST_ERROR), LARGEST_ERROR) if kp != 0.0 else u
        integral = min(max(integral + ki * e[k], 0.0), 1.0) if enabled[k] else 0.0
    return e


def _intervals(controller: Controller) -> Array:
    """Errors over the intervals of a learner, K: some turns in those of the reference, then none, few or many."""
    number = controller.number
    n = int(number["learning_interval"] / number["sample_time"])
    k = np.arange(n)
    some = 0.5 + 0.02 * np.where(k % 8 < 4, k % 4, 4 - k % 4)
    none = 0.45 + 0.1 * k / n
    many = 0.5 + 0.02 * (-1.0) ** k
    far = 0.5 + 0.3 * (-1.0) ** (k // 10)  # few turns, large errors
    first = [some] * (int(number["learning_reference"]) + 2)
    wanted = np.concatenate([*first, none, none, far, many, none, many, many, none])
    return _errors(controller, wanted, np.ones(wanted.size))


def _square_waves(controller: Controller) -> Array:
    """Errors of half periods that Hägglund's rule counts, K: each as long as the PI needs to cross a gap."""
    number = controller.number
    n = math.ceil(7.0 * number["ti"] / number["sample_time"]) + 2
    size = 0.15 * number["ti"] / (abs(number["kp"]) * n * number["sample_time"])
    halves = range(int(number["hagglund_least_half_periods"]) + 4)
    sides = [np.full(n + side % 3, size * (1.0 + 0.1 * (side % 4)) * (-1.0) ** side) for side in halves]
    return np.concatenate([np.full(n, 0.35 / 0.15 * size), *sides])
