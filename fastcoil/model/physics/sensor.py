"""The supply air sensor: first-order lag, noise, resolution.  The paper's is ideal (all 0)."""

from __future__ import annotations

import numpy as np

from fastcoil.model.numerics.jit import scalar


@scalar
def lagged(y_s, T, decay):
    """Sensor temperature after one step, decay = e^(-dt/τ).

    The usual y_s + (1 - decay)(T - y_s), written so that decay = 0 gives T to the bit.
    """
    return T + decay * (y_s - T)


@scalar
def quantised(y, resolution):
    """r floor(y/r + 1/2), or y itself where the resolution r is 0."""
    r = 1.0 if resolution <= 0.0 else resolution
    return y if resolution <= 0.0 else r * np.floor(y / r + 0.5)


@scalar
def measured(y_s, noise, resolution):
    """What the controller reads, °C."""
    return quantised(y_s + noise, resolution)
