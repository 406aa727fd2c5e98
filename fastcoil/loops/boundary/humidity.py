"""Whether entering air can hold the water that it is given: that depends on the pressure, which only the loop knows.

Relative humidity is proportional to the pressure, so a boundary keeps the largest ratio of both.
"""

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.model.moist_air import MASS_RATIO, liquid_pressure

MIST = 1.05
"""Relative humidity up to which air may be mist, or readings may be rounded."""


class Dampest(NamedTuple):
    """The sample nearest to saturation: relative humidity over pressure [1/Pa], the sample, and where it is."""

    ratio: float = 0.0
    T: float = 0.0
    W: float = 0.0
    where: str = ""

    def sentence(self, pressure: float) -> str:
        """What is wrong with it at a pressure, Pa."""
        return (
            f"W_a_in = {self.W:.4g} at T_a_in = {self.T:.4g} degC{self.where} is a relative humidity of "
            f"{self.ratio * pressure:.0%} at {pressure:.6g} Pa: check the units of both, or give the loop the pressure "
            "of the place"
        )


def dampest(T: Array, W: Array, label: int | None, than: Dampest) -> Dampest:
    """The sample of a day, (n_steps,) each, that is nearest to saturation, or ``than`` if that is nearer."""
    if _ratio(T.min(), W.max()) <= than.ratio:  # no sample can be nearer
        return than
    ratio = _ratio(T, W)
    k = int(np.argmax(ratio))
    where = f" at second {k}" + ("" if label is None else f" of day {label}")
    return max(than, Dampest(float(ratio[k]), float(T[k]), float(W[k]), where))


def _ratio(T: Array, W: Array) -> Array:
    """Relative humidity over pressure, 1/Pa."""
    return np.asarray(W / (MASS_RATIO + W) / liquid_pressure(T))
