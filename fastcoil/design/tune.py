"""``tune``: settings of a controller for a population of valves and days, tried on others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_flag
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError
from fastcoil.base.progress import ProgressDisplay, display_for_call
from fastcoil.design.measures import resolve_limits, violation, with_intervals
from fastcoil.design.tuning_plan import (
    DEFAULT_EVALUATIONS,
    DEFAULT_OBJECTIVE,
    DEFAULT_QUANTILE,
    Group,
    TuningRequest,
    plan_tuning,
    simc_gains_of_valves,
    simulate_group,
)
from fastcoil.design.tuning_result import CHOSEN, NOW, SIMC, Tuning, collect_notes
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop
from fastcoil.loops.simulate import number_of_threads
from fastcoil.model.metric_table import WARM_UP_S

_MOST_ON_FRONT = 20


def tune(
    loop: Loop,
    boundary: Boundary,
    *,
    search: Mapping[str, Any],
    objective: str = DEFAULT_OBJECTIVE,
    quantile: float | str = DEFAULT_QUANTILE,
    limits: Mapping[str, Any] | None = None,
    holdout: Any = None,
    evaluations: int = DEFAULT_EVALUATIONS,
    warm_up: int = WARM_UP_S,
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
    with argument_checks() as check:
        n_threads = check(number_of_threads, n_jobs)
        progress = check.unless_none(require_flag, "progress", progress)
        request = check(
            plan_tuning, loop, boundary, search=search, objective=objective, quantile=quantile, limits=limits,
            holdout=holdout, evaluations=evaluations, warm_up=warm_up, seed=seed, replicates=replicates,
        )  # fmt: skip
    with display_for_call(progress) as on_show:
        return run_tuning(request._replace(n_jobs=n_threads), on_show)


def run_tuning(request: TuningRequest, on_show: ProgressDisplay) -> Tuning:
    """Search, choose, and try the choice on the hold-out."""
    measures, training = request.measures, request.training
    size, *generations = plan_generations(len(request.axes), request.evaluations)
    cases = len(training.members) * training.boundary.n_days * request.replicates
    advance = on_show.start(size * sum(generations) * cases)
    request = request._replace(limits=resolve_limits(request.limits, measure_group(request, training, {})))
    batches: list[tuple[Array, dict[str, Array]]] = []

    def score_points(points: Array) -> Scores:
        values = request.values(points)
        measured_values = measure_group(request, training, request.tunings(values))
        batches.append((values, measured_values))
        advance(len(values) * cases)
        return score_measures(request, measured_values)

    evolve(score_points, _starting_points(request), len(request.axes), request.evaluations, request.seed)
    values = np.concatenate([batch for batch, _ in batches])
    first_indices = np.sort(np.unique(values, axis=0, return_index=True)[1])  # of each tuning
    values, measured_values = (
        values[first_indices],
        {m.name: np.concatenate([batch[m.name] for _, batch in batches])[first_indices] for m in measures},
    )
    scores = score_measures(request, measured_values)
    best_index = best_point(scores)
    if not np.isfinite(scores.goal[best_index]):
        reason = "with every tuning it is missing on more valves and days than the quantile leaves out"
        raise InputError(f"objective = {request.goal.metric!r}: {reason}; search other bounds, or another objective")
    front = pareto_front(scores)
    if front.size > _MOST_ON_FRONT:  # some points of it evenly along, both ends among them
        front = front[np.unique(np.linspace(0, front.size - 1, _MOST_ON_FRONT).round().astype(int))]
    parameters = {
        axis.name: int(value) if axis.parameter.whole else value
        for axis, value in zip(request.axes, values[best_index].tolist(), strict=True)
    }
    meets_limits = float(scores.violation[best_index]) == 0.0
    trained, held_out = (_compare_with_now(request, group, values[best_index]) for group in (training, request.holdout))
    front_dataset = _tunings_dataset(
        "point", request, values[front], {name: column[front] for name, column in measured_values.items()}
    )
    on_holdout = measure_group(request, request.holdout, request.tunings(values[front]))
    for measure in measures:
        attrs = measure.attrs | {"long_name": f"{measure.words}, held out"}
        front_dataset[f"held_out_{measure.name}"] = ("point", on_holdout[measure.name], attrs)
    notes = collect_notes(request, parameters, meets_limits, held_out)
    all_dataset, axes = (
        _tunings_dataset("evaluation", request, values, measured_values),
        (request.error, request.travel),
    )
    return Tuning(
        parameters,
        meets_limits,
        held_out,
        trained,
        front_dataset,
        all_dataset,
        request.goal,
        request.limits,
        notes,
        axes,
    )


def measure_group(request: TuningRequest, group: Group, changes: Mapping[str, Any]) -> dict[str, Array]:
    """The measures (n,) of a group with changes of its loop."""
    cases = simulate_group(request, group, changes)
    return {m.name: m.of(cases[m.metric].reshape(len(cases[m.metric]), -1)) for m in request.measures}


def score_measures(request: TuningRequest, measured_values: Mapping[str, Array]) -> Scores:
    """What the search compares, from measures (n,)."""
    other_limits = [limit for limit in request.limits if limit.measure != request.travel]
    compared = (measured_values[measure.name] for measure in (request.goal, request.error, request.travel))
    return Scores(violation(request.limits, measured_values), violation(other_limits, measured_values), *compared)


def _starting_points(request: TuningRequest) -> Array:
    """The loop's own settings and those after SIMC as points (n, d): medians where its valves differ."""
    current: dict[str, Any] = {name: request.training.loop[name] for name in request.names}
    if any(value is None for value in current.values()):
        return np.empty((0, len(current)))
    gains = {
        name: values
        for name, (_, values) in simc_gains_of_valves(request.training, request.names, request.warm_up).items()
    }
    tunings = [current, current | gains] if gains else [current]
    return np.array(
        [[axis.share(float(np.median(np.asarray(tuning[axis.name])))) for axis in request.axes] for tuning in tunings]
    )


