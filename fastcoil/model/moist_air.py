"""Moist-air relations on NumPy arrays, for days, weather and logs.

Sources: ASHRAE Handbook - Fundamentals (2017), chapter 1 (equation numbers below); Hyland & Wexler (1983).  In degC,
Pa, kg/kg dry air and kJ/kg dry air; every function broadcasts its arguments.

Air on a cold surface is saturated *over ice* below 0.01 degC, where eqs (5) and (6) meet; the handbook changes at 0
degC, with a jump.  Relative humidity, dew point and wet bulb are *over liquid water at every temperature*, the
convention of weather files and sensors (WMO-No. 8), within 0.3 % of Murphy & Koop (2005) down to -30 degC.
"""

import numpy as np
from numpy.typing import ArrayLike

from fastcoil.base.arrays import Array

MASS_RATIO = 0.621945  # molar mass of water over that of dry air, eq (20)
LEAST_HUMIDITY_RATIO = 1e-7  # dry air has no dew point; drier air than this gets the dew point of this, -92 degC
TRIPLE_POINT_C = 0.01  # of water: it freezes below
_ICE_TERMS = (-5.6745359e3, 6.3925247, -9.677843e-3, 6.2215701e-7, 2.0747825e-9, -9.484024e-13, 4.1635019)
_LIQUID_TERMS = (-5.8002206e3, 1.3914993, -4.8640239e-2, 4.1764768e-5, -1.4452093e-8, 0.0, 6.5459673)
"""Coefficients of eqs (5), stated for -100 to 0 degC, and (6), for 0 to 200 degC and continued below."""


def _hyland_wexler(T: ArrayLike, c: tuple[float, ...]) -> Array:
    """Saturation pressure, eq (5) or (6) [Pa]."""
    K = np.asarray(T, dtype=np.float64) + 273.15
    log_p = c[0] / K + c[1] + c[2] * K + c[3] * K**2 + c[4] * K**3 + c[5] * K**4 + c[6] * np.log(K)
    return np.asarray(np.exp(log_p))


def _log_slope(T: ArrayLike, c: tuple[float, ...]) -> Array:
    """Slope d(ln p_s)/dT of eq (5) or (6) [1/K]."""
    K = np.asarray(T, dtype=np.float64) + 273.15
    return np.asarray(-c[0] / K**2 + c[2] + 2 * c[3] * K + 3 * c[4] * K**2 + 4 * c[5] * K**3 + c[6] / K)


def liquid_saturation_pressure(T: ArrayLike) -> Array:
    """Saturation pressure over liquid water, eq (6) [Pa]."""
    return _hyland_wexler(T, _LIQUID_TERMS)


def saturation_pressure(T: ArrayLike) -> Array:
    """Saturation pressure over ice below 0.01 degC, eq (5), and over liquid water above, eq (6) [Pa]."""
    T = np.asarray(T, dtype=np.float64)
    return np.where(T < TRIPLE_POINT_C, _hyland_wexler(T, _ICE_TERMS), liquid_saturation_pressure(T))


def _ratio_at_vapour_pressure(p_w: Array, pressure: ArrayLike) -> Array:
    return np.asarray(MASS_RATIO * p_w / (np.asarray(pressure, dtype=np.float64) - p_w))


