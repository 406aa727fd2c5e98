"""The plant of Fig 6 behind the stem, over a block of lanes: water flow and coil."""

from __future__ import annotations

import numpy as np

from fastcoil.engine.rows import LANES, Q_W, T_A, T_C, T_W, VOLUME_STRIDE, W_A, W_S, R
from fastcoil.numerics.elementary import exp, log
from fastcoil.numerics.jit import section
from fastcoil.physics.coil import (
    NO_FLOW,
    air_heat,
    condensed,
    effectiveness,
    exchanged,
    metal,
    transfer_units,
    water,
    water_heat,
)
from fastcoil.physics.psychrometrics import (
    T_FROST,
    T_HOT,
    enthalpy_difference,
    frost_pressure,
    hot_pressure,
    humidity_ratio,
    mild_pressure,
)
from fastcoil.physics.valve import growth, leaking, log_flow

MILD_T, MILD_W = 1.0, 0.07
"""While all is warmer, °C, and drier, kg/kg, no metal is near freezing, and none above 50 °C gets wet."""


@section
def deliver(S, leaks):
    """Water flow, Eq (2), and water-side conductance, Eq (4): a short loop for each exponential and logarithm.

    leaks: whether any lane has its leakage given.
    """
    for j in range(LANES):
        S[R.growth + j] = growth(S[R.opening + j], S[R.valve_b + j], S[R.valve_c + j])
    for j in range(LANES):
        S[R.log_m_w + j] = log_flow(S[R.log_m_max + j], S[R.valve_a + j], S[R.growth + j])
    for j in range(LANES):
        S[R.m_w + j] = exp(S[R.log_m_w + j])
        S[R.C_flow + j] = S[R.m_w + j] * S[R.cp_w + j]
    if leaks:
        leak(S)
    water_side(S)


@section
def leak(S):
    """Water flow of the lanes whose leakage is given; the others keep that of Eq (2)."""
    for j in range(LANES):
        m_w = leaking(S[R.m_w + j], S[R.m_0 + j], S[R.m_1 + j], S[R.leakage + j])
        S[R.m_w + j] = m_w if S[R.leakage + j] >= 0.0 else S[R.m_w + j]
        S[R.C_flow + j] = S[R.m_w + j] * S[R.cp_w + j]
    for j in range(LANES):
        log_m_w = log(S[R.m_w + j] if S[R.m_w + j] > NO_FLOW else NO_FLOW)
        S[R.log_m_w + j] = log_m_w if S[R.leakage + j] >= 0.0 else S[R.log_m_w + j]


@section
def water_side(S):
    """Water-side conductance of every lane, Eq (4)."""
    for j in range(LANES):
        S[R.ntu_w + j] = transfer_units(S[R.ntu_w_factor + j], S[R.beta2 + j], S[R.log_m_w + j])
    for j in range(LANES):
        S[R.G_w + j] = exchanged(S[R.ntu_w + j]) * S[R.C_flow + j]


@section
def air_side(S, m_a):
    """Air-side effectiveness of every lane, Eq (4)."""
    for j in range(LANES):
        S[R.eps_a + j] = effectiveness(S[R.ntu_a_factor + j], S[R.beta4 + j], m_a)
        S[R.eps_star + j] = effectiveness(S[R.ntu_star_factor + j], S[R.beta6 + j], m_a)


@section
def shared_air_side(S, m_a, eps):
    """Air-side effectiveness of the whole day, where all lanes share β3…β6; eps: out, ε_a and ε_a*, (2, n_steps)."""
    for t in range(eps.shape[1]):
        eps[0, t] = effectiveness(S[R.ntu_a_factor], S[R.beta4], m_a[t])
        eps[1, t] = effectiveness(S[R.ntu_star_factor], S[R.beta6], m_a[t])


@section
def enter(V, n_volumes, T_a_in, W_a_in, T_w_in):
    """Set the air and the water that enter the coil in this step."""
    air = V[(n_volumes + 1) * VOLUME_STRIDE :]
    for j in range(LANES):
        air[T_A + j] = T_a_in
        air[W_A + j] = W_a_in
        V[T_W + j] = T_w_in


