"""The backlash inverse behind the PI (section 3.3, Fig 8), with a buffer against noise.

With an estimate of 0 it is the identity: the plain PI is the same law, and lanes of all controllers mix.
"""

from __future__ import annotations

from fastcoil.model.control.pi import clipped
from fastcoil.model.numerics.jit import exact

RISING = 1.0
FALLING = -1.0


@exact
def direction(u, mode, u_ext, buffer):
    """Mode after seeing u: it turns when u comes back from its extreme by more than ``buffer``.

    mode: RISING or FALLING; u_ext: furthest u since the last turn; buffer: fraction of stroke, 0 as in the
    paper, 1e-9 so that round-off is no reversal.
    """
    turned_down = mode > 0.0 and u < u_ext - buffer
    turned_up = mode < 0.0 and u > u_ext + buffer
    mode = FALLING if turned_down else mode
    return RISING if turned_up else mode


@exact
def extreme(u, mode, u_ext, turned):
    """u_ext after seeing u: u itself at a turn or further on, else held."""
    further = (mode > 0.0 and u > u_ext) or (mode < 0.0 and u < u_ext)
    return u if turned or further else u_ext


@exact
def inverse(u_ext, mode, x_hat):
    """Command that makes the opening u_ext behind a backlash x_hat: (1 - x̂) u, plus x̂ when rising."""
    return clipped((1.0 - x_hat) * u_ext + (x_hat if mode > 0.0 else 0.0))