def _compare_with_now(request: TuningRequest, group: Group, chosen: Array) -> xr.Dataset:
    """The chosen settings on a group, and the loop as it came beside."""
    changes = {
        NOW: {},
        CHOSEN: request.tunings(chosen[None]),
        SIMC: simc_gains_of_valves(group, request.names, request.warm_up),
    }
    cases_by_tuning = {
        name: simulate_group(request, group, change) for name, change in changes.items() if change or name == NOW
    }
    cases = {
        metric: np.concatenate([tuning_cases[metric] for tuning_cases in cases_by_tuning.values()])
        for metric in cases_by_tuning[NOW]
    }
    ds = with_intervals(cases, request.measures, list(cases_by_tuning), request.seed)
    return ds.assign_attrs(group=group.words)


def _tunings_dataset(
    dim: str, request: TuningRequest, values: Array, measured_values: Mapping[str, Array]
) -> xr.Dataset:
    """Settings and measures of some tunings."""
    variables: dict[str, Any] = {}
    for axis, column in zip(request.axes, values.T, strict=True):
        variables[axis.name] = (dim, column, {"long_name": axis.parameter.text, "units": axis.parameter.unit})
    for measure in request.measures:
        variables[measure.name] = (dim, measured_values[measure.name], measure.attrs)
    return xr.Dataset(variables)


class Scores(NamedTuple):
    """What is compared, (n,): limits broken, and those but of the travel; the goal; error, travel of the front."""

    violation: Array
    other_violation: Array
    goal: Array
    error: Array
    travel: Array


_SMALLEST_GENERATION = 8  # points of the smallest generation


def plan_generations(d: int, evaluations: int) -> tuple[int, int, int]:
    """Points of a generation; generations that seek the goal, the first one among them, and along the front."""
    size = max(_SMALLEST_GENERATION, 4 * d)
    generations = max(1, round(evaluations / size))
    return size, generations - generations // 4, generations // 4


_DIFFERENCE_SCALE = (0.3, 0.8)  # factor of a difference, drawn anew for each trial
_CROSSOVER_SHARE = 0.8  # share of the axes that a trial takes from the new point
_FRONT_SPREAD, _FRONT_OVERSHOOT = 0.02, 0.5
"""Spread of the trials around the front, share of an axis; how far they go beyond two neighbours, of their distance."""
_LEAST_RANGE = 1e-300


