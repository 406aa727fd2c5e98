"""Boundaries from others: days chosen, series replaced, days or hours put together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arguments import checking, is_number, plain, whole_of
from fastcoil.base.arrays import Array, Index, array_of
from fastcoil.base.errors import InputError, WrongType, collecting, shown
from fastcoil.base.machine import available_memory, gib
from fastcoil.loops.boundary.clock import Clock, clock_of
from fastcoil.loops.boundary.conditions import CONDITIONS, whole_seconds
from fastcoil.loops.boundary.series import (
    BOUNDARY_SERIES,
    Given,
    Values,
    common_size,
    label_array,
    read,
    value_problems,
)
from fastcoil.loops.boundary.source import (
    Days,
    EndToEnd,
    Held,
    Labelled,
    OneAfterAnother,
    Picked,
    Replaced,
    Source,
    Stream,
)


def positions(day: Any, n_days: int) -> Index | int:
    """Positions of days: of one, or of several by a slice, a list or flags.

    Raises
    ------
    InputError
        If there is no such day.
    """
    cure = f"give positions from 0 to {n_days - 1}, or a slice of them"
    if isinstance(day, slice):
        try:
            found = np.arange(n_days)[day]
        except (TypeError, ValueError):
            raise InputError(WrongType(f"day = {shown(day)}: {cure}")) from None
        return _some(found, day, cure)
    if is_number(day):
        k = float(plain(day))
        if not (-n_days <= k < n_days and k == int(k)):
            raise InputError(f"day = {shown(day)}: {cure}")
        return int(k) % n_days
    values = array_of("day", day, cure, "iub")
    if values.ndim != 1 or (values.dtype.kind == "b" and values.size != n_days):
        raise InputError(f"day = {shown(day)}: {cure}")
    if values.dtype.kind == "b":
        return _some(np.flatnonzero(values), day, cure)
    wrong = values[(values < -n_days) | (values >= n_days)]
    if wrong.size:
        raise InputError(f"day has {wrong[0]}: {cure}")
    return _some(values.astype(np.int64) % n_days, day, cure)


def positions_of(day: Any, labels: NDArray[np.int64]) -> Index | int:
    """Positions of days by their labels: of one, of several in a list, or of all from one to another in a slice.

    Raises
    ------
    InputError
        If there is no day of a label.
    """
    if isinstance(day, slice):
        if day.step is not None:
            raise InputError(f"day = {shown(day)}: leave out the step, or choose positions with isel")
        first = 0 if day.start is None else _place(day.start, labels)
        last = labels.size - 1 if day.stop is None else _place(day.stop, labels)
        return _some(np.arange(first, last + 1), day, "give the earlier label first")
    if is_number(day):
        return _place(day, labels)
    values = array_of("day", day, "give labels of days, or a slice of them", "iuf")
    if values.ndim != 1:
        raise InputError(f"day = {shown(day)}: give a label, a list of labels, or a slice of them")
    return _some(np.array([_place(label, labels) for label in values], dtype=np.int64), day, "give a label")


def _place(label: Any, labels: NDArray[np.int64]) -> int:
    found = np.flatnonzero(labels == plain(label)) if is_number(label) else np.zeros(0)
    if not found.size:
        known = f"{labels[0]} to {labels[-1]}, {labels.size} in all" if labels.size > 8 else shown(labels.tolist())
        raise InputError(f"day = {shown(plain(label))}: the boundary has no such day; it has {known}")
    return int(found[0])


def _some(found: Index, day: Any, cure: str) -> Index:
    if not found.size:
        raise InputError(f"day = {shown(day)} chooses no day: {cure}")
    if np.unique(found).size < found.size:
        raise InputError(f"day = {shown(day)} chooses a day twice: its label could stand for one only")
    return found


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


DIMS = ("day", "elapsed_time")


class Parts(NamedTuple):
    """What a boundary is made of; ``by_air``: whether the air flow alone decides on ``enabled``."""

    source: Source
    clock: Clock
    by_air: bool


def picked(parts: Parts, at: Index | int) -> Parts:
    """Some days by position; one by a number has no dim ``day``."""
    source, several = parts.source, not isinstance(at, int)
    index = np.atleast_1d(np.asarray(at, dtype=np.int64))
    day = source.day[index]
    start = None if parts.clock.start is None else parts.clock.start[index]
    if isinstance(source, Stream) and several:
        chosen: Source = Stream(Picked(source.make, index.tolist()), day, True, source.n_steps)
    else:
        rows = [source.of_day(int(k)) for k in index]
        chosen = Held({name: np.stack([row[name] for row in rows]) for name in rows[0]}, day, several)
    return Parts(chosen, Clock(start, parts.clock.time_zone), parts.by_air)


def joined(parts: Sequence[Parts], dim: str) -> Parts:
    """Boundaries put together, checked as ``joining_problems`` does: their days, or the hours of their days."""
    sources, first = [one.source for one in parts], parts[0]
    zone = next((one.clock.time_zone for one in parts if one.clock.time_zone), "")
    by_air = all(one.by_air for one in parts)
    if dim == "day":
        starts = [one.clock.start for one in parts if one.clock.start is not None]
        clock = Clock(np.concatenate(starts) if starts else None, zone)
        day, n_steps = np.concatenate([source.day for source in sources]), first.source.n_steps
    else:
        clock, day = Clock(first.clock.start, zone), first.source.day
        n_steps = sum(source.n_steps for source in sources)
    has_day_dim = dim == "day" or first.source.has_day_dim
    if any(source.is_streamed for source in sources):
        if dim == "day":
            make: Days = OneAfterAnother([_days_of(one) for one in parts], [source.day.size for source in sources])
        else:
            make = EndToEnd([source.of_day for source in sources])
        return Parts(Stream(make, day, has_day_dim, n_steps), clock, by_air)
    needed, available = 8 * len(BOUNDARY_SERIES) * day.size * n_steps, available_memory()
    if needed > available:
        raise InputError(
            f"the boundaries take {gib(needed)} of memory together, {gib(available)} are available: give fewer, or "
            "make the days when they are needed, with from_days"
        )
    series = [source.series for source in sources]
    whole = {name: np.concatenate([one[name] for one in series], axis=DIMS.index(dim)) for name in series[0]}
    return Parts(Held(whole, day, has_day_dim), clock, by_air)


def joining_problems(parts: Sequence[Parts], dim: str) -> list[str]:
    """Why boundaries cannot be put together, a sentence each."""
    sources, problems = [one.source for one in parts], []
    first, zones = sources[0], sorted({one.clock.time_zone for one in parts} - {""})
    if len(zones) > 1:
        problems.append(f"the boundaries are in the time zones {' and '.join(zones)}: put together those of one")
    known = [one.clock.start is not None for one in parts]
    if len(set(known)) > 1:
        problems.append(
            f"boundary {known.index(True)} has a start and boundary {known.index(False)} has none: give it one with "
            "assign(start=…), or assign(start=None) to the others"
        )
    if dim == "day":
        problems += [
            f"boundary {i} lasts {source.n_steps:,} s, the first {first.n_steps:,} s: give days of one length"
            for i, source in enumerate(sources)
            if source.n_steps != first.n_steps
        ]
        labels, counts = np.unique(np.concatenate([source.day for source in sources]), return_counts=True)
        if counts.max() > 1:
            problems.append(
                f"day label {labels[counts.argmax()]} appears twice: give each day its own label, as assign(day=7)"
            )
        return problems
    for i, source in enumerate(sources[1:], start=1):
        if source.has_day_dim != first.has_day_dim or source.day.size != first.day.size:
            n = [f"{one.day.size} days" if one.has_day_dim else "no dim day" for one in (source, first)]
            problems.append(f"boundary {i} has {n[0]}, the first {n[1]}: give the same days")
        elif first.has_day_dim and not np.array_equal(source.day, first.day):
            problems.append(f"boundary {i} has other days than the first: give the same days, in the same order")
    return problems or (_late_starts(parts) if all(known) else [])


def _late_starts(parts: Sequence[Parts]) -> list[str]:
    """The first boundary that does not start where the one before ends."""
    for i, (before, one) in enumerate(zip(parts, parts[1:], strict=False), start=1):
        assert before.clock.start is not None
        assert one.clock.start is not None
        ends = before.clock.start + np.timedelta64(before.source.n_steps, "s")
        wrong = np.flatnonzero(ends != one.clock.start)
        if wrong.size:
            k = int(wrong[0])
            return [
                f"boundary {i} starts at {one.clock.start[k]}, the one before ends at {ends[k]}: put together what "
                "follows without a gap, or assign(start=None) to all"
            ]
    return []


def _days_of(parts: Parts) -> Days:
    """The days of a boundary as those of a stream."""
    if isinstance(parts.source, Stream):
        return parts.source.make
    return Replaced(parts.source.of_day, {"enabled": None}) if parts.by_air else parts.source.of_day


def rows_of(source: Source) -> dict[str, Array]:
    """The series, (n_days, n_steps) each, or (n_steps,) without a dim ``day``."""
    return {name: values if source.has_day_dim else values[0] for name, values in source.series.items()}
