"""Stability at dt = 1 s: both borders, and that the substeps which a refusal advises are enough."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.loops.clashes import check_stability
from fastcoil.loops.scenarios import Layout
from fastcoil.model import moist_air
from fastcoil.model.parameter_table import PARAMETERS

pytestmark = pytest.mark.kernel


def gamma_and_lambda(day, **coil):
    """γ and λ at full opening, by hand, for a coil of paper_like."""
    p = {n: PARAMETERS[n].default for n in PARAMETERS} | coil
    scale = 8.0 / p["n_volumes"]
    m_w = p["m_max"] * (1 + p["valve_a"] * np.exp(-p["valve_b"] * (1 - p["valve_c"]))) ** (-1 / p["valve_a"])
    m_a = day.series["m_a"].max()
    G_w = (1 - np.exp(-p["beta1"] * scale * m_w ** p["beta2"])) * m_w * p["cp_w"]
    G_a = (1 - np.exp(-p["beta3"] * scale * m_a ** p["beta4"])) * m_a * p["cp_a"]
    dew_point = moist_air.dew_point(day.series["W_a_in"].max(), p["pressure"])
    slope = moist_air.saturation_enthalpy_slope(dew_point, p["pressure"])
    G_wet = (1 - np.exp(-p["beta5"] * scale * m_a ** p["beta6"])) * m_a * slope
    return m_w * p["cp_w"] / (scale * p["C_w"]), (max(G_a, G_wet) + G_w) / (scale * p["C_c"])


COILS = [
    {},
    {"beta1": 0.2, "beta2": -0.1, "beta3": 0.3, "beta4": -0.3, "beta5": 0.6, "beta6": -0.2, "pressure": 95e3,
     "cp_w": 3.9, "cp_a": 1.1, "m_max": 1.7, "valve_a": 1.2, "valve_b": 5.0, "valve_c": 0.5, "n_volumes": 6},
]  # fmt: skip


@pytest.mark.parametrize(("name", "number", "other"), [("C_w", "γ", "λ"), ("C_c", "λ", "γ")])
@pytest.mark.parametrize("coil", COILS)
def test_the_border_of_stability_of_water_and_metal(days, coil, name, number, other, simulate_problems):
    limit = gamma_and_lambda(days, **{name: 1.0}, **coil)[number == "λ"]
    fc.simulate(fc.Loop(**{name: limit * (1 + 1e-9)}, **coil), days, warm_up=60)
    (problem,) = simulate_problems(fc.Loop(**{name: limit * (1 - 1e-9)}, **coil), days, warm_up=60)
    assert "unstable" in problem
    assert f"{number} = " in problem
    assert f"{other} = " not in problem
    assert problem.endswith(f"or give fewer n_volumes or larger {name}")


def test_the_border_of_stability_with_an_installed_valve(days, simulate_problems):
    """At full opening the water flow of such a valve is ``m_full``."""
    valve = {"rangeability": 50.0, "authority": 0.3, "m_full": 1.7}
    limit = 1.7 * 4.186
    fc.simulate(fc.Loop(C_w=limit * (1 + 1e-9), **valve), days, warm_up=60)
    assert "γ = " in simulate_problems(fc.Loop(C_w=limit * (1 - 1e-9), **valve), days, warm_up=60)[0]


def test_leakage_moves_no_border(days, simulate_problems):
    """At full opening a valve delivers the same, whatever it leaks when closed."""
    limit = gamma_and_lambda(days)[0] * 8.8
    loop = fc.Loop(leakage=[0.0, 0.05, 0.9])
    fc.simulate(loop.assign(C_w=limit * (1 + 1e-9)), days, warm_up=60)
    (problem,) = simulate_problems(loop.assign(C_w=limit * (1 - 1e-9)), days, warm_up=60)
    assert "6 of 6 scenarios" in problem


def test_a_coil_that_cannot_get_wet_has_the_dry_border():
    day = fc.constant_day(hours=0.25, W_a_in=0.004)
    fc.simulate(fc.Loop(C_c=3.0), day, warm_up=60)
    with pytest.raises(fc.InputError, match="λ"):
        check_stability(Layout(fc.Loop(C_c=3.0), fc.constant_day(hours=0.25, W_a_in=0.015)))


@pytest.mark.parametrize("given", [1, 3])
def test_substeps_that_are_advised_are_enough_and_one_less_is_not(days, given, simulate_problems):
    (problem,) = simulate_problems(fc.Loop(n_volumes=40, substeps=given), days, warm_up=60)
    assert problem.startswith(f"unstable at dt = {'1 s' if given == 1 else '1/3 s'}: ")
    advised = int(problem.split("substeps = ")[1].split()[0])
    assert advised > given
    fc.simulate(fc.Loop(n_volumes=40, substeps=advised), days, warm_up=60)
    assert (
        "2 of 4 scenarios"
        in simulate_problems(fc.Loop(n_volumes=40, substeps=[advised, advised - 1]), days, warm_up=60)[0]
    )


def test_one_unstable_scenario_refuses_the_study_and_is_counted(days, simulate_problems):
    (problem,) = simulate_problems(
        fc.Loop(C_w=[8.8, 9.0, 1.0], backlash=[0.0, 0.1], kp=[0.01, 0.02, 0.03]), days, warm_up=60
    )
    assert "12 of 36 scenarios" in problem
    assert "C_w=1" in problem
