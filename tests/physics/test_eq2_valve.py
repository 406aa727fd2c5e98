"""Eq (2): the Richards curve, and its exact equality with an equal-percentage valve of given authority."""

import math

import numpy as np
import pytest
import reference

from fastcoil.physics.valve import installed_valve, water_flow

OPENINGS = np.linspace(0.0, 1.0, 201).tolist()
CURVES = [
    (2.0, 0.7, 9.0, 0.38),
    (0.8, 2.0, 7.8, 0.535),
    (1.0, 1.0, 5.0, 0.5),
    (3.0, 0.05, 30.0, 0.9),
    (2.5, 6.0, 2.0, -0.5),
]
VALVES = [(50.0, 0.3, 1.8), (30.0, 0.9, 2.0), (50.0, 0.05, 0.4), (1.5, 0.5, 1.0), (500.0, 0.001, 3.0)]


@pytest.mark.parametrize("curve", CURVES)
def test_curve_is_the_printed_formula(curve):
    for open_ in OPENINGS:
        assert water_flow(open_, *curve) == pytest.approx(reference.richards_valve(open_, *curve), rel=1e-14)


@pytest.mark.parametrize("curve", CURVES)
def test_flow_rises_towards_the_asymptote(curve):
    flows = [water_flow(open_, *curve) for open_ in OPENINGS]
    assert np.all(np.diff(flows) > 0.0)
    assert 0.0 < flows[0] < flows[-1] < curve[0]
    assert water_flow(1000.0, *curve) == pytest.approx(curve[0], rel=1e-15)


@pytest.mark.parametrize("curve", CURVES)
def test_growth_is_steepest_at_c(curve):
    _, _, b, c = curve
    open_ = c + np.linspace(-0.5, 0.5, 1001) / b
    flows = np.array([water_flow(x, *curve) for x in open_.tolist()])
    steepest = open_[1:-1][np.argmax(flows[2:] - flows[:-2])]
    assert steepest == pytest.approx(c, abs=0.002 / b)


def test_logistic_curve_is_half_open_at_c():
    assert water_flow(0.4, 2.0, 1.0, 9.0, 0.4) == pytest.approx(1.0, rel=1e-15)


@pytest.mark.parametrize("valve", VALVES)
def test_installed_valve_is_the_hydraulic_circuit(valve):
    rangeability, authority, m_full = valve
    curve = installed_valve(*valve)
    # coil and pipes in series with the valve, fully open: the valve takes the share `authority` of 1 Pa
    coil = (1.0 - authority) / m_full**2
    open_valve = authority / m_full**2
    for open_ in OPENINGS:
        inherent = rangeability ** (open_ - 1.0)
        m_w = math.sqrt(1.0 / (coil + open_valve / inherent**2))
        assert water_flow(open_, *curve) == pytest.approx(m_w, rel=1e-12)


@pytest.mark.parametrize("valve", VALVES)
def test_installed_valve_is_the_references(valve):
    assert installed_valve(*valve) == pytest.approx(reference.valve_from_authority(*valve), rel=1e-14, abs=1e-14)


def test_full_authority_leaves_the_inherent_characteristic():
    curve = installed_valve(50.0, 1.0 - 1e-12, 2.0)
    for open_ in OPENINGS:
        assert water_flow(open_, *curve) == pytest.approx(2.0 * 50.0 ** (open_ - 1.0), rel=1e-6)
