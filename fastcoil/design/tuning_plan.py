"""What is asked of a tuning, checked before anything runs."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from fastcoil.base.arguments import checking, instance_of, whole_of
from fastcoil.design.measures import MARGIN, TRAVEL, Limit, Measure, goal_of, limits_of, reported
from fastcoil.design.population import TUNING, Group, require_margins, split
from fastcoil.design.search import effort
from fastcoil.design.search_space import Space, space_of
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clashes import check_clashes
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import RUN_LIMITS, plan_simulation
from fastcoil.model.metric_table import WARM_UP

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
