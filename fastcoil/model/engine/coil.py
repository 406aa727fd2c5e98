"""The coil of a block of lanes, Eqs (3) and (4), in one of two orders.

*Lagged*, as printed: after the controller, water, then air and metal take an explicit step from state [t].

*Quasistatic*: before the controller, the air passes the metal of now; after it, metal and water take a step with the
heats of that pass, by the trapezoidal rule along the water; of the heat of the air, only what the volume's own metal
changes is taken at the middle of the step.  Its error falls with the step, not with its square, but starts at a tenth
of the printed one.  The same limits keep every temperature between its neighbours.
"""

from __future__ import annotations

import numpy as np

from fastcoil.model import physics
from fastcoil.model.engine.rows import LANES, T_A, T_C, T_W, VOLUME_STRIDE, W_A, W_S, P, Q, R
from fastcoil.model.numerics.jit import kernel, scalar, section

MILD_T = 1.0
"""°C; while everything in a coil is warmer, no metal is near freezing."""
MILD_W = 0.07
"""kg/kg; while all air is drier, no metal above 50 °C gets wet."""
_DEW_POINT_STEP_K = 0.0625  # exact in binary


@section
def update_water_conductance(S):
    """Update the water-side conductance of every lane, Eq (4)."""
    for j in range(LANES):
        S[R.ntu_w + j] = physics.transfer_units(S[R.ntu_w_factor + j], S[R.beta2 + j], S[R.log_m_w + j])
    for j in range(LANES):
        S[R.G_w + j] = physics.effectiveness_from_ntu(S[R.ntu_w + j]) * S[R.C_flow + j]


@section
def update_air_effectiveness(S, m_a):
    """Update the air-side effectiveness of every lane, Eq (4)."""
    for j in range(LANES):
        S[R.eps_a + j] = physics.effectiveness(S[R.ntu_a_factor + j], S[R.beta4 + j], m_a)
        S[R.eps_star + j] = physics.effectiveness(S[R.ntu_star_factor + j], S[R.beta6 + j], m_a)


@section
def set_air_effectiveness(S, eps_a, eps_star):
    """Set an air-side effectiveness that all lanes share."""
    for j in range(LANES):
        S[R.eps_a + j] = eps_a
        S[R.eps_star + j] = eps_star


@section
def fill_air_effectiveness(S, m_a, eps):
    """Fill eps, (2, n_steps), with ε_a and ε_a* of the whole day, for lanes that share β3…β6."""
    eps_a, eps_star = eps[0], eps[1]
    for t in range(eps_a.size):  # out of its column: a loop over every eighth number is not vectorised
        eps_a[t] = m_a[t]
    for t in range(eps_a.size):
        eps_star[t] = physics.effectiveness(S[R.ntu_star_factor], S[R.beta6], eps_a[t])
        eps_a[t] = physics.effectiveness(S[R.ntu_a_factor], S[R.beta4], eps_a[t])


@section
def set_inlets(V, n_volumes, T_a_in, W_a_in, T_w_in):
    """Set the air and the water that enter the coil in this step."""
    air = V[(n_volumes + 1) * VOLUME_STRIDE :]
    for j in range(LANES):
        air[T_A + j] = T_a_in
        air[W_A + j] = W_a_in
        V[T_W + j] = T_w_in


@section
def coldest_and_dampest(S, V, n_volumes):
    """Lowest temperature, °C, and highest humidity ratio in the coils, until something colder or damper enters."""
    for j in range(LANES):
        S[R.coldest + j] = np.inf
        S[R.dampest + j] = -np.inf
    for i in range(1, n_volumes + 1):
        cv = V[i * VOLUME_STRIDE :]
        for j in range(LANES):
            low = cv[T_W + j] if cv[T_W + j] < S[R.coldest + j] else S[R.coldest + j]
            low = cv[T_C + j] if cv[T_C + j] < low else low
            S[R.coldest + j] = cv[T_A + j] if cv[T_A + j] < low else low
            S[R.dampest + j] = cv[W_A + j] if cv[W_A + j] > S[R.dampest + j] else S[R.dampest + j]
    coldest, dampest = np.inf, -np.inf
    for j in range(LANES):
        coldest, dampest = min(coldest, S[R.coldest + j]), max(dampest, S[R.dampest + j])
    return coldest, dampest


