"""Moist-air relations on NumPy arrays, for what the host does with days, weather and logs.

Sources: ASHRAE Handbook - Fundamentals (2017), chapter 1 (equation numbers below); Hyland & Wexler (1983).
Temperatures are in degC, pressures in Pa, humidity ratios W in kg/kg dry air, enthalpies in kJ/kg dry air.
Every function broadcasts its arguments and returns float64.

Saturation is *over liquid water at every temperature*.  Below 0.01 degC the liquid curve is continued:
relative humidity and dew point in weather files refer to liquid water by convention (WMO-No. 8), and clamping
would make air of -20 degC as moist as air of 0 degC.  The continuation is within 0.3 % of Murphy & Koop
(2005) for supercooled water down to -30 degC, and within 0.8 % at -40 degC.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fastcoil.arrays import Array

MASS_RATIO = 0.621945
"""Molar mass of water over that of dry air, eq (20)."""
LEAST_HUMIDITY_RATIO = 1e-7
"""Dry air has no dew point; drier air than this is given the dew point of this (-92 degC)."""


def saturation_pressure(T: ArrayLike) -> Array:
    """Saturation pressure over liquid water, eq (6) [Pa]; stated for 0 to 200 degC, continued below."""
    K = np.asarray(T, dtype=np.float64) + 273.15
    log_p = (
        -5.8002206e3 / K
        + 1.3914993
        - 4.8640239e-2 * K
        + 4.1764768e-5 * K**2
        - 1.4452093e-8 * K**3
        + 6.5459673 * np.log(K)
    )
    return np.asarray(np.exp(log_p))


def _log_saturation_slope(T: ArrayLike) -> Array:
    """Slope d(ln p_s)/dT of eq (6) [1/K]."""
    K = np.asarray(T, dtype=np.float64) + 273.15
    return np.asarray(
        5.8002206e3 / K**2 - 4.8640239e-2 + 2 * 4.1764768e-5 * K - 3 * 1.4452093e-8 * K**2 + 6.5459673 / K
    )


def _from_vapour_pressure(p_w: Array, pressure: ArrayLike) -> Array:
    return np.asarray(MASS_RATIO * p_w / (np.asarray(pressure, dtype=np.float64) - p_w))


def saturation_humidity_ratio(T: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Humidity ratio of saturated air, eq (36) solved for W [kg/kg]."""
    return _from_vapour_pressure(saturation_pressure(T), pressure)


def humidity_ratio(T: ArrayLike, relative_humidity: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Humidity ratio from temperature and relative humidity (0 to 1), eqs (20) and (22) [kg/kg]."""
    p_w = np.asarray(relative_humidity, dtype=np.float64) * saturation_pressure(T)
    return _from_vapour_pressure(p_w, pressure)


def humidity_ratio_from_dew_point(T_dew: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Humidity ratio from the dew point, eq (36) [kg/kg]."""
    return saturation_humidity_ratio(T_dew, pressure)


def humidity_ratio_from_wet_bulb(T: ArrayLike, T_wet_bulb: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Humidity ratio from temperature and wet bulb (wick wet, not iced), eq (33); not below 0 [kg/kg]."""
    T, T_wb = np.asarray(T, dtype=np.float64), np.asarray(T_wet_bulb, dtype=np.float64)
    W_s = saturation_humidity_ratio(T_wb, pressure)
    W = ((2501.0 - 2.326 * T_wb) * W_s - 1.006 * (T - T_wb)) / (2501.0 + 1.86 * T - 4.186 * T_wb)
    return np.asarray(np.maximum(W, 0.0))


def dew_point(W: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """Temperature at which air of humidity ratio ``W`` is saturated: the inverse of eq (6) [degC]."""
    W = np.maximum(np.asarray(W, dtype=np.float64), LEAST_HUMIDITY_RATIO)
    log_p_w = np.log(W * np.asarray(pressure, dtype=np.float64) / (MASS_RATIO + W))
    # The Magnus formula is within 0.5 K here, so four Newton steps on ln p_s reach round-off.
    x = log_p_w - np.log(610.94)
    T = np.asarray(243.04 * x / (17.625 - x))
    for _ in range(4):
        T = T - (np.log(saturation_pressure(T)) - log_p_w) / _log_saturation_slope(T)
    return np.asarray(T)


def enthalpy(T: ArrayLike, W: ArrayLike) -> Array:
    """Specific enthalpy h = 1.006 T + W (2501 + 1.86 T), eq (30) [kJ/kg dry air]."""
    T, W = np.asarray(T, dtype=np.float64), np.asarray(W, dtype=np.float64)
    return np.asarray(1.006 * T + W * (2501.0 + 1.86 * T))


def temperature(h: ArrayLike, W: ArrayLike) -> Array:
    """Temperature from enthalpy and humidity ratio: the inverse of `enthalpy` [degC]."""
    h, W = np.asarray(h, dtype=np.float64), np.asarray(W, dtype=np.float64)
    return np.asarray((h - 2501.0 * W) / (1.006 + 1.86 * W))


def saturation_enthalpy_slope(T: ArrayLike, pressure: ArrayLike = 101325.0) -> Array:
    """dh_s/dT of saturated air [kJ/(kg K)]: the heat capacity that a wet coil sees."""
    T, p = np.asarray(T, dtype=np.float64), np.asarray(pressure, dtype=np.float64)
    p_s = saturation_pressure(T)
    W_s = _from_vapour_pressure(p_s, p)
    dW_s = MASS_RATIO * p * p_s * _log_saturation_slope(T) / (p - p_s) ** 2
    return np.asarray(1.006 + 1.86 * W_s + (2501.0 + 1.86 * T) * dW_s)


def mix(fraction: ArrayLike, T_1: ArrayLike, W_1: ArrayLike, T_2: ArrayLike, W_2: ArrayLike) -> tuple[Array, Array]:
    """Adiabatic mixture of air 1 (share ``fraction`` of the dry air) and air 2: (T [degC], W [kg/kg])."""
    x = np.asarray(fraction, dtype=np.float64)
    W = x * np.asarray(W_1, dtype=np.float64) + (1.0 - x) * np.asarray(W_2, dtype=np.float64)
    h = x * enthalpy(T_1, W_1) + (1.0 - x) * enthalpy(T_2, W_2)
    return temperature(h, W), np.asarray(W)
