"""Stability at dt = 1 s: both borders, and that the substeps which a refusal advises are enough."""

import numpy as np
import pytest
from helpers.refusals import assert_refused

import fastcoil as fc
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


def refuse_unstable(*args, field="C_w"):
    return assert_refused(field, "value", fc.simulate, *args, warm_up=60)


@pytest.mark.parametrize("name", ["C_w", "C_c"])
@pytest.mark.parametrize("coil", COILS)
def test_the_border_of_stability_of_water_and_metal(days, coil, name):
    limit = gamma_and_lambda(days, **{name: 1.0}, **coil)[name == "C_c"]
    fc.simulate(fc.Loop(**{name: limit * (1 + 1e-9)}, **coil), days, warm_up=60)
    refuse_unstable(fc.Loop(**{name: limit * (1 - 1e-9)}, **coil), days, field=name)


def test_the_border_of_stability_with_an_installed_valve(days):
    """At full opening the water flow of such a valve is ``m_full``."""
    valve = {"rangeability": 50.0, "authority": 0.3, "m_full": 1.7}
    limit = 1.7 * 4.186
    fc.simulate(fc.Loop(C_w=limit * (1 + 1e-9), **valve), days, warm_up=60)
    refuse_unstable(fc.Loop(C_w=limit * (1 - 1e-9), **valve), days)


def test_leakage_moves_no_border(days):
    limit = gamma_and_lambda(days)[0] * 8.8
    loop = fc.Loop(leakage=[0.0, 0.05, 0.9])
    fc.simulate(loop.assign(C_w=limit * (1 + 1e-9)), days, warm_up=60)
    refuse_unstable(loop.assign(C_w=limit * (1 - 1e-9)), days)  # all six scenarios


def test_a_coil_that_cannot_get_wet_has_the_dry_border():
    day = fc.constant_day(hours=0.25, W_a_in=0.004)
    fc.simulate(fc.Loop(C_c=3.0), day, warm_up=60)
    refuse_unstable(fc.Loop(C_c=3.0), fc.constant_day(hours=0.25, W_a_in=0.015), field="C_c")


@pytest.mark.parametrize("given", [1, 3])
def test_substeps_that_are_advised_are_enough_and_one_less_is_not(days, given):
    error = refuse_unstable(fc.Loop(n_volumes=40, substeps=given), days)
    advised = int(error.problems[0].split("substeps = ")[1].split()[0])
    assert advised > given
    fc.simulate(fc.Loop(n_volumes=40, substeps=advised), days, warm_up=60)
    refuse_unstable(fc.Loop(n_volumes=40, substeps=[advised, advised - 1]), days)


def test_one_unstable_scenario_refuses_the_study_and_is_counted(days):
    refuse_unstable(fc.Loop(C_w=[8.8, 9.0, 1.0], backlash=[0.0, 0.1], kp=[0.01, 0.02, 0.03]), days)