@scalar
def dew_point_bound(T, W, pressure):
    """A temperature, °C, at and above which no air of humidity ratio W condenses on metal; inf if there is none.

    It lies up to ``_DEW_POINT_STEP_K`` above the dew point.  T: where the search starts, the bound before.
    """
    W *= 1.000001  # the pieces of the saturation curve meet to some 1e-9 of it
    T = physics.T_SATURATION_MIN if T == np.inf else T
    while T < physics.T_SATURATION_MAX and physics.saturation_humidity_ratio(T, pressure) < W:
        T += _DEW_POINT_STEP_K
    while T > physics.T_SATURATION_MIN and physics.saturation_humidity_ratio(T - _DEW_POINT_STEP_K, pressure) >= W:
        T -= _DEW_POINT_STEP_K
    return T if T < physics.T_SATURATION_MAX else np.inf


@section
def count_wet_volumes(S, V, n_volumes):
    """Count the volumes in which the air of now condenses."""
    for j in range(LANES):
        S[R.wet_volumes + j] = 0.0
    for i in range(1, n_volumes + 1):
        saturate(S, V, i, False)
        pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
        for j in range(LANES):
            S[R.wet_volumes + j] += 1.0 if pair[VOLUME_STRIDE + W_A + j] > pair[W_S + j] else 0.0


@section
def saturate(S, V, i, is_mild):
    """Compute saturation at the metal of volume i; is_mild: neither near freezing nor condensing above 50 °C."""
    cv = V[i * VOLUME_STRIDE : (i + 1) * VOLUME_STRIDE]
    for j in range(LANES):
        cv[W_S + j] = physics.humidity_ratio(physics.saturation_pressure_mild(cv[T_C + j]), S[R.pressure + j])
    if not is_mild:
        saturate_cold_and_hot(S, V, i)


@section
def saturate_cold_and_hot(S, V, i):
    """Compute saturation at the metal of volume i in the lanes in which it is near freezing or above 50 °C."""
    cv = V[i * VOLUME_STRIDE : (i + 1) * VOLUME_STRIDE]
    cold, hot = False, False
    for j in range(LANES):
        cold |= cv[T_C + j] < physics.T_FROST
        hot |= cv[T_C + j] > physics.T_HOT
    if cold:
        for j in range(LANES):
            W_s = physics.humidity_ratio(physics.saturation_pressure_frost(cv[T_C + j]), S[R.pressure + j])
            cv[W_S + j] = W_s if cv[T_C + j] < physics.T_FROST else cv[W_S + j]
    if hot:
        for j in range(LANES):
            W_s = physics.humidity_ratio(physics.saturation_pressure_hot(cv[T_C + j]), S[R.pressure + j])
            cv[W_S + j] = W_s if cv[T_C + j] > physics.T_HOT else cv[W_S + j]


@section
def march_lagged_water(S, V, n_volumes, is_mild, may_condense):
    """March the water of every volume, Eq (3); also heat into the water and saturation, which the air march reads.

    From the outlet to the inlet, so that the water entering a volume is still in state [t].  Apart from the air march,
    since two short chains of arithmetic overlap better than a long one.  is_mild: as for ``saturate``.  may_condense:
    (at least n_volumes + 1,), where air may condense in some lane; only there saturation is computed.
    """
    for k in range(n_volumes):
        i = n_volumes - k
        if may_condense[i]:
            march_lagged_water_volume(S, V, i, True)
            if not is_mild:
                saturate_cold_and_hot(S, V, i)
        else:
            march_lagged_water_volume(S, V, i, False)


@section
def march_lagged_water_volume(S, V, i, saturates):
    """March the water of volume i, Eq (3); with ``saturates`` also compute saturation at its metal."""
    pair = V[(i - 1) * VOLUME_STRIDE : (i + 1) * VOLUME_STRIDE]
    for j in range(LANES):
        row = VOLUME_STRIDE + j
        T_w, T_w_in, T_c = pair[row + T_W], pair[T_W + j], pair[row + T_C]
        Q_w = physics.water_heat(S[R.G_w + j], T_c, T_w_in)
        pair[row + T_W] = physics.next_water_temperature(T_w, T_w_in, Q_w, S[R.C_flow + j], S[R.dt_C_w + j])
        pair[row + Q] = Q_w
        if saturates:
            pair[row + W_S] = physics.humidity_ratio(physics.saturation_pressure_mild(T_c), S[R.pressure + j])


