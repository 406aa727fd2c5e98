"""The self-learning rule of section 3.3: step the estimate up until the mode switches chatter."""

from __future__ import annotations

from fastcoil.numerics.jit import exact


@exact
def switch_frequency(switches, interval):
    """Mode switches per 10 min over an interval in s."""
    return switches / (interval / 600.0)


@exact
def chatters(f, f_ref, ratio, floor):
    """Whether f exceeds ``ratio`` times the reference frequency; the paper's 200 % is ratio = 2, floor = 0."""
    reference = floor if f_ref < floor else f_ref
    return f > ratio * reference


@exact
def updated(x_hat, step, down, lower, cap):
    """Estimate after an update: one step down when it chatters, else one up, within lower–cap."""
    stepped = x_hat - step if down else x_hat + step
    stepped = lower if stepped < lower else stepped
    return cap if stepped > cap else stepped
