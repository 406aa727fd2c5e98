"""Motor and stem behind a trend log: the kernels do what Eq (1) says, step by step."""

import numpy as np
import pytest

from fastcoil.measured.grid import mean_openings, motor_positions, openings, turns


def test_the_motor_runs_to_the_command_no_faster_than_it_can():
    command = np.random.default_rng(3).uniform(0, 1, 60)
    positions = motor_positions(command, 0.1)
    at = command[0]
    for k, target in enumerate(command):
        assert positions[k] == at
        at += min(max(target - at, -0.1), 0.1)
    assert positions[-1] == at
    np.testing.assert_array_equal(motor_positions(command, 1.0)[1:], command)


@pytest.mark.parametrize("width", [1, 3])
def test_openings_are_means_of_those_of_the_play_operator(width):
    positions = motor_positions(np.random.default_rng(4).uniform(0, 1, 41), 0.1)
    sizes = np.array([0.0, 0.07, 0.2])
    means, squares = mean_openings(positions, sizes, width)
    assert means.shape == squares.shape == (41 // width, 3)
    for j, size in enumerate(sizes):
        q, stem = min(max(positions[0] - size / 2, 0), 1 - size), []
        for position in positions:
            q = min(max(q, position - size), position)
            stem.append(q / (1 - size))
        np.testing.assert_allclose(openings(positions, sizes)[:, j], stem, atol=1e-14)
        between = [(a + b) / 2 for a, b in zip(stem[:-1], stem[1:], strict=True)]
        for k in range(41 // width):
            piece = between[k * width : (k + 1) * width]
            assert means[k, j] == pytest.approx(sum(piece) / width, abs=1e-14)
            assert squares[k, j] == pytest.approx(sum(o * o for o in piece) / width, abs=1e-14)


def test_turns_count_what_comes_back_by_more_than_asked():
    assert turns(np.array([0.0, 0.5, 0.3, 0.6, 0.599, 0.7]), 0.01) == 2
    assert turns(np.linspace(0.0, 1.0, 50), 0.01) == 0
