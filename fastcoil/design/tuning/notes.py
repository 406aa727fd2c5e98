"""What to mind about a tuning: sentences that stand beside its numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import xarray as xr

from fastcoil.design.tuning.intervals import CHANGE
from fastcoil.design.tuning.measures import Measure
from fastcoil.design.tuning.plan import Asked
from fastcoil.design.tuning.split import ONE_OF, has_good_valve
from fastcoil.design.tuning.words import CHOSEN, NOW

_FEW_VALVES, _FEW_DAYS = 20, 3
_IN_THE_TAIL = 3
"""Valves held out that should lie above a quantile, or it is little more than the worst of them."""


def notes_on(
    asked: Asked, parameters: Mapping[str, float], meets_limits: bool, trained: xr.Dataset, held_out: xr.Dataset
) -> tuple[str, ...]:
    """Failures first, then what the search ran into, then what the population lacks."""
    found = [*_failures(asked, meets_limits, held_out), *_ends(asked, parameters), *_lacks(asked)]
    return tuple(found)


def _failures(asked: Asked, meets_limits: bool, held_out: xr.Dataset) -> Iterator[str]:
    if not meets_limits:
        yield "No tuning in these ranges keeps every limit: widen the ranges, raise a limit, or mend the valves."
    for limit in asked.limits:
        there = held_out[limit.measure.name].sel(edge="value")
        value, now = float(there.sel(tuning=CHOSEN)), float(there.sel(tuning=NOW))
        most = now if limit.as_now else limit.most
        if not value <= most:
            words = ", what it is there now" if limit.as_now else ""
            yield (
                f"The hold-out breaks a limit: {limit.measure.words}, is {limit.measure.shown(value)} there, above "
                f"{limit.measure.shown(most)}{words}."
            )
    low, high = (float(held_out[CHANGE].sel(tuning=CHOSEN, edge=edge)) for edge in ("low", "high"))
    if low > 0.0:
        yield "On the hold-out the objective is worse than now."
    elif high >= 0.0:
        yield "On the hold-out the objective does not differ from now beyond chance."


def _ends(asked: Asked, parameters: Mapping[str, float]) -> Iterator[str]:
    for axis in asked.space.axes:
        name = axis.parameter.name
        end = axis.end(parameters[name])
        if end:
            yield f"{name} = {parameters[name]:g} lies at the {end} end of its range: the best may lie beyond."


def _needed(measure: Measure) -> int:
    """Valves held out that a measure needs."""
    if measure.quantile is None or measure.quantile == 1.0:
        return _FEW_VALVES
    return max(_FEW_VALVES, math.ceil(_IN_THE_TAIL / (1.0 - measure.quantile) - 1e-9))


def _lacks(asked: Asked) -> Iterator[str]:
    training, tried = asked.training, asked.holdout
    valves, shared = len(set(training.members) | set(tried.members)), training.members == tried.members
    if not (has_good_valve(training.loop) or has_good_valve(tried.loop)):
        yield (
            "No valve of the population is without backlash: add some with backlash = 0, or what was chosen may make a "
            "good valve worse."
        )
    if shared:
        yield (
            f"The population has {valves} valve{'s' * (valves > 1)}, so none is held out, only days: nothing says how "
            "the tuning does on another valve."
        )
    elif len(tried.members) < (needed := max(map(_needed, asked.measures))):
        yield (
            f"{len(tried.members)} valves held out are few for these quantiles: draw {ONE_OF * needed} or more in all."
        )
    if tried.boundary.n_days < _FEW_DAYS:
        days = tried.boundary.n_days
        yield (
            f"The hold-out has {days} day{'s' * (days > 1)}, so that the intervals hold "
            + ("no" if days == 1 else "little of the")
            + " scatter between days: give more with holdout."
        )
