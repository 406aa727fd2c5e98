"""Stick-slip, and a motor with a neutral zone: the published charts, and what must hold of any such valve."""

from itertools import accumulate, pairwise

import numpy as np
import pytest
import reference
from helpers.stems import stem_positions
from hypothesis import given
from hypothesis import strategies as st

from fastcoil.model.physics import motor_position, move_with_dead_zone, opening, stick_slip

FRACTION = st.floats(0.0, 1.0, allow_subnormal=False)
POSITIONS = st.lists(st.one_of(FRACTION, st.sampled_from([0.0, 1.0, 0.3, 0.5])), min_size=1, max_size=60)
BANDS = st.floats(0.0, 0.9, allow_subnormal=False)
VALVES = [(0.07, 0.02), (0.1, 0.1), (0.3, 0.013), (0.9, 0.45), (0.007, 0.003)]


def random_positions(seed, n):
    """Moves of all sizes, halts, and runs into both ends of the stroke."""
    rng = np.random.default_rng(seed)
    moves = rng.choice([0.0, 0.003, 0.03, 0.3], n) * rng.standard_normal(n)
    return list(accumulate(moves, lambda position, move: min(max(position + move, 0.0), 1.0), initial=0.0))[1:]


def move_stem(positions, S, J):
    """q and direction of a stem that starts stuck at 0."""
    q, direction, moves = 0.0, 0.0, []
    for previous, position in pairwise([0.0, *positions]):
        q, direction = stick_slip(q, direction, position, previous, S, J)
        moves.append((q, direction))
    return np.array(moves).T


@pytest.mark.parametrize(("S", "J"), VALVES)
def test_equals_the_published_chart(S, J):
    positions = random_positions(1, 4000)
    chart = reference.StickSlip(S, J)
    chart_moves = [(chart.move(position)[1], 0.0 if chart.stp else chart.d) for position in positions]
    (q, direction), (openings, directions) = move_stem(positions, S, J), np.transpose(chart_moves)
    np.testing.assert_array_equal(direction, directions)
    np.testing.assert_allclose([opening(each, S - J) for each in q], openings, rtol=0.0, atol=1e-15)
    assert {-1.0, 0.0, 1.0} == set(direction)


@pytest.mark.parametrize("S", [0.0, 0.07, 0.15, 0.9])
def test_without_a_jump_it_is_equation_1_to_the_bit(S):
    positions = random_positions(2, 20000)
    np.testing.assert_array_equal(move_stem(positions, S, 0.0)[0], stem_positions(positions, S))


@given(POSITIONS, BANDS, FRACTION)
def test_homogeneity(positions, S, share):
    """In command, stick band and jump together."""
    J = share * S
    eighth = move_stem([p / 8.0 for p in positions], S / 8.0, J / 8.0)
    np.testing.assert_array_equal([8.0, 1.0] @ (eighth * [[1.0], [0.0]]), move_stem(positions, S, J)[0])


@given(POSITIONS, BANDS, FRACTION)
def test_the_opening_stays_between_0_and_1_and_a_turned_stem_jumps_by_j_at_least(positions, S, share):
    J = share * S
    q, direction = move_stem(positions, S, J)
    openings = np.array([opening(each, S - J) for each in q])
    assert np.all((openings >= 0.0) & (openings <= 1.0))
    before = np.concatenate([[0.0], direction[:-1]])
    jumps = np.abs(np.diff(q, prepend=0.0))[(direction != 0.0) & (direction != before)]
    assert np.all(jumps >= J - 1e-15)


# The motor


def run_motor(targets, max_travel, zone):
    position, runs, positions = 0.0, False, []
    for target in targets:
        position, runs = move_with_dead_zone(position, target, max_travel, zone, runs)
        positions.append(position)
    return np.array(positions)


def test_a_motor_starts_outside_its_neutral_zone_and_runs_to_its_target():
    targets = [0.02, 0.04, 0.045, 0.045, 0.045, 0.06, 0.03, 0.03]
    assert run_motor(targets, 0.02, 0.03) == pytest.approx([0.0, 0.02, 0.04, 0.045, 0.045, 0.045, 0.045, 0.045])
    # it still runs where the target has come nearer than the zone
    assert run_motor([0.1, 0.03], 0.02, 0.03) == pytest.approx([0.02, 0.03])


@pytest.mark.parametrize("zone", [0.0, 0.02, 0.2])
@pytest.mark.parametrize("stroke_time", [0.0, 40.0])
def test_a_motor_is_the_references(zone, stroke_time):
    targets = random_positions(3, 3000)
    twin = reference.NeutralZone(zone)
    expected = [twin.move(target, 0.0, stroke_time) for target in targets]
    max_travel = 1.0 / stroke_time if stroke_time else np.inf
    np.testing.assert_array_equal(run_motor(targets, max_travel, zone), expected)


@given(st.lists(FRACTION, min_size=1, max_size=40), st.sampled_from([0.01, 0.2, np.inf]))
def test_without_a_zone_the_motor_follows_every_target_to_the_bit(targets, max_travel):
    expected = accumulate(targets, lambda position, target: motor_position(position, target, max_travel), initial=0.0)
    assert run_motor(targets, max_travel, 0.0).tolist() == list(expected)[1:]
