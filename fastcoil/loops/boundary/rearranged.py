"""Boundaries from others: days chosen, days or hours put together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError
from fastcoil.base.machine import available_memory, gib
from fastcoil.loops.boundary.clock import Clock
from fastcoil.loops.boundary.day_makers import Days, EndToEnd, OneAfterAnother, Picked, Replaced
from fastcoil.loops.boundary.series import BOUNDARY_SERIES
from fastcoil.loops.boundary.source import Held, Source, Stream

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
