"""The valve: Eq (1), one clamp that equals the paper's three branches, and Eq (2), its flow curve.

Eq (1) must keep the laws of a play operator; Eq (2) must equal an equal-percentage valve of given authority exactly.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
import reference
from helpers.stems import stem_positions
from hypothesis import given
from hypothesis import strategies as st

from fastcoil.model.physics import installed_valve, opening, water_flow

FRACTION = st.floats(0.0, 1.0, allow_subnormal=False)
# halts, and both ends of the stroke, more often than chance would have them
POSITIONS = st.lists(st.one_of(FRACTION, st.sampled_from([0.0, 1.0, 0.3, 0.5])), min_size=1, max_size=60)
BACKLASHES = st.floats(0.0, 0.9, allow_subnormal=False)
OPENINGS = np.linspace(0.0, 1.0, 201).tolist()
CURVES = [
    (2.0, 0.7, 9.0, 0.38),
    (0.8, 2.0, 7.8, 0.535),
    (1.0, 1.0, 5.0, 0.5),
    (3.0, 0.05, 30.0, 0.9),
    (2.5, 6.0, 2.0, -0.5),
]
VALVES = [(50.0, 0.3, 1.8), (30.0, 0.9, 2.0), (50.0, 0.05, 0.4), (1.5, 0.5, 1.0), (500.0, 0.001, 3.0)]


# Eq (1)


@given(POSITIONS, BACKLASHES)
def test_equals_the_three_printed_branches(positions, x_bl):
    x, printed_openings = 0.0, []
    for previous, position in pairwise([0.0, *positions]):
        x, open_ = reference.backlash(position, previous, x, x_bl)
        printed_openings.append(open_)
    openings = [opening(q, x_bl) for q in stem_positions(positions, x_bl)]
    # the printed x is a running sum: its round-off grows with the number of moves, and α stretches it
    tolerance = 2e-16 * len(positions) / (1.0 - x_bl) + 1e-15
    np.testing.assert_allclose(openings, printed_openings, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize(
    ("positions", "openings"),
    [
        ([0.25, 0.5, 0.5, 0.375, 0.25, 0.125, 0.0], [0.0, 1 / 3, 1 / 3, 1 / 3, 1 / 3, 1 / 6, 0.0]),
        ([1.0, 0.75, 0.5, 1.0], [1.0, 1.0, 2 / 3, 1.0]),
    ],
)
def test_worked_example_with_a_quarter_of_play(positions, openings):
    assert [opening(q, 0.25) for q in stem_positions(positions, 0.25)] == pytest.approx(openings, abs=1e-15)


@given(POSITIONS)
def test_without_backlash_the_stem_is_the_motor(positions):
    stem = stem_positions(positions, 0.0)
    assert stem.tolist() == positions
    assert [opening(q, 0.0) for q in stem] == positions


@given(POSITIONS, BACKLASHES)
def test_invariants(positions, x_bl):
    p, q = np.array(positions), stem_positions(positions, x_bl)
    assert np.all(q >= np.maximum(0.0, p - x_bl))
    assert np.all(q <= p)
    assert np.all(q <= 1.0 - x_bl)
    openings = np.array([opening(v, x_bl) for v in q])
    assert np.all((openings >= 0.0) & (openings <= 1.0))


@given(POSITIONS, BACKLASHES, st.integers(2, 5))
def test_rate_independence(positions, x_bl, n):
    path = np.concatenate([[0.0], positions])
    slower = np.concatenate([np.linspace(a, b, n + 1)[1:] for a, b in zip(path[:-1], path[1:], strict=True)])
    slower[n - 1 :: n] = positions
    np.testing.assert_array_equal(stem_positions(slower.tolist(), x_bl)[n - 1 :: n], stem_positions(positions, x_bl))


@given(POSITIONS, BACKLASHES)
def test_homogeneity(positions, x_bl):
    eighth = stem_positions([p / 8.0 for p in positions], x_bl / 8.0)
    np.testing.assert_array_equal(8.0 * eighth, stem_positions(positions, x_bl))


@given(st.lists(st.tuples(FRACTION, FRACTION), min_size=1, max_size=60), BACKLASHES)
def test_order_and_distance_are_kept(pairs, x_bl):
    low, high = np.sort(np.array(pairs), axis=1).T
    gap = stem_positions(high.tolist(), x_bl) - stem_positions(low.tolist(), x_bl)
    assert np.all(gap >= 0.0)
    assert np.all(gap <= np.max(high - low) + 1e-15)


# Eq (2)


@pytest.mark.parametrize("curve", CURVES)
def test_curve_is_the_printed_formula(curve):
    for open_ in OPENINGS:
        assert water_flow(open_, *curve) == pytest.approx(reference.richards_valve(open_, *curve), rel=1e-14)


@pytest.mark.parametrize("valve", VALVES)
def test_installed_valve_is_the_hydraulic_circuit(valve):
    (rangeability, authority, m_full), curve = valve, installed_valve(*valve)
    # coil and pipes in series with the valve, fully open: the valve takes the share `authority` of 1 Pa
    coil, open_valve = (1.0 - authority) / m_full**2, authority / m_full**2
    for open_ in OPENINGS:
        inherent = rangeability ** (open_ - 1.0)
        m_w = math.sqrt(1.0 / (coil + open_valve / inherent**2))
        assert water_flow(open_, *curve) == pytest.approx(m_w, rel=1e-12)


@pytest.mark.parametrize("valve", VALVES)
def test_installed_valve_is_the_references(valve):
    assert installed_valve(*valve) == pytest.approx(reference.valve_from_authority(*valve), rel=1e-14, abs=1e-14)