@section
def march_lagged_air(S, V, n_volumes, shares_air_side, eps_a, eps_star, m_a, dt_counted, T_dry, may_condense):
    """Eq (3) for the air and the metal of every volume, lagged: states[t] become states[t + 1].

    Air enters volume i from the row of volume i + 1, still state [t].  ``shares_air_side``: all lanes have eps_a,
    eps_star.  dt_counted: s, 0 where condensate does not count.  T_dry: nothing condenses on metal from here up, °C.
    may_condense: of this march; out, the next.
    """
    m_a_dt = m_a * dt_counted
    for i in range(1, n_volumes + 1):
        if may_condense[i]:
            may_condense[i] = march_lagged_wet_volume(S, V, i, shares_air_side, eps_a, eps_star, m_a, m_a_dt, T_dry)
        else:
            may_condense[i] = march_lagged_dry_volume(S, V, i, shares_air_side, eps_a, m_a, T_dry)


@section
def march_lagged_wet_volume(S, V, i, shares_air_side, eps_a, eps_star, m_a, m_a_dt, T_dry):
    """March air and metal of volume i, where air may condense; return whether it may in the next march."""
    pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
    may_condense = False
    for j in range(LANES):
        T_in, W_in = pair[VOLUME_STRIDE + T_A + j], pair[VOLUME_STRIDE + W_A + j]
        T_c, W_s, Q_w = pair[T_C + j], pair[W_S + j], pair[Q + j]

        wet = W_in > W_s
        cooled = (eps_a if shares_air_side else S[R.eps_a + j]) * (T_in - T_c)
        dried = (eps_star if shares_air_side else S[R.eps_star + j]) * physics.enthalpy_difference(T_in, W_in, T_c, W_s)
        T_out = T_in - cooled
        dW = physics.condensed_water(wet, W_in, cooled, dried, T_out)

        Q_a = physics.air_heat(wet, m_a, cooled, dried, S[R.cp_a + j])
        T_next = physics.next_metal_temperature(T_c, Q_a, Q_w, S[R.dt_C_c + j])
        may_condense |= not T_next >= T_dry
        pair[T_C + j] = T_next
        pair[T_A + j] = T_out
        pair[W_A + j] = W_in - dW
        S[R.condensate + j] += m_a_dt * dW
    return may_condense


@section
def march_lagged_dry_volume(S, V, i, shares_air_side, eps_a, m_a, T_dry):
    """March air and metal of volume i, where no air condenses in any lane, with less work."""
    pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
    may_condense = False
    for j in range(LANES):
        T_in, T_c = pair[VOLUME_STRIDE + T_A + j], pair[T_C + j]
        cooled = (eps_a if shares_air_side else S[R.eps_a + j]) * (T_in - T_c)
        Q_a = physics.air_heat(False, m_a, cooled, cooled, S[R.cp_a + j])
        T_next = physics.next_metal_temperature(T_c, Q_a, pair[Q + j], S[R.dt_C_c + j])
        may_condense |= not T_next >= T_dry
        pair[T_C + j] = T_next
        pair[T_A + j] = T_in - cooled
        pair[W_A + j] = pair[VOLUME_STRIDE + W_A + j]
    return may_condense


@section
def pass_air(S, V, n_volumes, m_a, dt_counted, is_mild, may_condense):
    """Pass the air of now over the metal of now, from the air's inlet to its outlet: T_a, W_a, and the heat Q."""
    for k in range(n_volumes):
        i = n_volumes - k
        if may_condense[i]:
            saturate(S, V, i, is_mild)
            pass_wet_volume(S, V, i, m_a, m_a * dt_counted)
        else:
            pass_dry_volume(S, V, i, m_a)


@section
def pass_wet_volume(S, V, i, m_a, m_a_dt):
    """Pass the air through volume i, where it may condense."""
    pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
    for j in range(LANES):
        T_in, W_in = pair[VOLUME_STRIDE + T_A + j], pair[VOLUME_STRIDE + W_A + j]
        T_c, W_s = pair[T_C + j], pair[W_S + j]
        wet = W_in > W_s
        cooled = S[R.eps_a + j] * (T_in - T_c)
        dried = S[R.eps_star + j] * physics.enthalpy_difference(T_in, W_in, T_c, W_s)
        T_out = T_in - cooled
        dW = physics.condensed_water(wet, W_in, cooled, dried, T_out)
        pair[Q + j] = physics.air_heat(wet, m_a, cooled, dried, S[R.cp_a + j])
        pair[T_A + j] = T_out
        pair[W_A + j] = W_in - dW
        S[R.condensate + j] += m_a_dt * dW