@section
def extremes(V, n_volumes):
    """Lowest temperature, °C, and highest humidity ratio, kg/kg, in the coils of a block.

    Eqs (3) and (4) take weighted means, at dt within the stability limits, and nothing but a loss of humidity: until
    something colder or damper enters, no volume goes beyond.
    """
    coldest, dampest = np.inf, -np.inf
    for i in range(1, n_volumes + 1):
        cv = V[i * VOLUME_STRIDE :]
        for j in range(LANES):
            coldest = min(coldest, cv[T_W + j], cv[T_C + j], cv[T_A + j])
            dampest = max(dampest, cv[W_A + j])
    return coldest, dampest


@section
def march_water(S, V, n_volumes, is_mild):
    """Eq (3) for the water of every volume, and what the air march reads: heat into the water, saturation.

    It runs from the water's outlet to its inlet, so that the water entering a volume is still in state [t].  It is
    separate from the air march because two short chains of arithmetic overlap better than a long one.
    is_mild: no metal is near freezing, and no air so moist that it condenses above 50 °C.
    """
    for k in range(n_volumes):
        i = n_volumes - k
        pair = V[(i - 1) * VOLUME_STRIDE : (i + 1) * VOLUME_STRIDE]
        cold, hot = False, False
        for j in range(LANES):
            own = VOLUME_STRIDE + j
            T_w, T_w_in, T_c = pair[own + T_W], pair[T_W + j], pair[own + T_C]
            Q_w = water_heat(S[R.G_w + j], T_c, T_w_in)
            pair[own + T_W] = water(T_w, T_w_in, Q_w, S[R.C_flow + j], S[R.dt_C_w + j])
            pair[own + Q_W] = Q_w
            pair[own + W_S] = humidity_ratio(mild_pressure(T_c), S[R.pressure + j])
            if not is_mild:
                cold |= T_c < T_FROST
                hot |= T_c > T_HOT
        if cold:
            for j in range(LANES):
                own = VOLUME_STRIDE + j
                W_s = humidity_ratio(frost_pressure(pair[own + T_C]), S[R.pressure + j])
                pair[own + W_S] = W_s if pair[own + T_C] < T_FROST else pair[own + W_S]
        if hot:
            for j in range(LANES):
                own = VOLUME_STRIDE + j
                W_s = humidity_ratio(hot_pressure(pair[own + T_C]), S[R.pressure + j])
                pair[own + W_S] = W_s if pair[own + T_C] > T_HOT else pair[own + W_S]


@section
def march_air(S, V, n_volumes, lagged_air, shared, eps_a, eps_star, m_a, dt_counted):
    """Eq (3) for the air and the metal of every volume: states[t] become states[t + 1].

    Air enters volume i from the row of volume i + 1.  In a march that starts at the water's inlet that row still
    holds state [t] (lagged, as printed); in one that starts at the air's inlet, this step's outlet (quasistatic).
    ``shared``: all lanes have the effectiveness eps_a, eps_star; otherwise it is in the rows of that name.
    dt_counted: the time step, s, or 0 where condensate does not count.
    """
    m_a_dt = m_a * dt_counted
    for k in range(n_volumes):
        i = k + 1 if lagged_air else n_volumes - k
        pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
        for j in range(LANES):
            T_in, W_in = pair[VOLUME_STRIDE + T_A + j], pair[VOLUME_STRIDE + W_A + j]
            T_c, W_s, Q_w = pair[T_C + j], pair[W_S + j], pair[Q_W + j]

            wet = W_in > W_s
            cooled = (eps_a if shared else S[R.eps_a + j]) * (T_in - T_c)
            dried = (eps_star if shared else S[R.eps_star + j]) * enthalpy_difference(T_in, W_in, T_c, W_s)
            T_out = T_in - cooled
            dW = condensed(wet, W_in, cooled, dried, T_out)

            Q_a = air_heat(wet, m_a, cooled, dried, S[R.cp_a + j])
            pair[T_C + j] = metal(T_c, Q_a, Q_w, S[R.dt_C_c + j])
            pair[T_A + j] = T_out
            pair[W_A + j] = W_in - dW
            S[R.condensate + j] += m_a_dt * dW


@section
def count_wet(S, V, n_volumes):
    """Count the wet volumes: the rows hold what a march compares before a lagged one, after a quasistatic one."""
    for j in range(LANES):
        S[R.wet_volumes + j] = 0.0
    for i in range(1, n_volumes + 1):
        pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
        for j in range(LANES):
            S[R.wet_volumes + j] += 1.0 if pair[VOLUME_STRIDE + W_A + j] > pair[W_S + j] else 0.0
