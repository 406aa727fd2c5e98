"""The adaptive backlash inverse, simplified: one gap, a normalised gradient step, a band-pass for the closed loop.

After Tao and Kokotović (1993).  Engaged, an inverse with estimate x̂ behind a gap X gives an opening that is off by
(x̂ - X) φ / (1 - X), φ = m - u, where m is 1 rising and 0 falling: what φ and the error have in common shows in which
direction x̂ is wrong.
"""

from typing import NamedTuple

import numpy as np

from fastcoil.model.estimators.interface import Estimator, filter_weight, low_pass
from fastcoil.model.numerics.jit import exact

WASHOUT_RATIO = 20.0  # time constant of the washout over that of the filter: what lasts so long is no reversal
SET_POINT_STEP_K = 0.1  # change between two samples that is a step; the reference model follows smaller ones
AIR_FLOW_STEP_SHARE = 0.05  # change since the last step that is one, over the flow


@exact
def outside_dead_zone(e, dead_zone):
    """The part of e outside the dead zone, K."""
    above = e - dead_zone if e > dead_zone else 0.0
    return e + dead_zone if e < -dead_zone else above


@exact
def has_stepped(reference, now, size):
    """Whether a signal is more than ``size`` away from ``reference``; one that is not known, NaN, has no steps."""
    return abs(now - reference) > size


@exact
def gradient_step(x_hat, gain, sample_time, e, zeta, cap):
    """Estimate after a normalised-gradient step, γ Ts ε ζ/(1 + ζ²), projected on 0–cap."""
    x_hat = x_hat + gain * sample_time * e * zeta / (1.0 + zeta * zeta)
    x_hat = 0.0 if x_hat < 0.0 else x_hat
    return cap if x_hat > cap else x_hat


class Parameters(NamedTuple):
    """Parameters of the loop that the adaptation reads."""

    sample_time: float
    action: float
    gradient_gain: float
    gradient_filter_time: float
    gradient_reference_time: float
    gradient_dead_zone: float
    gradient_pause: float
    gradient_cap: float


class Memory(NamedTuple):
    """State from one sample to the next.  NaN: nothing yet."""

    weight_ref: float  # weight of a new value in the reference model
    weight_fast: float  # in the filter
    weight_slow: float  # in the filter of the washout
    m_a: float  # air flow at its last step, kg/s
    T_ref: float  # output of the reference model, °C
    fast: float  # φ behind the filter
    slow: float  # φ behind the filter of the washout
    resumes_at: float  # end of the pause, s


@exact
def initial_memory(p):
    """Memory at the start: nothing yet."""
    ref = filter_weight(p.gradient_reference_time, p.sample_time)
    fast = filter_weight(p.gradient_filter_time, p.sample_time)
    slow = filter_weight(WASHOUT_RATIO * p.gradient_filter_time, p.sample_time)
    return Memory(ref, fast, slow, np.nan, np.nan, np.nan, np.nan, 0.0)


@exact
def update_estimate(now, p, memory):
    """Move the estimate along the gradient, unless u is at an end or a step was not long ago; anew at u = 0."""
    starts_anew = np.isnan(memory.T_ref) or now.u <= 0.0
    sign = 1.0 - 2.0 * p.action
    T_set = now.T - sign * now.e  # of the sample that is seen
    T_ref = low_pass(now.T if starts_anew else memory.T_ref, T_set, memory.weight_ref)
    zeta = 0.0 if starts_anew else memory.fast - memory.slow  # before φ answered to this very error, and to its noise
    phi = (1.0 if now.mode > 0.0 else 0.0) - now.u  # by how much of its error the estimate shifts the opening
    fast = low_pass(np.nan if starts_anew else memory.fast, phi, memory.weight_fast)
    slow = low_pass(np.nan if starts_anew else memory.slow, phi, memory.weight_slow)

    has_air_flow_step = starts_anew or has_stepped(memory.m_a, now.m_a, AIR_FLOW_STEP_SHARE * memory.m_a)
    has_step = has_air_flow_step or has_stepped(T_set, now.T_set, SET_POINT_STEP_K)
    resumes_at = now.t + p.gradient_pause if has_step else memory.resumes_at
    acts = now.t >= resumes_at and now.u > 0.0 and now.u < 1.0

    e = outside_dead_zone(sign * (now.T - T_ref), p.gradient_dead_zone)
    x_hat = gradient_step(now.estimate, p.gradient_gain, p.sample_time, e, zeta, p.gradient_cap)
    m_a = now.m_a if has_air_flow_step else memory.m_a
    w_ref, w_fast, w_slow = memory.weight_ref, memory.weight_fast, memory.weight_slow
    next_memory = Memory(w_ref, w_fast, w_slow, m_a, T_ref, fast, slow, resumes_at)
    return x_hat if acts else now.estimate, next_memory


ESTIMATOR = Estimator("gradient", Parameters, Memory, update_estimate, initial_memory)
