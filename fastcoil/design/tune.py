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
from fastcoil.design.tuning_result import CHOSEN, NOW, SIMC, Tuning, collect_notes, contradiction_by_converged_march
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.loop import Loop, used_choices
from fastcoil.loops.simulate import number_of_threads
from fastcoil.model.metric_table import WARM_UP_S

from fastcoil.design.tuning_plan import (  # isort: skip
    DEFAULT_EVALUATIONS, DEFAULT_OBJECTIVE, DEFAULT_QUANTILE, Group, TuningRequest, plan_tuning, simc_changes,
    simulate_group,
)  # fmt: skip


def tune(
    loop: Loop, boundary: Boundary, *, search: Mapping[str, Any], objective: str = DEFAULT_OBJECTIVE,
    quantile: float | str = DEFAULT_QUANTILE, limits: Mapping[str, Any] | None = None, holdout: Any = None,
    evaluations: int = DEFAULT_EVALUATIONS, warm_up: int = WARM_UP_S, seed: int = 0, replicates: int = 1,
    n_jobs: int | None = None, progress: bool | None = None,
) -> Tuning:  # fmt: skip
    """Choose settings of a controller for all valves of ``loop`` on all days of ``boundary``, and try them on others.

    One of every three valves and the days of ``holdout`` are set aside.  The search never sees them; the results of the
    chosen settings there are what counts.

    Parameters
    ----------
    loop
        The population: every combination along its dims is a valve, such as 200 drawn ones along ``sample``.
    boundary
        The days; several, or others given with ``holdout``.
    search
        Bounds (lowest, highest) by parameter of the controller, the inverse or an estimator, in its unit.  Bounds that
        are positive and 5 times apart are searched in logarithms.
    objective, quantile
        Metric to minimise, in its unit, and its quantile over valves and days: 0.95 is the value that 95 % of them do
        not exceed; ``"mean"`` the mean.
    limits
        Upper limits by metric: a number holds for ``quantile``, a pair such as ``(0.05, "mean")`` for its own;
        ``"now"`` in place of a number is the value of the loop as given, on the valves and days of the search.
    holdout
        Days to try the choice on: a Boundary, or labels of some days of ``boundary``; its last third by default.
    evaluations
        Tunings that are tried, rounded to whole generations; the last quarter of them looks for the front of error
        against motor travel.
    warm_up, replicates, n_jobs, progress
        As in ``simulate``.
    seed
        Of the measurement noise, of the valves that are set aside, and of the search.

    Returns
    -------
    Tuning
        ``parameters``; ``held_out`` and ``trained``, compared with the loop as given; ``front``, ``plot()``.

    Raises
    ------
    InputError
        With one sentence for each mistake; where no tuning has a finite objective.

    Examples
    --------
    >>> valves = fc.Loop.preset("lbnl").assign(backlash=("sample", [0.0, 0.05, 0.1]))
    >>> days = fc.paper_day(hours=1, seed=[1, 2])
    >>> tuning = fc.tune(valves, days, search={"kp": (0.005, 0.1)}, evaluations=16, progress=False)
    >>> tuning.meets_limits, 0.005 <= tuning.parameters["kp"] <= 0.1
    (True, True)
    """
    with argument_checks() as check:
        n_threads = check(number_of_threads, n_jobs)
        progress = check.unless_none(require_flag, "progress", progress)
        request = check(
            plan_tuning, loop, boundary, search=search, objective=objective, quantile=quantile, limits=limits,
            holdout=holdout, evaluations=evaluations, warm_up=warm_up, seed=seed, replicates=replicates,
        )  # fmt: skip
    with display_for_call(progress) as display:
        return run_tuning(request._replace(n_jobs=n_threads), display)


