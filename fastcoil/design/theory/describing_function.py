"""Describing function of what lies between the controller's u and the opening: gap, inverse, buffer.

A sine of amplitude A goes in; the describing function N(A) is the part of the same frequency that comes out, over A.
A gap, an inverse with a right or wrong estimate in front of it, and its buffer all make the same kind of element: it
follows its input at a distance, and after each turn of the input waits until that has come back some way.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arrays import Array

Complex = NDArray[np.complex128]


def describing_function(amplitude: Array, width: Array, wait: Array) -> Complex:
    """N(A) of an element that follows its input at a distance and waits after each turn.

    Rising, the output is the input less half the ``width``; falling, the input plus half of it.  After a turn it holds
    until the input has come back by ``wait``, and then jumps to where it belongs.  A play of gap b is width = wait = b:
    there is nothing to jump, and N is the textbook's (Gelb and Vander Velde 1968, appendix B; Slotine and Li 1991, eq
    5.21), here with h = b/2, k = h/A::

        Re N = (π/2 + asin(1 - 2k) + 2 (1 - 2k) √(k (1 - k)))/π,   Im N = -4k (1 - k)/π

    A width below 0 is an inverse that takes the gap for larger than it is: the output is ahead.

    Parameters
    ----------
    amplitude, width, wait
        In one unit, of shapes that broadcast; wait at least 0 and at least the width.

    Returns
    -------
    N, complex; 0 where the input swings less than ``wait`` from peak to peak: then nothing ever moves.
    """
    amplitude, width, wait = np.broadcast_arrays(amplitude, width, wait)
    moves = 2.0 * amplitude > wait
    A = np.where(moves, amplitude, 1.0)
    g, s = np.where(moves, width, 0.0) / A, 1.0 - np.where(moves, wait, 0.0) / A
    root = np.sqrt(1.0 - s * s)
    # Fourier coefficients over half a period, from a peak: held at 1 - g/2 while sin > s, then sin + g/2
    in_phase = (1.0 - g) * root + 0.25 * np.pi + 0.5 * np.arcsin(s) - 0.5 * s * root
    ahead = -0.5 * (1.0 - s) ** 2 - g * s
    return np.where(moves, (in_phase + 1j * ahead) * (2.0 / np.pi), 0.0)


def limited(amplitude: Array, low: Array, high: Array) -> Array:
    """N(A), real, of a limiter whose limits lie ``low`` and ``high`` beside the mean of its input.

    With low = -high it is the saturation of the textbooks (Slotine and Li 1991, eq 5.9).

    amplitude, low, high: in one unit, of shapes that broadcast; low at most high.
    """

    def up_to(limit: Array) -> Array:
        share = np.clip(limit / amplitude, -1.0, 1.0)
        return np.asarray((np.arcsin(share) + share * np.sqrt(1.0 - share * share)) / np.pi)

    return up_to(high) - up_to(low)


_STEPS, _PERIODS, _FASTEST = 1000, 3, 100.0


@cache
def _rate_limits() -> tuple[Array, Array, Array]:
    """Logarithm of how much faster a sine would move than it may, ln |N|, and lag of N in rad, (n,) each."""
    faster = np.geomspace(1.0, _FASTEST, 120)
    phase = 2.0 * np.pi * np.arange(_STEPS) / _STEPS
    most = 2.0 * np.pi / _STEPS / faster
    # where the triangle of a motor that never catches up is at phase 0
    height = np.minimum(0.5 * np.pi / faster, 1.0)
    position, path = -height * np.arccos(height) / (0.5 * np.pi), np.empty((_STEPS, faster.size))
    for _ in range(_PERIODS):
        for k, target in enumerate(np.sin(phase)):
            position = position + np.clip(target - position, -most, most)
            path[k] = position
    N = 2j * np.mean(path * np.exp(-1j * phase)[:, None], axis=0)
    return np.log(faster), np.log(np.abs(N)), -np.angle(N)


def rate_limited(faster: Array) -> Complex:
    """N of a motor of limited speed, beside ``faster``: the largest speed of its target over its own, A ω stroke_time.

    Up to 1 it follows at once.  Above, it follows a triangle in the end; N is found by moving it along a sine.
    """
    log_faster, log_size, lag = _rate_limits()
    at = np.log(np.clip(faster, 1.0, _FASTEST))
    return np.asarray(np.exp(np.interp(at, log_faster, log_size) - 1j * np.interp(at, log_faster, lag)))
