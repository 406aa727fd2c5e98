"""The adaptive backlash inverse, simplified: one gap, a normalised gradient step, a band-pass for the closed loop.

After Tao and Kokotović (1993).  Engaged, an inverse with estimate x̂ behind a gap X gives an opening that is off by
(x̂ - X) φ / (1 - X), φ = m - u, where m is 1 rising and 0 falling: what φ and the error have in common says which way
x̂ is wrong.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.estimators.family import Estimator, low_passed
from fastcoil.numerics.jit import exact

WASHOUT = 20.0
"""Time constant of the washout over that of the filter: what lasts so long is no reversal."""
SET_POINT_STEP = 0.1
"""A change of the set-point between two samples that is a step, K; the reference model follows smaller ones."""
AIR_FLOW_STEP = 0.05
"""A change of the air flow since its last step that is one, as a share of the flow."""


@exact
def regressor(mode, u):
    """φ = m - u: by how much of its error the estimate shifts the opening."""
    return (1.0 if mode > 0.0 else 0.0) - u


@exact
def beyond(e, dead_zone):
    """The part of e outside the dead zone, K."""
    above = e - dead_zone if e > dead_zone else 0.0
    return e + dead_zone if e < -dead_zone else above


@exact
def stepped(before, now, size):
    """Whether a signal is more than ``size`` away from what it was; one that is not known has no steps."""
    return abs(now - before) > size


@exact
def moved(x_hat, gain, sample_time, e, zeta, cap):
    """Estimate after a normalised-gradient step, γ Ts ε ζ/(1 + ζ²), projected on 0–cap."""
    x_hat = x_hat + gain * sample_time * e * zeta / (1.0 + zeta * zeta)
    x_hat = 0.0 if x_hat < 0.0 else x_hat
    return cap if x_hat > cap else x_hat


class Parameters(NamedTuple):
    """Parameters of the loop that the adaptation uses."""

    sample_time: float
    action: float
    gradient_gain: float
    gradient_filter_time: float
    gradient_reference_time: float
    gradient_dead_zone: float
    gradient_pause: float
    gradient_cap: float


class Memory(NamedTuple):
    """What it remembers.  NaN: nothing yet."""

    t: float = np.nan
    """Time of the last sample, s."""
    T_set: float = np.nan
    """Set-point then, °C."""
    m_a: float = np.nan
    """Air flow at its last step, kg/s."""
    T_ref: float = np.nan
    """Output of the reference model, °C."""
    fast: float = np.nan
    """φ behind the filter."""
    slow: float = np.nan
    """φ behind the filter of the washout."""
    resumes: float = 0.0
    """End of the pause, s."""


@exact
def step(now, p, memory):
    """Move the estimate along the gradient, unless u is at an end or a step was not long ago.

    The sample seen is the one before, at the set-point remembered.  The reference model has no dead time: what the loop
    makes of one is over before the pause is.
    """
    broken = not now.t - memory.t <= p.sample_time  # the start, or the loop was off
    T_set = now.T_set if broken else memory.T_set
    T_ref = low_passed(now.T if broken else memory.T_ref, T_set, p.gradient_reference_time, p.sample_time)
    phi = regressor(now.mode, now.u)
    fast = low_passed(np.nan if broken else memory.fast, phi, p.gradient_filter_time, p.sample_time)
    slow = low_passed(np.nan if broken else memory.slow, phi, WASHOUT * p.gradient_filter_time, p.sample_time)

    air_steps = broken or stepped(memory.m_a, now.m_a, AIR_FLOW_STEP * memory.m_a)
    steps = air_steps or stepped(memory.T_set, now.T_set, SET_POINT_STEP)
    resumes = now.t + p.gradient_pause if steps else memory.resumes
    acts = now.t >= resumes and now.u > 0.0 and now.u < 1.0

    sign = 1.0 - 2.0 * p.action
    e = beyond(sign * (now.T - T_ref), p.gradient_dead_zone)
    zeta = 0.0 if broken else memory.fast - memory.slow  # before φ answered to this very error, and to its noise
    x_hat = moved(now.estimate, p.gradient_gain, p.sample_time, e, zeta, p.gradient_cap)
    after = Memory(now.t, now.T_set, now.m_a if air_steps else memory.m_a, T_ref, fast, slow, resumes)
    return x_hat if acts else now.estimate, after


GRADIENT = Estimator("gradient", Parameters, Memory, step)