def run_tuning(request: TuningRequest, display: ProgressDisplay) -> Tuning:
    """Search, choose, and try the choice on the hold-out."""
    training, holdout = request.training, request.holdout
    size, *generations = plan_generations(len(request.axes), request.evaluations)
    n_cases = len(training.members) * training.boundary.n_days * request.replicates
    advance = display.start(size * sum(generations) * n_cases)
    request = request._replace(limits=resolve_limits(request.limits, measure_group(request, training, {})))
    batches: list[tuple[Array, dict[str, Array]]] = []

    def score(points: Array) -> Scores:
        values = request.values(points)
        batches.append((values, measure_group(request, training, request.tunings(values))))
        advance(len(values) * n_cases)
        return score_measures(request, batches[-1][1])

    evolve(score, _starting_points(request), len(request.axes), request.evaluations, request.seed)
    values = np.concatenate([batch for batch, _ in batches])
    first = np.sort(np.unique(values, axis=0, return_index=True)[1])  # of equal tunings
    values = values[first]
    measured = {m.name: np.concatenate([batch[m.name] for _, batch in batches])[first] for m in request.measures}
    scores = score_measures(request, measured)
    best = best_point(scores)
    if not np.isfinite(scores.goal[best]):
        reason = "with every tuning it is missing on more valves and days than the quantile leaves out"
        sentence = f"objective = {request.goal.metric!r}: {reason}; search other bounds, or another objective"
        raise InputError(sentence, "objective", "data")
    front = pareto_front(scores)
    if front.size > 20:  # some points evenly along it, both ends among them
        front = front[np.unique(np.linspace(0, front.size - 1, 20).round().astype(int))]
    chosen = zip(request.axes, values[best].tolist(), strict=True)
    parameters = {axis.name: int(value) if axis.parameter.whole else value for axis, value in chosen}
    meets_limits = float(scores.violation[best]) == 0.0
    trained, held_out = (_compare_with_now(request, group, values[best]) for group in (training, holdout))
    contradiction = ""
    if "lagged" in used_choices(holdout.loop, "air_march"):
        group = holdout._replace(loop=holdout.loop.assign(converged=True))
        converged = _compare_with_now(request, group, values[best])
        contradiction = contradiction_by_converged_march(request.limits, held_out, converged)
    on_front = _tunings_dataset("point", request, values[front], {n: column[front] for n, column in measured.items()})
    on_holdout = measure_group(request, holdout, request.tunings(values[front]))
    for measure in request.measures:
        attrs = measure.attrs | {"long_name": f"{measure.words}, held out"}
        on_front[f"held_out_{measure.name}"] = ("point", on_holdout[measure.name], attrs)
    return Tuning(
        parameters=parameters, meets_limits=meets_limits, held_out=held_out, trained=trained, front=on_front,
        evaluations=_tunings_dataset("evaluation", request, values, measured), objective=request.goal,
        limits=request.limits, notes=collect_notes(request, parameters, meets_limits, held_out),
        axes=(request.error, request.travel), contradiction=contradiction,
    )  # fmt: skip


def measure_group(request: TuningRequest, group: Group, changes: Mapping[str, Any]) -> dict[str, Array]:
    """Simulate a group with changes of its loop, and return its measures (n,)."""
    cases = simulate_group(request, group, changes)
    return {m.name: m.evaluate(cases[m.metric].reshape(len(cases[m.metric]), -1)) for m in request.measures}


def score_measures(request: TuningRequest, measured: Mapping[str, Array]) -> Scores:
    """Convert measures (n,) to the scores that the search compares."""
    others = [limit for limit in request.limits if limit.measure != request.travel]
    compared = (measured[measure.name] for measure in (request.goal, request.error, request.travel))
    return Scores(violation(request.limits, measured), violation(others, measured), *compared)


def _starting_points(request: TuningRequest) -> Array:
    """Settings of the loop and those after SIMC as points (n, d): medians where its valves differ."""
    current: dict[str, Any] = {name: request.training.loop[name] for name in request.names}
    if any(value is None for value in current.values()):
        return np.empty((0, len(current)))
    gains = {n: values for n, (_, values) in simc_changes(request.training, request.names, request.warm_up).items()}
    tunings = [current, current | gains] if gains else [current]
    medians = [[float(np.median(np.asarray(tuning[axis.name]))) for axis in request.axes] for tuning in tunings]
    return np.array([[axis.share(value) for axis, value in zip(request.axes, t, strict=True)] for t in medians])


def _compare_with_now(request: TuningRequest, group: Group, chosen: Array) -> xr.Dataset:
    """Measures of a group with its current, the chosen and SIMC's settings."""
    simc = simc_changes(group, request.names, request.warm_up)
    changes = {NOW: {}, CHOSEN: request.tunings(chosen[None])} | ({SIMC: simc} if simc else {})
    cases = [simulate_group(request, group, change, with_twins=True) for change in changes.values()]
    joined = {metric: np.concatenate([of_tuning[metric] for of_tuning in cases]) for metric in cases[0]}
    return with_intervals(joined, request.measures, list(changes), request.seed).assign_attrs(group=group.words)


def _tunings_dataset(dim: str, request: TuningRequest, values: Array, measured: Mapping[str, Array]) -> xr.Dataset:
    """Settings and measures of tunings along ``dim``."""
    variables: dict[str, Any] = {}
    for axis, column in zip(request.axes, values.T, strict=True):
        variables[axis.name] = (dim, column, {"long_name": axis.parameter.text, "units": axis.parameter.unit})
    for measure in request.measures:
        variables[measure.name] = (dim, measured[measure.name], measure.attrs)
    return xr.Dataset(variables)


