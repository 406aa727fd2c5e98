"""The likelihood of each backlash from the response of the temperature to a valve test.

The temperature answers the opening behind the gap through two lags and a dead time; what is left is drift, whose
changes are coloured, and noise: an ARIMA(1,1,1).  For each candidate gap, start of the stem, pair of lags, dead time
and colour of the noise, the gain has a wide normal prior and is integrated out; the likelihoods of all but the gap are
summed.  Nothing is fitted by iteration, so that a log has one answer.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array

LAGS = (8.0, 15.0, 25.0, 40.0, 65.0, 100.0, 150.0)
"""Lags that are tried, in pairs, s: sensor, metal, water and air of a coil."""
DEAD_TIMES = (0.0, 10.0, 20.0)  # s
SKEWS = (-150.0, -120.0, -90.0, -60.0, -30.0, 40.0, 60.0, 90.0, 120.0, 150.0)
"""Dead times of a log whose command and temperature have clocks of their own, s; negative: the command is late."""
_SKEWED = 3.0  # logarithm of how much less likely than clocks that agree
AR, MA = (0.0, 0.5, 0.8, 0.95), (0.0, 0.4, 0.7, 0.85, 0.95)
"""Of the changes of the drift: memory from sample to sample, and the share that the noise of the sensor takes back."""
_TYPICAL = (0.5, 0.8)  # of these two, with which lags and dead times are chosen
LARGEST_GAIN = 40.0  # K per stroke, standard deviation of the prior
STARTS = 4  # places of the stem in its gap that are tried at first, where what came before leaves it open
_UNLIKELY = 15.0  # logarithm of likelihood below the best from which lags and dead times are left out
_COARSE = 8  # every so many candidates choose them
INPUT_LAGS = (15.0, 60.0, 200.0)  # s, of each known disturbance
_SAME, _TINY = 1e-3, 1e-9
"""Fraction of stroke within which all starts of the stem are one; share of a variance that is none."""


class Response(NamedTuple):
    """How the temperature answers: log-likelihood of each candidate, and the most probable model."""

    likelihood: Array
    gain: float  # K per stroke
    lag: float  # sum of both, s
    dead_time: float  # s
    explained: float  # share of the variance of the temperature
    stem: Array  # its place behind the most probable gap, fraction of stroke, from the first row that is modelled on
    model: Array  # temperature of the model without drift, K from its start, at the samples that are compared


def stems(positions: Array, candidates: Array, starts: Array) -> Array:
    """Place of the stem behind each candidate gap, Eq (1), from each start: (n, …) like ``starts``, (…, candidates)."""
    q, found = starts, np.empty((positions.size, *starts.shape))
    for k, position in enumerate(positions.tolist()):
        q = np.minimum(np.maximum(q, position - candidates), position)
        found[k] = q
    return found


def response(
    temperature: Array, positions: Array, first: int, from_row: int, interval: float, inputs: Sequence[Array],
    candidates: Array,
) -> Response:  # fmt: skip
    """Compare candidate gaps.

    temperature, positions of the motor, and inputs: (n,) each, at equal intervals.  The rows from ``first`` on are
    modelled, those from ``from_row`` on are compared; the rows before ``first`` tell where the stem may be.
    """
    from scipy.signal import lfilter

    def lagged(series: Array, lag: float) -> Array:
        a = np.exp(-interval / lag)
        return np.asarray(lfilter([1.0 - a], [1.0, -a], series, axis=-1, zi=a * series[..., :1])[0])

    def late(series: Array, dead_time: float) -> Array:
        rows = np.arange(series.shape[-1]) - round(dead_time / interval)
        return np.take(series, rows, axis=-1, mode="clip")

    before = positions[: first + 1]
    low = stems(before, candidates, np.maximum(before[0] - candidates, 0.0))[-1]
    high = stems(before, candidates, np.full(candidates.size, before[0]))[-1]
    n_starts = STARTS if np.max(high - low) > _SAME else 1
    starts = low + (high - low) * np.linspace(0.0, 1.0, n_starts)[:, np.newaxis]
    places = np.moveaxis(stems(positions[first:], candidates, starts), 0, -1)
    openings = places / (1.0 - candidates[:, np.newaxis])
    compared = slice(from_row - first, None)
    openings -= openings[..., compared][..., :1]
    y = temperature[first:] - temperature[from_row]
    known = [lagged(series[first:] - series[from_row], lag) for series in inputs for lag in INPUT_LAGS]

    def whitened(series: Array, ar: float, ma: float) -> Array:
        return np.asarray(lfilter(np.convolve([1.0, -1.0], [1.0, -ar]), [1.0, -ma], series, axis=-1)[..., compared])

    def evidence(answers: Array, ar: float, ma: float) -> tuple[Array, Array]:
        """Log-likelihood of each opening, with its gain integrated out, and the gain."""
        Y, W = whitened(y, ar, ma), whitened(answers, ar, ma)
        Z, _ = np.linalg.qr(np.stack([np.ones(Y.size), *(whitened(one, ar, ma) for one in known)], axis=1))
        Y, W = Y - Z @ (Z.T @ Y), W - (W @ Z) @ Z.T
        n, total = Y.size - Z.shape[1], float(Y @ Y)
        square, product = np.sum(W * W, axis=-1), W @ Y
        variance = np.full(square.shape, 0.5 * total / n)
        for _ in range(2):
            gain = product / (square + variance / LARGEST_GAIN**2)
            variance = np.maximum(total - product * gain, _TINY * total) / n
        doubt = np.log1p(square * LARGEST_GAIN**2 / variance)
        return np.asarray(-0.5 * (n * np.log(variance) + doubt)), np.asarray(gain)

    dynamics = [
        (slow, fast, dead) for i, slow in enumerate(LAGS) for fast in LAGS[: i + 1] for dead in (*DEAD_TIMES, *SKEWS)
    ]

    def answered(slow: float, fast: float, dead: float, every: int = 1) -> Array:
        return late(lagged(lagged(openings[:, ::every], slow), fast), dead)

    prior = {dead: 0.0 for dead in DEAD_TIMES} | {dead: -_SKEWED for dead in SKEWS}
    coarse = [float(evidence(answered(*one, _COARSE), *_TYPICAL)[0].max()) + prior[one[-1]] for one in dynamics]
    likely = [one for one, found in zip(dynamics, coarse, strict=True) if found > max(coarse) - _UNLIKELY]
    total, best = np.full(candidates.size, -np.inf), (-np.inf, (0.0, 0.0, 0.0), 0, 0, 0.0)
    for dynamic in likely:
        answers = answered(*dynamic)
        for ar in AR:
            for ma in MA:
                found, gains = evidence(answers, ar, ma)
                found = found + prior[dynamic[-1]]
                total = np.logaddexp(total, np.logaddexp.reduce(found, axis=0))
                at = np.unravel_index(int(found.argmax()), found.shape)
                if found[at] > best[0]:
                    best = (float(found[at]), dynamic, int(at[0]), int(at[1]), float(gains[at]))
    _, (slow, fast, dead), start, size, gain = best
    model = gain * late(lagged(lagged(openings[start, size], slow), fast), dead)[compared]
    seen = y[compared]
    left = np.var(seen - model) / max(float(np.var(seen)), _TINY)
    return Response(total, gain, slow + fast, dead, 1.0 - float(left), places[start, size], model)
