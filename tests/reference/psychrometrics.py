"""Moist air."""

import math

from reference.rounding import clip


def saturation_pressure(T):
    """Hyland-Wexler saturation pressure [Pa] at T [degC]: over ice below 0.01 degC, over liquid water above."""
    T_K = T + 273.15
    if T < 0.01:
        quadratic = -5.6745359e3 / T_K + 6.3925247 - 9.677843e-3 * T_K + 6.2215701e-7 * T_K**2
        return math.exp(quadratic + 2.0747825e-9 * T_K**3 - 9.484024e-13 * T_K**4 + 4.1635019 * math.log(T_K))
    quadratic = -5.8002206e3 / T_K + 1.3914993 - 4.8640239e-2 * T_K + 4.1764768e-5 * T_K**2
    return math.exp(quadratic - 1.4452093e-8 * T_K**3 + 6.5459673 * math.log(T_K))


def saturation_humidity_ratio(T, pressure):
    """Saturation humidity ratio W_s [kg/kg] at T [degC], clamped to -20..60 degC, and pressure [Pa]."""
    p_ws = saturation_pressure(clip(T, -20.0, 60.0))
    return 0.621945 * p_ws / (pressure - p_ws)


def enthalpy(T, W):
    """Enthalpy of moist air [kJ/kg dry air] at T [degC] and humidity ratio W [kg/kg]."""
    return 1.006 * T + W * (2501.0 + 1.86 * T)


def humidity_ratio(h, T):
    """Humidity ratio [kg/kg] of moist air of enthalpy h [kJ/kg] at T [degC]: enthalpy() solved for W."""
    return (h - 1.006 * T) / (2501.0 + 1.86 * T)
