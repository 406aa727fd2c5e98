"""How to integrate the coil: methods that were tried for ``converged = true``, against Runge and Kutta's at 0.25 s.

In all of them the air is quasistatic and passes the metal of now before the controller looks.  The formulas are those
of the package; the integration, the order of the second and the loop around them are written here.  The tunings and
days are not those on which the method was chosen.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy import stats

import fastcoil as fc
from fastcoil.model import control, physics
from studies.common import write_table
from studies.robustness.best_pi import PRESETS

Array = npt.NDArray[np.float64]
NO_SAMPLE = "hunting loops amplify last bits, so that cells differ from processor to processor"
SEED, TUNINGS, DAYS = 94801, 40, range(94811, 94814)
HOURS, WARM_UP = 4, 1800
"""Length of a day, and the seconds in which no error counts."""
SPREAD = 2.0
"""Largest factor on kp and on ti of a preset."""
DIVERGED_RMSE_K = 50.0
BACKLASH = (0.0, 0.03, 0.07, 0.12)
METHODS = (
    "explicit Euler", "Adams and Bashforth", "midpoint", "trapezoidal along the water",
    "the same, air heat extrapolated", "the same, air heat implicit in its metal", "Runge and Kutta",
)  # fmt: skip
EULER, ADAMS_BASHFORTH, MIDPOINT, TRAPEZOIDAL, EXTRAPOLATED, IMPLICIT, RUNGE_KUTTA = range(len(METHODS))
AIR_PASSES = (1, 1, 2, 1, 1, 1, 4)
"""Passes of the air over the metal that a step takes: most of its cost."""
MARCHES = (("lagged", 1), ("lagged", 8), ("quasistatic", 1), ("quasistatic", 2), ("quasistatic", 8))
"""Air march and substeps of the package that are measured."""
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


@njit
def trapezoidal_step(h, T_w, T_c, T_w_in, C_flow, G_w, G_a, C_w, C_c, Q_a):
    """Advance T_w and T_c by the trapezoidal rule over h s, from volume to volume along the water.

    G_a: what the metal's own change takes off the heat of the air, kW/K; 0: nothing.
    """
    T_in = T_w_in
    for i in range(T_w.size):
        T_c_mean = T_c[i] + (Q_a[i] - G_w * (T_c[i] - T_in)) / (2.0 * C_c / h + G_w + G_a)
        T_w_mean = T_w[i] + (C_flow * (T_in - T_w[i]) + G_w * (T_c_mean - T_in)) / (2.0 * C_w / h + C_flow)
        T_c[i], T_w[i], T_in = 2.0 * T_c_mean - T_c[i], 2.0 * T_w_mean - T_w[i], T_w_mean


@njit(nogil=True)
def control_loop(p, series, method, steps, T_sup):
    """Fill T_sup, (n_steps,), °C, of one loop.

    p: values of NAMES; series: (5, n_steps), rows as in SERIES; method: index of METHODS; steps: a second.
    """
    (
        C_w, C_c, beta1, beta2, beta3, beta4, beta5, beta6, cp_w, cp_a, pressure, n_volumes,
        T_initial, m_max, valve_a, valve_b, valve_c, backlash, stroke_time, sensor_time_constant, kp, ti, sample_time,
    ) = p  # fmt: skip
    n = int(n_volumes)
    per_volume, h = 8.0 / n, 1.0 / steps
    C_w, C_c = C_w * per_volume, C_c * per_volume
    max_travel = 1.0 / stroke_time if stroke_time > 0.0 else np.inf
    decay = np.exp(-1.0 / sensor_time_constant) if sensor_time_constant > 0.0 else 0.0
    T_w, T_c, T_a, Q_a = np.full(n, T_initial), np.full(n, T_initial), np.empty(n), np.empty(n)
    dT_w, dT_c, Q_a_before = np.zeros((4, n)), np.zeros((4, n)), np.zeros(n)
    n_stages = 4 if method == RUNGE_KUTTA else 2 if method == MIDPOINT else 1
    last_share = 1.0 if method == RUNGE_KUTTA else 0.5
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
        for step in range(steps):
            if TRAPEZOIDAL <= method <= IMPLICIT:
                if step > 0:
                    pass_air(T_c, T_a_in, W_a_in, eps_a, eps_star, m_a, cp_a, pressure, T_a, Q_a)
                extrapolated = 1.5 * Q_a - 0.5 * Q_a_before if method == EXTRAPOLATED and t + step > 0 else Q_a
                G_a = eps_a * m_a * cp_a if method == IMPLICIT else 0.0
                trapezoidal_step(h, T_w, T_c, T_w_in, C_flow, G_w, G_a, C_w, C_c, extrapolated)
                Q_a_before[:] = Q_a
                continue
            before_w, before_c = dT_w[0].copy(), dT_c[0].copy()
            for k in range(n_stages):
                share = 0.0 if k == 0 else h if k == 3 else last_share * h if k == 1 and n_stages == 2 else 0.5 * h
                T_w_k, T_c_k = T_w + share * dT_w[k - 1], T_c + share * dT_c[k - 1]
                pass_air(T_c_k, T_a_in, W_a_in, eps_a, eps_star, m_a, cp_a, pressure, T_a, Q_a)
                change_rates(T_w_k, T_c_k, T_w_in, C_flow, G_w, C_w, C_c, Q_a, dT_w[k], dT_c[k])
            if method == RUNGE_KUTTA:
                T_w += h / 6.0 * (dT_w[0] + 2.0 * dT_w[1] + 2.0 * dT_w[2] + dT_w[3])
                T_c += h / 6.0 * (dT_c[0] + 2.0 * dT_c[1] + 2.0 * dT_c[2] + dT_c[3])
            elif method == ADAMS_BASHFORTH and t + step > 0:
                T_w += h * (1.5 * dT_w[0] - 0.5 * before_w)
                T_c += h * (1.5 * dT_c[0] - 0.5 * before_c)
            else:
                T_w += h * dT_w[n_stages - 1]
                T_c += h * dT_c[n_stages - 1]


def draw_tunings(preset: str, size: int = TUNINGS, seed: int = SEED) -> dict[str, Array]:
    """Draw kp and ti around those of a preset, and backlash: {parameter: (size,)}."""
    rng, loop = np.random.default_rng(seed), fc.Loop.preset(preset)
    kp, ti = (float(loop[name]) * SPREAD ** rng.uniform(-1.0, 1.0, size) for name in ("kp", "ti"))
    return {"kp": kp, "ti": ti, "backlash": rng.choice(BACKLASH, size)}


def integrate_rmse(
    preset: str, tunings: Mapping[str, Array], day: fc.Boundary, method: int = RUNGE_KUTTA, steps: int = 4
) -> Array:
    """RMSE, K, of a preset with each of the tunings, {parameter: (n,)}, on every day, (n, n_days).

    method: index of METHODS; steps: a second.
    """
    ds, loop = day.to_dataset().transpose("day", ...), fc.Loop.preset(preset)
    rmse = np.empty((len(tunings["kp"]), ds.sizes["day"]))
    T_sup = np.empty(ds.sizes["elapsed_time"])
    for k in range(rmse.shape[1]):
        series = np.stack([np.broadcast_to(ds[name].isel(day=k).values, T_sup.shape) for name in SERIES])
        for j in range(rmse.shape[0]):
            p = tuple(float(tunings[name][j] if name in tunings else loop[name]) for name in NAMES)
            control_loop(p, series, method, steps, T_sup)
            with np.errstate(over="ignore"):  # a method that diverges
                rmse[j, k] = np.sqrt(np.mean((T_sup - series[-1])[WARM_UP:] ** 2))
    return rmse


def march_rmse(preset: str, tunings: Mapping[str, Array], day: fc.Boundary, air_march: str, substeps: int) -> Array:
    """The same, simulated by the package."""
    swept = {name: ("sample", values) for name, values in tunings.items()}
    loop = fc.Loop.preset(preset).assign(air_march=air_march, substeps=substeps, **swept)
    return np.asarray(fc.simulate(loop, day, warm_up=WARM_UP).rmse.transpose("sample", "day").values)


def describe_error(rmse: Array, exact: Array) -> str:
    """Error of the mean RMSE and median error of single loops, in per cent, with its 95 % interval over days."""
    if not rmse.max() < DIVERGED_RMSE_K:
        return "diverges"
    by_day = 100.0 * (rmse.mean(axis=0) - exact.mean(axis=0)) / exact.mean()
    half = stats.t.ppf(0.975, by_day.size - 1) * by_day.std(ddof=1) / np.sqrt(by_day.size)
    return f"{by_day.mean():+.1f} ± {half:.1f}, {100.0 * np.median(np.abs(rmse / exact - 1.0)):.2f}"


def main(size: int = TUNINGS, days: range = DAYS, hours: int = HOURS) -> None:
    """Write how far every method and every march is from Runge and Kutta's at 0.25 s, on each preset."""
    day = fc.paper_day(hours=hours, seed=list(days))
    tunings = {preset: draw_tunings(preset, size) for preset in PRESETS}
    exact = {preset: integrate_rmse(preset, drawn, day) for preset, drawn in tunings.items()}
    rows = []
    for air_march, substeps in MARCHES:
        errors = [march_rmse(preset, tunings[preset], day, air_march, substeps) for preset in PRESETS]
        rows.append(
            [f"fastcoil, {air_march}", str(substeps), str(substeps), *map(describe_error, errors, exact.values())]
        )
    for method, steps in [*((method, 1) for method in range(RUNGE_KUTTA)), (RUNGE_KUTTA, 8)]:
        errors = [integrate_rmse(preset, tunings[preset], day, method, steps) for preset in PRESETS]
        passes = str(steps * AIR_PASSES[method])
        rows.append([METHODS[method], str(steps), passes, *map(describe_error, errors, exact.values())])
    write_table(
        "numerics/integrators",
        f"RMSE against Runge and Kutta's method at 0.25 s: error of the mean ± half its 95 % interval over days, and "
        f"median error of single loops, in per cent; {size} tunings × {len(days)} days of {hours} h a preset",
        ["method", "steps a second", "air passes a second", *PRESETS],
        rows,
    )
