"""The coil, Eqs (3) and (4): one control volume over one time step.  Section 2.2 of the paper.

CV i of N: water enters CV 1, air enters CV N; T_w_in = T_w^(i-1), T_in, W_in = T_a^(i+1), W^(i+1).
Conductances stand in for the paper's water-side resistances (G = 1/R), which are infinite without flow.
Units: °C, kg/s, kJ, kW, s; C in kJ/K per control volume.
"""

from __future__ import annotations

from fastcoil.model.numerics.elementary import exp, log
from fastcoil.model.numerics.jit import scalar
from fastcoil.model.physics.psychrometrics import heat_capacity, vapour_enthalpy

NO_FLOW = 1e-9
"""Least water flow, kg/s, at which the effectiveness is taken: below it, whatever the exponent, the conductance of
Eq (4) goes to 0 with the flow."""


@scalar
def transfer_units(factor, exponent, log_m):
    """Number of transfer units β m^β' of Eq (4), from ln m."""
    return factor * exp(exponent * log_m)


@scalar
def exchanged(ntu):
    """Effectiveness ε = 1 - e^(-NTU), Eq (4)."""
    return 1.0 - exp(-ntu)


@scalar
def effectiveness(factor, exponent, m):
    """ε = 1 - exp(-β m^β'), Eq (4); 1 without flow, whatever the exponent."""
    eps = exchanged(transfer_units(factor, exponent, log(m)))
    return 1.0 if m <= 0.0 else eps


@scalar
def air_heat(wet, m_a, cooled, dried, cp_a):
    """Heat from the air into the metal, kW: by its fall in temperature (Eq 3) or, when wet, in enthalpy.

    cooled = ε_a (T_in - T_c), K; dried = ε_a* (h_in - h_s), kJ/kg, with h_s saturated at T_c.
    """
    return m_a * (dried if wet else cp_a * cooled)


@scalar
def condensed(wet, W_in, cooled, dried, T_out):
    """Water that the air loses, W_in - W_out: its fall in enthalpy less that of cooling, as vapour at T_out.

    ε_a* and ε_a are fitted separately, so a barely wet volume could add moisture: it then condenses nothing.
    """
    dW = (dried - heat_capacity(W_in) * cooled) / vapour_enthalpy(T_out)
    dW = 0.0 if dW < 0.0 else dW
    return dW if wet else 0.0


@scalar
def water_heat(G_w, T_c, T_w_in):
    """Heat from the metal into the water, kW; G_w = ε_w m_w c_p,w."""
    return G_w * (T_c - T_w_in)


@scalar
def metal(T_c, Q_a, Q_w, dt_C_c):
    """T_c[t+1], Eq (3), second line and its wet form, from the heats of air and water, kW."""
    return T_c + dt_C_c * (Q_a - Q_w)


@scalar
def water(T_w, T_w_in, Q_w, C_flow, dt_C_w):
    """T_w[t+1], Eq (3), first line; C_flow = m_w c_p,w, kW/K."""
    return T_w + dt_C_w * (C_flow * (T_w_in - T_w) + Q_w)
