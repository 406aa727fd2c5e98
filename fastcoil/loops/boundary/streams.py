"""Streams of days: as a user's function makes them, and with some series replaced."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fastcoil.base.arguments import checking, whole_of
from fastcoil.base.errors import InputError, WrongType, collecting, shown
from fastcoil.loops.boundary.clock import Clock, clock_of
from fastcoil.loops.boundary.conditions import CONDITIONS, whole_seconds
from fastcoil.loops.boundary.day_makers import Labelled, Replaced
from fastcoil.loops.boundary.series import (
    BOUNDARY_SERIES,
    Given,
    Values,
    common_size,
    label_array,
    read,
    value_problems,
)
from fastcoil.loops.boundary.source import Stream

_LONGEST = round(3600 * (CONDITIONS["hours"].upper or 0.0))
"""Seconds of a day."""


def stream_of(
    make: Callable[[int], Mapping[str, Any]], day: Values, n_steps: Any, hours: Any, start: Any, time_zone: Any
) -> tuple[Stream, Clock]:
    """The days that ``make`` gives by their labels, arguments as of `Boundary.from_days`; the first is tried."""
    with checking() as check:
        if not callable(make):
            check.problems.append(
                WrongType(f"make = {shown(make)}: give a function that returns the series of the day of a label")
            )
        if (n_steps is None) == (hours is None):
            check.problems.append("n_steps and hours: give one of them, the length of each day")
        if n_steps is not None:
            n_steps = check(whole_of, "n_steps", n_steps, 1, _LONGEST)
        if hours is not None:
            n_steps = check(whole_seconds, hours)
        labels = label_array(day, check.problems)
        if not check.problems and labels is not None:
            clock = check(clock_of, start, time_zone, labels.size, n_steps)
    assert labels is not None  # a problem otherwise
    days = np.atleast_1d(labels).astype(np.int64)
    stream = Stream(Labelled(make, days), days, bool(labels.ndim), n_steps)
    stream.of_day(0)
    return stream, clock


def replaced(stream: Stream, clock: Clock, changes: Mapping[str, Any]) -> tuple[Stream, Clock]:
    """A stream with other series, labels or clock.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    problems: list[str] = []
    given: dict[str, Given] = {}
    for name, value in changes.items():
        if name in BOUNDARY_SERIES:
            with collecting(problems):
                given[name] = read(BOUNDARY_SERIES[name], value)
    for dim, word, size in (("elapsed_time", "samples", stream.n_steps), ("day", "days", stream.day.size)):
        found = common_size(dim, word, given, problems)
        if found not in (None, size):
            first = next(name for name, one in given.items() if dim in one.dims)
            problems.append(f"{first} has {found:,} {word} where the boundary has {size:,}: give as many")
    labels = label_array(changes["day"], problems) if changes.get("day") is not None else stream.day
    if labels is not None and np.size(labels) != stream.day.size:
        problems.append(f"day has {np.size(labels)} labels for {stream.day.size} days: give one label for each day")
    for name, one in given.items():
        problems += value_problems(BOUNDARY_SERIES[name], one, stream.day)
    with collecting(problems):
        clock = clock_of(
            changes.get("start", clock.start),
            changes.get("time_zone", clock.time_zone),
            stream.day.size,
            stream.n_steps,
        )
    if problems or labels is None:
        raise InputError(list(dict.fromkeys(problems)))
    rows = {name: None if changes[name] is None else one for name, one in given.items()}
    make = Replaced(stream.make, rows) if rows else stream.make
    day = np.atleast_1d(labels).astype(np.int64)
    return Stream(make, day, stream.has_day_dim or bool(np.ndim(labels)), stream.n_steps), clock
