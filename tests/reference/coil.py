"""Eqs (3) and (4): the coil.

CV = control volume, CV 1..N along the water: water enters CV 1, air enters CV N, supply air leaves CV 1; in
per-volume lists, index 0 is CV 1.
"""

import math

import numpy as np

from reference.psychrometrics import enthalpy, humidity_ratio, saturation_humidity_ratio


def effectiveness(flow, factor, exponent):
    """Eq (4): effectiveness [-] of one volume at a mass flow [kg/s]; 1 without flow."""
    if flow <= 0.0:
        return 1.0
    return 1.0 - math.exp(-factor * flow**exponent)


def exchange(parameters, m_w, m_a):
    """Eq (4) for one of N volumes: (eps_a, eps_star, G_w, G_a, G_star).

    Effectivenesses are dimensionless; the conductances, 1/R_w and 1/R_a in kW/K and 1/R_a* in kg/s, replace
    the printed resistances because these are infinite without flow.
    """
    p = parameters
    scale = 8.0 / p["n_volumes"]
    eps_w = effectiveness(m_w, p["beta1"] * scale, p["beta2"])
    eps_a = effectiveness(m_a, p["beta3"] * scale, p["beta4"])
    eps_star = effectiveness(m_a, p["beta5"] * scale, p["beta6"])
    water_flow, air_flow = max(m_w, 0.0), max(m_a, 0.0)
    return eps_a, eps_star, eps_w * water_flow * p["cp_w"], eps_a * air_flow * p["cp_a"], eps_star * air_flow


def pass_air(parameters, T_c, m_a, T_a_in, W_a_in, saturation=None, lagged=None):
    """The air side of Eq (3) and the wet balance that follows it: (T_a, W_a, Q, number of wet volumes, vapour).

    T_c [degC]: metal of each volume.  T_a [degC] and W_a [kg/kg] leave each volume, Q [kW] goes into its metal,
    vapour [kg/s] is what the air loses in all.  lagged: T_a and W_a of a second ago, which then enter the volumes
    downstream.
    """
    p = parameters
    if saturation is None:
        saturation = saturation_humidity_ratio
    n_volumes = p["n_volumes"]
    eps_a, eps_star, _, G_a, G_star = exchange(p, 0.0, m_a)
    T_a, W_a, Q = ([0.0] * n_volumes for _ in range(3))
    wet_volumes, vapour = 0, 0.0
    # The pass runs from the air inlet, so the entry of the volume upstream is already this step's.
    T_upstream, W_upstream = lagged or (T_a, W_a)
    for i in range(n_volumes - 1, -1, -1):
        T_in, W_in = (T_a_in, W_a_in) if i == n_volumes - 1 else (T_upstream[i + 1], W_upstream[i + 1])
        W_s = saturation(T_c[i], p["pressure"])

        T_a[i] = T_in + eps_a * (T_c[i] - T_in)
        if W_in > W_s:
            wet_volumes += 1
            h_in, h_s = enthalpy(T_in, W_in), enthalpy(T_c[i], W_s)
            h_out = h_in + eps_star * (h_s - h_in)
            # Temperature and enthalpy have different effectivenesses, so a barely wet volume would
            # otherwise humidify the air.
            W_a[i] = min(humidity_ratio(h_out, T_a[i]), W_in)
            Q[i] = G_star * (h_in - h_s)
        else:
            W_a[i] = W_in
            Q[i] = G_a * (T_in - T_c[i])
        vapour += max(m_a, 0.0) * (W_in - W_a[i])
    return T_a, W_a, Q, wet_volumes, vapour


def change_rates(parameters, T_w, T_c, Q, m_w, T_w_in):
    """Eq (3) for water and metal: (dT_w/dt, dT_c/dt) [K/s] of every volume; Q [kW] comes from the air."""
    p = parameters
    n_volumes = p["n_volumes"]
    C_w, C_c = p["C_w"] * 8.0 / n_volumes, p["C_c"] * 8.0 / n_volumes
    G_w = exchange(p, m_w, 0.0)[2]
    water_rates, metal_rates = [], []
    for T_water_in, T_water, T_metal, Q_air in zip([T_w_in, *T_w[:-1]], T_w, T_c, Q, strict=True):
        Q_water = G_w * (T_metal - T_water_in)
        water_rates.append((m_w * p["cp_w"] * (T_water_in - T_water) + Q_water) / C_w)
        metal_rates.append((Q_air - Q_water) / C_c)
    return water_rates, metal_rates


