"""Step responses: their transform, the sensor behind them, and a first-order model with delay."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arrays import Array
from fastcoil.model.engine.at_rest import FEW, SLOWEST

Complex = NDArray[np.complex128]


def transform(response: Array, w: Array, ratio: Array | None = None) -> Complex:
    """Σ (r_k - r_(k-1)) e^(-jωk) over k ≥ 1: of a step response from sample 1 on, w in radians per sample.

    ratio: of successive changes behind the end, (n,); without it as the last of them are.
    """
    changes = np.diff(response, axis=1, prepend=0.0)
    n = changes.shape[1]
    turns = np.exp(-1j * np.outer(np.arange(1, n + 1), w))
    ratio = (_last_ratio(changes) if ratio is None else ratio)[:, None]
    after = np.exp(-1j * w)[None, :]
    rest = changes[:, -1:] * ratio * turns[-1] * after / (1.0 - ratio * after)
    found: Complex = changes @ turns.real + 1j * (changes @ turns.imag) + rest
    return found


def _last_ratio(changes: Array) -> Array:
    """Ratio of successive changes at the end of a response, (n,), between 0 and ``SLOWEST``."""
    few = min(FEW, changes.shape[1] - 1)
    if few < 1:
        return np.zeros(changes.shape[0])
    last, before = changes[:, -1], changes[:, -1 - few]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where((last * before > 0.0), np.abs(last / before) ** (1.0 / few), 0.0)
    return np.minimum(ratio, SLOWEST)


def sampled(response: Array, tau: Array, period: int, w: Array) -> Complex:
    """``transform`` of every ``period``-th second of what a sensor with lag tau, (n,), s, shows; w in rad/s.

    Exact: from sample to sample what the sensor showed decays by d^period, d = e^(-1/tau), and the seconds between
    count by their age.
    """
    n = response.shape[1]
    changes = np.diff(response, axis=1, prepend=0.0)
    ratio = _last_ratio(changes)[:, None]
    # two samples lie behind the end
    more = 3 * period - n % period
    tail = response[:, -1:] + changes[:, -1:] * ratio * (1.0 - ratio ** np.arange(1, more + 1)) / (1.0 - ratio)
    seconds = np.concatenate([response, tail], axis=1).reshape(tau.size, -1, period)
    with np.errstate(divide="ignore"):
        decay = np.where(tau > 0.0, np.exp(-1.0 / tau), 0.0)[:, None]
    weight = (1.0 - decay) * decay ** np.arange(period - 1, -1, -1)
    shown = np.einsum("nkp,np->nk", seconds, weight)
    found: Complex = transform(shown, w * period, ratio[:, 0] ** period)
    found /= 1.0 - decay**period * np.exp(-1j * w * period)
    return found


def sensed_by(response: Array, tau: Array, longer: int) -> Array:
    """The responses as a sensor with lag tau, (n,), s, shows them; ``longer``, s, and by what the lag takes."""
    n = response.shape[1]
    more = longer + 10 * math.ceil(tau.max())
    changes = np.diff(response, axis=1, prepend=0.0)
    ratio = _last_ratio(changes)[:, None]
    # geometric: each change behind the end is the one before it times the ratio
    tail = response[:, -1:] + changes[:, -1:] * ratio * (1.0 - ratio ** np.arange(1, more + 1)) / (1.0 - ratio)
    whole = np.concatenate([response, tail], axis=1)
    if not tau.any():
        return whole
    with np.errstate(divide="ignore"):
        decay = np.where(tau > 0.0, np.exp(-1.0 / tau), 0.0)
    y = np.zeros(tau.size)
    sensed = np.empty_like(whole)
    for t in range(n + more):
        y = whole[:, t] + decay * (y - whole[:, t])
        sensed[:, t] = y
    return sensed
