"""A building's points, each logged at its own times, on one clock: the table that the fits read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, collecting, nearest, shown
from fastcoil.logs.cells import is_datum
from fastcoil.logs.columns import Reading, Wanted, status_columns
from fastcoil.logs.pieces import LONG_STEP, may_be_of_changes
from fastcoil.logs.readings import read_columns
from fastcoil.logs.series import COLUMNS, counted
from fastcoil.logs.table import Table, label_and_unit
from fastcoil.logs.timestamps import MICROSECONDS, is_time, read_stamps

_TIMES = (
    "timestamp",
    "time",
    "date",
    "datetime",
    "date time",
    "date/time",
    "time stamp",
    "zeit",
    "zeitstempel",
    "datum",
)
"""Headers of a column of times, in small letters."""
POINTS = [name for name in COLUMNS if name not in ("elapsed_time", "batch")]
"""What a point may be."""
_ROWS_LOOKED_AT = 1000  # A column without a number in them is one of remarks
_CURE = "--time-format '{format}'"


class Point(NamedTuple):
    """One point: its name among ``COLUMNS``, its times (µs since 1970, ascending) and values in our unit, (n,) each.

    absolute: whether the times are of UTC, not of a clock on the wall.  file: where it is from.
    """

    name: str
    times: Index
    values: Array
    absolute: bool
    file: str


class Files:
    """Points of several files.

    Parameters
    ----------
    paths
        The files.
    columns
        Our name → file, or header, or ``file:header``, for points that neither header nor file name names.
    units
        Our name → unit, for headers without one.
    time_format
        As of ``read_log``.
    """

    def __init__(
        self, paths: Sequence[Path], columns: Mapping[str, str], units: Mapping[str, str], time_format: str | None
    ) -> None:
        self.points: list[Point] = []
        self.notes: list[str] = []
        self._columns, self._units, self._time_format = columns, units, time_format
        self._used: set[str] = set()
        problems = [
            f"{option} has unknown {shown(name)}{nearest(name, POINTS)}: use {', '.join(POINTS)}"
            for option, given in (("--column", columns), ("--unit", units))
            for name in given
            if name not in POINTS
        ]
        for path in paths:
            with collecting(problems):
                self._read(path)
        problems += [
            f"--column {name}={columns[name]}: no file and no header is called so, or several are"
            for name in columns
            if name in POINTS and name not in self._used and not problems
        ]
        names = [point.name for point in self.points]
        problems += [
            f"--unit {name}={units[name]}: no file has the point {name}"
            for name in units
            if name in POINTS and name not in names and not problems
        ]
        for name in dict.fromkeys(names):
            if names.count(name) > 1:
                files = " and ".join(point.file for point in self.points if point.name == name)
                problems.append(f"{name} is in {files}: leave one out")
        if problems:
            raise InputError(problems)

    def _read(self, path: Path) -> None:
        """Add the points of a file."""
        table = Table.read(path)
        time = _time_column(table)
        named = self._names(table, path, time)
        with collecting(table.problems):
            stamps = read_stamps([row[time] for row in table.rows], table.row_numbers, self._time_format, _CURE)
        table.stop_if_wrong()
        table.notes += stamps.notes
        if not stamps.good.all():
            k = int(np.argmin(stamps.good))
            cell, row = shown(table.rows[k][time]), table.row_numbers[k]
            table.problems.append(f"{table.header[time] or 'time'} = {cell} in row {row} {stamps.wrong}")
        units = {name: unit for name, unit in self._units.items() if name in named}
        how = Reading(columns={}, units=units, has_command=True)
        readings = read_columns(table, named, how, Wanted((), measured=POINTS), sparse=True)
        table.problems += readings.complaints
        table.stop_if_wrong()
        times, order = _ascending(table, stamps.microseconds)
        for name, values in readings.known.items():
            kept = order[np.isfinite(values[order])]
            if not kept.size:
                raise InputError(f"{table.name}: {name} has no value")
            self.points.append(Point(name, times[kept], values[kept], stamps.absolute, table.name))
        self.notes += [f"{table.name}: {note}" for note in table.notes + readings.notes]

    def _names(self, table: Table, path: Path, time: int) -> dict[str, int]:
        """Column of each point of a file, by our name."""
        status = status_columns(table)
        others = [k for k in range(len(table.header)) if k != time and k not in status]
        columns = [k for k in others if any(is_datum(row[k]) for row in table.rows[:_ROWS_LOOKED_AT])]
        named: dict[str, int] = {}
        for name, target in self._columns.items():
            file, _, header = target.partition(":")
            of_file = file in (path.name, str(path), path.stem)
            fits = [
                k
                for k in columns
                if target in (table.header[k], label_and_unit(table.header[k])[0])
                or (of_file and (header in (table.header[k], label_and_unit(table.header[k])[0]) if header else True))
            ]
            if len(fits) == 1 and name in POINTS:
                if name in self._used:
                    raise InputError(f"--column {name}={target}: it is in {path.name} and in a file before: "
                                     "give FILE:HEADER")  # fmt: skip
                named[name] = fits[0]
                self._used.add(name)
        taken = set(named.values())
        for k in columns:
            label = label_and_unit(table.header[k])[0]
            if k not in taken and label in POINTS and label not in self._columns:
                named.setdefault(label, k)
        if not named and len(columns) == 1 and path.stem in POINTS:
            named[path.stem] = columns[0]
        if not named:
            headers = ", ".join(shown(table.header[k]) for k in columns[:3]) or "no column of numbers but the time"
            raise InputError(
                f"{path.name} has {headers}: say which point that is, with --column NAME={path.name}"
                + (":HEADER" if len(columns) > 1 else "")
                + f", of {', '.join(POINTS)}"
            )
        left = [table.header[k] for k in others if k not in named.values()]
        if left:
            table.notes.append(f"{counted(len(left), 'column')} left out: {', '.join(map(shown, left[:3]))}")
        return named


def _time_column(table: Table) -> int:
    """Index of the column of times: by its header, or the first one if it has times."""
    for k, header in enumerate(table.header):
        if header.strip().lower() in _TIMES:
            return k
    if is_time(table.rows[0][0]):
        return 0
    raise InputError(f"{table.name} has no column of times: call it timestamp")


def _ascending(table: Table, times: Index) -> tuple[Index, Index]:
    """The times, and the rows in ascending order of time, of doubles the last; time that goes to and fro is refused."""
    steps = np.diff(times)
    order = np.arange(times.size)
    if (steps < 0).any() and (steps <= 0).all():
        table.notes.append("the newest row is first: turned round")
        order = order[::-1]
        steps = -steps[::-1]
    if (steps < 0).any():
        k = int(np.argmax(steps < 0))
        first, second = sorted((table.row_numbers[order[k]], table.row_numbers[order[k + 1]]))
        raise InputError(f"{table.name}: time goes back between rows {first} and {second}: sort the rows by time")
    double = np.append(steps == 0, False)
    if double.any():
        table.notes.append(f"{counted(double, 'row')} at the time of the next: left out")
    return times, order[~double]


_NICE = (1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 900, 1800, 3600)  # steps of a clock, s
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
