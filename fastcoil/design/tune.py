"""``tune``: settings of a controller for a population of valves and days, tried on others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, flag_of
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError
from fastcoil.base.progress import Shown, progress_of_call
from fastcoil.design.measures import resolved, violation, with_intervals
from fastcoil.design.tuning_plan import EVALUATIONS, OBJECTIVE, QUANTILE, Asked, Group, own_gains, plan_tuning, tried
from fastcoil.design.tuning_result import CHOSEN, NOW, SIMC, Tuning, notes_on
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import workers
from fastcoil.model.metric_table import WARM_UP

_MOST_ON_FRONT = 20


def tune(
    loop: Loop,
    boundary: Boundary,
    *,
    search: Mapping[str, Any],
    objective: str = OBJECTIVE,
    quantile: float | str = QUANTILE,
    limits: Mapping[str, Any] | None = None,
    holdout: Any = None,
    evaluations: int = EVALUATIONS,
    warm_up: int = WARM_UP,
    seed: int = 0,
    replicates: int = 1,
    n_jobs: int | None = None,
    progress: bool | None = None,
) -> Tuning:
    """Choose settings of a controller for all valves of ``loop`` on all days of ``boundary``, and try them on others.

    One of every three valves and the days of ``holdout`` are set aside.  The search never sees them; what the chosen
    settings do there is the result.

    Parameters
    ----------
    loop
        The population: every combination along its dims is a valve, such as 200 drawn ones along ``sample``.
    boundary
        The days; several, or others given with ``holdout``.
    search
        What may be chosen: bounds (lowest, highest) by parameter of the controller, the inverse or an estimator.
        Ends that are positive and 5 times apart are searched in logarithms.
    objective, quantile
        Metric to make small, and the share of valves and days whose value counts: 0.95 is the value that 95 % of
        them do not exceed; ``"mean"`` the mean.
    limits
        Upper limits by metric: a number holds for ``quantile``, a pair such as ``(0.05, "mean")`` for its own;
        ``"now"`` in place of a number is what the loop does as it came, on the valves and days of the search.
    holdout
        Days to try the choice on: a Boundary, or labels of some days of ``boundary``; its last third by default.
    evaluations
        Tunings that are tried, rounded to whole generations; the last quarter of them looks for the front of error
        against motor travel.
    warm_up, replicates, progress
        As in ``simulate``.
    seed
        Of the measurement noise, of the valves that are set aside, and of the search.
    n_jobs
        Threads; all cores by default.  The result does not depend on it.

    Returns
    -------
    Tuning
        ``parameters``, ``held_out`` and ``trained`` with the loop as it came beside, ``front``, ``plot()``.

    Raises
    ------
    InputError
        With one sentence for each mistake; where no tuning has a finite objective.
    """
    with checking() as check:
        n_threads = check(workers, n_jobs)
        progress = check.unless_none(flag_of, "progress", progress)
        asked = check(
            plan_tuning, loop, boundary, search=search, objective=objective, quantile=quantile, limits=limits,
            holdout=holdout, evaluations=evaluations, warm_up=warm_up, seed=seed, replicates=replicates,
        )  # fmt: skip
    with progress_of_call(progress) as on_show:
        return run_tuning(asked._replace(n_jobs=n_threads), on_show)


def run_tuning(asked: Asked, on_show: Shown) -> Tuning:
    """Search, choose, and try the choice on the hold-out."""
    measures, training = asked.measures, asked.training
    size, *generations = effort(len(asked.axes), asked.evaluations)
    cases = len(training.members) * training.boundary.n_days * asked.replicates
    advance = on_show.start(size * sum(generations) * cases)
    asked = asked._replace(limits=resolved(asked.limits, measured(asked, training, {})))
    every: list[tuple[Array, dict[str, Array]]] = []

    def scored(points: Array) -> Scores:
        values = asked.values(points)
        found = measured(asked, training, asked.tunings(values))
        every.append((values, found))
        advance(len(values) * cases)
        return scores_of(asked, found)

    evolve(scored, _beginning(asked), len(asked.axes), asked.evaluations, asked.seed)
    values = np.concatenate([of for of, _ in every])
    first = np.sort(np.unique(values, axis=0, return_index=True)[1])  # of each tuning
    values, found = values[first], {m.name: np.concatenate([of[m.name] for _, of in every])[first] for m in measures}
    scores = scores_of(asked, found)
    at = best(scores)
    if not np.isfinite(scores.goal[at]):
        what = "with every tuning it is missing on more valves and days than the quantile leaves out"
        raise InputError(f"objective = {asked.goal.metric!r}: {what}; search other bounds, or another objective")
    front = on_front(scores)
    if front.size > _MOST_ON_FRONT:  # some points of it evenly along, both ends among them
        front = front[np.unique(np.linspace(0, front.size - 1, _MOST_ON_FRONT).round().astype(int))]
    parameters = {
        axis.name: int(value) if axis.parameter.whole else value
        for axis, value in zip(asked.axes, values[at].tolist(), strict=True)
    }
    meets_limits = float(scores.violation[at]) == 0.0
    trained, held_out = (_beside_now(asked, group, values[at]) for group in (training, asked.holdout))
    of_front = _dataset("point", asked, values[front], {name: each[front] for name, each in found.items()})
    on_holdout = measured(asked, asked.holdout, asked.tunings(values[front]))
    for measure in measures:
        attrs = measure.attrs | {"long_name": f"{measure.words}, held out"}
        of_front[f"held_out_{measure.name}"] = ("point", on_holdout[measure.name], attrs)
    notes = notes_on(asked, parameters, meets_limits, held_out)
    of_all, axes = _dataset("evaluation", asked, values, found), (asked.error, asked.travel)
    return Tuning(parameters, meets_limits, held_out, trained, of_front, of_all, asked.goal, asked.limits, notes, axes)


def measured(asked: Asked, group: Group, changes: Mapping[str, Any]) -> dict[str, Array]:
    """The measures (n,) of a group with changes of its loop."""
    cases = tried(asked, group, changes)
    return {m.name: m.of(cases[m.metric].reshape(len(cases[m.metric]), -1)) for m in asked.measures}


def scores_of(asked: Asked, found: Mapping[str, Array]) -> Scores:
    """What the search compares, from measures (n,)."""
    others = [limit for limit in asked.limits if limit.measure != asked.travel]
    compared = (found[measure.name] for measure in (asked.goal, asked.error, asked.travel))
    return Scores(violation(asked.limits, found), violation(others, found), *compared)


def _beginning(asked: Asked) -> Array:
    """The loop's own settings and those after SIMC as points (n, d): medians where its valves differ."""
    own: dict[str, Any] = {name: asked.training.loop[name] for name in asked.names}
    if any(value is None for value in own.values()):
        return np.empty((0, len(own)))
    gains = {name: values for name, (_, values) in own_gains(asked.training, asked.names, asked.warm_up).items()}
    tunings = [own, own | gains] if gains else [own]
    return np.array(
        [[axis.share(float(np.median(np.asarray(of[axis.name])))) for axis in asked.axes] for of in tunings]
    )


