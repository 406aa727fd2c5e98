"""JAX: a compiled ``scan`` over time, scenarios as arrays, float64.

Under lagged air every control volume reads states of the step before, so that the arrays are (volumes, scenarios).
The converged march is a ``scan`` over the volumes as well: as a plain loop, which XLA unrolls and fuses, it takes ten
times as long.  Controller and valve run, by ``cond``, only in seconds in which a scenario samples.

A program: it runs in an environment with JAX and NumPy alone, and answers the works that ``jax_peer.py`` sends.
"""

from __future__ import annotations

import functools
import pickle
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .common import (
    BETA1,
    BETA2,
    BETA3,
    BETA4,
    BETA5,
    BETA6,
    BUFFER,
    C_C,
    C_W,
    CP_A,
    CP_W,
    M_MAX,
    MASS_RATIO,
    P_WS,
    PRESSURE,
    SCENARIO,
    SERIES,
    T_INITIAL,
    VALVE_A,
    VALVE_B,
    VALVE_C,
    Arrays,
    N,
    switch_seconds,
)

jax.config.update("jax_enable_x64", True)

State = dict[str, Any]


def saturation_humidity_ratio(T: jax.Array) -> jax.Array:
    s = (jnp.clip(T, 0.01, 50.0) - 25.0) / 25.0
    p = jnp.full_like(s, P_WS[0])
    for c in P_WS[1:]:
        p = p * s + c
    return MASS_RATIO * p / (PRESSURE - p)


def enthalpy(T: jax.Array, W: jax.Array) -> jax.Array:
    return 1.006 * T + W * (2501.0 + 1.86 * T)


def sample(scenario: State, state: State, t: jax.Array, e: jax.Array, counts: jax.Array) -> State:
    """PI, backlash inverse, Eqs (1) and (2), water side of Eq (4)."""
    kp, ti, sample_time, x_bl, x_hat = (scenario[k] for k in SCENARIO)
    due = t % sample_time == 0.0
    integral = jnp.clip(state["integral"] + kp * sample_time / ti * e, 0.0, 1.0)
    u = jnp.where(due, jnp.clip(kp * e + integral, 0.0, 1.0), state["u"])
    integral = jnp.where(due, integral, state["integral"])

    rising, u_ext = state["rising"], state["u_ext"]
    turned = jnp.where(rising, u < u_ext - BUFFER, u > u_ext + BUFFER)
    rising ^= turned
    moved = turned | jnp.where(rising, u > u_ext, u < u_ext)
    u_ext = jnp.where(moved, u, u_ext)
    command = jnp.clip((1.0 - x_hat) * u_ext + jnp.where(rising, x_hat, 0.0), 0.0, 1.0)
    command = jnp.where(moved, command, state["command"])

    q = jnp.minimum(jnp.maximum(state["q"], command - x_bl), command)
    opening = q / (1.0 - x_bl)
    m_w = M_MAX * (1.0 + VALVE_A * jnp.exp(-VALVE_B * (opening - VALVE_C))) ** (-1.0 / VALVE_A)
    C_flow = m_w * CP_W
    G_w = (1.0 - jnp.exp(-BETA1 * m_w**BETA2)) * C_flow
    switches = state["switches"] + jnp.where(turned, counts, 0.0)
    return state | {
        "integral": integral, "u": u, "rising": rising, "u_ext": u_ext, "command": command, "q": q,
        "C_flow": C_flow, "G_w": G_w, "switches": switches,
    }  # fmt: skip


