"""What is asked of a tuning, its valves and days, training and held out, and trying settings on them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import (
    argument_checks,
    collect_problems,
    is_number,
    raise_problems,
    require_integer,
    require_mapping,
    to_builtin,
)
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, WrongTypeMessage, short_repr
from fastcoil.design.describing_function import unpredictable_loops
from fastcoil.design.limit_cycle import predict_cycles
from fastcoil.design.linearise import first_order, simc
from fastcoil.design.measures import HUNTING_INDEX, TRAVEL, Limit, Measure, parse_goal, parse_limits, reported_measures
from fastcoil.design.operating_points import OperatingPoints
from fastcoil.design.plants import Columns, Plants
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
_LEAST_LOG_RATIO = 5.0  # an axis whose ends are positive and this many times apart is searched in logarithms
_SIGNIFICANT_DIGITS = 4  # significant digits of a value that is tried: the one that is quoted was tried itself
_END_SHARE = 0.01  # share of an axis that counts as its end


class Axis(NamedTuple):
    """A parameter and its bounds."""

    parameter: Parameter
    low: float
    high: float

    @property
    def name(self) -> str:
        return self.parameter.name

    @property
    def is_log(self) -> bool:
        return self.low > 0.0 and self.high >= _LEAST_LOG_RATIO * self.low

    def values(self, shares: Array) -> Array:
        """Values at (n,) shares of the axis, rounded to what is quoted."""
        if self.is_log:
            exact = self.low * (self.high / self.low) ** shares
        else:
            exact = self.low + (self.high - self.low) * shares
        is_whole = self.parameter.whole
        rounded = (
            np.rint(exact) if is_whole else np.array([float(f"{value:.{_SIGNIFICANT_DIGITS}g}") for value in exact])
        )
        return np.asarray(np.clip(rounded, self.low, self.high))

    def share(self, value: float) -> float:
        """Where a value lies on the axis, from 0 to 1."""
        if self.is_log:
            share = np.log(max(value, self.low) / self.low) / np.log(self.high / self.low)
        else:
            share = (value - self.low) / (self.high - self.low)
        return float(np.clip(share, 0.0, 1.0))

    def end(self, value: float) -> str:
        """``lower`` or ``upper`` where a value lies at an end that the parameter itself would let it pass."""
        share = self.share(value)
        if share < _END_SHARE and self.low > self.parameter.lower:
            return "lower"
        return "upper" if share > 1.0 - _END_SHARE and self.high < self.parameter.upper else ""


def parse_axes(search: object, loop: Loop) -> tuple[Axis, ...]:
    """The axes of a search from ``{name: (low, high)}``."""
    cure = 'give bounds by parameter, such as {"kp": (0.005, 0.1), "ti": (5, 600)}'
    bounds_by_name: Mapping[str, object] = require_mapping("search", search, cure)
    if not bounds_by_name:
        raise InputError(f"search is empty: {cure}")
    axes, problems = [], list[str]()
    for name, bounds in bounds_by_name.items():
        with collect_problems(problems, "search: "):
            axes.append(_parse_axis(name, bounds, loop))
    if {"backlash_estimate", "estimate_ratio"} <= bounds_by_name.keys():
        problems.append("search: estimate_ratio stands in for backlash_estimate: search one or the other")
    valve_dims = {dim for name, value in loop.swept.items() if name not in bounds_by_name for dim in value.dims}
    problems += [
        f"search: {name} is swept along {dim!r}, where nothing else varies: sweep it along the dim of the valves"
        for name in bounds_by_name.keys() & loop.swept.keys()
        for dim in loop.swept[name].dims
        if dim not in valve_dims
    ]
    raise_problems(problems)
    return tuple(axes)


def _parse_axis(name: str, bounds: object, loop: Loop) -> Axis:
    parameter = loop.parameters[require_parameter_name(name, loop.parameters)]
    if parameter.is_word:
        raise InputError(f"{name} is a word: tune the loop with each of {parameter.bounds} and compare")
    is_of_controller = parameter.group in _CONTROLLER_GROUPS and name != "plant_gain"
    if not is_of_controller and not any(name in rule.own for rule in loop.rules.values()):
        raise InputError(f"{name} is not the controller's to choose: draw it in the population, as a dim of the loop")
    pair = to_builtin(bounds)
    if not isinstance(pair, (list, tuple)) or len(pair) != 2 or not all(map(is_number, pair)):
        raise InputError(WrongTypeMessage(f"{name} = {short_repr(bounds)}: give two numbers, (lowest, highest)"))
    low, high = (float(to_builtin(end)) for end in pair)
    raise_problems([problem for end in (low, high) if (problem := parameter.problem(end))])
    if not low < high:
        raise InputError(f"{name} = {short_repr(bounds)}: the lowest value must be below the highest")
    return Axis(parameter, low, high)


DEFAULT_OBJECTIVE, DEFAULT_QUANTILE, DEFAULT_EVALUATIONS = "rmse", 0.95, 240
MOST_EVALUATIONS = 100_000


class TuningRequest(NamedTuple):
    """A tuning that can be made: what is searched, for what, on whom, who is held out, and how it is tried."""

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
        """The measure of the motor's travel: that of its limit, if there is one."""
        return next(measure for measure in self.measures if measure.metric == TRAVEL)

    @property
    def error(self) -> Measure:
        """What stands against the travel on the front: the goal, or the error where the travel is the goal."""
        return next(measure for measure in self.measures if measure.metric != TRAVEL)


