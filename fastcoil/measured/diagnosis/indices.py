"""Indices that people know: how well the loop holds its set-point, how it swings, what its motor does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fastcoil.base.arrays import Array, Mask

SETTLED_AFTER = 600.0
"""Seconds after a change of the set-point from which the loop counts as settled."""
LEAST_CHANGE = 0.3
"""Change of the set-point that counts, K, at once or within the time above."""
_END = 0.005
"""A command so near to closed or open counts as that."""
_AMPLITUDE = 0.1
"""Of the least oscillation that Hägglund's index counts, K: 1 % of the 10 K that a supply temperature ranges over."""
_EVENTS, _SUPERVISED = 10, 50.0
"""So many events within so many integral times are an oscillation."""
_ORDER, _STEP, _AHEAD = 15, 30.0, 60.0
"""Order of the model of the error, its step [s], and the time that no controller can overtake [s]."""
_LONG, _PEAKED = 5.0, 2.0
"""A half period counts for Hägglund's gap if it lasts so many integral times and its peak is below so many means."""
_DAY = 86400.0


class Index(NamedTuple):
    """A number with its unit and its meaning; NaN where the log cannot tell."""

    value: float
    unit: str
    meaning: str


def settled(T_set: Array, good: Mask, interval: float) -> Mask:
    """Where the set-point has hardly moved for a while, and the plant was on all that time, (n,)."""
    width = max(1, round(SETTLED_AFTER / interval))
    if T_set.size <= width:
        return np.zeros(T_set.size, dtype=bool)
    known = np.where(np.isfinite(T_set), T_set, np.inf)
    windows = sliding_window_view(known, width + 1)
    with np.errstate(invalid="ignore"):
        steady = windows.max(axis=1) - windows.min(axis=1) < LEAST_CHANGE
    there = sliding_window_view(good, width + 1).mean(axis=1) > 0.5
    return np.concatenate([np.zeros(width, dtype=bool), steady & there]) & good


def in_control(command: Array, good: Mask, interval: float) -> Mask:
    """Where the valve was not closed or wide open for so long that the loop has no say, (n,)."""
    at_end = good & ((command <= _END) | (command >= 1.0 - _END))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at_end, [False]]).astype(int)))
    found = good.copy()
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if (last - first) * interval > SETTLED_AFTER:
            found[first:last] = False
    return found


def travel(positions: Array, on: Mask, interval: float) -> tuple[float, float]:
    """Strokes and turns of the motor in a day of operation; ``positions``: (n + 1,), at the samples.

    A turn is a change of sign between successive movements.
    """
    days = float(on.sum()) * interval / _DAY
    if days == 0.0:
        return np.nan, np.nan
    moves = np.diff(positions)[on]
    moved = moves[np.abs(moves) > 1e-9]
    return float(np.abs(moved).sum()) / days, float(np.sum(moved[1:] * moved[:-1] < 0.0)) / days


def oscillation_index(e: Array, good: Mask, interval: float, ti: float) -> float:
    """Hägglund, Control Engineering Practice 3 (1995) 1543: above 1 the loop oscillates.

    The integral of |e| between two zero crossings is an event if it exceeds 2 a/ω, as that of half a sine of amplitude
    a = 0.1 K and frequency ω = 2 π/ti does: a ti/π.  The index is the largest number of events within 50 ti, over 10.

    ti: integral time, s; where it is not known, the period of the oscillation stands for it.
    """
    if not np.isfinite(ti):
        return 0.0
    halves = half_periods(e, good, interval)
    at = halves.end[halves.iae > _AMPLITUDE * ti / np.pi]
    within = np.searchsorted(at, at + _SUPERVISED * ti, side="right") - np.arange(at.size)
    return float(np.max(within, initial=0)) / _EVENTS


class Halves(NamedTuple):
    """Half periods of an error, between zero crossings.

    end, duration: s.  iae: integral of its absolute value, K s.  peak: largest of it, K.
    """

    end: Array
    duration: Array
    iae: Array
    peak: Array


def half_periods(e: Array, good: Mask, interval: float) -> Halves:
    """The half periods that are wholly good."""
    sign = np.where(good, np.where(e > 0.0, 1, -1), 0)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(sign)) + 1, [e.size]])
    first, last = edges[:-1], edges[1:]
    whole = (sign[first] != 0) & (first > 0) & (last < e.size)
    whole &= (sign[first - 1] == -sign[first]) & (sign[np.minimum(last, e.size - 1)] == -sign[first])
    size = np.where(good, np.abs(e), 0.0)
    iae = np.add.reduceat(size, first)[whole] * interval
    peak = np.maximum.reduceat(size, first)[whole]
    return Halves(last[whole] * interval, (last - first)[whole] * interval, iae, peak)


def harris_index(e: Array, good: Mask, interval: float) -> float:
    """Normalised Harris index, 1 - σ²/mean e²: 0 is the best that feedback can do, 1 the worst.

    σ² is the variance of what could not be foretold of the error a minute ahead: from an autoregressive model of order
    15 in steps of 30 s, with innovations of variance s² and impulse response h, σ² = s² (h₀² + h₁²).  The index of
    Harris (Can. J. Chem. Eng. 67 (1989) 856) as ASHRAE RP-1587 recommends it for HVAC loops; a minute stands for the
    dead time, which a log does not tell.
    """
    every = max(1, round(_STEP / interval))
    thinned, usable = e[::every], good[::every]
    if thinned.size <= _ORDER:
        return np.nan
    windows = sliding_window_view(thinned, _ORDER + 1)[sliding_window_view(usable, _ORDER + 1).all(axis=1)]
    if windows.shape[0] < 4 * _ORDER:
        return np.nan
    centre = windows.mean()
    X, y = windows[:, -2::-1] - centre, windows[:, -1] - centre
    a = np.linalg.lstsq(X, y, rcond=None)[0]
    innovations = float(np.mean((y - X @ a) ** 2))
    h = np.zeros(max(1, round(_AHEAD / (every * interval))))
    h[0] = 1.0
    for j in range(1, h.size):
        h[j] = a[: min(j, _ORDER)] @ h[j - 1 :: -1][:_ORDER]
    total = float(np.mean(windows[:, -1] ** 2))
    return float(np.clip(1.0 - innovations * float(h @ h) / total, 0.0, 1.0)) if total > 0.0 else np.nan


def hagglund_gap(e: Array, good: Mask, interval: float, kp: float, ti: float, gain: float) -> float:
    """Backlash after Hägglund, J. Process Control 17 (2007) 741, fraction of stroke; NaN without evidence.

    While the gap is crossed the valve stands still and the error is a square wave; d = kp (Δt/ti - 1/(kp gain)) Δy,
    with the mean error Δy of a half period Δt.  The median of those that last 5 ti or more and peak below 2 Δy.

    kp, ti: gain [1/K] and integral time [s] of the controller.  gain: of the plant, K per stroke.
    """
    halves = half_periods(e, good, interval)
    mean = halves.iae / halves.duration
    d = kp * (halves.duration / ti - 1.0 / (kp * gain)) * mean
    counts = (halves.duration >= _LONG * ti) & (halves.peak < _PEAKED * mean) & (d > 0.0) & (d < 1.0)
    return float(np.median(d[counts])) if counts.any() else np.nan


def rms(e: Array, good: Mask) -> float:
    """Root mean square where good; NaN without samples."""
    return float(np.sqrt(np.mean(e[good] ** 2))) if good.any() else np.nan
