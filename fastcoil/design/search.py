"""Differential evolution: whole generations at once, limits first, then the goal; then along the front.

Storn and Price (1997), doi:10.1023/A:1008202821328: a trial point is the best one plus a scaled difference of two
others, mixed with the point that it may replace.  Of two points the one that breaks the limits less is better, then the
one with the lower goal: Deb (2000), doi:10.1016/S0045-7825(99)00389-8.  SciPy's has the same idea; here the way taken
depends on numpy's random numbers alone, so that another SciPy repeats it.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index


class Scores(NamedTuple):
    """What is compared, (n,) each.

    By how much the limits are broken, and those but that of the travel; the goal; error and travel of the front.
    """

    violation: Array
    other_violation: Array
    goal: Array
    error: Array
    travel: Array


_SCALE = (0.3, 0.8)  # factor of a difference, drawn anew for each trial
_LEAST = 8  # points of the smallest generation
_MIXED = 0.8  # share of the axes that a trial takes from the new point
_SMALL, _BEYOND = 0.02, 0.5
"""Spread of the trials around the front, share of an axis; how far they go beyond two neighbours, of their distance."""
_TINY = 1e-300


def effort(d: int, evaluations: int) -> tuple[int, int, int]:
    """How ``evaluations`` points of ``d`` axes are spent.

    Returns the points of a generation, the generations that seek the goal, the first one among them, and those that go
    along the front, a quarter.
    """
    size = max(_LEAST, 4 * d)
    generations = max(1, round(evaluations / size))
    return size, generations - generations // 4, generations // 4


def evolve(measured: Callable[[Array], Scores], first: Array, d: int, evaluations: int, seed: int) -> None:
    """Search the unit cube; ``measured`` keeps what is found.

    measured: points (n, d) → their scores.  first: points (n, d) to begin with, besides those that fill the cube.
    evaluations: see ``effort``.
    """
    rng = np.random.default_rng([seed, 2])
    size, for_goal, for_front = effort(d, evaluations)
    points = np.concatenate([first, _filling(rng, size - len(first), d)])[:size]
    scores = measured(points)
    tried, of_tried = points, scores

    def try_more(trials: Array) -> Scores:
        nonlocal tried, of_tried
        found = measured(trials)
        tried = np.concatenate([tried, trials])
        of_tried = Scores(*map(np.concatenate, zip(of_tried, found, strict=True)))
        return found

    for _ in range(for_goal - 1):
        trials = _trials(rng, points, best(scores))
        found = try_more(trials)
        less, as_much = found.violation < scores.violation, found.violation == scores.violation
        better = less | (as_much & (found.goal <= scores.goal))
        points = np.where(better[:, None], trials, points)
        scores = Scores(*(np.where(better, new, old) for new, old in zip(found, scores, strict=True)))
    for _ in range(for_front):
        front = on_front(of_tried)
        try_more(_along(rng, tried[front], of_tried.error[front], of_tried.travel[front], size))


def best(scores: Scores) -> int:
    """The place of the best point."""
    return int(np.lexsort((scores.travel, scores.goal, scores.violation))[0])


def on_front(scores: Scores) -> Index:
    """Places of the points of which no other has both less travel and a lower error, in the order of the travel.

    Of the limits, that of the travel does not count.  Where no point keeps the others, those that break them least.
    """
    kept = np.flatnonzero(scores.other_violation == scores.other_violation.min())
    order = kept[np.lexsort((scores.error[kept], scores.travel[kept]))]
    lowest = np.minimum.accumulate(np.concatenate([[np.inf], scores.error[order][:-1]]))
    return np.asarray(order[(scores.error[order] < lowest) & np.isfinite(scores.travel[order])])


def _filling(rng: np.random.Generator, n: int, d: int) -> Array:
    """A Latin hypercube: each axis is cut into n parts with a point in each."""
    parts = np.stack([rng.permutation(n) for _ in range(d)], axis=1) if n > 0 else np.empty((0, d))
    return (parts + rng.random(parts.shape)) / max(n, 1)


def _trials(rng: np.random.Generator, points: Array, best_at: int) -> Array:
    """A trial for each point; one that leaves the cube comes back to its border."""
    n, d = points.shape
    pairs = np.argsort(rng.random((n, n)), axis=1)[:, :2]
    scale = rng.uniform(*_SCALE, (n, 1))
    new = points[best_at] + scale * (points[pairs[:, 0]] - points[pairs[:, 1]])
    mixed = rng.random((n, d)) < _MIXED
    mixed[np.arange(n), rng.integers(0, d, n)] = True
    return np.asarray(np.clip(np.where(mixed, new, points), 0.0, 1.0))


def _along(rng: np.random.Generator, front: Array, error: Array, travel: Array, n: int) -> Array:
    """Points between neighbours on the front, most where these lie far apart, a little beyond them and some way off."""
    at, step = np.zeros(n, dtype=int), np.zeros((n, front.shape[1]))
    if len(front) > 1:
        gaps = sum(np.abs(np.diff(values)) / max(float(np.ptp(values)), _TINY) for values in (error, travel))
        at = np.minimum(np.searchsorted(np.cumsum(gaps) / np.sum(gaps), rng.random(n)), len(front) - 2)
        step = front[at + 1] - front[at]
    way = rng.uniform(-_BEYOND, 1.0 + _BEYOND, (n, 1))
    new = front[at] + way * step + _SMALL * rng.standard_normal((n, front.shape[1]))
    return np.asarray(np.clip(new, 0.0, 1.0))
