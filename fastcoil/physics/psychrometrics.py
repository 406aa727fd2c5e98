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

# p_ws in s = (T - 25)/25, interpolated at the 11 Chebyshev nodes of 0..50 °C: 3.3e-11 relative at worst,
# without the logarithm, division and exponential of Eq 6
_P_WS = (
    6.0440527927853835e-05,
    0.0018476855404687487,
    -0.008544918167897401,
    -0.18512738008059554,
    0.6903322167840471,
    27.588163854011352,
    240.23428223667085,
    1118.6402979145653,
    3070.402066967956,
    4723.276617581905,
    3169.2164701436113,
)


@scalar
def saturation_pressure(T):
    """Saturation pressure p_ws over liquid water, Pa; T is clamped to 0.01–50 °C."""
    T = T_SATURATION_MIN if T < T_SATURATION_MIN else T
    T = T_SATURATION_MAX if T > T_SATURATION_MAX else T
    return polynomial((T - 25.0) * 0.04, _P_WS)


@scalar
def saturation_humidity_ratio(T, pressure):
    """W_s, kg/kg (ASHRAE Fundamentals 2017, ch. 1, Eq 21)."""
    p_ws = saturation_pressure(T)
    return MASS_RATIO * p_ws / (pressure - p_ws)


@scalar
def enthalpy(T, W):
    """h, kJ/kg of dry air (ASHRAE Fundamentals 2017, ch. 1, Eq 30)."""
    return 1.006 * T + W * (2501.0 + 1.86 * T)


@scalar
def humidity_ratio(h, T):
    """W of air with enthalpy h and temperature T: the inverse of ``enthalpy``."""
    return (h - 1.006 * T) / (2501.0 + 1.86 * T)
