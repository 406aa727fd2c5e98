"""The self-learning rule of section 3.3: step the estimate up until the mode switches chatter."""

from __future__ import annotations

from fastcoil.numerics.jit import exact

ENOUGH, QUIET, UNMEASURABLE = 0.0, 1.0, 2.0


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
def evidence(switches, f, f_ref, sample_time, min_switches, max_reference):
    """Whether an interval is ENOUGH evidence for a step, too QUIET, or UNMEASURABLE as a reference.

    f_ref: negative until there is a reference.  A controller switches at most once a sample: a reference near that
    limit cannot be exceeded ``ratio`` times, whatever the backlash.  With ``min_switches`` 0 and ``max_reference`` 1
    every interval is enough, as in the paper.
    """
    unmeasurable = f_ref < 0.0 and f > max_reference * 600.0 / sample_time
    reason = UNMEASURABLE if unmeasurable else ENOUGH
    return QUIET if switches < min_switches else reason


@exact
def updated(x_hat, step, down, lower, cap):
    """Estimate after an update: one step down when it chatters, else one up, within lower–cap."""
    stepped = x_hat - step if down else x_hat + step
    stepped = lower if stepped < lower else stepped
    return cap if stepped > cap else stepped


@exact
def step_size(last, down, climbing, growth):
    """Next step: it grows during the first climb of the estimate; a step down undoes the last one up."""
    return last * growth if climbing and not down else last


@exact
def final_estimate(x_hat, factor, lower):
    """Estimate to keep when learning stops: slightly too low is safer than slightly too high."""
    kept = x_hat * factor
    return lower if kept < lower else kept
