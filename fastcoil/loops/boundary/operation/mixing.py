"""Outdoor air in the mixture, with an economiser, and whether the coil has anything to do."""

from __future__ import annotations

import numpy as np

from fastcoil.base.arrays import Array, Mask

DAMPER_TIME = 90
"""Seconds that the dampers take for a full stroke: usual for their motors."""
COIL_ON, COIL_OFF = 0.5, 0.2
"""Kelvins by which the mixture misses the set-point where the coil's loop goes on, and where it goes off."""


def outdoor_share(
    T_out: Array, W_out: Array, T_return: float, W_return: float, T_set: Array, least: Array, limit: float
) -> Array:
    """Share of outdoor air in the dry air of the mixture that an economiser asks for, (n,), from ``least`` to 1.

    Below the outdoor temperature ``limit`` [degC] it is the share whose mixture has the temperature ``T_set``, by the
    balance of enthalpy; elsewhere ``least``.
    """
    warm = (1.006 + 1.86 * W_return) * np.maximum(T_return - T_set, 0.0)
    cold = (1.006 + 1.86 * W_out) * np.maximum(T_set - T_out, 0.0)
    wanted = np.divide(warm, warm + cold, out=np.ones_like(T_out), where=cold > 0.0)
    return np.where(T_out < limit, np.maximum(wanted, least), least)


def through_dampers(share: Array) -> Array:
    """A share as the dampers follow it, (n,): its mean over the last ``DAMPER_TIME`` seconds, at first as it is."""
    total = np.cumsum(np.concatenate((np.zeros(1), np.full(DAMPER_TIME, share[0]), share)))
    return np.asarray((total[DAMPER_TIME + 1 :] - total[1:-DAMPER_TIME]) / DAMPER_TIME)


def coil_is_needed(missing: Array) -> Mask:
    """Where the coil's loop is on, (n,): from `COIL_ON` missing kelvins on until less than `COIL_OFF` are missing."""
    decides = (missing > COIL_ON) | (missing < COIL_OFF)
    decides[0] = True
    last = np.maximum.accumulate(np.where(decides, np.arange(missing.size), 0))
    return np.asarray(missing[last] > COIL_ON)
