"""The coil, Eqs (3) and (4): one control volume over one time step.  Section 2.2 of the paper.

CV i of N: water enters CV 1, air enters CV N; T_w_in = T_w^(i-1), T_in, W_in = T_a^(i+1), W^(i+1).
Conductances stand in for the paper's resistances (G = 1/R), which are infinite without flow.
Units: °C, kg/s, kJ, kW, s; C in kJ/K per control volume.
"""

from __future__ import annotations

from fastcoil.numerics.elementary import exp, power
from fastcoil.numerics.jit import scalar
from fastcoil.physics.psychrometrics import humidity_ratio


@scalar
def effectiveness(factor, exponent, m):
    """ε = 1 - exp(-β m^β'), Eq (4); 1 without flow, whatever the exponent."""
    eps = 1.0 - exp(-factor * power(m, exponent))
    return 1.0 if m <= 0.0 else eps


@scalar
def air_heat(wet, G_a, T_in, T_c, G_star, h_in, h_s):
    """Heat from the air into the metal, kW: driven by temperature (Eq 3) or, when wet, by enthalpy.

    G_a = ε_a m_a c_p,a in kW/K; G_star = ε_a* m_a in kg/s; h_s: saturated at T_c.
    """
    return G_star * (h_in - h_s) if wet else G_a * (T_in - T_c)


@scalar
def metal(T_c, Q_a, G_w, T_w_in, dt_C_c):
    """T_c[t+1], Eq (3), second line and its wet form; Q_a: heat from the air, kW; G_w = ε_w m_w c_p,w."""
    return T_c + dt_C_c * (Q_a - G_w * (T_c - T_w_in))


@scalar
def water(T_w, T_w_in, T_c, C_flow, G_w, dt_C_w):
    """T_w[t+1], Eq (3), first line; C_flow = m_w c_p,w, kW/K."""
    return T_w + dt_C_w * (C_flow * (T_w_in - T_w) + G_w * (T_c - T_w_in))


@scalar
def outlet(x_in, x_coil, eps):
    """What leaves the volume of a temperature or enthalpy that enters it: x_in + ε (x_coil - x_in)."""
    return x_in + eps * (x_coil - x_in)


@scalar
def outlet_humidity(wet, W_in, h_out, T_out):
    """W of the leaving air: unchanged when dry, else from h_out and T_out.

    ε_a* and ε_a are fitted apart, so a barely wet volume could add moisture: it is limited to W_in.
    """
    W_out = humidity_ratio(h_out, T_out)
    W_out = W_in if W_out > W_in else W_out
    return W_out if wet else W_in