def plan_tuning(
    loop: Loop,
    boundary: Boundary,
    *,
    search: object,
    objective: object = DEFAULT_OBJECTIVE,
    quantile: object = DEFAULT_QUANTILE,
    limits: object = None,
    holdout: object = None,
    evaluations: object = DEFAULT_EVALUATIONS,
    warm_up: int = WARM_UP_S,
    seed: int = 0,
    replicates: int = 1,
) -> TuningRequest:
    """Check the arguments of ``tune`` and divide valves and days."""
    run_options: dict[str, Any] = {"warm_up": warm_up, "seed": seed, "replicates": replicates}
    plan = plan_simulation(loop, boundary, **run_options)
    with argument_checks() as check:
        axes = check(parse_axes, search, loop)
        goal = check(parse_goal, objective, quantile)
        parsed_limits = check(parse_limits, limits, quantile)
        n_evaluations = check(require_integer, "evaluations", evaluations, 1, MOST_EVALUATIONS)
        groups = check(split_population, loop, boundary, holdout, plan.seed)
    # all combinations of lowest and highest values: what cannot be together shows there
    corners = zip(*product(*((axis.low, axis.high) for axis in axes[:_MOST_CORNER_AXES])), strict=True)
    corner_values = {
        axis.name: (TUNING_DIM, list(corner_loop)) for axis, corner_loop in zip(axes, corners, strict=False)
    }
    other_values = {axis.name: axis.low for axis in axes[_MOST_CORNER_AXES:]}
    for group in groups:
        plan_simulation(group.loop, group.boundary, **run_options)
        extremes = group.boundary.extremes
        corner_loop = group.loop.assign(**corner_values, **other_values)
        check_clashes(corner_loop, np.array(extremes["T_set"]), extremes["backlash_scale"][0])
        if any(limit.measure.metric == HUNTING_INDEX for limit in parsed_limits):
            reasons_by_loop = unpredictable_loops(
                parameter_columns(corner_loop, corner_loop.sizes, np.arange(math.prod(corner_loop.sizes.values())))
            )
            reasons = [reason for reason, where in reasons_by_loop.items() if np.any(where)]
            raise_problems(
                [f"limits: {HUNTING_INDEX}: theory has none for some of these loops: {reason}" for reason in reasons]
            )
    measures = tuple(reported_measures(goal, parsed_limits))
    return TuningRequest(
        axes, goal, tuple(parsed_limits), measures, *groups, n_evaluations, plan.warm_up, plan.seed, replicates
    )


_MOST_CORNER_AXES = 6  # axes of which all combinations of ends are looked at
HELD_OUT_ONE_IN = 3  # one valve of so many is held out, and one day
VALVE_DIM, TUNING_DIM = "sample", "tuning"
"""Dim of the population once its own dims are flattened; dim of the tunings that it is tried with."""


class Group(NamedTuple):
    """Valves on days; ``members`` are the valves' flat positions in the loop's own dims."""

    loop: Loop
    boundary: Boundary
    members: tuple[int, ...]

    @property
    def words(self) -> str:
        valves, days = len(self.members), self.boundary.n_days
        return f"{valves:,} valve{'s' * (valves > 1)} × {days:,} day{'s' * (days > 1)}"