def evolve(score: Callable[[Array], Scores], first: Array, d: int, evaluations: int, seed: int) -> None:
    """Search the unit cube by differential evolution, whole generations at once; ``score`` keeps what is found.

    Storn and Price (1997), doi:10.1023/A:1008202821328: a trial point is the best one plus a scaled difference of two
    others, mixed with the point that it may replace.  Of two points the one that breaks the limits less is better, then
    the one with the lower goal: Deb (2000), doi:10.1016/S0045-7825(99)00389-8.  The last generations go along the
    front.  SciPy's has the same idea; here the way taken depends on numpy's random numbers alone, so that another SciPy
    repeats it.

    scored: points (n, d) → their scores.  first: points (n, d) to begin with, besides those that fill the cube.
    evaluations: see ``effort``.
    """
    rng = np.random.default_rng([seed, 2])
    size, for_goal, for_front = plan_generations(d, evaluations)
    n = max(size - len(first), 0)  # fill up with a Latin hypercube: each axis is cut into n parts with a point in each
    parts = np.stack([rng.permutation(n) for _ in range(d)], axis=1)
    points = np.concatenate([first, (parts + rng.random(parts.shape)) / max(n, 1)])[:size]
    scores = score(points)
    all_points, all_scores = points, scores

    def try_trials(trials: Array) -> Scores:
        nonlocal all_points, all_scores
        trial_scores = score(trials)
        all_points = np.concatenate([all_points, trials])
        all_scores = Scores(*map(np.concatenate, zip(all_scores, trial_scores, strict=True)))
        return trial_scores

    for _ in range(for_goal - 1):
        trials = _draw_trials(rng, points, best_point(scores))
        trial_scores = try_trials(trials)
        is_less_broken, is_as_broken = (
            trial_scores.violation < scores.violation,
            trial_scores.violation == scores.violation,
        )
        is_better = is_less_broken | (is_as_broken & (trial_scores.goal <= scores.goal))
        points = np.where(is_better[:, None], trials, points)
        scores = Scores(*(np.where(is_better, new, old) for new, old in zip(trial_scores, scores, strict=True)))
    for _ in range(for_front):
        front = pareto_front(all_scores)
        try_trials(
            _draw_trials_along_front(rng, all_points[front], all_scores.error[front], all_scores.travel[front], size)
        )


def best_point(scores: Scores) -> int:
    """The place of the best point."""
    return int(np.lexsort((scores.travel, scores.goal, scores.violation))[0])


def pareto_front(scores: Scores) -> Index:
    """Points that no other beats in travel and error, by travel; of the limits that of the travel does not count."""
    allowed = np.flatnonzero(scores.other_violation == scores.other_violation.min())
    order = allowed[np.lexsort((scores.error[allowed], scores.travel[allowed]))]
    lowest = np.minimum.accumulate(np.concatenate([[np.inf], scores.error[order][:-1]]))
    return np.asarray(order[(scores.error[order] < lowest) & np.isfinite(scores.travel[order])])


def _draw_trials(rng: np.random.Generator, points: Array, best_index: int) -> Array:
    """A trial for each point; one that leaves the cube comes back to its border."""
    n, d = points.shape
    pairs = np.argsort(rng.random((n, n)), axis=1)[:, :2]
    scale = rng.uniform(*_DIFFERENCE_SCALE, (n, 1))
    trial_points = points[best_index] + scale * (points[pairs[:, 0]] - points[pairs[:, 1]])
    is_mixed = rng.random((n, d)) < _CROSSOVER_SHARE
    is_mixed[np.arange(n), rng.integers(0, d, n)] = True
    return np.asarray(np.clip(np.where(is_mixed, trial_points, points), 0.0, 1.0))


def _draw_trials_along_front(rng: np.random.Generator, front: Array, error: Array, travel: Array, n: int) -> Array:
    """Points between neighbours on the front, most where these lie far apart, a little beyond them and some way off."""
    segment, step = np.zeros(n, dtype=int), np.zeros((n, front.shape[1]))
    if len(front) > 1:
        gaps = sum(np.abs(np.diff(values)) / max(float(np.ptp(values)), _LEAST_RANGE) for values in (error, travel))
        segment = np.minimum(np.searchsorted(np.cumsum(gaps) / np.sum(gaps), rng.random(n)), len(front) - 2)
        step = front[segment + 1] - front[segment]
    position = rng.uniform(-_FRONT_OVERSHOOT, 1.0 + _FRONT_OVERSHOOT, (n, 1))
    trial_points = front[segment] + position * step + _FRONT_SPREAD * rng.standard_normal((n, front.shape[1]))
    return np.asarray(np.clip(trial_points, 0.0, 1.0))
