"""Loops at rest for the tests of the theory: coils dry and wet, heating, valves of low authority, both air marches."""

import numpy as np

import fastcoil as fc
from fastcoil.design.operating_points import OperatingPoints
from fastcoil.design.plants import linearise_plants, state_names, state_space_of

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
    """Return A, B and C of one plant: from opening to true T_sup, in steps of a second."""
    A, B = state_space_of(columns, conditions)
    return A[0], B[0], np.array(state_names(int(columns["n_volumes"][0]))) == "T_a_1"