def euler_step(parameters, T_w, T_c, Q, m_w, T_w_in, dt):
    """Eq (3) as printed: (T_w, T_c) [degC] at t + dt."""
    water_rates, metal_rates = change_rates(parameters, T_w, T_c, Q, m_w, T_w_in)
    return _advance(T_w, water_rates, dt), _advance(T_c, metal_rates, dt)


def _advance(T, rates, dt):
    return [value + dt * rate for value, rate in zip(T, rates, strict=True)]


def trapezoidal_step(parameters, T_w, T_c, Q, m_w, m_a, T_w_in, dt):
    """Eq (3) with the means of T_w and T_c over the step on its right, solved for all volumes at once: both at t + dt.

    Q [kW] is the heat of the air at t, less what the air would give less to dry metal of the mean temperature.
    """
    p = parameters
    n_volumes = p["n_volumes"]
    _, _, G_w, G_a, _ = exchange(p, m_w, m_a)
    h_w, h_c = (dt / 2.0 / (C * 8.0 / n_volumes) for C in (p["C_w"], p["C_c"]))
    C_flow = m_w * p["cp_w"]
    A, b = np.eye(2 * n_volumes), np.array([*T_w, *T_c])  # unknown are the means, first of the water
    for i in range(n_volumes):
        water, metal, upstream = i, n_volumes + i, i - 1
        A[water, water] += h_w * C_flow
        A[water, metal] -= h_w * G_w
        A[metal, metal] += h_c * (G_a + G_w)
        b[metal] += h_c * (Q[i] + G_a * T_c[i])
        if i > 0:
            A[water, upstream] -= h_w * (C_flow - G_w)
            A[metal, upstream] -= h_c * G_w
        else:
            b[water] += h_w * (C_flow - G_w) * T_w_in
            b[metal] += h_c * G_w * T_w_in
    after = 2.0 * np.linalg.solve(A, b) - np.array([*T_w, *T_c])
    return after[:n_volumes].tolist(), after[n_volumes:].tolist()


def runge_kutta_second(parameters, T_w, T_c, m_w, m_a, T_w_in, T_a_in, W_a_in, saturation=None, steps=4):
    """Eq (3) with air that passes without delay, by Runge and Kutta's method in ``steps``: both a second later."""
    h = 1.0 / steps
    for _ in range(steps):
        rates = []
        for share in (0.0, 0.5 * h, 0.5 * h, h):
            water_rates, metal_rates = rates[-1] if rates else ([0.0] * len(T_w), [0.0] * len(T_c))
            T_w_k, T_c_k = _advance(T_w, water_rates, share), _advance(T_c, metal_rates, share)
            Q = pass_air(parameters, T_c_k, m_a, T_a_in, W_a_in, saturation)[2]
            rates.append(change_rates(parameters, T_w_k, T_c_k, Q, m_w, T_w_in))
        for k, weight in enumerate((1.0, 2.0, 2.0, 1.0)):
            T_w, T_c = (_advance(T, r, weight * h / 6.0) for T, r in zip((T_w, T_c), rates[k], strict=True))
    return T_w, T_c


def steady_state_dry(parameters, m_w, m_a, T_w_in, T_a_in):
    """Closed-form steady state of Eq (3) for a dry coil: (T_sup, T_w_out) [degC].

    m_w, m_a > 0 in kg/s, entering temperatures in degC.  The difference between the air and the water
    entering a volume grows by the ratio r from each volume to the next, hence a geometric sum.
    """
    p = parameters
    _, _, G_w, G_a, _ = exchange(p, m_w, m_a)
    C_air, C_water, G_s = m_a * p["cp_a"], m_w * p["cp_w"], G_a * G_w / (G_a + G_w)
    a, w = G_s / C_air, G_s / C_water
    r = (1.0 - w) / (1.0 - a)
    S = sum(r**k for k in range(p["n_volumes"]))
    T_sup = T_a_in - (T_a_in - T_w_in) * a * S / (1.0 + a * (S - 1.0))
    T_w_out = T_w_in + C_air / C_water * (T_a_in - T_sup)
    return T_sup, T_w_out