def draw_held_out(backlash: Array, seed: int) -> Index:
    """One of every three valves, drawn in the order of backlash, (n,), so that both groups are alike; sorted."""
    order = np.argsort(backlash, kind="stable")
    triples = order[: order.size // HELD_OUT_ONE_IN * HELD_OUT_ONE_IN].reshape(-1, HELD_OUT_ONE_IN)
    picks = np.random.default_rng([seed, 1]).integers(0, HELD_OUT_ONE_IN, triples.shape[0])
    return np.sort(triples[np.arange(triples.shape[0]), picks])


def select_valves(loop: Loop, members: Index) -> Loop:
    """These members of the population, along one dim."""
    if not loop.sizes:
        return loop
    columns = parameter_columns(loop, loop.sizes, members)
    return loop.assign(**{name: (VALVE_DIM, columns[name]) for name in loop.swept})


def split_days(boundary: Boundary, holdout: object) -> tuple[Boundary, Boundary]:
    """The days to tune on, and those held out: another boundary, labels of days, or by default the last third."""
    n = boundary.n_days
    if isinstance(holdout, Boundary):
        if holdout.n_steps != boundary.n_steps:
            raise InputError(f"holdout lasts {holdout.hours:g} h, boundary {boundary.hours:g} h: give days as long")
        searched_days = {day_digest(0, boundary.of_day(k)): boundary.day[k] for k in range(n)}
        of_holdout = {day_digest(0, holdout.of_day(k)): holdout.day[k] for k in range(holdout.n_days)}
        shared = [f"day {name} is day {searched_days[day]}" for day, name in of_holdout.items() if day in searched_days]
        raise_problems([f"holdout: its {days} of the boundary: give days that it does not have" for days in shared])
        return boundary, holdout.isel(day=np.arange(holdout.n_days))
    day_labels = boundary.day.tolist()
    labels: Any = day_labels[n - max(1, n // HELD_OUT_ONE_IN) :] if holdout is None else np.asarray(holdout).tolist()
    if not isinstance(labels, list) or not labels or not all(label in day_labels for label in labels):
        raise InputError(
            f"holdout = {short_repr(holdout)}: give a Boundary of other days, or some of {short_repr(day_labels)}"
        )
    held_out = np.array(sorted({day_labels.index(label) for label in labels}))
    if held_out.size == n:
        raise InputError(f"boundary has {n} days, all held out: give several, or others with holdout=…")
    kept = np.setdiff1d(np.arange(n), held_out)
    return boundary.isel(day=kept), boundary.isel(day=held_out)


def split_population(loop: Loop, boundary: Boundary, holdout: object, seed: int) -> tuple[Group, Group]:
    """The valves and days to tune on, and others to try the tuning on; with fewer than three valves the same ones."""
    all_valves = np.arange(math.prod(loop.sizes.values()))
    training_days, holdout_days = split_days(boundary, holdout)
    held_out = draw_held_out(parameter_columns(loop, loop.sizes, all_valves)["backlash"], seed)
    kept, held_out = (np.setdiff1d(all_valves, held_out), held_out) if held_out.size else (all_valves, all_valves)
    return (
        Group(select_valves(loop, kept), training_days, tuple(kept.tolist())),
        Group(select_valves(loop, held_out), holdout_days, tuple(held_out.tolist())),
    )


def population_margins(loop: Loop, boundary: Boundary, warm_up: int) -> xr.DataArray:
    """Hunting index of every loop on every day, at the mean conditions of the seconds that count."""
    points = OperatingPoints(loop, boundary, warm_up=warm_up)
    variables = points.evaluate(
        lambda columns, _, plants: [(HUNTING_INDEX, predict_cycles(columns, plants).hunting_index)]
    )
    return points.dataset({HUNTING_INDEX: (variables[HUNTING_INDEX], {})})[HUNTING_INDEX]


Changes = Mapping[str, tuple[str, Array]]  # dim and values of parameters that change


def simc_gains_of_valves(group: Group, names: Sequence[str], warm_up: int) -> Changes:
    """kp and ti after SIMC of each valve, the median of its days; of all valves where it has none; or nothing."""
    if not {"kp", "ti"} <= set(names):
        return {}
    points = OperatingPoints(group.loop, group.boundary, warm_up=warm_up)

    def gains(columns: Columns, _: Mapping[str, Array], plants: Plants) -> list[tuple[str, Array]]:
        tuned_gains = simc(columns, plants, first_order(columns, plants))
        return [(name, np.where(plants.reachable, values, np.nan)) for name, values in tuned_gains._asdict().items()]

    gains_by_name = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of valves without a day: reported above
        for name, values in points.evaluate(gains).items():
            valve_medians = np.nanmedian(values.reshape(-1, group.boundary.n_days), axis=1)
            gains_by_name[name] = np.where(np.isfinite(valve_medians), valve_medians, np.nanmedian(valve_medians))
    usable = all(np.isfinite(values).all() and (values > 0.0).all() for values in gains_by_name.values())
    return {name: (VALVE_DIM, values) for name, values in gains_by_name.items()} if usable else {}


def simulate_group(request: TuningRequest, group: Group, changes: Changes) -> dict[str, Array]:
    """Metrics of a group with changes of its loop: metric → (tuning, day, valve, replicate)."""
    loop = group.loop.assign(**changes)
    ds = simulate(
        loop, group.boundary, warm_up=request.warm_up, seed=request.seed, replicates=request.replicates, n_jobs=request.n_jobs,
        progress=False,
    )  # fmt: skip
    order, cases = (TUNING_DIM, "day", VALVE_DIM, "replicate"), {}
    for metric in dict.fromkeys(measure.metric for measure in request.measures):
        values = population_margins(loop, group.boundary, request.warm_up) if metric == HUNTING_INDEX else ds[metric]
        missing = [dim for dim in order if dim not in values.dims]
        ordered = values.reset_coords(drop=True).expand_dims(missing).transpose(*order)
        cases[metric] = np.asarray(ordered.values, dtype=float)
    return cases