def saturation_humidity_ratio(T: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Humidity ratio of saturated air, eq (21), over ice below 0.01 degC [kg/kg]."""
    return _ratio_at_vapour_pressure(saturation_pressure(T), pressure)


def humidity_ratio(T: ArrayLike, relative_humidity: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Humidity ratio from temperature and relative humidity (0 to 1), eqs (20) and (22) [kg/kg]."""
    p_w = np.asarray(relative_humidity, dtype=np.float64) * liquid_saturation_pressure(T)
    return _ratio_at_vapour_pressure(p_w, pressure)


def humidity_ratio_from_dew_point(T_dew: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Humidity ratio from the dew point, eq (36) [kg/kg]."""
    return _ratio_at_vapour_pressure(liquid_saturation_pressure(T_dew), pressure)


def humidity_ratio_from_wet_bulb(T: ArrayLike, T_wet_bulb: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Humidity ratio from temperature and wet bulb (wick wet, not iced), eq (33); not below 0 [kg/kg]."""
    T, T_wb = np.asarray(T, dtype=np.float64), np.asarray(T_wet_bulb, dtype=np.float64)
    W_s = humidity_ratio_from_dew_point(T_wb, pressure)
    W = ((2501.0 - 2.326 * T_wb) * W_s - 1.006 * (T - T_wb)) / (2501.0 + 1.86 * T - 4.186 * T_wb)
    return np.asarray(np.maximum(W, 0.0))


def dew_point(W: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Temperature at which air of humidity ratio ``W`` is saturated over liquid, the inverse of eq (6) [degC]."""
    log_p_w = _log_vapour_pressure(W, pressure)
    # The Magnus formula is within 0.5 K here, so four Newton steps on ln p_s reach round-off.
    x = log_p_w - np.log(610.94)
    T = np.asarray(243.04 * x / (17.625 - x))
    for _ in range(4):
        T = T - (np.log(liquid_saturation_pressure(T)) - log_p_w) / _log_slope(T, _LIQUID_TERMS)
    return np.asarray(T)


def wetting_point(W: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Temperature of a surface below which air of humidity ratio ``W`` wets or frosts it: dew or frost point [degC]."""
    T, log_p_w = dew_point(W, pressure), _log_vapour_pressure(W, pressure)
    T_frost = T
    for _ in range(5):  # from the dew point, at most 9 K away
        T_frost = T_frost - (np.log(_hyland_wexler(T_frost, _ICE_TERMS)) - log_p_w) / _log_slope(T_frost, _ICE_TERMS)
    return np.where(T < TRIPLE_POINT_C, T_frost, T)


def _log_vapour_pressure(W: ArrayLike, pressure: ArrayLike) -> Array:
    W = np.maximum(np.asarray(W, dtype=np.float64), LEAST_HUMIDITY_RATIO)
    return np.asarray(np.log(W * np.asarray(pressure, dtype=np.float64) / (MASS_RATIO + W)))


def enthalpy(T: ArrayLike, W: ArrayLike) -> Array:
    """Specific enthalpy h = 1.006 T + W (2501 + 1.86 T), eq (30) [kJ/kg dry air]."""
    T, W = np.asarray(T, dtype=np.float64), np.asarray(W, dtype=np.float64)
    return np.asarray(1.006 * T + W * (2501.0 + 1.86 * T))


def temperature_from_enthalpy(h: ArrayLike, W: ArrayLike) -> Array:
    """Temperature from enthalpy and humidity ratio: the inverse of `enthalpy` [degC]."""
    h, W = np.asarray(h, dtype=np.float64), np.asarray(W, dtype=np.float64)
    return np.asarray((h - 2501.0 * W) / (1.006 + 1.86 * W))


def saturation_enthalpy_slope(T: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """dh_s/dT of saturated air [kJ/(kg K)]: the heat capacity that a wet coil sees."""
    T, p = np.asarray(T, dtype=np.float64), np.asarray(pressure, dtype=np.float64)
    p_s = saturation_pressure(T)
    W_s = _ratio_at_vapour_pressure(p_s, p)
    slope = np.where(T < TRIPLE_POINT_C, _log_slope(T, _ICE_TERMS), _log_slope(T, _LIQUID_TERMS))
    dW_s = MASS_RATIO * p * p_s * slope / (p - p_s) ** 2
    return np.asarray(1.006 + 1.86 * W_s + (2501.0 + 1.86 * T) * dW_s)


def mix(fraction: ArrayLike, T_1: ArrayLike, W_1: ArrayLike, T_2: ArrayLike, W_2: ArrayLike) -> tuple[Array, Array]:
    """Adiabatic mixture of air 1 (share ``fraction`` of the dry air) and air 2: (T [degC], W [kg/kg])."""
    x = np.asarray(fraction, dtype=np.float64)
    W = x * np.asarray(W_1, dtype=np.float64) + (1.0 - x) * np.asarray(W_2, dtype=np.float64)
    h = x * enthalpy(T_1, W_1) + (1.0 - x) * enthalpy(T_2, W_2)
    return temperature_from_enthalpy(h, W), np.asarray(W)