def cool(T_in: jax.Array, W_in: jax.Array, T_c: jax.Array, m_a: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Temperature and humidity of air that leaves metal of T_c, and its heat."""
    W_s = saturation_humidity_ratio(T_c)
    eps_a, eps_star = 1.0 - jnp.exp(-BETA3 * m_a**BETA4), 1.0 - jnp.exp(-BETA5 * m_a**BETA6)
    wet = W_in > W_s
    h_in, h_s = enthalpy(T_in, W_in), enthalpy(T_c, W_s)
    T_out, h_out = T_in + eps_a * (T_c - T_in), h_in + eps_star * (h_s - h_in)
    W_out = jnp.minimum((h_out - 1.006 * T_out) / (2501.0 + 1.86 * T_out), W_in)
    Q_a = jnp.where(wet, eps_star * m_a * (h_in - h_s), eps_a * m_a * CP_A * (T_in - T_c))
    return T_out, jnp.where(wet, W_out, W_in), Q_a


def march_printed(state: State, m_a: jax.Array, T_a_in: jax.Array, W_a_in: jax.Array, T_w_in: jax.Array) -> State:
    """Eq (3) for all volumes at once, from states of the step before."""
    T_w, T_c, T_a, W_a = (state[k] for k in ("T_w", "T_c", "T_a", "W_a"))
    row = (1, T_w.shape[1])
    T_in = jnp.concatenate([T_a[1:], jnp.full(row, T_a_in)])
    W_in = jnp.concatenate([W_a[1:], jnp.full(row, W_a_in)])
    T_w_up = jnp.concatenate([jnp.full(row, T_w_in), T_w[:-1]])
    T_out, W_out, Q_a = cool(T_in, W_in, T_c, m_a)
    Q_w = state["G_w"] * (T_c - T_w_up)
    return state | {
        "T_w": T_w + (state["C_flow"] * (T_w_up - T_w) + Q_w) / C_W,
        "T_c": T_c + (Q_a - Q_w) / C_C,
        "T_a": T_out,
        "W_a": W_out,
    }


def pass_air(T_c: jax.Array, m_a: jax.Array, T_a_in: jax.Array, W_a_in: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Supply temperature of air that passes the metal of now, and its heat in each volume."""

    def volume(air: tuple[jax.Array, jax.Array], T_c: jax.Array) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        T_out, W_out, Q_a = cool(*air, T_c, m_a)
        return (T_out, W_out), Q_a

    row = T_c.shape[1:]
    (T_sup, _), Q_a = jax.lax.scan(volume, (jnp.full(row, T_a_in), jnp.full(row, W_a_in)), T_c, reverse=True)
    return T_sup, Q_a


def exchange(state: State, Q_a: jax.Array, m_a: jax.Array, T_w_in: jax.Array) -> State:
    """Eq (3) for metal and water by the trapezoidal rule along the water, with means over the step."""
    C_flow, G_w = state["C_flow"], state["G_w"]
    half_c = 1.0 / (2.0 * C_C + G_w + (1.0 - jnp.exp(-BETA3 * m_a**BETA4)) * m_a * CP_A)
    half_w = 1.0 / (2.0 * C_W + C_flow)

    def volume(T_w_in: jax.Array, now: tuple[jax.Array, ...]) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        T_w, T_c, Q_a = now
        T_c_mean = T_c + half_c * (Q_a - G_w * (T_c - T_w_in))
        T_w_mean = T_w + half_w * (C_flow * (T_w_in - T_w) + G_w * (T_c_mean - T_w_in))
        return T_w_mean, (2.0 * T_w_mean - T_w, 2.0 * T_c_mean - T_c)

    _, (T_w, T_c) = jax.lax.scan(volume, jnp.full(C_flow.shape, T_w_in), (state["T_w"], state["T_c"], Q_a))
    return state | {"T_w": T_w, "T_c": T_c}


@functools.partial(jax.jit, static_argnames=("period", "warm_up", "last", "converged"))
def all_scenarios(
    scenario: State, series: State, period: int, warm_up: int, last: int, converged: bool
) -> tuple[jax.Array, jax.Array]:
    """Sums of squared errors, and switches before second ``last``."""
    n, n_steps = scenario["kp"].size, series["m_a"].size
    zeros, temperatures = jnp.zeros(n), jnp.full((N, n), T_INITIAL)
    names = ("integral", "u", "u_ext", "command", "q", "C_flow", "G_w", "switches", "sum_e2")
    start = dict.fromkeys(names, zeros) | {"rising": jnp.zeros(n, dtype=bool)}
    start |= {"T_w": temperatures, "T_c": temperatures}
    if not converged:
        start |= {"T_a": temperatures, "W_a": jnp.full((N, n), series["W_a_in"][0])}

    def step(state: State, now: tuple[jax.Array, ...]) -> tuple[State, None]:
        t, m_a, T_a_in, W_a_in, T_w_in, T_set = now
        T_sup, Q_a = pass_air(state["T_c"], m_a, T_a_in, W_a_in) if converged else (state["T_a"][0], None)
        e = T_sup - T_set
        state = state | {"sum_e2": state["sum_e2"] + jnp.where(t >= warm_up, e * e, 0.0)}
        counts = jnp.where((t >= warm_up) & (t < last), 1.0, 0.0)
        state = jax.lax.cond(t % period == 0, lambda s: sample(scenario, s, t, e, counts), lambda s: s, state)
        if converged:
            return exchange(state, Q_a, m_a, T_w_in), None
        return march_printed(state, m_a, T_a_in, W_a_in, T_w_in), None

    end, _ = jax.lax.scan(step, start, (jnp.arange(n_steps), *(series[k] for k in SERIES)))
    return end["sum_e2"], end["switches"]


def run(scenarios: Arrays, series: Arrays, warm_up: int, converged: bool) -> Arrays:
    """Do the common work on JAX's default device."""
    n_steps = series["m_a"].size
    n_blocks, last = switch_seconds(n_steps, warm_up)
    period = int(np.gcd.reduce(scenarios["sample_time"].astype(np.int64)))
    sum_e2, switches = all_scenarios(dict(scenarios), dict(series), period, warm_up, last, converged)
    rmse = np.sqrt(np.asarray(sum_e2) / (n_steps - warm_up))
    return {"rmse": rmse, "switch_frequency": np.asarray(switches) / n_blocks}


def main() -> None:
    """Answer works, pickled on stdin, by metrics on stdout, until there are no more."""
    while True:
        try:
            work = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        pickle.dump(run(*work), sys.stdout.buffer)
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
