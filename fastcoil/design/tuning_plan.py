"""What is asked of a tuning, its valves and days, training and held out, and trying settings on them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, collecting, is_number, mapping_of, plain, refuse, whole_of
from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.design.describing_function import unknown
from fastcoil.design.limit_cycle import cycles_of
from fastcoil.design.linearise import first_order, simc
from fastcoil.design.measures import MARGIN, TRAVEL, Limit, Measure, goal_of, limits_of, reported
from fastcoil.design.operating_points import OperatingPoints
from fastcoil.design.plants import Columns, Plants
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.samples import day_digest
from fastcoil.loops.clashes import check_clashes
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import plan_simulation
from fastcoil.loops.scenarios import columns_of
from fastcoil.loops.simulate import simulate
from fastcoil.model.metric_table import WARM_UP
from fastcoil.model.parameter_table import Parameter, check_name

_GROUPS = ("controller", "inverse", "estimator", "learner", "hagglund", "gradient", "identify")
"""Groups of parameters that a controller has; the others belong to the plant, and so does ``plant_gain``."""
_WIDE = 5.0  # an axis whose ends are positive and this many times apart is searched in logarithms
_DIGITS = 4  # significant digits of a value that is tried: the one that is quoted was tried itself
_NEAR = 0.01  # share of an axis that counts as its end


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
        return self.low > 0.0 and self.high >= _WIDE * self.low

    def values(self, shares: Array) -> Array:
        """Values at (n,) shares of the axis, rounded to what is quoted."""
        if self.is_log:
            found = self.low * (self.high / self.low) ** shares
        else:
            found = self.low + (self.high - self.low) * shares
        whole = self.parameter.whole
        rounded = np.rint(found) if whole else np.array([float(f"{value:.{_DIGITS}g}") for value in found])
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


def axes_of(search: object, loop: Loop) -> tuple[Axis, ...]:
    """The axes of a search from ``{name: (low, high)}``."""
    cure = 'give bounds by parameter, such as {"kp": (0.005, 0.1), "ti": (5, 600)}'
    given: Mapping[str, object] = mapping_of("search", search, cure)
    if not given:
        raise InputError(f"search is empty: {cure}")
    axes, problems = [], list[str]()
    for name, bounds in given.items():
        with collecting(problems, "search: "):
            axes.append(_axis(name, bounds, loop))
    if {"backlash_estimate", "estimate_ratio"} <= given.keys():
        problems.append("search: estimate_ratio stands in for backlash_estimate: search one or the other")
    kept = {dim for name, value in loop.swept.items() if name not in given for dim in value.dims}
    problems += [
        f"search: {name} is swept along {dim!r}, where nothing else varies: sweep it along the dim of the valves"
        for name in given.keys() & loop.swept.keys()
        for dim in loop.swept[name].dims
        if dim not in kept
    ]
    refuse(problems)
    return tuple(axes)


def _axis(name: str, bounds: object, loop: Loop) -> Axis:
    parameter = loop.parameters[check_name(name, loop.parameters)]
    if parameter.is_word:
        raise InputError(f"{name} is a word: tune the loop with each of {parameter.bounds} and compare")
    of_controller = parameter.group in _GROUPS and name != "plant_gain"
    if not of_controller and not any(name in rule.own for rule in loop.rules.values()):
        raise InputError(f"{name} is not the controller's to choose: draw it in the population, as a dim of the loop")
    pair = plain(bounds)
    if not isinstance(pair, (list, tuple)) or len(pair) != 2 or not all(map(is_number, pair)):
        raise InputError(WrongType(f"{name} = {shown(bounds)}: give two numbers, (lowest, highest)"))
    low, high = (float(plain(end)) for end in pair)
    refuse([problem for end in (low, high) if (problem := parameter.problem(end))])
    if not low < high:
        raise InputError(f"{name} = {shown(bounds)}: the lowest value must be below the highest")
    return Axis(parameter, low, high)


OBJECTIVE, QUANTILE, EVALUATIONS = "rmse", 0.95, 240
MOST_EVALUATIONS = 100_000


class Asked(NamedTuple):
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
        return {name: (TUNING, column) for name, column in zip(self.names, values.T, strict=True)}

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
    how: dict[str, Any] = {"warm_up": warm_up, "seed": seed, "replicates": replicates}
    plan = plan_simulation(loop, boundary, **how)
    with checking() as check:
        axes = check(axes_of, search, loop)
        goal = check(goal_of, objective, quantile)
        limited = check(limits_of, limits, quantile)
        asked = check(whole_of, "evaluations", evaluations, 1, MOST_EVALUATIONS)
        groups = check(split, loop, boundary, holdout, plan.seed)
    # all combinations of lowest and highest values: what cannot be together shows there
    corners = zip(*product(*((axis.low, axis.high) for axis in axes[:_MOST_CORNERS])), strict=True)
    at = {axis.name: (TUNING, list(ends)) for axis, ends in zip(axes, corners, strict=False)}
    rest = {axis.name: axis.low for axis in axes[_MOST_CORNERS:]}
    for group in groups:
        plan_simulation(group.loop, group.boundary, **how)
        extremes = group.boundary.extremes
        ends = group.loop.assign(**at, **rest)
        check_clashes(ends, np.array(extremes["T_set"]), extremes["backlash_scale"][0])
        if any(limit.measure.metric == MARGIN for limit in limited):
            known = unknown(columns_of(ends, ends.sizes, np.arange(math.prod(ends.sizes.values()))))
            reasons = [reason for reason, where in known.items() if np.any(where)]
            refuse([f"limits: {MARGIN}: theory has none for some of these loops: {reason}" for reason in reasons])
    measures = tuple(reported(goal, limited))
    return Asked(axes, goal, tuple(limited), measures, *groups, asked, plan.warm_up, plan.seed, replicates)


_MOST_CORNERS = 6  # axes of which all combinations of ends are looked at
ONE_OF = 3  # one valve of so many is held out, and one day
VALVE, TUNING = "sample", "tuning"
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


def held_valves(backlash: Array, seed: int) -> Index:
    """One of every three valves, drawn in the order of backlash, (n,), so that both groups are alike; sorted."""
    order = np.argsort(backlash, kind="stable")
    threes = order[: order.size // ONE_OF * ONE_OF].reshape(-1, ONE_OF)
    drawn = np.random.default_rng([seed, 1]).integers(0, ONE_OF, threes.shape[0])
    return np.sort(threes[np.arange(threes.shape[0]), drawn])


def part_of(loop: Loop, members: Index) -> Loop:
    """These members of the population, along one dim."""
    if not loop.sizes:
        return loop
    columns = columns_of(loop, loop.sizes, members)
    return loop.assign(**{name: (VALVE, columns[name]) for name in loop.swept})


def split_days(boundary: Boundary, holdout: object) -> tuple[Boundary, Boundary]:
    """The days to tune on, and those held out: another boundary, labels of days, or by default the last third."""
    n = boundary.n_days
    if isinstance(holdout, Boundary):
        if holdout.n_steps != boundary.n_steps:
            raise InputError(f"holdout lasts {holdout.hours:g} h, boundary {boundary.hours:g} h: give days as long")
        searched = {day_digest(0, boundary.of_day(k)): boundary.day[k] for k in range(n)}
        of_holdout = {day_digest(0, holdout.of_day(k)): holdout.day[k] for k in range(holdout.n_days)}
        shared = [f"day {name} is day {searched[day]}" for day, name in of_holdout.items() if day in searched]
        refuse([f"holdout: its {days} of the boundary: give days that it does not have" for days in shared])
        return boundary, holdout.isel(day=np.arange(holdout.n_days))
    known = boundary.day.tolist()
    labels: Any = known[n - max(1, n // ONE_OF) :] if holdout is None else np.asarray(holdout).tolist()
    if not isinstance(labels, list) or not labels or not all(label in known for label in labels):
        raise InputError(f"holdout = {shown(holdout)}: give a Boundary of other days, or some of {shown(known)}")
    held = np.array(sorted({known.index(label) for label in labels}))
    if held.size == n:
        raise InputError(f"boundary has {n} days, all held out: give several, or others with holdout=…")
    kept = np.setdiff1d(np.arange(n), held)
    return boundary.isel(day=kept), boundary.isel(day=held)


def split(loop: Loop, boundary: Boundary, holdout: object, seed: int) -> tuple[Group, Group]:
    """The valves and days to tune on, and others to try the tuning on; with fewer than three valves the same ones."""
    everyone = np.arange(math.prod(loop.sizes.values()))
    tuned_on, tried_on = split_days(boundary, holdout)
    held = held_valves(columns_of(loop, loop.sizes, everyone)["backlash"], seed)
    kept, held = (np.setdiff1d(everyone, held), held) if held.size else (everyone, everyone)
    return (
        Group(part_of(loop, kept), tuned_on, tuple(kept.tolist())),
        Group(part_of(loop, held), tried_on, tuple(held.tolist())),
    )


def margins(loop: Loop, boundary: Boundary, warm_up: int) -> xr.DataArray:
    """Margin of every loop on every day, at the mean conditions of the seconds that count."""
    points = OperatingPoints(loop, boundary, warm_up=warm_up)
    found = points.evaluated(lambda columns, _, plants: [(MARGIN, cycles_of(columns, plants).margin)])
    return points.dataset({MARGIN: (found[MARGIN], {})})[MARGIN]


Changes = Mapping[str, tuple[str, Array]]  # dim and values of parameters that change


def own_gains(group: Group, names: Sequence[str], warm_up: int) -> Changes:
    """kp and ti after SIMC of each valve, the median of its days; of all valves where it has none; or nothing."""
    if not {"kp", "ti"} <= set(names):
        return {}
    points = OperatingPoints(group.loop, group.boundary, warm_up=warm_up)

    def gains(columns: Columns, _: Mapping[str, Array], plants: Plants) -> list[tuple[str, Array]]:
        of = simc(columns, plants, first_order(columns, plants))
        return [(name, np.where(plants.reachable, values, np.nan)) for name, values in of._asdict().items()]

    found = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of valves without a day: reported above
        for name, values in points.evaluated(gains).items():
            of_valves = np.nanmedian(values.reshape(-1, group.boundary.n_days), axis=1)
            found[name] = np.where(np.isfinite(of_valves), of_valves, np.nanmedian(of_valves))
    usable = all(np.isfinite(values).all() and (values > 0.0).all() for values in found.values())
    return {name: (VALVE, values) for name, values in found.items()} if usable else {}


def tried(asked: Asked, group: Group, changes: Changes) -> dict[str, Array]:
    """Metrics of a group with changes of its loop: metric → (tuning, day, valve, replicate)."""
    loop = group.loop.assign(**changes)
    ds = simulate(
        loop, group.boundary, warm_up=asked.warm_up, seed=asked.seed, replicates=asked.replicates, n_jobs=asked.n_jobs,
        progress=False,
    )  # fmt: skip
    order, cases = (TUNING, "day", VALVE, "replicate"), {}
    for metric in dict.fromkeys(measure.metric for measure in asked.measures):
        values = margins(loop, group.boundary, asked.warm_up) if metric == MARGIN else ds[metric]
        missing = [dim for dim in order if dim not in values.dims]
        whole = values.reset_coords(drop=True).expand_dims(missing).transpose(*order)
        cases[metric] = np.asarray(whole.values, dtype=float)
    return cases
