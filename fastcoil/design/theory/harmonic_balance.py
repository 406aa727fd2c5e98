"""Harmonic balance: at which frequency a loop comes round in phase, and how large |L| |N| is there.

A cycle needs 1 + L(jω) N(A, ω) = 0, with the linear part L of the loop and the describing function N of the rest.
Split in two: N has to lag as much as L leaves of 180°, and then |L| |N| has to be 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.design.theory.describing_function import Complex

_HALVINGS = 10
_FLAT = 0.01
"""A rise of the phase, rad, from which a loop has more than one frequency for a phase."""


class Balance(NamedTuple):
    """Of each piece of the phase curves, loop and amplitude, (3, n, n_amplitudes).

    product: |L| |N| where L and N lag 180° together; 0 where they do nowhere.  place: where between the frequencies
    that is, as an index with a fraction.  size: |N|.
    """

    product: Array
    place: Array
    size: Array


def between(curves: Array, place: Array) -> Array:
    """Values of curves (n, n_w) at places (n, m), straight between their points."""
    first = np.clip(place.astype(np.int64), 0, curves.shape[1] - 2)
    rows = np.arange(curves.shape[0])[:, None]
    share = place - first
    return np.asarray(curves[rows, first] * (1.0 - share) + curves[rows, first + 1] * share)


def frequency(w: Array, place: Array) -> Array:
    """Frequencies at places between those of w, which ascend by equal ratios."""
    return np.asarray(w[0] * np.exp(place * np.log(w[1] / w[0])))


def balance(w: Array, L: Complex, N: Callable[[Array], Complex], n_amplitudes: int, lead: Array) -> Balance:
    """Where L and N lag 180° together, for each loop and amplitude.

    With fast integral action the phase of L falls, rises and falls again: the three pieces are told apart.  In a loop
    where it only falls, all of it is the first piece.

    Parameters
    ----------
    w
        Frequencies, rad/s, (n_w,), ascending by equal ratios.
    L
        Linear part of the loops, (n, n_w).
    N
        Frequencies, (n, n_amplitudes) → the describing function there.
    lead
        Most that N may lead, rad, (n,).
    """
    left, log_L = np.pi + np.unwrap(np.angle(L), axis=1), np.log(np.abs(L))
    found = []
    for low, high, turn in _pieces(left, lead):
        shape = (L.shape[0], n_amplitudes)
        a, b = (np.broadcast_to(end[:, None].astype(float), shape).copy() for end in (low, high))

        def excess(place: Array, turn: float = turn) -> Array:
            return turn * (between(left, place) + np.angle(N(frequency(w, place))))

        place, there = _root(excess, a, b)
        size = np.abs(N(frequency(w, place)))
        found.append((np.where(there, np.exp(between(log_L, place)) * size, 0.0), place, size))
    product, place, size = (np.stack(part) for part in zip(*found, strict=True))
    return Balance(product, place, size)


def _root(excess: Callable[[Array], Array], a: Array, b: Array) -> tuple[Array, Mask]:
    """Where a falling function crosses 0 between a and b, and whether it does."""
    fa, fb = excess(a), excess(b)
    there = (fa >= 0.0) & (fb <= 0.0) & (b > a)
    for _ in range(_HALVINGS):
        x = 0.5 * (a + b)
        fx = excess(x)
        right = fx > 0.0
        a, fa, b, fb = np.where(right, x, a), np.where(right, fx, fa), np.where(right, b, x), np.where(right, fb, fx)
    steep = np.where(fa > fb, fa - fb, 1.0)
    return a + (b - a) * np.clip(fa / steep, 0.0, 1.0), there


def _pieces(left: Array, lead: Array) -> list[tuple[Index, Index, float]]:
    """First and last index of the last fall of each curve, of a first one and of the rise between; -1 for the rise."""
    n, n_w = left.shape
    rows = np.arange(n)
    over = left < -lead[:, None]
    last = np.where(over.any(axis=1), over.argmax(axis=1), n_w - 1)
    seen = np.where(np.arange(n_w) <= last[:, None], left, -np.inf)
    later = np.maximum.accumulate(seen[:, ::-1], axis=1)[:, ::-1]
    rise = np.where(np.isfinite(seen), later, 0.0) - np.where(np.isfinite(seen), seen, 0.0)
    dip = rise.argmax(axis=1)
    bumps = rise[rows, dip] > _FLAT
    dip = np.where(bumps, dip, 0)
    peak = np.where(np.arange(n_w) >= dip[:, None], seen, -np.inf).argmax(axis=1)
    peak = np.where(bumps, peak, 0)
    return [(peak, last, 1.0), (np.zeros_like(dip), dip, 1.0), (dip, peak, -1.0)]
