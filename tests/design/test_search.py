"""The search: it finds known optima, keeps limits, and its front is the front."""

import numpy as np
import pytest

from fastcoil.design.tune import Scores, best_point, evolve, pareto_front, plan_generations


def run_search(goal, violation, d, evaluations, seed, first=None, travel=None):
    """Every point that a search of functions of points tries, with its scores."""
    points, scores = [], []

    def score(at):
        batch = Scores(violation(at), np.zeros(len(at)), goal(at), goal(at), at[:, 0] if travel is None else travel(at))
        points.append(at)
        scores.append(batch)
        return batch

    evolve(score, np.empty((0, d)) if first is None else first, d, evaluations, seed)
    return np.concatenate(points), Scores(*map(np.concatenate, zip(*scores, strict=True)))


def no_violation(at):
    return np.zeros(len(at))


@pytest.mark.parametrize("seed", range(2))
def test_it_finds_the_bottom_of_a_bowl(seed):
    middle = np.array([0.31, 0.77, 0.5])
    points, scores = run_search(lambda at: (at - middle) ** 2 @ [1.0, 4.0, 2.0], no_violation, 3, 400, seed)
    assert np.abs(points[best_point(scores)] - middle).max() < 0.02
    assert ((points >= 0.0) & (points <= 1.0)).all()
    assert len(points) == plan_generations(3, 400)[0] * sum(plan_generations(3, 400)[1:]) == pytest.approx(400, abs=12)


@pytest.mark.parametrize("seed", range(2))
def test_a_limit_decides_before_the_goal(seed):
    """As far out as possible inside a quarter of a disk: on its edge, halfway between the axes."""

    def excess(at):
        return np.maximum((at**2).sum(axis=1) - 0.5, 0.0)

    points, scores = run_search(lambda at: -at.sum(axis=1), excess, 2, 400, seed)
    assert scores.violation[best_point(scores)] == 0.0
    assert points[best_point(scores)].sum() == pytest.approx(1.0, abs=0.01)


def test_where_nothing_keeps_the_limits_the_least_broken_is_best():
    points, scores = run_search(lambda at: at[:, 0], lambda at: 1.0 + np.abs(at[:, 1] - 0.4), 2, 300, 0)
    assert points[best_point(scores)][1] == pytest.approx(0.4, abs=0.02)


def test_the_same_seed_goes_the_same_way_and_another_one_another():
    of_seeds = [run_search(lambda at: at.sum(axis=1), no_violation, 2, 100, seed)[0] for seed in (3, 3, 4)]
    assert np.array_equal(of_seeds[0], of_seeds[1])
    assert not np.array_equal(of_seeds[0], of_seeds[2])


def test_a_part_of_the_trials_spreads_along_the_front():
    """Error falls as travel rises, and the goal alone would sit at one end."""
    points, scores = run_search(lambda at: (1.0 - at[:, 0]) + 3.0 * at[:, 1], no_violation, 2, 400, 0)
    front = pareto_front(scores)
    assert np.ptp(points[front][:, 0]) > 0.8
    assert len(front) > 30
    assert np.diff(np.sort(points[front][:, 0])).max() < 0.2


def test_the_front_holds_all_that_nothing_beats_and_only_that():
    rng = np.random.default_rng(0)
    error, travel = rng.random(200).round(1), rng.random(200).round(1)
    other = rng.integers(0, 2, 200).astype(float)
    error[3] = np.inf
    front = pareto_front(Scores(np.zeros(200), other, error, error, travel))
    allowed = [k for k in range(200) if other[k] == 0.0]
    points = {(error[k], travel[k]) for k in allowed}
    expected = {p for p in points if not any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)}
    assert {(error[k], travel[k]) for k in front} == expected
    assert len(front) == len(expected)
    assert (np.diff(travel[front]) > 0).all()
    assert (other[front] == 0.0).all()
