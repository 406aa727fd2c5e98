"""Loops at rest for the tests of the theory: coils dry and wet, heating, valves of low authority, both air marches."""

import numpy as np
from reference.coil import euler_step, pass_air, trapezoidal_step
from reference.valve import leaking_valve, valve_from_authority

import fastcoil as fc
from fastcoil.design.operating_points import OperatingPoints
from fastcoil.design.plants import linearise_plants

LINEAR_LOOPS = {
    "wet, lagged": (fc.Loop(), {}),
    "dry, lagged": (fc.Loop(C_c=12.0), {"relative_humidity": 0.2}),
    "mixed, quasistatic": (fc.Loop.preset("lbnl").assign(air_march="quasistatic", n_volumes=5), {"T_a_in": 28.0}),
    "wet, lagged, 3 substeps": (fc.Loop(substeps=3), {}),
    "mixed, converged": (fc.Loop.preset("paper_like_fast", converged=True), {"T_a_in": 27.0}),
    "low authority, leaking": (fc.Loop(rangeability=30.0, authority=0.1, m_full=1.6, leakage=0.01), {"T_set": 16.0}),
    "heating": (fc.Loop(action="heating"), {"T_a_in": 10.0, "T_w_in": 50.0, "T_set": 25.0, "relative_humidity": 0.3}),
}


def rest_points(name, **changes):
    """Return parameters and conditions of one kind, as for ``linearise_plants``."""
    loop, entering = LINEAR_LOOPS[name]
    return conditions_of(loop.assign(backlash=0.0).assign(**changes), fc.constant_day(0.6, **entering))


def conditions_of(loop, day):
    """Return parameters and conditions of a loop, or a sweep, on a constant day."""
    operating_points = OperatingPoints(loop, day, at=0)
    index = np.arange(operating_points.size)
    return operating_points.columns(index), operating_points.conditions(index)


def rest_plants(name, **changes):
    """Return the parameters of one kind, and its plant at rest."""
    columns, conditions = rest_points(name, **changes)
    return columns, linearise_plants(columns, conditions)


def plants_at(loop, day):
    """Return the parameters of a loop, or a sweep, and its plants on a constant day."""
    columns, conditions = conditions_of(loop, day)
    return columns, linearise_plants(columns, conditions)


def state_space(columns, conditions):
    """Return A, B and C of one plant by the model in plain Python: from opening to true T_sup, in steps of a second."""
    p = {name: values[0].item() if hasattr(values[0], "item") else values[0] for name, values in columns.items()}
    p |= {"n_volumes": int(p["n_volumes"]), "leakage": None if np.isnan(p["leakage"]) else p["leakage"]}
    N, curve = p["n_volumes"], [p[name] for name in ("m_max", "valve_a", "valve_b", "valve_c", "curve")]
    if not np.isnan(p["authority"]):
        curve[:4] = valve_from_authority(p["rangeability"], p["authority"], p["m_full"])
    m_a, T_a_in, W_a_in, T_w_in = (float(conditions[name][0]) for name in ("m_a", "T_a_in", "W_a_in", "T_w_in"))
    opening = float(linearise_plants(columns, conditions).opening[0])

    def march(x, opening):
        """T_w, T_c, T_a and W_a a second later."""
        T_w, T_c, *air = np.split(x, 4)
        m_w, dt = leaking_valve(opening, p["leakage"], *curve), 1.0 / p["substeps"]
        for _ in range(int(p["substeps"])):
            lagged = air if p["air_march"] == "lagged" else None
            *air, Q, _, _ = pass_air(p, T_c, m_a, T_a_in, W_a_in, lagged=lagged)
            if lagged:
                T_w, T_c = euler_step(p, T_w, T_c, Q, m_w, T_w_in, dt)
            else:
                T_w, T_c = trapezoidal_step(p, T_w, T_c, Q, m_w, m_a, T_w_in, dt)
        if p["air_march"] != "lagged":
            air = pass_air(p, T_c, m_a, T_a_in, W_a_in)[:2]
        return np.concatenate([T_w, T_c, *air])

    x, rest = np.zeros(4 * N), np.repeat([T_w_in, T_w_in, T_a_in, W_a_in], N)
    while np.abs(rest - x).max() > 1e-12:
        x, rest = rest, march(rest, opening)
    changes = np.diag(np.repeat([1e-4, 1e-4, 1e-4, 1e-7], N))
    A = [(march(rest + d, opening) - march(rest - d, opening)) / (2.0 * d.sum()) for d in changes]
    B = (march(rest, opening + 1e-5) - march(rest, opening - 1e-5)) / 2e-5
    return np.transpose(A), B, np.eye(4 * N)[2 * N]
