"""Eq (1): the one-clamp play equals the paper's three branches, and has the laws of a play operator."""

import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st

from fastcoil.physics.valve import backlash, opening

FRACTION = st.floats(0.0, 1.0, allow_subnormal=False)
# halts, and both ends of the stroke, more often than chance would have them
POSITIONS = st.lists(st.one_of(FRACTION, st.sampled_from([0.0, 1.0, 0.3, 0.5])), min_size=1, max_size=60)
BACKLASHES = st.floats(0.0, 0.9, allow_subnormal=False)


def play(positions, x_bl):
    """Stem positions of a motor that starts, like the stem, at 0."""
    q, stem = 0.0, []
    for position in positions:
        q = backlash(q, position, x_bl)
        stem.append(q)
    return np.array(stem)


def printed_openings(positions, x_bl):
    x, previous, openings = 0.0, 0.0, []
    for position in positions:
        x, open_ = reference.backlash(position, previous, x, x_bl)
        previous = position
        openings.append(open_)
    return np.array(openings)


def wandering(seed, n=3000):
    """Moves of all sizes, halts, and runs into both ends of the stroke."""
    rng = np.random.default_rng(seed)
    moves = rng.choice([0.0, 0.01, 0.1, 0.7], n) * rng.standard_normal(n)
    positions = np.empty(n)
    position = 0.0
    for t in range(n):
        position = min(max(position + moves[t], 0.0), 1.0)
        positions[t] = position
    return positions.tolist()


def assert_equals_printed(positions, x_bl):
    openings = [opening(q, x_bl) for q in play(positions, x_bl)]
    # the printed x is a running sum: its round-off grows with the number of moves, and α stretches it
    tolerance = 2e-16 * len(positions) / (1.0 - x_bl) + 1e-15
    np.testing.assert_allclose(openings, printed_openings(positions, x_bl), rtol=0.0, atol=tolerance)


@given(POSITIONS, BACKLASHES)
def test_equals_the_three_printed_branches(positions, x_bl):
    assert_equals_printed(positions, x_bl)


@pytest.mark.parametrize("x_bl", [0.0, 0.007, 0.07, 0.15, 0.5, 0.9])
@pytest.mark.parametrize("seed", range(4))
def test_equals_the_three_printed_branches_on_long_runs(seed, x_bl):
    assert_equals_printed(wandering(seed), x_bl)


@pytest.mark.parametrize(
    ("positions", "openings"),
    [
        ([0.25, 0.5, 0.5, 0.375, 0.25, 0.125, 0.0], [0.0, 1 / 3, 1 / 3, 1 / 3, 1 / 3, 1 / 6, 0.0]),
        ([1.0, 0.75, 0.5, 1.0], [1.0, 1.0, 2 / 3, 1.0]),
    ],
)
def test_worked_example_with_a_quarter_of_play(positions, openings):
    assert [opening(q, 0.25) for q in play(positions, 0.25)] == pytest.approx(openings, abs=1e-15)


@given(POSITIONS)
def test_without_backlash_the_stem_is_the_motor(positions):
    stem = play(positions, 0.0)
    assert stem.tolist() == positions
    assert [opening(q, 0.0) for q in stem] == positions


@given(POSITIONS, BACKLASHES)
def test_invariants(positions, x_bl):
    p, q = np.array(positions), play(positions, x_bl)
    assert np.all(q >= np.maximum(0.0, p - x_bl))
    assert np.all(q <= p)
    assert np.all(q <= 1.0 - x_bl)
    openings = np.array([opening(v, x_bl) for v in q])
    assert np.all((openings >= 0.0) & (openings <= 1.0))


@given(POSITIONS, BACKLASHES)
def test_a_held_motor_holds_the_stem(positions, x_bl):
    stem = play(positions, x_bl)
    assert backlash(stem[-1], positions[-1], x_bl) == stem[-1]


@given(POSITIONS, BACKLASHES, st.integers(2, 5))
def test_rate_independence(positions, x_bl, n):
    path = np.concatenate([[0.0], positions])
    slower = np.concatenate([np.linspace(a, b, n + 1)[1:] for a, b in zip(path[:-1], path[1:], strict=True)])
    slower[n - 1 :: n] = positions
    np.testing.assert_array_equal(play(slower.tolist(), x_bl)[n - 1 :: n], play(positions, x_bl))


@given(POSITIONS, BACKLASHES)
def test_homogeneity(positions, x_bl):
    eighth = play([p / 8.0 for p in positions], x_bl / 8.0)
    np.testing.assert_array_equal(8.0 * eighth, play(positions, x_bl))


@given(st.lists(st.tuples(FRACTION, FRACTION), min_size=1, max_size=60), BACKLASHES)
def test_order_and_distance_are_kept(pairs, x_bl):
    low, high = np.sort(np.array(pairs), axis=1).T
    gap = play(high.tolist(), x_bl) - play(low.tolist(), x_bl)
    assert np.all(gap >= 0.0)
    assert np.all(gap <= np.max(high - low) + 1e-15)
