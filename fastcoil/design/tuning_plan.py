"""The request for a tuning, its valves and days, training and held out, and simulations of settings on them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base import arguments
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.base.text import format_count
from fastcoil.design.describing_function import unpredictable_loops
from fastcoil.design.limit_cycle import predict_cycles
from fastcoil.design.linearise import first_order, simc
from fastcoil.design.measures import HUNTING_INDEX, TRAVEL, Limit, Measure, parse_goal, parse_limits, reported_measures
from fastcoil.design.operating_points import OperatingPoints
from fastcoil.design.plants import Columns, Plants
from fastcoil.design.swing_verdict import judge_by_twins
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.samples import day_digest
from fastcoil.loops.clashes import check_clashes
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import plan_simulation
from fastcoil.loops.scenarios import parameter_columns
from fastcoil.loops.simulate import simulate
from fastcoil.model.metric_table import WARM_UP_S
from fastcoil.model.parameter_table import Parameter, require_parameter_name

_CONTROLLER_GROUPS = ("controller", "inverse", "estimator", "learner", "hagglund", "gradient", "identify")
"""Groups of parameters that a controller has; the others belong to the plant, and so does ``plant_gain``."""
DEFAULT_OBJECTIVE = "rmse"
DEFAULT_QUANTILE = 0.95
DEFAULT_EVALUATIONS = 240
MAX_EVALUATIONS = 100_000
HELD_OUT_ONE_IN = 3  # one valve of so many is held out, and one day
VALVE_DIM = "sample"  # of the population once its own dims are flattened
TUNING_DIM = "tuning"
Changes = Mapping[str, tuple[str, Array]]
"""Dim and values by parameter that changes."""


class Axis(NamedTuple):
    """A parameter and its bounds; searched in logarithms if these are positive and 5 times apart."""

    parameter: Parameter
    low: float
    high: float

    @property
    def name(self) -> str:
        return self.parameter.name

    @property
    def is_log(self) -> bool:
        return self.low > 0.0 and self.high >= 5.0 * self.low

    def values(self, shares: Array) -> Array:
        """Values at (n,) shares of the axis, rounded to the 4 digits that are quoted."""
        ratio, width = self.high / self.low if self.is_log else 1.0, self.high - self.low
        exact = self.low * ratio**shares if self.is_log else self.low + width * shares
        rounded = np.rint(exact) if self.parameter.whole else np.array([float(f"{value:.4g}") for value in exact])
        return np.asarray(np.clip(rounded, self.low, self.high))

    def share(self, value: float) -> float:
        """Position of a value on the axis, from 0 to 1."""
        if self.is_log:
            share = np.log(max(value, self.low) / self.low) / np.log(self.high / self.low)
        else:
            share = (value - self.low) / (self.high - self.low)
        return float(np.clip(share, 0.0, 1.0))

    def end(self, value: float) -> str:
        """``lower`` or ``upper`` if a value lies in the last 1 % at an end beyond which the parameter continues."""
        share = self.share(value)
        if share < 0.01 and self.low > self.parameter.lower:
            return "lower"
        return "upper" if share > 0.99 and self.high < self.parameter.upper else ""


def parse_axes(search: object, loop: Loop) -> tuple[Axis, ...]:
    """Convert ``{name: (low, high)}`` to the axes of a search."""
    cure = 'give bounds by parameter, such as {"kp": (0.005, 0.1), "ti": (5, 600)}'
    bounds_by_name: Mapping[str, object] = arguments.require_mapping("search", search, cure)
    if not bounds_by_name:
        raise InputError(f"search is empty: {cure}", "search", "missing")
    axes, problems = [], list[str]()
    for name, bounds in bounds_by_name.items():
        with arguments.collect_problems(problems, "search: "):
            axes.append(_parse_axis(name, bounds, loop))
    if {"backlash_estimate", "estimate_ratio"} <= bounds_by_name.keys():
        sentence = "search: estimate_ratio stands in for backlash_estimate: search one or the other"
        problems.append(Problem(sentence, "estimate_ratio", "conflict"))
    valve_dims = {dim for name, value in loop.swept.items() if name not in bounds_by_name for dim in value.dims}
    cure = "where nothing else varies: sweep it along the dim of the valves"
    problems += [
        Problem(f"search: {name} is swept along {dim!r}, {cure}", name, "conflict")
        for name in bounds_by_name
        for dim in getattr(loop.swept.get(name), "dims", ())
        if dim not in valve_dims
    ]
    arguments.raise_problems(problems)
    return tuple(axes)


def _parse_axis(name: str, bounds: object, loop: Loop) -> Axis:
    parameter = loop.parameters[require_parameter_name(name, loop.parameters)]
    if parameter.is_word:
        sentence = f"{name} is a word: tune the loop with each of {parameter.bounds} and compare"
        raise InputError(sentence, name, "unsupported")
    is_of_controller = parameter.group in _CONTROLLER_GROUPS and name != "plant_gain"
    if not is_of_controller and not any(name in rule.own for rule in loop.rules.values()):
        sentence = f"{name} is not the controller's to choose: draw it in the population, as a dim of the loop"
        raise InputError(sentence, name, "name")
    pair = arguments.to_builtin(bounds)
    if not isinstance(pair, (list, tuple)) or len(pair) != 2 or not all(map(arguments.is_number, pair)):
        raise InputError(f"{name} = {short_repr(bounds)}: give two numbers, (lowest, highest)", name, "type")
    low, high = (float(arguments.to_builtin(end)) for end in pair)
    arguments.raise_problems([problem for end in (low, high) if (problem := parameter.problem(end))])
    if not low < high:
        raise InputError(f"{name} = {short_repr(bounds)}: the lowest value must be below the highest", name, "value")
    return Axis(parameter, low, high)


class TuningRequest(NamedTuple):
    """A checked request for a tuning: axes, goal and limits, valves and days, and options of the simulations."""

    axes: tuple[Axis, ...]
    goal: Measure
    limits: tuple[Limit, ...]
    measures: tuple[Measure, ...]
    training: Group
    holdout: Group
    evaluations: int
    warm_up: int
    seed: int
    replicates: int
    n_jobs: int | None = None

    @property
    def names(self) -> list[str]:
        """The parameters that are searched."""
        return [axis.name for axis in self.axes]

    def values(self, points: Array) -> Array:
        """Values of the parameters at points (n, d) of the unit cube."""
        return np.stack([axis.values(points[:, k]) for k, axis in enumerate(self.axes)], axis=1)

    def tunings(self, values: Array) -> Changes:
        """Tunings (n, d) as changes of a loop."""
        return {name: (TUNING_DIM, column) for name, column in zip(self.names, values.T, strict=True)}

    @property
    def travel(self) -> Measure:
        """Measure of the motor's travel: that of its limit, if there is one."""
        return next(measure for measure in self.measures if measure.metric == TRAVEL)

    @property
    def error(self) -> Measure:
        """Measure against the travel on the front: the goal, or the error where the travel is the goal."""
        return next(measure for measure in self.measures if measure.metric != TRAVEL)


