"""Moist air.  Temperatures in °C, pressures in Pa, enthalpies in kJ/kg and humidity ratios in kg/kg of dry air.

Saturation is Hyland and Wexler's, over ice and over liquid water (ASHRAE Handbook Fundamentals 2017, ch. 1, Eqs 5
and 6).
"""

from __future__ import annotations

from fastcoil.model.numerics.elementary import polynomial
from fastcoil.model.numerics.jit import scalar

T_FROST, T_HOT = 0.01, 50.0
"""Over ice below the triple point, where Eqs 5 and 6 meet to 6e-9 of p_ws; rarely above the other in a coil."""
T_SATURATION_MIN, T_SATURATION_MAX = -20.0, 60.0
MASS_RATIO = 0.621945
"""Molar mass of water over that of dry air."""

# p_ws, Pa, interpolated at Chebyshev nodes, without the logarithm, division and exponential of Eqs 5 and 6.
# In T - 25 °C on 0..50 °C: 3.3e-11 relative at worst
_MILD, _P_MILD = 25.0, (
    6.337648701247726e-19, 4.843596783206397e-16, -5.599997570513241e-14, -3.0331269952404774e-11,
    2.8276007599474568e-09, 2.8250279786507624e-06, 0.0006149997625258774, 0.07159297906653218, 4.91264330714873,
    188.9310647032762, 3169.2164701436113,
)  # fmt: skip
# in T + 10 °C on -20..0.01 °C, over ice: 4.4e-11
_FROST, _P_FROST = -10.0, (
    2.166482455294341e-13, 1.364296417216959e-10, 3.0164038582249346e-08, 4.057612631985733e-06,
    0.00036773757795715217, 0.022801634494503644, 0.9359654830054085, 23.07378361055915, 259.902864952159,
)  # fmt: skip
# in T - 55 °C on 50..60 °C: 2.8e-12
_HOT, _P_HOT = 55.0, (
    -3.804957288664999e-09, 2.726680428272405e-06, 0.001046644188296657, 0.17144009348699968, 15.457900310573544,
    755.1027089840052, 15759.706943242232,
)  # fmt: skip


@scalar
def mild_pressure(T):
    """Saturation pressure p_ws over liquid water, Pa; T is clamped to 0.01–50 °C."""
    T = T_FROST if T < T_FROST else T
    # each limit on a variable of its own becomes one instruction; both on T would become masks
    x = T - _MILD
    x = T_HOT - _MILD if x > T_HOT - _MILD else x
    return polynomial(x, _P_MILD)


@scalar
def frost_pressure(T):
    """Saturation pressure p_ws over ice, Pa, below 0.01 °C; T is clamped to -20 °C."""
    x = T - _FROST
    return polynomial(T_SATURATION_MIN - _FROST if x < T_SATURATION_MIN - _FROST else x, _P_FROST)


@scalar
def hot_pressure(T):
    """Saturation pressure p_ws over liquid water, Pa, above 50 °C; T is clamped to 60 °C."""
    x = T - _HOT
    return polynomial(T_SATURATION_MAX - _HOT if x > T_SATURATION_MAX - _HOT else x, _P_HOT)


@scalar
def saturation_pressure(T):
    """Saturation pressure p_ws, Pa: over ice below 0.01 °C, over liquid water above; T is clamped to -20–60 °C."""
    p_ws = frost_pressure(T) if T < T_FROST else mild_pressure(T)
    return hot_pressure(T) if T > T_HOT else p_ws


@scalar
def humidity_ratio(p_w, pressure):
    """W, kg/kg, at a partial pressure of vapour (ASHRAE Fundamentals 2017, ch. 1, Eq 20)."""
    return MASS_RATIO * p_w / (pressure - p_w)


@scalar
def saturation_humidity_ratio(T, pressure):
    """W_s, kg/kg (ASHRAE Fundamentals 2017, ch. 1, Eq 21)."""
    return humidity_ratio(saturation_pressure(T), pressure)


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
