"""The plant of Fig 6 over a block of lanes: actuator, valve, coil."""

from __future__ import annotations

from fastcoil.engine.lanes import LANES, T_A, T_C, T_W, VOLUME_STRIDE, W_A, R
from fastcoil.engine.metrics import T_CENTRE, account_travel
from fastcoil.numerics.jit import section
from fastcoil.physics.actuator import accepted, motor
from fastcoil.physics.coil import air_heat, effectiveness, metal, outlet, outlet_humidity, water
from fastcoil.physics.psychrometrics import enthalpy, saturation_humidity_ratio
from fastcoil.physics.valve import backlash, opening, water_flow


@section
def actuate(S, counted):
    """Motor and gearbox, Eq (1).  Returns whether a lane moved its valve, and whether a motor still runs."""
    moved, running = False, False
    for j in range(LANES):
        target = accepted(S[R.command + j], S[R.command_resolution + j])
        position = motor(S[R.position + j], target, S[R.max_travel + j])
        q = backlash(S[R.q + j], position, S[R.backlash + j])
        open_ = opening(q, S[R.backlash + j])
        d_opening, d_position = open_ - S[R.opening + j], position - S[R.position + j]
        if counted:
            account_travel(S, j, d_opening, d_position)
        S[R.position + j] = position
        S[R.q + j] = q
        S[R.opening + j] = open_
        moved |= d_opening != 0.0
        running |= position != target
    return moved, running


@section
def deliver(S):
    """Water flow, Eq (2), and water-side conductance, Eq (4)."""
    for j in range(LANES):
        m_w = water_flow(S[R.opening + j], S[R.m_max + j], S[R.valve_a + j], S[R.valve_b + j], S[R.valve_c + j])
        C_flow = m_w * S[R.cp_w + j]
        S[R.m_w + j] = m_w
        S[R.C_flow + j] = C_flow
        S[R.G_w + j] = effectiveness(S[R.eps_w_factor + j], S[R.beta2 + j], m_w) * C_flow


@section
def air_side(S, m_a, shared):
    """Air-side effectiveness and conductances, Eq (4); ``shared``: β3…β6 are the same in all lanes."""
    if shared:
        eps_a = effectiveness(S[R.eps_a_factor], S[R.beta4], m_a)
        eps_star = effectiveness(S[R.eps_star_factor], S[R.beta6], m_a)
        for j in range(LANES):
            S[R.eps_a + j] = eps_a
            S[R.eps_star + j] = eps_star
    else:
        for j in range(LANES):
            S[R.eps_a + j] = effectiveness(S[R.eps_a_factor + j], S[R.beta4 + j], m_a)
            S[R.eps_star + j] = effectiveness(S[R.eps_star_factor + j], S[R.beta6 + j], m_a)
    for j in range(LANES):
        S[R.G_a + j] = S[R.eps_a + j] * m_a * S[R.cp_a + j]
        S[R.G_star + j] = S[R.eps_star + j] * m_a


@section
def march(S, V, n_volumes, lagged_air, T_a_in, W_a_in, T_w_in, m_a_counted):
    """Eq (3) for every volume, from the air's entrance to its exit: states[t] become states[t + 1].

    The air on its way, T_air and W_air, is what the next volume takes in: the state [t] of the volume passed
    (lagged, as printed), or its outlet of this step (quasistatic).
    """
    for j in range(LANES):
        S[R.T_air + j] = T_a_in
        S[R.W_air + j] = W_a_in
        V[T_W + j] = T_w_in
        S[R.wet_volumes + j] = 0.0
    for i in range(n_volumes, 0, -1):
        pair = V[(i - 1) * VOLUME_STRIDE : (i + 1) * VOLUME_STRIDE]
        for j in range(LANES):
            T_in, W_in = S[R.T_air + j], S[R.W_air + j]
            T_c, T_w, T_w_in_i = pair[VOLUME_STRIDE + T_C + j], pair[VOLUME_STRIDE + T_W + j], pair[T_W + j]

            W_s = saturation_humidity_ratio(T_c, S[R.pressure + j])
            wet = W_in > W_s
            h_in, h_s = enthalpy(T_in, W_in), enthalpy(T_c, W_s)
            Q_a = air_heat(wet, S[R.G_a + j], T_in, T_c, S[R.G_star + j], h_in, h_s)
            T_c_next = metal(T_c, Q_a, S[R.G_w + j], T_w_in_i, S[R.dt_C_c + j])
            T_w_next = water(T_w, T_w_in_i, T_c, S[R.C_flow + j], S[R.G_w + j], S[R.dt_C_w + j])
            T_out = outlet(T_in, T_c, S[R.eps_a + j])
            W_out = outlet_humidity(wet, W_in, outlet(h_in, h_s, S[R.eps_star + j]), T_out)

            S[R.T_air + j] = pair[VOLUME_STRIDE + T_A + j] if lagged_air else T_out
            S[R.W_air + j] = pair[VOLUME_STRIDE + W_A + j] if lagged_air else W_out
            pair[VOLUME_STRIDE + T_C + j] = T_c_next
            pair[VOLUME_STRIDE + T_W + j] = T_w_next
            pair[VOLUME_STRIDE + T_A + j] = T_out
            pair[VOLUME_STRIDE + W_A + j] = W_out
            S[R.wet_volumes + j] += 1.0 if wet else 0.0
            S[R.condensate + j] += m_a_counted * (W_in - W_out)
            far = abs(T_c_next - T_CENTRE)
            S[R.farthest_T_c + j] = far if far > S[R.farthest_T_c + j] else S[R.farthest_T_c + j]