def _beside_now(asked: Asked, group: Group, chosen: Array) -> xr.Dataset:
    """The chosen settings on a group, and the loop as it came beside."""
    changes = {NOW: {}, CHOSEN: asked.tunings(chosen[None]), SIMC: own_gains(group, asked.names, asked.warm_up)}
    of_tunings = {name: tried(asked, group, change) for name, change in changes.items() if change or name == NOW}
    cases = {metric: np.concatenate([of[metric] for of in of_tunings.values()]) for metric in of_tunings[NOW]}
    ds = with_intervals(cases, asked.measures, list(of_tunings), asked.seed)
    return ds.assign_attrs(group=group.words)


def _dataset(dim: str, asked: Asked, values: Array, found: Mapping[str, Array]) -> xr.Dataset:
    """Settings and measures of some tunings."""
    variables: dict[str, Any] = {}
    for axis, column in zip(asked.axes, values.T, strict=True):
        variables[axis.name] = (dim, column, {"long_name": axis.parameter.text, "units": axis.parameter.unit})
    for measure in asked.measures:
        variables[measure.name] = (dim, found[measure.name], measure.attrs)
    return xr.Dataset(variables)


class Scores(NamedTuple):
    """What is compared, (n,): limits broken, and those but of the travel; the goal; error, travel of the front."""

    violation: Array
    other_violation: Array
    goal: Array
    error: Array
    travel: Array


_LEAST = 8  # points of the smallest generation


def effort(d: int, evaluations: int) -> tuple[int, int, int]:
    """Points of a generation; generations that seek the goal, the first one among them, and along the front."""
    size = max(_LEAST, 4 * d)
    generations = max(1, round(evaluations / size))
    return size, generations - generations // 4, generations // 4


_SCALE = (0.3, 0.8)  # factor of a difference, drawn anew for each trial
_MIXED = 0.8  # share of the axes that a trial takes from the new point
_SMALL, _BEYOND = 0.02, 0.5
"""Spread of the trials around the front, share of an axis; how far they go beyond two neighbours, of their distance."""
_TINY = 1e-300


def evolve(scored: Callable[[Array], Scores], first: Array, d: int, evaluations: int, seed: int) -> None:
    """Search the unit cube by differential evolution, whole generations at once; ``scored`` keeps what is found.

    Storn and Price (1997), doi:10.1023/A:1008202821328: a trial point is the best one plus a scaled difference of two
    others, mixed with the point that it may replace.  Of two points the one that breaks the limits less is better, then
    the one with the lower goal: Deb (2000), doi:10.1016/S0045-7825(99)00389-8.  The last generations go along the
    front.  SciPy's has the same idea; here the way taken depends on numpy's random numbers alone, so that another SciPy
    repeats it.

    scored: points (n, d) → their scores.  first: points (n, d) to begin with, besides those that fill the cube.
    evaluations: see ``effort``.
    """
    rng = np.random.default_rng([seed, 2])
    size, for_goal, for_front = effort(d, evaluations)
    n = max(size - len(first), 0)  # fill up with a Latin hypercube: each axis is cut into n parts with a point in each
    parts = np.stack([rng.permutation(n) for _ in range(d)], axis=1)
    points = np.concatenate([first, (parts + rng.random(parts.shape)) / max(n, 1)])[:size]
    scores = scored(points)
    tried, of_tried = points, scores

    def try_more(trials: Array) -> Scores:
        nonlocal tried, of_tried
        found = scored(trials)
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
    """Points that no other beats in travel and error, by travel; of the limits that of the travel does not count."""
    kept = np.flatnonzero(scores.other_violation == scores.other_violation.min())
    order = kept[np.lexsort((scores.error[kept], scores.travel[kept]))]
    lowest = np.minimum.accumulate(np.concatenate([[np.inf], scores.error[order][:-1]]))
    return np.asarray(order[(scores.error[order] < lowest) & np.isfinite(scores.travel[order])])


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
