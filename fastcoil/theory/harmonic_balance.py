"""Harmonic balance: at which frequency and amplitude a loop with a gap sustains a cycle.

A cycle needs 1 + L(jω) N(A) = 0, with the linear part L of the loop and the describing function N of the rest.  Split
in two: N has to lag as much as L leaves of 180°, and then |L| |N| has to be 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.arrays import Array
from fastcoil.theory.describing_function import Complex, describing_function, limited

_DEPTHS = np.concatenate([np.geomspace(1e-9, 1e-2, 200), np.linspace(0.0102, 0.999, 400), 1.0 - np.geomspace(9e-4, 1e-6, 30)])
_PLAY = describing_function(0.5 / _DEPTHS, np.array(1.0), np.array(1.0))
_LAG, _SIZE = -np.angle(_PLAY), np.abs(_PLAY)
_NEAR_CROSSOVER = 40
"""Points between the last frequency with phase left and none."""
LARGEST = 2.0
"""Amplitude of u, in strokes, up to which a cycle is sought: the limits of the stroke end all growth before."""


class Balance(NamedTuple):
    """Of each loop, (n,).

    margin: largest |L| |N| where L and N lag 180° together; without a gap |L| where L alone does.
    w_margin: its frequency, rad/s.
    w, amplitude, size: frequency, amplitude of u and |N| of the cycle that sustains itself; where there is none, those
    of the margin.
    """

    margin: Array
    w_margin: Array
    w: Array
    amplitude: Array
    size: Array


def balance(w: Array, L: Complex, gap: Array, below: Array, above: Array) -> Balance:
    """Balance loops with a play, each.

    Of several cycles the one of the highest frequency counts: where |L| |N| falls with the frequency, a larger
    oscillation decays and a smaller one grows (Gelb and Vander Velde 1968, section 3.2); it is the largest.

    Parameters
    ----------
    w
        Frequencies, rad/s, ascending, (n_w,).
    L
        Linear part of the loop, (n, n_w); NaN above the frequencies that the controller can make.
    gap
        Of the play, fraction of stroke, (n,).
    below, above
        How far u can swing below and above its mean, fraction of stroke, (n,).
    """
    log_w = np.log(w)
    n, rows = L.shape[0], np.arange(L.shape[0])
    left = np.pi + np.unwrap(np.where(np.isfinite(L), np.angle(L), 0.0), axis=1)
    left = np.where(np.isfinite(L), left, -1.0)
    size = np.where(np.isfinite(L), np.log(np.abs(L)), -np.inf)
    end = np.where((left <= 0.0).any(axis=1), (left <= 0.0).argmax(axis=1), w.size)
    last = np.maximum(end - 1, 0)
    beyond = np.minimum(end, w.size - 1)
    inside = (np.arange(w.size) < end[:, None]) & (left < 0.5 * np.pi)

    # more points between the last frequency and the crossover, where the amplitude grows without bounds
    step = np.where(np.isfinite(L[rows, beyond]), 0.0, np.nan)
    first_left, then_left = left[rows, last], np.where(np.isnan(step), 0.0, left[rows, beyond])
    then_size = np.where(np.isnan(step), size[rows, last], size[rows, beyond])
    share = 1.0 - np.geomspace(1.0, 1e-9, _NEAR_CROSSOVER)  # of the way to no phase left
    more_left = first_left[:, None] * (1.0 - share)
    way = np.where(first_left > then_left, first_left / np.where(first_left > then_left, first_left - then_left, 1.0), 0.0)
    way = np.minimum(way, 1.0)[:, None] * share
    more_w = log_w[last][:, None] + way * (log_w[beyond] - log_w[last])[:, None]
    more_size = size[rows, last][:, None] + way * (then_size - size[rows, last])[:, None]

    left = np.concatenate([np.where(inside, left, np.nan), more_left], axis=1)
    at = np.concatenate([np.broadcast_to(log_w, (n, w.size)), more_w], axis=1)
    size = np.concatenate([size, more_size], axis=1)
    depth = np.exp(np.interp(left, _LAG, np.log(_DEPTHS)))
    N = np.interp(left, _LAG, _SIZE)
    tiny = 1e-9
    amplitude = np.minimum(0.5 * np.maximum(gap, tiny)[:, None] / depth, LARGEST)
    through = 0.5 * (limited(amplitude, below[:, None]) + limited(amplitude, above[:, None]))
    N = N * through
    F = np.where(np.isfinite(left), np.exp(size) * N, 0.0)
    is_gap = gap > 0.0
    unlimited = np.where(np.isfinite(left), np.exp(size) * N / through, 0.0)
    best = np.where(is_gap, unlimited.argmax(axis=1), F.shape[1] - 1)
    margin = unlimited[rows, best]
    falls = (F[:, :-1] >= 1.0) & (F[:, 1:] < 1.0) & np.isfinite(left[:, 1:])
    k = falls.shape[1] - 1 - falls[:, ::-1].argmax(axis=1)
    cycles = falls[rows, k]
    ahead, after = np.log(np.where(cycles, F[rows, k], 2.0)), np.log(np.where(cycles, F[rows, k + 1], 0.5))
    part = np.where(cycles, ahead / (ahead - after), 0.0)
    k = np.where(cycles, k, best)

    def there(values: Array) -> Array:
        following = np.where(cycles, values[rows, np.minimum(k + 1, values.shape[1] - 1)], values[rows, k])
        return np.asarray(values[rows, k] + part * (following - values[rows, k]))

    return Balance(margin, np.exp(at[rows, best]), np.exp(there(at)), np.exp(there(np.log(amplitude))), there(N))
