"""The state in which a run of a block starts: derived rows, state rows, sums."""

from __future__ import annotations

import numpy as np

from fastcoil.model.control.buffer import largest_buffer, noise_buffer
from fastcoil.model.control.compensation import slope
from fastcoil.model.control.inverse import FALLING
from fastcoil.model.engine.rows import LANES, PARAMETER_ROWS, STATE_AT, SUMS_AT, T_A, T_C, T_W, VOLUME_STRIDE, W_A, R
from fastcoil.model.numerics.elementary import exp, log
from fastcoil.model.numerics.jit import section
from fastcoil.model.physics.valve import growth, installed_valve, log_flow


@section
def derive(S, rows, n_volumes):
    """Fill the parameter rows, from a block's ``rows``, and the derived rows; coil parameters are for 8 volumes."""
    S[:STATE_AT] = 0.0
    for k in range(len(PARAMETER_ROWS)):
        for j in range(LANES):
            S[k * LANES + j] = rows[k, j]
    per_volume = 8.0 / n_volumes
    for j in range(LANES):
        S[R.dt_C_w + j] = 1.0 / (per_volume * S[R.C_w + j]) / S[R.substeps + j]
        S[R.dt_C_c + j] = 1.0 / (per_volume * S[R.C_c + j]) / S[R.substeps + j]
        S[R.ntu_w_factor + j] = per_volume * S[R.beta1 + j]
        S[R.ntu_a_factor + j] = per_volume * S[R.beta3 + j]
        S[R.ntu_star_factor + j] = per_volume * S[R.beta5 + j]
        S[R.max_travel + j] = 1.0 / S[R.stroke_time + j]
        tau = S[R.sensor_time_constant + j]
        S[R.sensor_decay + j] = exp(-1.0 / tau) if tau > 0.0 else 0.0
        S[R.ki + j] = S[R.kp + j] * S[R.sample_time + j] / S[R.ti + j]
        S[R.sign + j] = 1.0 - 2.0 * S[R.action + j]
        if S[R.rangeability + j] > 0.0:
            m_max, a, b, c = installed_valve(S[R.rangeability + j], S[R.authority + j], S[R.m_full + j])
            S[R.m_max + j] = m_max
            S[R.valve_a + j] = a
            S[R.valve_b + j] = b
            S[R.valve_c + j] = c
        S[R.log_m_max + j] = log(S[R.m_max + j])
        for opening, flow in ((0.0, R.m_0), (1.0, R.m_1)):
            grown = growth(opening, S[R.valve_b + j], S[R.valve_c + j])
            S[flow + j] = exp(log_flow(S[R.log_m_max + j], S[R.valve_a + j], grown))
        highest = largest_buffer(S[R.buffer_swing + j], S[R.plant_gain + j])
        S[R.largest_buffer + j] = highest
        sigma = 0.0 if S[R.buffer_noise + j] > 0.0 else S[R.noise_std + j]
        S[R.buffer + j] = noise_buffer(S[R.buffer + j], S[R.buffer_ratio + j], S[R.kp + j], sigma, highest)
        S[R.steepness + j] = slope(S[R.smooth_rate + j], S[R.sample_time + j])


@section
def set_initial_state(S, open_loop):
    """Fill the state rows: everything at rest, and no controller in an open loop."""
    S[STATE_AT:SUMS_AT] = 0.0
    nothing = np.nan if open_loop else 0.0
    for j in range(LANES):
        S[R.y_s + j] = S[R.T_initial + j]
        S[R.u + j] = nothing
        S[R.integral + j] = nothing
        S[R.mode + j] = 0.0 if open_loop else FALLING
        S[R.estimate + j] = np.nan if open_loop else S[R.backlash_estimate + j]
        S[R.assumed + j] = S[R.estimate_share + j] * S[R.backlash_estimate + j]
        S[R.worn + j] = S[R.backlash + j]
        S[R.gap + j] = S[R.backlash + j]
        S[R.backlash_scale + j] = 1.0
        S[R.time_reached + j] = np.nan
        S[R.time_confirmed + j] = np.nan
        S[R.time_identified + j] = np.nan


@section
def reset_sums(S, open_loop):
    """Fill the rows of the sums: nothing counted yet."""
    S[SUMS_AT:] = 0.0
    for j in range(LANES):
        S[R.sum_switches + j] = np.nan if open_loop else 0.0
        S[R.peak_power + j] = -np.inf


@section
def fill_coil(S, V, n_volumes, W_a):
    """Set every volume to ``T_initial``, with air of humidity ratio W_a."""
    for i in range(1, n_volumes + 1):
        v = i * VOLUME_STRIDE
        for j in range(LANES):
            V[v + T_W + j] = S[R.T_initial + j]
            V[v + T_C + j] = S[R.T_initial + j]
            V[v + T_A + j] = S[R.T_initial + j]
            V[v + W_A + j] = W_a