class Scores(NamedTuple):
    """Scores of tunings, (n,): violation of the limits, and of all but the travel's; goal, error and travel."""

    violation: Array
    other_violation: Array
    goal: Array
    error: Array
    travel: Array


def plan_generations(d: int, evaluations: int) -> tuple[int, int, int]:
    """Points of a generation; numbers of generations for the goal, the first one included, and along the front."""
    size = max(8, 4 * d)
    generations = max(1, round(evaluations / size))
    return size, generations - generations // 4, generations // 4


def evolve(score: Callable[[Array], Scores], first: Array, d: int, evaluations: int, seed: int) -> None:
    """Search the unit cube by differential evolution, a generation at a time; ``score`` keeps the results.

    Storn and Price (1997), doi:10.1023/A:1008202821328, with the rules of Deb (2000),
    doi:10.1016/S0045-7825(99)00389-8, for limits.  The last generations go along the front.  SciPy implements the same
    idea; here the search depends on numpy's random numbers alone.

    score: points (n, d) → their scores.  first: points (n, d) to begin with.  evaluations: see ``plan_generations``.
    """
    rng = np.random.default_rng([seed, 2])
    size, for_goal, for_front = plan_generations(d, evaluations)
    n = max(size - len(first), 0)  # fill up with a Latin hypercube: each axis is cut into n parts with a point in each
    parts = np.stack([rng.permutation(n) for _ in range(d)], axis=1)
    points = np.concatenate([first, (parts + rng.random(parts.shape)) / max(n, 1)])[:size]
    scores = score(points)
    all_points, all_scores = points, scores

    def try_points(trials: Array) -> Scores:
        nonlocal all_points, all_scores
        new = score(trials)
        all_points = np.concatenate([all_points, trials])
        all_scores = Scores(*map(np.concatenate, zip(all_scores, new, strict=True)))
        return new

    for _ in range(for_goal - 1):
        trials = _draw_trials(rng, points, best_point(scores))
        new = try_points(trials)
        has_equal_violation = new.violation == scores.violation
        is_better = (new.violation < scores.violation) | (has_equal_violation & (new.goal <= scores.goal))
        points = np.where(is_better[:, None], trials, points)
        scores = Scores(*(np.where(is_better, after, before) for after, before in zip(new, scores, strict=True)))
    for _ in range(for_front):
        k = pareto_front(all_scores)
        try_points(_draw_trials_along_front(rng, all_points[k], all_scores.error[k], all_scores.travel[k], size))


def best_point(scores: Scores) -> int:
    """Index of the best point."""
    return int(np.lexsort((scores.travel, scores.goal, scores.violation))[0])


def pareto_front(scores: Scores) -> Index:
    """Indices of the points that no other beats in travel and error, by travel, whose own limit does not count."""
    allowed = np.flatnonzero(scores.other_violation == scores.other_violation.min())
    order = allowed[np.lexsort((scores.error[allowed], scores.travel[allowed]))]
    lowest = np.minimum.accumulate(np.concatenate([[np.inf], scores.error[order][:-1]]))
    return np.asarray(order[(scores.error[order] < lowest) & np.isfinite(scores.travel[order])])


def _draw_trials(rng: np.random.Generator, points: Array, best_index: int) -> Array:
    """Draw a trial for each point; one that leaves the cube comes back to its border."""
    n, d = points.shape
    pairs = np.argsort(rng.random((n, n)), axis=1)[:, :2]
    new = points[best_index] + rng.uniform(0.3, 0.8, (n, 1)) * (points[pairs[:, 0]] - points[pairs[:, 1]])
    is_new = rng.random((n, d)) < 0.8  # crossover
    is_new[np.arange(n), rng.integers(0, d, n)] = True
    return np.asarray(np.clip(np.where(is_new, new, points), 0.0, 1.0))


def _draw_trials_along_front(rng: np.random.Generator, front: Array, error: Array, travel: Array, n: int) -> Array:
    """Draw trials between neighbours on the front, most where these lie far apart, a little beyond and beside them."""
    segment, step = np.zeros(n, dtype=int), np.zeros((n, front.shape[1]))
    if len(front) > 1:
        gaps = sum(np.abs(np.diff(values)) / max(float(np.ptp(values)), 1e-300) for values in (error, travel))
        segment = np.minimum(np.searchsorted(np.cumsum(gaps) / np.sum(gaps), rng.random(n)), len(front) - 2)
        step = front[segment + 1] - front[segment]
    position = rng.uniform(-0.5, 1.5, (n, 1))  # on the segment, 0 to 1 between the neighbours
    new = front[segment] + position * step + 0.02 * rng.standard_normal((n, front.shape[1]))
    return np.asarray(np.clip(new, 0.0, 1.0))