@section
def pass_dry_volume(S, V, i, m_a):
    """Pass the air through volume i, where none condenses in any lane: ``pass_wet_volume`` with less work."""
    pair = V[i * VOLUME_STRIDE : (i + 2) * VOLUME_STRIDE]
    for j in range(LANES):
        T_in = pair[VOLUME_STRIDE + T_A + j]
        cooled = S[R.eps_a + j] * (T_in - pair[T_C + j])
        pair[Q + j] = physics.air_heat(False, m_a, cooled, cooled, S[R.cp_a + j])
        pair[T_A + j] = T_in - cooled
        pair[W_A + j] = pair[VOLUME_STRIDE + W_A + j]


@section
def update_half_step_of_water(S):
    """Update what half a step of a kilowatt does to the water of a volume, which flows out on the way, K/kW."""
    for j in range(LANES):
        S[R.half_C_w + j] = physics.implicit_half_step(S[R.dt_C_w + j], S[R.C_flow + j])


@section
def update_half_step_of_metal(S, m_a):
    """Update the same of its metal, which loses heat to the air and to the water on the way."""
    for j in range(LANES):
        S[R.half_C_c + j] = half_step_of_metal(S, j, m_a)


@section
def half_step_of_metal(S, j, m_a):
    """What half a step of a kilowatt does to the metal of a volume of lane j, K/kW."""
    G_a = S[R.eps_a + j] * (m_a * S[R.cp_a + j])
    return physics.implicit_half_step(S[R.dt_C_c + j], S[R.G_w + j] + G_a)


@section
def exchange_heat(S, V, n_volumes, T_dry, may_condense):
    """Eq (3) for metal and water of every volume by the trapezoidal rule, with the heats of ``pass_air``.

    The means over the step follow along the water; the end lies as far beyond them as the start before them.
    """
    for j in range(LANES):
        S[R.T_w_mean + j] = V[T_W + j]
    for i in range(1, n_volumes + 1):
        cv = V[i * VOLUME_STRIDE : (i + 1) * VOLUME_STRIDE]
        condenses_next = False
        for j in range(LANES):
            T_w, T_c, T_w_in, G_w = cv[T_W + j], cv[T_C + j], S[R.T_w_mean + j], S[R.G_w + j]
            Q_w = physics.water_heat(G_w, T_c, T_w_in)
            T_c_mean = physics.next_metal_temperature(T_c, cv[Q + j], Q_w, S[R.half_C_c + j])
            Q_w = physics.water_heat(G_w, T_c_mean, T_w_in)
            T_w_mean = physics.next_water_temperature(T_w, T_w_in, Q_w, S[R.C_flow + j], S[R.half_C_w + j])
            T_next = T_c_mean + (T_c_mean - T_c)
            condenses_next |= not T_next >= T_dry
            cv[T_C + j] = T_next
            cv[T_W + j] = T_w_mean + (T_w_mean - T_w)
            S[R.T_w_mean + j] = T_w_mean
        may_condense[i] = condenses_next


@kernel
def stability_numbers(matrix, m_a, slope):
    """Return γ = m_w c_p,w dt / C_w and λ = dt (G_a + G_w) / C_c of every scenario at full opening, (n,) each.

    dt = 1 s / substeps.  matrix: (len(PARAMETER_ROWS), n).  m_a: air flows to try, kg/s.  slope: dh_s/dT of the
    wettest entering air, kJ/(kg K), for the wet form of λ; 0 where no volume can be wet.
    """
    gamma, lam = np.empty(matrix.shape[1]), np.empty(matrix.shape[1])
    for k in range(matrix.shape[1]):
        p = matrix[:, k]
        per_volume = 8.0 / p[P.n_volumes]
        m_max, a, b, c = p[P.m_max], p[P.valve_a], p[P.valve_b], p[P.valve_c]
        if p[P.rangeability] > 0.0:
            m_max, a, b, c = physics.installed_valve(p[P.rangeability], p[P.authority], p[P.m_full])
        m_w = physics.water_flow(1.0, m_max, a, b, c)
        G_w = physics.effectiveness(per_volume * p[P.beta1], p[P.beta2], m_w) * m_w * p[P.cp_w]
        G_air = 0.0
        for m in m_a:
            G_a = physics.effectiveness(per_volume * p[P.beta3], p[P.beta4], m) * m * p[P.cp_a]
            G_wet = physics.effectiveness(per_volume * p[P.beta5], p[P.beta6], m) * m * slope
            G_air = max(G_air, G_a, G_wet)
        gamma[k] = m_w * p[P.cp_w] / (per_volume * p[P.C_w]) / p[P.substeps]
        lam[k] = (G_air + G_w) / (per_volume * p[P.C_c]) / p[P.substeps]
    return gamma, lam
