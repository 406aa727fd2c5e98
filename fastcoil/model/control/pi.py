"""The PI law in front of the inverse (Fig 6): valve opening wanted for a temperature error."""

from __future__ import annotations

import numpy as np

from fastcoil.model.numerics.jit import exact


@exact
def clipped(x):
    """x limited to 0–1."""
    x = 0.0 if x < 0.0 else x
    return 1.0 if x > 1.0 else x


@exact
def sample_number(t, sample_time):
    """Number of the last controller sample at or before t: samples are taken where t mod sample_time = 0."""
    return np.floor(t / sample_time)


@exact
def holds(e, dead_band):
    """Whether the controller holds at an error e inside its dead band, both in K; a dead band of 0 never holds."""
    return abs(e) <= dead_band and dead_band > 0.0


@exact
def integrated(integral, e, ki):
    """Integral part at a controller sample, 0–1; ki = K_p T_s / T_i, 1/K.  The new error is added before use."""
    return clipped(integral + ki * e)


@exact
def desired_opening(e, integral, kp):
    """PI output u, 0–1.  e: T - T_set (cooling), T_set - T (heating), K."""
    return clipped(kp * e + integral)