def plan_tuning(
    loop: Loop, boundary: Boundary, *, search: object, objective: object = DEFAULT_OBJECTIVE,
    quantile: object = DEFAULT_QUANTILE, limits: object = None, holdout: object = None,
    evaluations: object = DEFAULT_EVALUATIONS, warm_up: int = WARM_UP_S, seed: int = 0, replicates: int = 1,
) -> TuningRequest:  # fmt: skip
    """Check the arguments of ``tune`` and split valves and days."""
    options: dict[str, Any] = {"warm_up": warm_up, "seed": seed, "replicates": replicates}
    plan = plan_simulation(loop, boundary, **options)
    with arguments.argument_checks() as check:
        axes = check(parse_axes, search, loop)
        goal = check(parse_goal, objective, quantile)
        parsed_limits = check(parse_limits, limits, quantile)
        n_evaluations = check(arguments.require_integer, "evaluations", evaluations, 1, MAX_EVALUATIONS)
        groups = check(split_population, loop, boundary, holdout, plan.seed)
    # clashes between parameters show at all combinations of the bounds, of up to six axes
    corners = zip(*product(*((axis.low, axis.high) for axis in axes[:6])), strict=True)
    values: dict[str, Any] = {a.name: (TUNING_DIM, list(ends)) for a, ends in zip(axes, corners, strict=False)}
    values |= {axis.name: axis.low for axis in axes[6:]}
    for group in groups:
        plan_simulation(group.loop, group.boundary, **options)
        extremes, corner_loop = group.boundary.extremes, group.loop.assign(**values)
        check_clashes(corner_loop, np.array(extremes["T_set"]), extremes["backlash_scale"][0])
        if any(limit.measure.metric == HUNTING_INDEX for limit in parsed_limits):
            flat = np.arange(math.prod(corner_loop.sizes.values()))
            why = unpredictable_loops(parameter_columns(corner_loop, corner_loop.sizes, flat))
            prefix = f"limits: {HUNTING_INDEX}: theory has none for some of these loops"
            sentences = [f"{prefix}: {reason}" for reason, where in why.items() if np.any(where)]
            arguments.raise_problems([Problem(sentence, HUNTING_INDEX, "unsupported") for sentence in sentences])
    measures = tuple(reported_measures(goal, parsed_limits))
    return TuningRequest(
        axes, goal, tuple(parsed_limits), measures, *groups, n_evaluations, plan.warm_up, plan.seed, replicates
    )


