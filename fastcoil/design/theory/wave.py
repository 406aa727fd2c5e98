"""The wave of T_sup in a cycle: how far it swings, harmonics and all.

A describing function knows the fundamental only.  Behind a valve that stands at its ends for a while the temperature
swings as a triangle or a saw, by up to a quarter further than its fundamental.
"""

from __future__ import annotations

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.design.theory.curve_of_plant import temperature
from fastcoil.design.theory.elements import Elements
from fastcoil.design.theory.harmonic_balance import between
from fastcoil.design.theory.limited_pi import STEPS, LimitedPI, driven
from fastcoil.design.theory.plants import Plants, frequency_response

_HARMONICS = np.arange(1, 7)
_LOWEST, _FREQUENCIES = 1e-4, 64
_PERIODS = 3


def amplitude_of(u: Array, mean: Array, w: Array, pi: LimitedPI, elements: Elements, plants: Plants) -> Array:
    """Half of peak to peak of T_sup, K, (n,).

    u, mean: amplitude of u without limits, and its mean, fraction of stroke; w: rad/s; (n, 1) each.
    """
    period = np.linspace(0.0, 2.0 * np.pi, STEPS, endpoint=False)
    driving = np.clip(mean + u * np.sin(period), 0.0, 1.0).T[:, :, None]
    proportional, integral = pi.parts(u, w)
    ends = integral > np.minimum(mean, 1.0 - mean)
    if ends.any():
        some = np.flatnonzero(ends)
        bias = pi.part(some).passed(u[some], w[some], plants.some(some))[1]
        driving[:, some] = driven(proportional[some], integral[some], bias)
    opening = pi.opening(_followed(_held(driving, w * elements.sample_time), w, elements))
    at_rest = temperature(plants.curve, opening.transpose(1, 2, 0))[:, 0]
    return np.asarray(0.5 * np.ptp(_filtered(at_rest, w, plants), axis=1))


def _held(driving: Array, angle: Array) -> Array:
    """The wave as a sampled controller holds it, by ``angle`` of a period, (n, 1), from sample to sample."""
    step = np.maximum(angle[:, 0] * STEPS / (2.0 * np.pi), 1.0)
    k = np.arange(STEPS)[:, None]
    sampled = np.round(np.floor(k / step + 1e-9) * step).astype(np.int64) % STEPS
    return driving[sampled, np.arange(step.size)]


def _followed(driving: Array, w: Array, elements: Elements) -> Array:
    """Where motor and gap bring the stem, in u: (STEPS, n, 1)."""
    with np.errstate(divide="ignore"):
        most = 2.0 * np.pi / STEPS / (w * elements.stroke_time)
    half, ahead = 0.5 * np.maximum(elements.width, 0.0), 0.5 * np.maximum(-elements.width, 0.0)
    motor, stem, way = driving[0], driving[0], np.zeros(w.shape)
    path = np.empty(driving.shape)
    for _ in range(_PERIODS):
        for k, target in enumerate(driving):
            moved = motor + np.clip(target - motor, -most, most)
            way = np.where(moved > motor, 1.0, np.where(moved < motor, -1.0, way))
            motor = moved
            stem = np.clip(stem, motor - half, motor + half)
            path[k] = stem + ahead * way
    return path


def _filtered(at_rest: Array, w: Array, plants: Plants) -> Array:
    """The wave (n, n_points) that a plant makes of a wave of the temperatures at rest, (n, STEPS)."""
    _, first, which = np.unique(plants.same, return_index=True, return_inverse=True)
    known = np.geomspace(_LOWEST, np.pi, _FREQUENCIES)
    G = frequency_response(plants.response[first], known) / plants.gain[first, None]
    place = np.log(np.minimum(_HARMONICS * w, np.pi) / _LOWEST) / np.log(known[1] / known[0])
    size = between(np.log(np.maximum(np.abs(G), 1e-300))[which.ravel()], place)
    phase = between(np.unwrap(np.angle(G), axis=1)[which.ravel()], place)
    parts = np.fft.rfft(at_rest, axis=1)[:, _HARMONICS] * np.exp(size + 1j * phase)
    spectrum = np.zeros((w.size, 2 * STEPS + 1), complex)
    spectrum[:, _HARMONICS] = parts
    return np.asarray(np.fft.irfft(spectrum, 4 * STEPS, axis=1) * 4.0)
