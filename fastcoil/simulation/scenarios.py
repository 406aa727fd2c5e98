"""The scenarios of a study in one flat order: every loop × day × replicate, each made only when needed."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr

from fastcoil.boundary import Boundary
from fastcoil.errors import InputError
from fastcoil.estimators.shipped import ESTIMATORS
from fastcoil.parameter_table import ESTIMATOR_GROUPS, PARAMETERS, STAND_INS, Scalar
from fastcoil.simulation.control_problems import control_problems
from fastcoil.simulation.loop import Loop, forgetting

_CAPS = {"learner": "learning_cap", "gradient": "gradient_cap"}
"""The parameter that limits the estimate of an estimator."""


class Layout:
    """Dimensions of a study and the parameters of its scenarios by flat index (C order; the last dim is fastest).

    ``day`` comes first if the boundary has that dimension, so that neighbours share a day, then the loop's own
    dimensions, then ``replicate`` if there are several.
    """

    def __init__(self, loop: Loop, boundary: Boundary, replicates: int = 1) -> None:
        self.loop = _with_used_rules(loop)
        self.boundary = boundary
        self.sizes = ({"day": boundary.n_days} if boundary.has_day_dim else {}) | self.loop.sizes
        if replicates > 1:
            self.sizes["replicate"] = replicates
        self.size = math.prod(self.sizes.values())
        self._labels = self.loop.coordinates()

    def columns(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Every parameter of the scenarios ``index``, see ``columns_of``."""
        return columns_of(self.loop, self.sizes, index)

    def describe(self, flat: int) -> str:
        """One scenario in words: its labels in the sweep; empty if there is only one scenario."""
        labels, swept = self.coordinates(), self.loop.swept
        place = np.unravel_index(flat, tuple(self.sizes.values())) if self.sizes else ()
        at = {d: labels[d].values[i] for d, i in zip(self.sizes, place, strict=True)}
        named = [f"{d}={v}" if isinstance(v, str) else f"{d}={v:g}" for d, v in at.items() if d in swept or d in labels]
        return ", ".join(named)

    def coordinates(self) -> dict[str, xr.DataArray]:
        """Labels of every dimension and the swept parameters along them."""
        coordinates = dict(self._labels)
        if "day" in self.sizes:
            coordinates["day"] = xr.DataArray(self.boundary.day, dims="day")
        if "replicate" in self.sizes:
            coordinates["replicate"] = xr.DataArray(np.arange(self.sizes["replicate"]), dims="replicate")
        return coordinates

    def check_together(self) -> None:
        """Refuse values that only clash together: an estimate of 1 or more, an estimator that starts above its cap."""
        value: Mapping[str, Scalar | xr.DataArray | None] = {n: self.loop[n] for n in PARAMETERS}
        problems = []
        estimate = value["backlash_estimate"]
        if value["estimate_ratio"] is not None:
            estimate = value["estimate_ratio"] * value["backlash"]  # type: ignore[operator]
        largest = float(np.max(estimate))  # type: ignore[arg-type]
        if largest >= 1.0:
            problems.append(
                f"estimate_ratio × backlash reaches {largest:g}: an estimate must stay below 1, "
                "lower estimate_ratio or backlash"
            )
        step = xr.DataArray(value["learning_step"])
        learns = _has(value, "learner")
        for name, cap in _CAPS.items():
            if bool((_has(value, name) & (xr.DataArray(estimate) > xr.DataArray(value[cap]))).any()):
                problems.append(
                    f"backlash_estimate up to {largest:g} with the estimator {name}: it cannot start above {cap}, "
                    "lower the estimate or raise the cap"
                )
        if bool((learns & (step == 0.0)).any()):
            problems.append(
                "estimator = 'learner' with learning_step = 0: give the step by which it changes its estimate"
            )
        excess = float((xr.DataArray(value["slip_jump"]) - xr.DataArray(value["backlash"])).max())
        if excess > 0.0:
            problems.append(
                f"slip_jump is up to {excess:g} above the backlash: a stem jumps at most by the band in which it "
                "sticks, lower slip_jump or raise backlash"
            )
        problems += _unread_parameters(self.loop) + missing_parameters(self.loop)
        problems += control_problems(self.loop, self.boundary.series["T_set"])
        if problems:
            raise InputError(problems)


