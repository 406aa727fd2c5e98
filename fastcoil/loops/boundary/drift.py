"""Slow smooth noise of the signals of a day."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.model.numerics.low_pass import low_pass


class Drift(NamedTuple):
    """Slow smooth noise of a signal: standard deviation (unit of the signal) and time constant (s)."""

    std: float
    tau: int


def drifts_of(drifts: Mapping[str, Drift], seeds: Sequence[int], n_steps: int) -> dict[str, Array]:
    """Noise of each signal, (n_days, n_steps), a day for each seed; the order of the signals numbers their streams."""
    return {
        name: np.array([smooth_noise(n_steps, drift, (seed, i)) for seed in seeds])
        for i, (name, drift) in enumerate(drifts.items())
    }


def smooth_noise(n_steps: int, drift: Drift, stream: tuple[int, int]) -> Array:
    """Gaussian noise through two equal first-order filters, 1-s samples, (n_steps,).

    ``stream`` (seed, number of the signal) names the random stream.  The filters start 10 time constants
    early, from zero; the scale is the theoretical standard deviation: that of the samples differs a little.
    """
    seed, number = stream
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    return smooth(random.standard_normal(10 * drift.tau + n_steps), drift)


def smooth(white: Array, drift: Drift) -> Array:
    """White noise of standard deviation 1, (n,), as that of ``drift``, without its first 10 time constants.

    ``white`` is overwritten.
    """
    a = np.exp(-1.0 / drift.tau)
    k = 1.0 - a
    for _ in range(2):
        low_pass(white, a, white)
    # The two filters' response to an impulse is k^2 (n + 1) a^n; the sum of its squares:
    stationary_std = k**2 * np.sqrt((1.0 + a**2) / (1.0 - a**2) ** 3)
    return np.asarray(white[10 * drift.tau :] * (drift.std / stationary_std))
