"""What may stand in place of the backlash inverse: half the gap added to u, and an inverse without a jump."""

from __future__ import annotations

from fastcoil.model.control.pi import clipped
from fastcoil.model.numerics.elementary import exp
from fastcoil.model.numerics.jit import exact


@exact
def additive(u_ext, mode, x_hat):
    """u_ext plus half the estimate x_hat in the direction of u, 0–1: Hägglund (2007), with δ = x̂.

    As the inverse, but for the slow term x̂ (½ - u), which the integral part takes over.  The direction is the
    buffered mode: the sign of du/dt would follow the noise.
    """
    half = 0.5 * x_hat
    return clipped(u_ext + (half if mode > 0.0 else -half))


@exact
def slope(rate, sample_time):
    """4 / (rate T_s), of the smooth inverse: how fast its logistic function rises with a change of u.  rate: 1/s."""
    return 4.0 / (rate * sample_time)


@exact
def smooth(u, u_before, x_hat, steepness):
    """(1 - x̂) u + x̂ ½ (1 + tanh(k du/dt)) with k = 2/rate, 0–1: Zhou, Zhang and Wen (2007), Eqs 5–7.

    du/dt is the change over one controller sample; steepness: of ``slope``.  At ``rate`` 98 % of the gap has been
    crossed, at a standstill the motor is in the middle of it.  The logistic function of 2 k du/dt is that tanh; exp
    limits its argument, so nothing overflows.
    """
    crossed = 1.0 / (1.0 + exp(steepness * (u_before - u)))
    return clipped((1.0 - x_hat) * u + x_hat * crossed)