def _has(value: Mapping[str, Scalar | xr.DataArray | None], estimator: str) -> xr.DataArray:
    """Which scenarios have an estimator; without a word it is the learner where it has a step."""
    if value["estimator"] is None:
        return (xr.DataArray(value["learning_step"]) > 0.0) & (estimator == "learner")
    return xr.DataArray(value["estimator"]) == estimator


def words_used(loop: Loop, kind: str) -> set[str]:
    """The estimators, or the laws, that some scenario has."""
    value = loop[kind]
    if value is None:
        learns = bool(np.any(np.asarray(loop["learning_step"]) > 0.0))
        return {"learner"} if learns else {"none"}
    return set(np.unique(np.asarray(value)).tolist())


def missing_parameters(loop: Loop) -> list[str]:
    """Parameters that an estimator or a rule reads and that the loop does not give, a sentence each."""
    used = words_used(loop, "estimator")
    problems = [
        f"estimator = {estimator.name!r} without {name}: give the {PARAMETERS[name].text} "
        f"({PARAMETERS[name].unit}, {PARAMETERS[name].bounds})"
        for estimator in ESTIMATORS
        if estimator is not None and estimator.name in used
        for name in estimator.Parameters._fields
        if name not in STAND_INS and PARAMETERS[name].default is None and loop[name] is None
    ]
    return problems + [
        f"{rule.name} reads {name}, which the loop does not give: give {name}"
        for rule in loop.rules.values()
        for name in rule.reads
        if loop[name] is None
    ]


def _unread_parameters(loop: Loop) -> list[str]:
    """Parameters of estimators that no scenario has, a sentence each: most likely the estimator was forgotten."""
    used = {"learner"} if loop["estimator"] is None else words_used(loop, "estimator")
    problems = []
    for parameter in PARAMETERS.values():
        value = loop[parameter.name]
        changed = value is not None and bool(np.any(np.asarray(value) != parameter.default))
        if parameter.group in ESTIMATOR_GROUPS and changed and parameter.group not in used:
            problems.append(
                f"{parameter.name} belongs to the estimator {parameter.group}, which no scenario has: give "
                f"estimator = {parameter.group!r}, or leave {parameter.name} out"
            )
    rules = [rule for rule in loop.rules.values() if rule.name not in words_used(loop, rule.kind)]
    problems += [
        f"{rule.name}, which no scenario has, alone reads {' and '.join(rule.own)}: give {rule.kind} = {rule.name!r}, "
        "or leave them out"
        for rule in rules
    ]
    if bool(np.any(np.asarray(loop["estimate_share"]) != 1.0)) and used <= {"none"}:
        problems.append("estimate_share without an estimator: give estimator, or leave estimate_share out")
    return problems


def _with_used_rules(loop: Loop) -> Loop:
    """The loop without rules that no scenario has, unless their parameters were changed."""
    used = [rule for rule in loop.rules.values() if rule.name in words_used(loop, rule.kind)]
    read = {n for rule in used for n in rule.own}
    unused = [
        rule.name
        for rule in loop.rules.values()
        if rule not in used and all(n in read or loop[n] is p.default for n, p in rule.own.items())
    ]
    return forgetting(loop, unused) if unused else loop


def columns_of(loop: Loop, sizes: Mapping[str, int], index: np.ndarray) -> dict[str, np.ndarray]:
    """Every parameter of the scenarios ``index`` of a study with these sizes, (n,) each; NaN where one is not given.

    ``day`` is the position along that dimension, ``replicate`` the replicate's number.
    """
    place = dict(zip(sizes, np.unravel_index(index, tuple(sizes.values())), strict=True)) if sizes else {}
    columns: dict[str, np.ndarray] = {}
    for name in loop.parameters:
        value = loop[name]
        if isinstance(value, xr.DataArray):
            columns[name] = value.values[tuple(place[str(d)] for d in value.dims)]
        else:
            columns[name] = np.full(index.size, math.nan if value is None else value)
    if loop["estimator"] is None:
        columns["estimator"] = np.where(columns["learning_step"] > 0.0, "learner", "none")
    for dim in ("day", "replicate"):
        columns[dim] = place.get(dim, np.zeros(index.size, dtype=np.int64))
    return columns
