"""How far a loop without a gap is from instability: ultimate gain and period, gain margin, phase margin."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.design.theory.plants import Columns, Plants, driven_gain, loop_response, sampled_plant
from fastcoil.design.theory.response import Complex

_LOWEST = 1e-6
"""Lowest frequency, rad/s: any integral has brought L above 1 there."""
_FREQUENCIES = 800


class Margins(NamedTuple):
    """Of n loops, (n,) each, without a gap, so at its best.

    ultimate_gain: kp at which the loop would swing for ever under a P controller, 1/K.  ultimate_period: s.
    gain_margin: by how much kp may be multiplied; below 1 the loop is unstable.  phase_margin: degrees.
    NaN where there is no such thing: a valve that changes nothing, or acts the wrong way round.
    """

    ultimate_gain: Array
    ultimate_period: Array
    gain_margin: Array
    phase_margin: Array


def margins_of(columns: Columns, plants: Plants) -> Margins:
    """Margins of every loop, from the exact transfer function of the loop as it is sampled."""
    n = plants.gain.size
    found = Margins(*(np.full(n, math.nan) for _ in Margins._fields))
    periods = np.asarray(columns["sample_time"], float)
    gain = driven_gain(columns, plants)
    for period in np.unique(periods):
        members = np.flatnonzero((periods == period) & (gain > 0.0))
        if not members.size:
            continue
        some = {name: values[members] for name, values in columns.items()}
        of_some = plants.some(members)
        w = np.geomspace(_LOWEST, math.pi / period, _FREQUENCIES)
        P, which = sampled_plant(some, of_some, w)
        size, at = at_180(np.sign(of_some.gain[_firsts(which)])[:, None] * P, w)
        unit = gain[members] / np.abs(of_some.gain)
        found.ultimate_gain[members] = 1.0 / (unit * size[which])
        found.ultimate_period[members] = 2.0 * math.pi / at[which]
        L = loop_response(some, of_some, w)
        found.gain_margin[members] = 1.0 / at_180(L, w)[0]
        found.phase_margin[members] = _phase_left(L)
    return found


def _firsts(which: np.ndarray) -> np.ndarray:
    return np.unique(which, return_index=True)[1]


def at_180(L: Complex, w: Array) -> tuple[Array, Array]:
    """|L| and ω, (n,) each, where L crosses the negative real axis with the largest |L|; its end at π/ts is on it."""
    before, after = L[:, :-1].imag, L[:, 1:].imag
    crosses = (before < 0.0) & (after >= 0.0) & (L[:, 1:].real < 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crosses, before / (before - after), 0.0)
    real = L[:, :-1].real + share * (L[:, 1:].real - L[:, :-1].real)
    size = np.where(crosses, -real, 0.0)
    at = w[:-1] + share * np.diff(w)
    end = np.maximum(-L[:, -1].real, 0.0)
    size, at = np.column_stack([size, end]), np.column_stack([at, np.full(end.size, w[-1])])
    k = np.argmax(size, axis=1)
    rows = np.arange(k.size)
    return np.where(size[rows, k] > 0.0, size[rows, k], math.nan), at[rows, k]


def _phase_left(L: Complex) -> Array:
    """Least phase margin over the frequencies at which |L| = 1, degrees."""
    with np.errstate(divide="ignore"):  # a loop with kp = 0 has a size of 0 and no margin
        log_size = np.log(np.abs(L))
    phase = np.unwrap(np.angle(L), axis=1)
    before, after = log_size[:, :-1], log_size[:, 1:]
    crosses = before * after <= 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crosses, before / (before - after), 0.0)
    left = 180.0 + np.degrees(phase[:, :-1] + share * np.diff(phase, axis=1))
    least = np.min(np.where(crosses, left, np.inf), axis=1)
    return np.where(np.isfinite(least), least, math.nan)