class Group(NamedTuple):
    """Valves on days; members: flat positions of the valves in the dims of the population."""

    loop: Loop
    boundary: Boundary
    members: tuple[int, ...]

    @property
    def words(self) -> str:
        return f"{format_count(len(self.members), 'valve')} × {format_count(self.boundary.n_days, 'day')}"


def draw_held_out(backlash: Array, seed: int) -> Index:
    """Draw one of every three valves in the order of backlash, (n,), so that both groups are alike; sorted."""
    order = np.argsort(backlash, kind="stable")
    triples = order[: order.size // HELD_OUT_ONE_IN * HELD_OUT_ONE_IN].reshape(-1, HELD_OUT_ONE_IN)
    picks = np.random.default_rng([seed, 1]).integers(0, HELD_OUT_ONE_IN, triples.shape[0])
    return np.sort(triples[np.arange(triples.shape[0]), picks])


def select_valves(loop: Loop, members: Index) -> Loop:
    """Return some valves of the population, along one dim."""
    if not loop.sizes:
        return loop
    columns = parameter_columns(loop, loop.sizes, members)
    return loop.assign(**{name: (VALVE_DIM, columns[name]) for name in loop.swept})


def split_days(boundary: Boundary, holdout: object) -> tuple[Boundary, Boundary]:
    """Split the days to tune on from those held out: another boundary, labels of days, by default the last third."""
    n = boundary.n_days
    if isinstance(holdout, Boundary):
        if holdout.n_steps != boundary.n_steps:
            sentence = f"holdout lasts {holdout.hours:g} h, boundary {boundary.hours:g} h: give days as long"
            raise InputError(sentence, "holdout", "shape")
        searched = {day_digest(0, boundary.of_day(k)): boundary.day[k] for k in range(n)}
        of_holdout = {day_digest(0, holdout.of_day(k)): holdout.day[k] for k in range(holdout.n_days)}
        shared = [f"day {name} is day {searched[day]}" for day, name in of_holdout.items() if day in searched]
        if shared:
            sentences = [f"holdout: its {days} of the boundary: give days that it does not have" for days in shared]
            raise InputError(sentences, "holdout", "duplicate")
        return boundary, holdout.isel(day=np.arange(holdout.n_days))
    days = boundary.day.tolist()
    labels: Any = days[n - max(1, n // HELD_OUT_ONE_IN) :] if holdout is None else np.asarray(holdout).tolist()
    if not isinstance(labels, list) or not labels or not all(label in days for label in labels):
        cure = f"give a Boundary of other days, or some of {short_repr(days)}"
        raise InputError(f"holdout = {short_repr(holdout)}: {cure}", "holdout", "name")
    held_out = np.array(sorted({days.index(label) for label in labels}))
    if held_out.size == n:
        sentence = f"boundary has {format_count(n, 'day')}, all held out: give several, or other days as holdout"
        raise InputError(f"{sentence}, in a study as a table like [boundary]", "holdout", "missing")
    return boundary.isel(day=np.setdiff1d(np.arange(n), held_out)), boundary.isel(day=held_out)


def split_population(loop: Loop, boundary: Boundary, holdout: object, seed: int) -> tuple[Group, Group]:
    """Split valves and days to tune on from others to try the tuning on; with fewer than three valves, days alone."""
    all_valves = np.arange(math.prod(loop.sizes.values()))
    training_days, holdout_days = split_days(boundary, holdout)
    held_out = draw_held_out(parameter_columns(loop, loop.sizes, all_valves)["backlash"], seed)
    kept, held_out = (np.setdiff1d(all_valves, held_out), held_out) if held_out.size else (all_valves, all_valves)
    training = Group(select_valves(loop, kept), training_days, tuple(kept.tolist()))
    return training, Group(select_valves(loop, held_out), holdout_days, tuple(held_out.tolist()))


def hunting_indices(loop: Loop, boundary: Boundary, warm_up: int) -> xr.DataArray:
    """Hunting index of every loop on every day, at the mean conditions of the seconds that count."""
    points, name = OperatingPoints(loop, boundary, warm_up=warm_up), HUNTING_INDEX
    values = points.evaluate(lambda columns, plants: [(name, predict_cycles(columns, plants).hunting_index)])
    return points.dataset({name: (values[name], {})})[name]


def simc_changes(group: Group, names: Sequence[str], warm_up: int) -> Changes:
    """Gains after SIMC of each valve, the median of its days, or of all valves; empty unless kp and ti are searched."""
    if not {"kp", "ti"} <= set(names):
        return {}
    points = OperatingPoints(group.loop, group.boundary, warm_up=warm_up)

    def gains(columns: Columns, plants: Plants) -> list[tuple[str, Array]]:
        after_simc = simc(columns, plants, first_order(columns, plants))._asdict()
        return [(name, np.where(plants.reachable, values, np.nan)) for name, values in after_simc.items()]

    changes = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of valves without a day: reported above
        for name, values in points.evaluate(gains).items():
            medians = np.nanmedian(values.reshape(-1, group.boundary.n_days), axis=1)
            changes[name] = (VALVE_DIM, np.where(np.isfinite(medians), medians, np.nanmedian(medians)))
    usable = all(np.isfinite(values).all() and (values > 0.0).all() for _, values in changes.values())
    return changes if usable else {}


def simulate_group(
    request: TuningRequest, group: Group, changes: Changes, *, with_twins: bool = False
) -> dict[str, Array]:
    """Simulate a group with changes of its loop, and twins if asked for: metric → (tuning, day, valve, replicate)."""
    loop = group.loop.assign(**changes)
    options: dict[str, Any] = {name: getattr(request, name) for name in ("warm_up", "seed", "replicates", "n_jobs")}
    ds = simulate(loop, group.boundary, progress=False, **options)
    ds = judge_by_twins(ds, loop, group.boundary, **options) if with_twins else ds
    order, cases = (TUNING_DIM, "day", VALVE_DIM, "replicate"), {}
    for metric in dict.fromkeys(measure.metric for measure in request.measures):
        values = hunting_indices(loop, group.boundary, request.warm_up) if metric == HUNTING_INDEX else ds[metric]
        missing = [dim for dim in order if dim not in values.dims]
        ordered = values.reset_coords(drop=True).expand_dims(missing).transpose(*order)
        cases[metric] = np.asarray(ordered.values, dtype=float)
    return cases
