"""Points logged each at its own times, put on one clock: the table that the fits read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs.change_of_value import LONG_STEP, may_be_of_changes
from fastcoil.logs.notes import counted
from fastcoil.logs.points import Files, Point
from fastcoil.logs.series import COLUMNS
from fastcoil.logs.written_dates import MICROSECONDS

_NICE = (1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 900, 1800, 3600)
"""Steps of a clock, s."""
_SECOND = 1_000_000
_MOST_CELLS = 20_000_000
_DIGITS = 10


class Joined(NamedTuple):
    """A table as the text of a CSV file, and how it was made."""

    text: str
    notes: list[str]


def join_points(
    paths: Sequence[Path],
    *,
    columns: Mapping[str, str],
    units: Mapping[str, str],
    time_format: str | None,
    step: float | None,
    max_gap: float | None,
) -> Joined:
    """One table of the points of several files, on a common clock.

    Points that are written when they change hold until the next change, and so do commands, set-points and switches;
    others run straight between samples.  The clock runs while all points have values.

    Parameters
    ----------
    paths, columns, units, time_format
        As of `Files`.
    step
        Of the clock [s]; the usual step of the fastest point if left out, rounded down.
    max_gap
        Longest time without a sample over which a point holds or runs straight [s]; if left out, three usual steps for
        a point of regular samples, no limit for one that is written when it changes.

    Raises
    ------
    InputError
        With one sentence for each mistake in the files or the arguments.
    """
    files = Files(paths, columns, units, time_format)
    points = sorted(files.points, key=lambda point: list(COLUMNS).index(point.name))
    if len({point.absolute for point in points}) > 1:
        which = {point.absolute: point.file for point in points}
        raise InputError(
            f"{which[True]} has UTC offsets or epoch times, {which[False]} a local clock: export both alike"
        )
    regular = {point.name: not may_be_of_changes(np.diff(point.times) / _SECOND) for point in points}
    clock = _clock(points, regular, step)
    notes, values, good = list(files.notes), {}, np.ones(clock.size, dtype=bool)
    for point in points:
        values[point.name], has_value, note = _on_clock(point, clock, regular[point.name], max_gap)
        good &= has_value
        notes.append(note)
    if good.sum() < 2:
        raise InputError(
            "fewer than two rows are left where every point has a value: raise --max-gap, or leave one out"
        )
    if not good.all():
        notes.append(f"{counted(~good, 'row')} of {good.size:,} left out: a point has no sample within its longest gap")
    usual = float(np.median(np.diff(clock))) / _SECOND
    notes.append(f"{counted(good, 'row')}, {usual:g} s apart")
    return Joined(_text(clock[good], {n: v[good] for n, v in values.items()}, points[0].absolute), notes)


def _clock(points: Sequence[Point], regular: Mapping[str, bool], step: float | None) -> Index:
    """The times at which all points have values, µs."""
    if step is None:
        usual = [np.median(np.diff(point.times)) for point in points if point.times.size > 1]
        least = min(usual) / _SECOND if usual else 60.0
        step = float(max((one for one in _NICE if one <= least), default=_NICE[0]))
    every = round(step * _SECOND)
    start = max(point.times[0] for point in points)
    ends = [point.times[-1] for point in points if regular[point.name]]
    end = min(ends) if ends else max(point.times[-1] for point in points)
    first, last = -(-start // every), end // every
    if last <= first:
        spans = "; ".join(f"{p.name} {_shown_time(p.times[0])} to {_shown_time(p.times[-1])}" for p in points)
        raise InputError(f"there are no two times at which all points have values ({spans}): give files of one time")
    if (last - first) * len(points) > _MOST_CELLS:
        raise InputError(f"a clock of {step:g} s has {last - first:,} rows for {len(points)} points: raise --step")
    return np.arange(first, last + 1, dtype=np.int64) * every


def _on_clock(point: Point, clock: Index, regular: bool, max_gap: float | None) -> tuple[Array, Mask, str]:
    """Values of a point at the times of the clock; where it has any; and a sentence on how they were made."""
    latest = np.searchsorted(point.times, clock, side="right") - 1
    following = np.minimum(latest + 1, point.times.size - 1)
    steps = np.diff(point.times)
    held = COLUMNS[point.name].hold or not regular
    limit = max_gap
    if limit is None and regular and steps.size:
        limit = LONG_STEP * float(np.median(steps)) / _SECOND
    apart = np.where(following > latest, point.times[following] - point.times[latest], clock - point.times[latest])
    exact = clock == point.times[latest]
    good = exact | (apart <= (np.inf if limit is None else limit * _SECOND))
    straight = np.interp(clock, point.times, point.values)
    values = point.values[latest] if held else straight
    how = "held from sample to sample" if held else "on straight lines"
    what = "" if regular else ", written when it changes"
    longest = f"over {limit:g} s at most" if limit is not None else f"up to {steps.max(initial=0) / _SECOND:g} s"
    return values, good, f"{point.name}: {counted(point.times.size, 'sample')} of {point.file}{what}, {how} {longest}"


def _text(clock: Index, values: Mapping[str, Array], absolute: bool) -> str:
    zone = "+00:00" if absolute else ""
    header = ["timestamp", *(f"{name} [{COLUMNS[name].unit}]" for name in values)]
    cells = [[f"{stamp.isoformat()}{zone}" for stamp in clock.astype(MICROSECONDS).tolist()]]
    cells += [[f"{value:.{_DIGITS}g}" for value in column.tolist()] for column in values.values()]
    return "\n".join(map(",".join, [header, *map(list, zip(*cells, strict=True))])) + "\n"


def _shown_time(time: int) -> str:
    return str(np.datetime64(int(time), "us").astype("datetime64[s]"))
