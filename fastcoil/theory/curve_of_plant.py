"""What a swing of the opening does to the supply temperature at rest: the plant's gain over the whole swing.

Valve and coil together are far from a straight line, and the opening ends at 0 and 1.  Integral action holds the mean
temperature at the set-point, not the mean opening where it would be at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.arrays import Array

AMPLITUDES = np.geomspace(2e-3, 3.0, 28)
"""Of the opening, before it ends at 0 and 1."""
_NODES = np.sin(np.pi * ((np.arange(8) + 0.5) / 8.0 - 0.5))
"""A sinus at equal steps of its phase, from trough to peak."""
_HALVINGS = 12


class Swings(NamedTuple):
    """Mean opening, and gain over that at rest, for each of AMPLITUDES: (n, 28)."""

    mean: Array
    gain: Array

    def at(self, amplitude: Array) -> tuple[Array, Array]:
        """Mean and gain at amplitudes (n, n_amplitudes)."""
        ratio = np.log(AMPLITUDES[1] / AMPLITUDES[0])
        place = np.clip(np.log(np.maximum(amplitude, AMPLITUDES[0]) / AMPLITUDES[0]) / ratio, 0.0, AMPLITUDES.size - 1)
        first = np.minimum(place.astype(np.int64), AMPLITUDES.size - 2)
        share, rows = place - first, np.arange(self.mean.shape[0])[:, None]
        mean, gain = (v[rows, first] * (1.0 - share) + v[rows, first + 1] * share for v in self)
        return mean, gain


def swings_of(curve: Array, T_sup: Array, gain: Array) -> Swings:
    """Mean opening and gain of plants whose opening swings as a sinus.

    Parameters
    ----------
    curve
        T_sup at rest, °C, at openings from 0 to 1 by equal steps, (n, n_openings).
    T_sup
        The mean temperature that is held, °C, (n,).
    gain
        Of a small swing, K per unit opening, (n,).
    """
    last, rows = curve.shape[1] - 1, np.arange(curve.shape[0])[:, None, None]

    def temperature(opening: Array) -> Array:
        place = np.clip(opening, 0.0, 1.0) * last
        first = np.minimum(place.astype(np.int64), last - 1)
        share = place - first
        return np.asarray(curve[rows, first] * (1.0 - share) + curve[rows, first + 1] * share)

    sign = np.sign(curve[:, -1] - curve[:, 0])[:, None]
    low = np.broadcast_to(-AMPLITUDES, (curve.shape[0], AMPLITUDES.size))
    high = np.broadcast_to(1.0 + AMPLITUDES, low.shape)
    swing = AMPLITUDES[:, None] * _NODES
    for _ in range(_HALVINGS):
        mean = 0.5 * (low + high)
        below = sign * (temperature(mean[:, :, None] + swing).mean(axis=2) - T_sup[:, None]) < 0.0
        low, high = np.where(below, mean, low), np.where(below, high, mean)
    mean = 0.5 * (low + high)
    over = (temperature(mean[:, :, None] + swing) * _NODES).mean(axis=2) * 2.0 / AMPLITUDES
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = over / gain[:, None]
    return Swings(mean, np.where(np.isfinite(relative), relative, 0.0))
