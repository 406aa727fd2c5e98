"""What a swing of the opening does to the supply temperature at rest: the plant's gain over the whole swing.

Valve and coil together are far from a straight line, and the opening ends at 0 and 1.  Integral action holds the mean
temperature at the set-point, not the mean opening where it would be at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index

AMPLITUDES = np.geomspace(2e-3, 3.0, 28)
"""Of the opening, before it ends at 0 and 1."""
_NODES = np.sin(np.pi * ((np.arange(8) + 0.5) / 8.0 - 0.5))
"""A sine at equal steps of its phase, from trough to peak."""
_HALVINGS, _FINER = 12, 8


class Swings(NamedTuple):
    """Mean opening, and gain over that at rest, for each of AMPLITUDES: (n, 28)."""

    mean: Array
    gain: Array

    def part(self, some: Index) -> Swings:
        """Those of some plants."""
        return Swings(self.mean[some], self.gain[some])

    def at(self, amplitude: Array) -> tuple[Array, Array]:
        """Mean and gain at amplitudes (n, n_amplitudes)."""
        ratio = np.log(AMPLITUDES[1] / AMPLITUDES[0])
        place = np.clip(np.log(np.maximum(amplitude, AMPLITUDES[0]) / AMPLITUDES[0]) / ratio, 0.0, AMPLITUDES.size - 1)
        first = np.minimum(place.astype(np.int64), AMPLITUDES.size - 2)
        share, rows = place - first, np.arange(self.mean.shape[0])[:, None]
        mean, gain = (v[rows, first] * (1.0 - share) + v[rows, first + 1] * share for v in self)
        return mean, gain


def refined(curve: Array) -> Array:
    """A curve (n, n_openings) with ``_FINER`` times as many steps: cubic between its points, with the slopes there.

    Valve curves bend so much that straight lines between the points are up to a third off in slope.
    """
    slope = np.gradient(curve, axis=1)
    t = np.arange(_FINER) / _FINER
    left, right = curve[:, :-1, None], curve[:, 1:, None]
    rise = right - left
    bend = t * (1.0 - t) * ((slope[:, :-1, None] - rise) * (1.0 - t) - (slope[:, 1:, None] - rise) * t)
    return np.column_stack([(left + rise * t + bend).reshape(curve.shape[0], -1), curve[:, -1]])


def temperature(curve: Array, opening: Array) -> Array:
    """T_sup at rest, °C, at openings (n, m, k), ended at 0 and 1.  curve: as of ``swings_of``."""
    last, rows = curve.shape[1] - 1, np.arange(curve.shape[0])[:, None, None]
    place = np.clip(opening, 0.0, 1.0) * last
    first = np.minimum(place.astype(np.int64), last - 1)
    share = place - first
    return np.asarray(curve[rows, first] * (1.0 - share) + curve[rows, first + 1] * share)


def swings_of(curve: Array, T_sup: Array, gain: Array) -> Swings:
    """Mean opening and gain of plants whose opening swings as a sine.

    Parameters
    ----------
    curve
        T_sup at rest, °C, at openings from 0 to 1 by equal steps, (n, n_openings).
    T_sup
        The mean temperature that is held, °C, (n,).
    gain
        Of a small swing, K per unit opening, (n,).
    """
    sign = np.sign(curve[:, -1] - curve[:, 0])[:, None]
    low = np.broadcast_to(-AMPLITUDES, (curve.shape[0], AMPLITUDES.size))
    high = np.broadcast_to(1.0 + AMPLITUDES, low.shape)
    swing = AMPLITUDES[:, None] * _NODES
    for _ in range(_HALVINGS):
        mean = 0.5 * (low + high)
        below = sign * (temperature(curve, mean[:, :, None] + swing).mean(axis=2) - T_sup[:, None]) < 0.0
        low, high = np.where(below, mean, low), np.where(below, high, mean)
    mean = 0.5 * (low + high)
    over = (temperature(curve, mean[:, :, None] + swing) * _NODES).mean(axis=2) * 2.0 / AMPLITUDES
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = over / gain[:, None]
    return Swings(mean, np.where(np.isfinite(relative), relative, 0.0))
