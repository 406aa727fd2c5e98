"""A building's points, each logged at its own times, on one clock: the table that the fits read."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fastcoil.base.arguments import collecting
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.logs.cells import is_datum
from fastcoil.logs.columns import Reading, Wanted, status_columns
from fastcoil.logs.pieces import LONG_STEP, may_be_of_changes, read_times
from fastcoil.logs.plausibility import looks_like, misread_units
from fastcoil.logs.readings import read_columns
from fastcoil.logs.series import COLUMNS, counted
from fastcoil.logs.table import Table, label_and_unit
from fastcoil.logs.timestamps import MICROSECONDS, in_zone, offset_text

POINTS = [name for name in COLUMNS if name not in ("elapsed_time", "batch")]
"""What a point may be."""
_ROWS_LOOKED_AT = 1000  # A column without a number in them is one of remarks


class Point(NamedTuple):
    """One point: its name among ``COLUMNS``, its times (µs since 1970, ascending) and values in our unit, (n,) each.

    unit: in which it was logged.  clock: ``UTC`` where the times are absolute; else the name of the zone beside them,
    blank without one.  offset: by which the clock that wrote absolute times is ahead [µs].  file: where it is from.
    """

    name: str
    times: Index
    values: Array
    unit: str
    clock: str
    offset: int
    file: str


def read_points(
    paths: Sequence[Path], columns: Mapping[str, str], how: Reading, time_zone: str | None = None
) -> tuple[list[Point], list[str]]:
    """The points of several files, and notes on how they were read.

    Parameters
    ----------
    paths
        The files.
    columns
        Our name → file, or header, or ``file:header``, for points that neither header nor file name names.
    how
        Units by our name, for headers without one, and the format of the times.
    time_zone
        Of times that have none, such as ``America/New_York``.
    """
    points: list[Point] = []
    notes: list[str] = []
    used: set[str] = set()
    problems = [
        f"{option} has unknown {shown(name)}{nearest(name, POINTS)}: use {', '.join(POINTS)}"
        for option, given in (("--column", columns), ("--unit", how.units))
        for name in given
        if name not in POINTS
    ]
    known = {name: target for name, target in columns.items() if name in POINTS}
    for path in paths:
        with collecting(problems):
            table = Table.read(path)
            points += _points_of(table, path, known, used, how, time_zone)
            notes += [f"{table.name}: {note}" for note in table.notes]
    names = [point.name for point in points]
    if not problems:
        problems += [
            f"--column {name}={target}: no file and no header is called so, or several are"
            for name, target in known.items()
            if name not in used
        ]
        problems += [
            f"--unit {name}={unit}: no file has the point {name}"
            for name, unit in how.units.items()
            if name not in names
        ]
    for name in dict.fromkeys(names):
        if names.count(name) > 1:
            files = " and ".join(point.file for point in points if point.name == name)
            problems.append(f"{name} is in {files}: leave one out")
    if problems:
        raise InputError(problems)
    return points, notes


def _points_of(
    table: Table, path: Path, columns: Mapping[str, str], used: set[str], how: Reading, time_zone: str | None
) -> list[Point]:
    """The points of a file; their names by ``columns`` join those that are ``used``."""
    time = table.time_column()
    if time is None:
        raise InputError(f"{table.name} has no column of times: call it timestamp")
    named = _names(table, path, time, columns, used)
    with collecting(table.problems):
        stamps = read_times(table, time, how)
    table.stop_if_wrong()
    if not stamps.absolute and time_zone:
        stamps = in_zone(stamps, time_zone)
    how = Reading(columns={}, units={n: unit for n, unit in how.units.items() if n in named}, has_command=True)
    readings = read_columns(table, named, how, Wanted((), measured=POINTS), sparse=True)
    table.problems += readings.complaints
    table.stop_if_wrong()
    table.notes += readings.notes
    steps = np.diff(stamps.microseconds)
    if (steps < 0).any():
        first, second = table.row_numbers[int(np.argmax(steps < 0)) :][:2]
        raise InputError(f"{table.name}: time goes back between rows {first} and {second}: sort the rows by time")
    double = np.append(steps == 0, False)
    if double.any():
        table.notes.append(f"{counted(double, 'row')} at the time of the next: left out")
    points = []
    for name, values in readings.known.items():
        kept = ~double & np.isfinite(values)
        if not kept.any():
            raise InputError(f"{table.name}: {name} has no value")
        clock = "UTC" if stamps.absolute else stamps.time_zone
        times, unit = stamps.microseconds[kept], readings.units[name]
        points.append(Point(name, times, values[kept], unit, clock, stamps.offset, table.name))
    return points


def _names(table: Table, path: Path, time: int, columns: Mapping[str, str], used: set[str]) -> dict[str, int]:
    """Column of each point of a file, by our name."""
    status, labels = status_columns(table), [label_and_unit(header)[0] for header in table.header]
    others = [k for k in range(len(table.header)) if k != time and k not in status]
    numbers = [k for k in others if any(is_datum(row[k]) for row in table.rows[:_ROWS_LOOKED_AT])]
    named: dict[str, int] = {}
    for name, target in columns.items():
        file, _, header = target.partition(":")
        of_file = header if file in (path.name, str(path), path.stem) else None  # blank: any column of the file
        fits = [k for k in numbers if of_file == "" or {target, of_file} & {table.header[k], labels[k]}]
        if len(fits) == 1 and name in used:
            raise InputError(f"--column {name}={target}: it is in {path.name} and in a file before: give FILE:HEADER")
        if len(fits) == 1:
            named[name] = fits[0]
            used.add(name)
    taken = set(named.values())
    for k in numbers:
        if k not in taken and labels[k] in POINTS and labels[k] not in columns:
            named.setdefault(labels[k], k)
    if not named and len(numbers) == 1 and path.stem in POINTS:
        named[path.stem] = numbers[0]
    if not named:
        headers = ", ".join(shown(table.header[k]) for k in numbers[:3]) or "no column of numbers but the time"
        which = f"{path.name}{':HEADER' if len(numbers) > 1 else ''}"
        raise InputError(
            f"{path.name} has {headers}: say which point that is, with --column NAME={which}, of {', '.join(POINTS)}"
        )
    left = [table.header[k] for k in others if k not in named.values()]
    if left:
        table.notes.append(f"{counted(len(left), 'column')} left out: {', '.join(map(shown, left[:3]))}")
    return named


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
    time_format: str | None = None,
    time_zone: str | None = None,
    step: float | None = None,
    max_gap: float | None = None,
) -> Joined:
    """One table of the points of several files, on a common clock.

    Points that are written when they change hold until the next change, and so do commands, set-points and switches;
    others run straight between samples.  The clock runs while all points have values.

    Parameters
    ----------
    paths, columns, time_zone
        As of `read_points`.
    units, time_format
        As of ``read_log``.
    step
        Of the clock [s]; the usual step of the fastest point if left out, rounded down.
    max_gap
        Longest time without a sample over which a point holds or runs straight [s]; if left out, three usual steps for
        a point of regular samples, no limit for one that is written when it changes.
    """
    how = Reading(units=units, time_format=time_format, has_command=True)
    points, notes = read_points(paths, columns, how, time_zone)
    _question_units(points, units)
    points.sort(key=lambda point: list(COLUMNS).index(point.name))
    files = {point.clock: point.file for point in points}
    if len(files) > 1:
        clocks = ", ".join(f"{file} {clock or 'none'}" for clock, file in files.items())
        raise InputError(
            f"the files have different time zones ({clocks}): export all alike, or give the zone of times without a "
            "UTC offset, such as --time-zone America/New_York"
        )
    regular = {point.name: not may_be_of_changes(np.diff(point.times) / _SECOND) for point in points}
    clock = _clock(points, regular, step)
    values, good = {}, np.ones(clock.size, dtype=bool)
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
    notes.append(f"{counted(good, 'row')}, {usual:.4g} s apart")
    offsets = {point.offset for point in points}
    offset = None if points[0].clock != "UTC" else offsets.pop() if len(offsets) == 1 else 0
    return Joined(_text(clock[good], {n: v[good] for n, v in values.items()}, offset), notes)


def _question_units(points: Sequence[Point], trusted: Mapping[str, str]) -> None:
    """Refuse points whose numbers contradict the unit in their file, alone or beside each other."""
    by_name = {point.name: point for point in points}
    values = {name: point.values for name, point in by_name.items()}
    found = misread_units(values, {name: point.unit for name, point in by_name.items()}, trusted)
    if found:
        raise InputError([
            f"{by_name[name].file}: {name} is declared in {by_name[name].unit}, and {looks_like(meant)}: write "
            f"'[{meant}]' in the header; if {by_name[name].unit} is right, say so: --unit {name}='{by_name[name].unit}'"
            for name, meant in found.items()
        ])  # fmt: skip


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


def _text(clock: Index, values: Mapping[str, Array], offset: int | None) -> str:
    """Text of the table; ``offset``: from UTC [µs], None for the times of a local clock."""
    zone = "" if offset is None else offset_text(offset // 60_000_000)[3:] or "+00:00"
    clock = clock + (offset or 0)
    header = ["timestamp", *(f"{name} [{COLUMNS[name].unit}]" for name in values)]
    cells = [[f"{stamp.isoformat()}{zone}" for stamp in clock.astype(MICROSECONDS).tolist()]]
    cells += [[f"{value:.{_DIGITS}g}" for value in column.tolist()] for column in values.values()]
    return "\n".join(map(",".join, [header, *map(list, zip(*cells, strict=True))])) + "\n"


def _shown_time(time: int) -> str:
    return str(np.datetime64(int(time), "us").astype("datetime64[s]"))
