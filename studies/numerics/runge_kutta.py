"""The loop with its coil integrated by Runge and Kutta's method at 0.25 s: what every march is measured against.

The air is quasistatic and passes the metal of now before the controller looks.  The formulas are those of the package;
the integration, the order of the second and the loop around them are written here.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from numba import njit

import fastcoil as fc
from fastcoil.model import control, physics

Array = npt.NDArray[np.float64]
STEPS_A_SECOND = 4
WARM_UP = 1800
"""Seconds that no error counts."""
NAMES = (
    "C_w", "C_c", "beta1", "beta2", "beta3", "beta4", "beta5", "beta6", "cp_w", "cp_a", "pressure", "n_volumes",
    "T_initial", "m_max", "valve_a", "valve_b", "valve_c", "backlash", "stroke_time", "sensor_time_constant", "kp",
    "ti", "sample_time",
)  # fmt: skip
"""Parameters of a plain PI that cools; all others keep their defaults."""
SERIES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")


@njit
def pass_air(T_c, T_a_in, W_a_in, eps_a, eps_star, m_a, cp_a, pressure, T_a, Q_a):
    """Fill T_a, °C, and Q_a, kW, (n_volumes,), of air that passes the metal T_c from the last volume to the first."""
    T_in, W_in = T_a_in, W_a_in
    for i in range(T_c.size - 1, -1, -1):
        W_s = physics.saturation_humidity_ratio(T_c[i], pressure)
        wet = W_in > W_s
        cooled = eps_a * (T_in - T_c[i])
        dried = eps_star * physics.enthalpy_difference(T_in, W_in, T_c[i], W_s)
        Q_a[i] = physics.air_heat(wet, m_a, cooled, dried, cp_a)
        T_a[i] = T_in - cooled
        T_in, W_in = T_a[i], W_in - physics.condensed_water(wet, W_in, cooled, dried, T_a[i])


@njit
def change_rates(T_w, T_c, T_w_in, C_flow, G_w, C_w, C_c, Q_a, dT_w, dT_c):
    """Fill dT_w/dt and dT_c/dt, K/s, (n_volumes,), Eq (3)."""
    for i in range(T_w.size):
        T_in = T_w_in if i == 0 else T_w[i - 1]
        Q_w = physics.water_heat(G_w, T_c[i], T_in)
        dT_w[i] = (C_flow * (T_in - T_w[i]) + Q_w) / C_w
        dT_c[i] = (Q_a[i] - Q_w) / C_c


@njit(nogil=True)
def control_loop(p, series, T_sup):
    """Fill T_sup, (n_steps,), °C, of one loop.  p: values of NAMES; series: (5, n_steps), rows as in SERIES."""
    (
        C_w, C_c, beta1, beta2, beta3, beta4, beta5, beta6, cp_w, cp_a, pressure, n_volumes,
        T_initial, m_max, valve_a, valve_b, valve_c, backlash, stroke_time, sensor_time_constant, kp, ti, sample_time,
    ) = p  # fmt: skip
    n = int(n_volumes)
    per_volume, h = 8.0 / n, 1.0 / STEPS_A_SECOND
    C_w, C_c = C_w * per_volume, C_c * per_volume
    max_travel = 1.0 / stroke_time if stroke_time > 0.0 else np.inf
    decay = np.exp(-1.0 / sensor_time_constant) if sensor_time_constant > 0.0 else 0.0
    T_w, T_c, T_a, Q_a = np.full(n, T_initial), np.full(n, T_initial), np.empty(n), np.empty(n)
    dT_w, dT_c = np.empty((4, n)), np.empty((4, n))
    integral = u = position = q = y_s = 0.0
    for t in range(series.shape[1]):
        m_a, T_a_in, W_a_in, T_w_in, T_set = series[:, t]
        eps_a = physics.effectiveness(per_volume * beta3, beta4, m_a)
        eps_star = physics.effectiveness(per_volume * beta5, beta6, m_a)
        pass_air(T_c, T_a_in, W_a_in, eps_a, eps_star, m_a, cp_a, pressure, T_a, Q_a)
        T_sup[t] = T_a[0]
        y_s = T_sup[t] if t == 0 else physics.sensor_temperature(y_s, T_sup[t], decay)
        if t % sample_time == 0:
            integral = control.integral_part(integral, y_s - T_set, kp * sample_time / ti)
            u = control.desired_opening(y_s - T_set, integral, kp)
        position = physics.motor_position(position, u, max_travel)
        q = physics.backlash(q, position, backlash)
        m_w = physics.water_flow(physics.opening(q, backlash), m_max, valve_a, valve_b, valve_c)
        C_flow = m_w * cp_w
        G_w = physics.effectiveness(per_volume * beta1, beta2, m_w) * C_flow
        for _ in range(STEPS_A_SECOND):
            for k in range(4):
                share = h if k == 3 else 0.5 * h if k > 0 else 0.0
                T_w_k, T_c_k = T_w + share * dT_w[k - 1], T_c + share * dT_c[k - 1]
                pass_air(T_c_k, T_a_in, W_a_in, eps_a, eps_star, m_a, cp_a, pressure, T_a, Q_a)
                change_rates(T_w_k, T_c_k, T_w_in, C_flow, G_w, C_w, C_c, Q_a, dT_w[k], dT_c[k])
            T_w += h / 6.0 * (dT_w[0] + 2.0 * dT_w[1] + 2.0 * dT_w[2] + dT_w[3])
            T_c += h / 6.0 * (dT_c[0] + 2.0 * dT_c[1] + 2.0 * dT_c[2] + dT_c[3])


def integrate_rmse(preset: str, tunings: Mapping[str, Array], day: fc.Boundary) -> Array:
    """RMSE, K, of a preset with each of the tunings, {parameter: (n,)}, on every day, (n, n_days)."""
    ds = day.to_dataset()
    loop = fc.Loop.preset(preset)
    n = len(next(iter(tunings.values())))
    rmse = np.empty((n, ds.sizes["day"]))
    for k in range(rmse.shape[1]):
        of_day = ds.isel(day=k)
        T_set = of_day.T_set.values
        length = ds.sizes["elapsed_time"]
        series = np.stack([np.broadcast_to(of_day[name].values, length) for name in SERIES])
        T_sup = np.empty(length)
        for j in range(n):
            p = tuple(float(tunings[name][j] if name in tunings else loop[name]) for name in NAMES)
            control_loop(p, series, T_sup)
            rmse[j, k] = np.sqrt(np.mean((T_sup - T_set)[WARM_UP:] ** 2))
    return rmse
