"""Moist air.  Temperatures in °C, pressures in Pa, enthalpies in kJ/kg and humidity ratios in kg/kg of dry air.

Saturation is Hyland and Wexler's over liquid water (ASHRAE Handbook Fundamentals 2017, ch. 1, Eq 6).
"""

from __future__ import annotations

from fastcoil.numerics.elementary import polynomial
from fastcoil.numerics.jit import scalar

T_SATURATION_MIN = 0.01
T_SATURATION_MAX = 50.0
MASS_RATIO = 0.621945
"""Molar mass of water over that of dry air."""

# p_ws in T - 25 °C, interpolated at the 11 Chebyshev nodes of 0..50 °C: 3.3e-11 relative at worst,
# without the logarithm, division and exponential of Eq 6
_T_CENTRE = 25.0
_P_WS = (
    6.337648701247726e-19,
    4.843596783206397e-16,
    -5.599997570513241e-14,
    -3.0331269952404774e-11,
    2.8276007599474568e-09,
    2.8250279786507624e-06,
    0.0006149997625258774,
    0.07159297906653218,
    4.91264330714873,
    188.9310647032762,
    3169.2164701436113,
)


@scalar
def saturation_pressure(T):
    """Saturation pressure p_ws over liquid water, Pa; T is clamped to 0.01–50 °C."""
    T = T_SATURATION_MIN if T < T_SATURATION_MIN else T
    # each limit on a variable of its own becomes one instruction; both on T would become masks
    x = T - _T_CENTRE
    x = T_SATURATION_MAX - _T_CENTRE if x > T_SATURATION_MAX - _T_CENTRE else x
    return polynomial(x, _P_WS)


@scalar
def saturation_humidity_ratio(T, pressure):
    """W_s, kg/kg (ASHRAE Fundamentals 2017, ch. 1, Eq 21)."""
    p_ws = saturation_pressure(T)
    return MASS_RATIO * p_ws / (pressure - p_ws)


# enthalpy is 1.006 T + W (2501 + 1.86 T), kJ/kg of dry air (ASHRAE Fundamentals 2017, ch. 1, Eq 30); the kernel
# needs only its differences


@scalar
def vapour_enthalpy(T):
    """Enthalpy of water vapour, kJ/kg of water: what W multiplies in Eq 30."""
    return 2501.0 + 1.86 * T


@scalar
def heat_capacity(W):
    """c_p of moist air, kJ/K per kg of dry air: what T multiplies in Eq 30."""
    return 1.006 + 1.86 * W


@scalar
def enthalpy_difference(T, W, T_s, W_s):
    """h(T, W) - h(T_s, W_s), kJ/kg of dry air: first cooled to T_s as it is, then dried to W_s."""
    return heat_capacity(W) * (T - T_s) + vapour_enthalpy(T_s) * (W - W_s)
