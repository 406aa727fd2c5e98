"""The points in a building's files, each with times of its own: one or several to a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, collecting, nearest, shown
from fastcoil.logs.arguments import Declared, Wanted
from fastcoil.logs.cells import is_datum
from fastcoil.logs.notes import counted
from fastcoil.logs.readings import read_columns
from fastcoil.logs.series import COLUMNS
from fastcoil.logs.status import status_columns
from fastcoil.logs.table import Table, label_and_unit
from fastcoil.logs.timestamps import is_time, read_stamps

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
_ROWS_LOOKED_AT = 1000
"""A column without a number in them is one of remarks."""
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

    Raises
    ------
    InputError
        With one sentence for each mistake.
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
        declared = Declared(columns={}, units=units, constants=None, has_command=True)
        readings = read_columns(table, named, declared, Wanted((), measured=POINTS), strict=False, sparse=True)
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
