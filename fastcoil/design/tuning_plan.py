"""What may be searched, between which bounds, and what is asked of a tuning, checked before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import NamedTuple

import numpy as np

from fastcoil.base.arguments import checking, instance_of, is_number, mapping_of, plain, whole_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.design.measures import MARGIN, TRAVEL, Limit, Measure, goal_of, limits_of, reported
from fastcoil.design.population import TUNING, Group, require_margins, split
from fastcoil.design.search import effort
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clashes import check_clashes
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import RUN_LIMITS, plan_simulation
from fastcoil.model.metric_table import WARM_UP
from fastcoil.model.parameter_table import Parameter, check_name

_GROUPS = ("controller", "inverse", "estimator", "learner", "hagglund", "gradient", "identify")
"""Groups of parameters that a controller has; the others belong to the plant."""
_OF_THE_PLANT = ("plant_gain",)
_WIDE = 5.0
"""An axis whose ends are positive and this many times apart is searched in logarithms."""
_DIGITS = 4
"""Significant digits of a value that is tried: the one that is quoted was tried itself."""
_NEAR = 0.01
"""Share of an axis that counts as its end."""


class Axis(NamedTuple):
    """A parameter and its bounds."""

    parameter: Parameter
    low: float
    high: float

    @property
    def is_log(self) -> bool:
        return self.low > 0.0 and self.high >= _WIDE * self.low

    def values(self, shares: Array) -> Array:
        """Values at (n,) shares of the axis, rounded to what is quoted."""
        if self.is_log:
            found = self.low * (self.high / self.low) ** shares
        else:
            found = self.low + (self.high - self.low) * shares
        if self.parameter.whole:
            return np.asarray(np.clip(np.rint(found), self.low, self.high))
        rounded = np.array([float(f"{value:.{_DIGITS}g}") for value in found])
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
        if share < _NEAR and self.low > self.parameter.lower:
            return "lower"
        return "upper" if share > 1.0 - _NEAR and self.high < self.parameter.upper else ""


class Space(NamedTuple):
    """The axes of a search."""

    axes: tuple[Axis, ...]

    @property
    def names(self) -> list[str]:
        return [axis.parameter.name for axis in self.axes]

    def values(self, points: Array) -> Array:
        """Values of the parameters at points (n, d) of the unit cube."""
        return np.stack([axis.values(points[:, k]) for k, axis in enumerate(self.axes)], axis=1)

    def point(self, values: Mapping[str, float]) -> Array:
        """The point (d,) of some values, moved to the nearest end where one lies outside."""
        return np.array([axis.share(values[axis.parameter.name]) for axis in self.axes])


def may_be_searched(parameter: Parameter) -> bool:
    """Whether it is a number that a controller has."""
    return parameter.group in _GROUPS and parameter.name not in _OF_THE_PLANT and not parameter.is_word


def space_of(search: object, loop: Loop) -> Space:
    """The axes from ``{name: (low, high)}``."""
    cure = 'give bounds by parameter, such as {"kp": (0.005, 0.1), "ti": (5, 600)}'
    given: Mapping[str, object] = mapping_of("search", search, cure)
    if not given:
        raise InputError(f"search is empty: {cure}")
    with checking() as check:
        axes = [check(_axis, name, bounds, loop) for name, bounds in given.items()]
    space = Space(tuple(axes))
    problems = []
    if {"backlash_estimate", "estimate_ratio"} <= set(space.names):
        problems.append("search: estimate_ratio stands in for backlash_estimate: search one or the other")
    kept = {str(dim) for name, value in loop.swept.items() if name not in space.names for dim in value.dims}
    problems += [
        f"search: {name} is swept along {dim!r}, where nothing else varies: leave it out of the loop's sweep, or put "
        "it along the dim of the valves"
        for name, value in loop.swept.items()
        if name in space.names
        for dim in value.dims
        if dim not in kept
    ]
    if problems:
        raise InputError(problems)
    return space


def _axis(name: str, bounds: object, loop: Loop) -> Axis:
    try:
        parameter = loop.parameters[check_name(name, loop.parameters)]
    except InputError as error:
        raise InputError([f"search: {problem}" for problem in error.problems]) from None
    own = {n for rule in loop.rules.values() for n in rule.own}
    if name not in own and (parameter.group not in _GROUPS or name in _OF_THE_PLANT):
        raise InputError(
            f"search: {name} is not the controller's to choose: draw it in the population, as a dim of the loop, and "
            "search kp, ti, buffer or another setting of the controller"
        )
    if parameter.is_word:
        raise InputError(f"search: {name} is a word: tune the loop with each of {parameter.bounds} and compare")
    pair = plain(bounds)
    if not isinstance(pair, (list, tuple)) or len(pair) != 2 or not all(map(is_number, pair)):
        raise InputError(WrongType(f"search: {name} = {shown(bounds)}: give two numbers, (lowest, highest)"))
    low, high = (float(plain(end)) for end in pair)
    wrong = [f"search: {problem}" for end in (low, high) if (problem := parameter.problem(end))]
    if wrong:
        raise InputError(wrong)
    if not low < high:
        raise InputError(f"search: {name} = {shown(bounds)}: the lowest value must be below the highest")
    return Axis(parameter, low, high)


OBJECTIVE, QUANTILE, EVALUATIONS = "rmse", 0.95, 240
MOST_EVALUATIONS = 100_000
_MOST_CORNERS = 6
"""Axes of which all combinations of ends are looked at."""


class Asked(NamedTuple):
    """A tuning that can be made: what is searched, for what, on whom, and who is held out."""

    space: Space
    goal: Measure
    limits: tuple[Limit, ...]
    measures: tuple[Measure, ...]
    training: Group
    holdout: Group
    evaluations: int
    warm_up: int
    seed: int
    replicates: int

    @property
    def planned(self) -> int:
        """How many tunings are tried: whole generations."""
        return effort(len(self.space.axes), self.evaluations).points

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
    objective: object = OBJECTIVE,
    quantile: object = QUANTILE,
    limits: object = None,
    holdout: object = None,
    evaluations: object = EVALUATIONS,
    warm_up: int = WARM_UP,
    seed: int = 0,
    replicates: int = 1,
) -> Asked:
    """Check the arguments of ``tune`` and divide valves and days."""
    with checking() as check:
        check(instance_of, "loop", loop, Loop, "give a Loop, such as Loop.preset('lbnl')")
        check(instance_of, "boundary", boundary, Boundary, "give a Boundary, such as paper_day(seed=[1, 2, 3])")
    with checking() as check:
        space = check(space_of, search, loop)
        goal = check(goal_of, objective, quantile)
        limited = check(limits_of, limits, quantile)
        asked = check(whole_of, "evaluations", evaluations, 1, MOST_EVALUATIONS)
        warm_up = check(whole_of, "warm_up", warm_up, *RUN_LIMITS["warm_up"])
        seed = check(whole_of, "seed", seed, *RUN_LIMITS["seed"])
        replicates = check(whole_of, "replicates", replicates, *RUN_LIMITS["replicates"])
        groups = check(split, loop, boundary, holdout, seed or 0)
    for group in groups:
        plan_simulation(group.loop, group.boundary, warm_up=warm_up, seed=seed, replicates=replicates)
        corners = _at_the_corners(group.loop, space)
        extremes = group.boundary.extremes
        check_clashes(corners, np.array(extremes["T_set"]), extremes["backlash_scale"][0])
        if any(limit.measure.metric == MARGIN for limit in limited):
            require_margins(corners)
    return Asked(
        space, goal, tuple(limited), tuple(reported(goal, limited)), *groups, asked, warm_up, seed, replicates
    )  # fmt: skip


def _at_the_corners(loop: Loop, space: Space) -> Loop:
    """The loop with all combinations of the lowest and highest values: what cannot be together shows there."""
    corners = list(product(*((axis.low, axis.high) for axis in space.axes[:_MOST_CORNERS])))
    at = {name: (TUNING, [corner[k] for corner in corners]) for k, name in enumerate(space.names[:_MOST_CORNERS])}
    rest = {axis.parameter.name: axis.low for axis in space.axes[_MOST_CORNERS:]}
    return loop.assign(**at, **rest)
