"""A PI whose integral and output end at 0 and 1, driven by an error that swings as a sine.

An integral that stands at its end while the error is on the other side starts back at once: it lags less than one
without ends, and the cycle is shorter.  The mean error is then not 0 but what brings the mean temperature there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index
from fastcoil.design.theory.curve_of_plant import temperature
from fastcoil.design.theory.describing_function import Complex
from fastcoil.design.theory.elements import Elements
from fastcoil.design.theory.plants import Columns, Plants

STEPS = 32
"""Of a period."""
_PHASE = 2.0 * np.pi * (np.arange(STEPS) + 0.5) / STEPS
_SINE = np.sin(_PHASE)
_HALVINGS = 9


class LimitedPI(NamedTuple):
    """Of each loop, (n, 1).  sign: of the error per K of T_sup; the others are the parameters and of ``Elements``."""

    kp: Array
    ti: Array
    sample_time: Array
    sign: Array
    slope: Array
    offset: Array
    backlash: Array

    @classmethod
    def of(cls, columns: Columns, elements: Elements) -> LimitedPI:
        """Of loops with these parameters, (n,) each."""
        kp, ti, period = (np.asarray(columns[name], float)[:, None] for name in ("kp", "ti", "sample_time"))
        sign = np.where(np.asarray(columns["action"]) == "heating", -1.0, 1.0)[:, None]
        return cls(kp, ti, period, sign, elements.slope, elements.offset, elements.backlash)

    def part(self, some: Index) -> LimitedPI:
        """Those of some loops."""
        return LimitedPI(*(values[some] for values in self))

    def parts(self, amplitude: Array, w: Array) -> tuple[Array, Array]:
        """Amplitudes of the proportional and the integral part that together would swing u by ``amplitude``."""
        ratio = self.sample_time / self.ti / (1.0 - np.exp(-1j * w * self.sample_time))
        return amplitude / np.abs(1.0 + ratio), amplitude * np.abs(ratio / (1.0 + ratio))

    def passed(self, amplitude: Array, w: Array, plants: Plants) -> tuple[Complex, Array]:
        """Fundamental of u over that of a PI without ends, and the mean error over its amplitude: (n, m) each."""
        proportional, integral = self.parts(amplitude, w)
        low, high = -np.ones(amplitude.shape), np.ones(amplitude.shape)
        for _ in range(_HALVINGS):
            bias = 0.5 * (low + high)
            opening = self.opening(driven(proportional, integral, bias))
            mean = temperature(plants.curve, opening.reshape(STEPS, -1).T.reshape(*amplitude.shape, STEPS)).mean(axis=2)
            # the colder the air, the smaller the error that a cooling valve sees
            above = self.sign * (mean - plants.T_sup[:, None]) > bias * proportional / self.kp
            low, high = np.where(above, bias, low), np.where(above, high, bias)
        bias = 0.5 * (low + high)
        u = driven(proportional, integral, bias)
        fundamental = 2j / STEPS * np.tensordot(np.exp(-1j * _PHASE), u, axes=1)
        return fundamental / (proportional - 1j * integral), bias

    def opening(self, u: Array) -> Array:
        """Opening at rest that belongs to u, behind a gap in whose middle the motor stands."""
        return np.asarray((u - self.offset) * self.slope / (1.0 - self.backlash))


def driven(proportional: Array, integral: Array, bias: Array) -> Array:
    """u over a period of the error, (STEPS, n, m).

    proportional, integral: amplitudes of the two parts without ends, (n, m).  bias: mean error over its amplitude; one
    below 0 brings the integral to 0 in every period.
    """
    sums, u = np.where(bias < 0.0, 0.0, 1.0), np.empty((STEPS, *bias.shape))
    step = integral * (2.0 * np.pi / STEPS)
    for _ in range(2):
        for k, x in enumerate(_SINE):
            sums = np.clip(sums + step * (x + bias), 0.0, 1.0)
            u[k] = np.clip(proportional * (x + bias) + sums, 0.0, 1.0)
    return u
