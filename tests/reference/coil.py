"""Eqs (3) and (4): the coil.

CV = control volume, CV 1..N along the water: water enters CV 1, air enters CV N, supply air leaves CV 1; in
per-volume lists, index 0 is CV 1.
"""

import math

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


def coil_step(parameters, T_w, T_c, T_a, W_a, m_w, m_a, T_w_in, T_a_in, W_a_in, saturation=None, dt=1.0):
    """Eq (3) and the wet balance that follows it: all volumes from second t to t + dt.

    T_w, T_c, T_a [degC] and W_a [kg/kg] are the per-volume states at t: water, metal and air leaving each
    volume.  m_w, m_a [kg/s], T_w_in, T_a_in [degC] and W_a_in [kg/kg] are the flows and entering conditions
    at t.  Returns the four state lists at t + dt, the number of wet volumes, and the condensate [kg].
    """
    p = parameters
    if saturation is None:
        saturation = saturation_humidity_ratio
    n_volumes = p["n_volumes"]
    C_w, C_c = p["C_w"] * 8.0 / n_volumes, p["C_c"] * 8.0 / n_volumes
    eps_a, eps_star, G_w, G_a, G_star = exchange(p, m_w, m_a)
    water_capacity_rate = m_w * p["cp_w"]

    T_w_next, T_c_next, T_a_next, W_a_next = ([0.0] * n_volumes for _ in range(4))
    wet_volumes, condensate = 0, 0.0
    # The march runs from the air inlet, so the entry of the volume upstream is already this step's.
    T_upstream, W_upstream = (T_a, W_a) if p["air_march"] == "lagged" else (T_a_next, W_a_next)
    for i in range(n_volumes - 1, -1, -1):
        T_in, W_in = (T_a_in, W_a_in) if i == n_volumes - 1 else (T_upstream[i + 1], W_upstream[i + 1])
        T_water = T_w_in if i == 0 else T_w[i - 1]
        T_coil = T_c[i]
        W_s = saturation(T_coil, p["pressure"])

        T_out = T_in + eps_a * (T_coil - T_in)
        if W_in > W_s:
            wet_volumes += 1
            h_in, h_s = enthalpy(T_in, W_in), enthalpy(T_coil, W_s)
            h_out = h_in + eps_star * (h_s - h_in)
            # Temperature and enthalpy have different effectivenesses, so a barely wet volume would
            # otherwise humidify the air.
            W_out = min(humidity_ratio(h_out, T_out), W_in)
            Q_air = G_star * (h_in - h_s)
        else:
            W_out = W_in
            Q_air = G_a * (T_in - T_coil)
        condensate += max(m_a, 0.0) * (W_in - W_out) * dt

        Q_water = G_w * (T_coil - T_water)
        T_w_next[i] = T_w[i] + dt * (water_capacity_rate * (T_water - T_w[i]) + Q_water) / C_w
        T_c_next[i] = T_coil + dt * (Q_air - Q_water) / C_c
        T_a_next[i], W_a_next[i] = T_out, W_out
    return T_w_next, T_c_next, T_a_next, W_a_next, wet_volumes, condensate


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
