"""A building's points, each logged at its own times, as one table: from several files, or from rows of one value each.

Such rows have a time, the name of a point and its value, as historians write them.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fastcoil.base.arguments import collecting, refuse
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, shown
from fastcoil.logs.cells import is_missing, is_value
from fastcoil.logs.columns import Reading, Wanted, find_columns, meaning_of
from fastcoil.logs.pieces import LONG_STEP, may_be_of_changes, read_times
from fastcoil.logs.plausibility import looks_like, misread_units
from fastcoil.logs.readings import left_out, read_columns
from fastcoil.logs.series import COLUMNS, NAMES, TIMES, counted, is_unit
from fastcoil.logs.table import TURNED, Table, label_and_unit, letters_of
from fastcoil.logs.timestamps import MICROSECONDS, MINUTE, SECOND, Stamps, in_zone, offset_text

_NO_POINTS = ("elapsed_time", "batch")
POINTS = [name for name in COLUMNS if name not in _NO_POINTS]  # what a point may be
_ROWS_LOOKED_AT = 1000  # A column without a value in them is one of remarks


class Source(NamedTuple):
    """A table of one column, which may be a point, and the times of its rows."""

    table: Table
    stamps: Stamps


class Point(NamedTuple):
    """One point of a building."""

    name: str  # among ``COLUMNS``
    times: Index  # µs since 1970, ascending, (n,)
    values: Array  # in our unit, (n,)
    unit: str  # in which it was logged
    clock: str  # ``UTC`` where the times are absolute, else the name of the zone beside them, or blank
    offset: int  # by which the clock that wrote absolute times is ahead, µs
    file: str  # where it is from

    @property
    def is_regular(self) -> bool:
        """Whether it has samples at equal steps; others are written when they change."""
        return not may_be_of_changes(np.diff(self.times) / SECOND)


_POINT, _VALUE, _UNIT = (NAMES["headers"][kind].split() for kind in ("point", "value", "unit"))
"""Headers of columns in a log that has a row for each value, as ``letters_of`` gives them."""


def sources_of(table: Table, how: Reading, time_zone: str | None = None) -> list[Source]:
    """A table, or each point of a table that has a row for each value, with the times of its rows."""
    asked = (how.columns or {}).get("timestamp")
    time = table.time_column() if asked is None else table.column(asked)
    if time is None:
        raise InputError(f"{table.name} has no column of times: call it timestamp")
    with collecting(table.problems):
        stamps = read_times(table, time, how)
    table.stop_if_wrong()
    if not stamps.absolute and time_zone:
        stamps = in_zone(stamps, time_zone)
    if (columns := value_columns(table)) is None:
        named = {k: header for k, header in enumerate(table.header) if label_and_unit(header)[0] not in _NO_POINTS}
        return [Source(_column(table, k, header), stamps) for k, header in named.items() if k != time]
    if not stamps.good.all():
        table.notes.append(left_out(table, "timestamp", ~stamps.good, "row"))
    point, value, unit = columns
    rows: dict[str, list[int]] = {}
    for k in np.flatnonzero(stamps.good).tolist():
        row = table.rows[k]
        rows.setdefault(row[point].strip(), []).append(k)
        number, brace, status = row[value].partition("{")
        beside = row[unit].strip() if unit is not None and not is_missing(number) and is_unit(row[unit].strip()) else ""
        row[value] = " ".join(filter(None, (number.strip(), beside, brace + status)))
    table.notes.append(f"a row for each value: {counted(len(rows), 'point')} by {shown(table.header[point])}")
    of_all = label_and_unit(table.header[value])[1]
    sources = []
    for name, own in rows.items():
        if stamps.microseconds[own[0]] > stamps.microseconds[own[-1]]:
            own.reverse()
            table.notes.append(TURNED)
        header = f"{name} [{of_all}]" if of_all and not label_and_unit(name)[1] else name
        column = _column(table, value, header, own)
        column.unit_cure = "give each of its rows {unit!r} in a column Unit"
        sources.append(Source(column, stamps._replace(microseconds=stamps.microseconds[own], good=stamps.good[own])))
    return sources


def _column(table: Table, column: int, header: str, rows: Sequence[int] | None = None) -> Table:
    """One column of some rows, or of all, whose notes are those of the table."""
    own = range(len(table.rows)) if rows is None else rows
    cells, numbers = [[table.rows[k][column]] for k in own], [table.row_numbers[k] for k in own]
    units = table.units and [table.units[column]]
    return replace(table, header=[header], rows=cells, row_numbers=numbers, units=units, problems=[])


def value_columns(table: Table) -> tuple[int, int, int | None] | None:
    """Index of the columns of points, values and units of a log that has a row for each value; None of any other."""
    labels = [letters_of(header) for header in table.header]
    points, values, units = ([k for k, one in enumerate(labels) if one in known] for known in (_POINT, _VALUE, _UNIT))
    if not points or len(values) != 1 or table.time_column() is None:
        return None
    # of a path and a short name that one counts which tells more points apart
    return max(points, key=lambda k: len({row[k] for row in table.rows})), values[0], units[0] if units else None


def points_of(sources: Sequence[Source], whole: Table, how: Reading, wanted: Wanted) -> list[Point]:
    """The wanted points among several columns; ``whole`` gets the headers of all."""
    whole.header = ["timestamp", *(source.table.header[0] for source in sources)]
    found = find_columns(whole, how, wanted)
    whole.stop_if_wrong()
    points, problems = list[Point](), list[str]()
    for name, column in sorted(found.items(), key=lambda one: one[1]):
        with collecting(problems):
            points += [_point_in(sources[column - 1], name, how)] if column else []
    refuse(problems)
    return points


def _point_in(source: Source, name: str, how: Reading) -> Point:
    """The point in a column; blanks are no mistake where ``drop`` is not offered."""
    table, stamps = source.table, source.stamps
    own = replace(how, columns={}, units={one: unit for one, unit in how.units.items() if one == name})
    readings = read_columns(table, {name: 0}, own, Wanted((), measured=POINTS), sparse=how.drop is None)
    if not how.drop:
        readings.refuse(table, how)
    elif readings.bad[name].any():
        table.notes.append(left_out(table, name, readings.bad[name], "value"))
    table.stop_if_wrong()
    table.notes += readings.notes
    steps = np.diff(stamps.microseconds)
    if (steps < 0).any():
        first, second = table.row_numbers[int(np.argmax(steps < 0)) :][:2]
        raise InputError(f"{table.name}: time goes back between rows {first} and {second}: sort the rows by time")
    double = np.append(steps == 0, False)
    if double.any():
        table.notes.append(f"{counted(double, 'row')} at the time of the next: left out")
    values = readings.known[name]
    kept = ~double & ~readings.bad[name] & np.isfinite(values)
    if not kept.any():
        raise InputError(f"{table.name}: {name} has no value")
    clock = "UTC" if stamps.absolute else stamps.time_zone
    times, unit = stamps.microseconds[kept], readings.units[name]
    return Point(name, times, values[kept], unit, clock, stamps.offset, table.name)


def pivoted(table: Table, how: Reading, wanted: Wanted) -> Table:
    """The wanted points, with our names, at the times of the fastest regular one; else at those of every value."""
    sources = sources_of(table, how)
    columns = None if how.columns is None else {name: one for name, one in how.columns.items() if name not in TIMES}
    points = points_of(sources, table, replace(how, columns=columns, drop=bool(how.drop)), wanted)
    for k, point in enumerate(points):
        scale, offset = COLUMNS[point.name].units[point.unit]
        points[k] = point._replace(values=(point.values - offset) / scale)  # as they were logged
    points.sort(key=lambda point: point.name not in wanted.measured)  # of two that are as fast one is measured
    every = np.unique(np.concatenate([point.times for point in points]))
    steady = [point.times for point in points if point.is_regular]
    clock = min(steady, key=lambda times: float(np.median(np.diff(times))), default=every)
    start, end = _span(points)
    clock, (header, *cells), notes = _on_clock(points, clock[(clock >= start) & (clock <= end)], how.max_gap, _EXACT)
    rows = dict(chain(*(zip(one.stamps.microseconds.tolist(), one.table.row_numbers, strict=True) for one in sources)))
    alike = all(np.array_equal(point.times, points[0].times) for point in points)
    said = list(dict.fromkeys([*table.notes, *notes * (not alike)]))
    return Table(table.name, header, cells, [rows[time] for time in clock.tolist()], notes=said)


def join_points(
    paths: Sequence[Path],
    *,
    columns: Mapping[str, str],
    units: Mapping[str, str],
    time_format: str | None = None,
    time_zone: str | None = None,
    step: float | None = None,
    max_gap: float | None = None,
) -> tuple[str, list[str]]:
    """The points of several files on a common clock, as the text of a CSV file, and how it was made.

    Points that are written when they change hold until the next change, and so do commands, set-points and switches;
    others run straight between samples.  The clock runs while all points have values.

    columns: our name → file, or header, or ``file:header``, for points that neither header nor file name names.
    time_zone: of times that have none.  step: of the clock [s]; the usual step of the fastest point, rounded down, if
    left out.  max_gap: longest time without a sample over which a point holds or runs straight [s]; if left out, three
    usual steps for a point of regular samples, no limit for one that is written when it changes.
    """
    how = Reading(columns=columns, units=units, time_format=time_format, has_command=True)
    points, notes = _of_files(paths, how, time_zone)
    values, declared = {one.name: one.values for one in points}, {one.name: one.unit for one in points}
    found = misread_units(values, declared, how.units)
    problems = [
        f"{one.file}: {one.name} is declared in {one.unit}, and {looks_like(found[one.name])}: write "
        f"'[{found[one.name]}]' in the header; if {one.unit} is right, say so: {how.unit_cure(one.name, one.unit)}"
        for one in points
        if one.name in found
    ]
    refuse(problems)
    points = [point._replace(unit=COLUMNS[point.name].unit) for point in points]
    points.sort(key=lambda point: list(COLUMNS).index(point.name))
    files = {point.clock: point.file for point in points}
    if len(files) > 1:
        clocks = ", ".join(f"{file} {clock or 'none'}" for clock, file in files.items())
        cure = "export all alike, or give the zone of the others, such as --time-zone America/New_York"
        raise InputError(f"the files have different time zones ({clocks}): {cure}")
    clock, lines, of_clock = _on_clock(points, _clock(points, step), max_gap, _DIGITS)
    usual = float(np.median(np.diff(clock))) / SECOND
    said = [*notes, *of_clock, f"{counted(clock.size, 'row')}, {usual:.4g} s apart"]
    return "\n".join(map(",".join, lines)) + "\n", said


def _of_files(paths: Sequence[Path], how: Reading, time_zone: str | None) -> tuple[list[Point], list[str]]:
    """The points of several files, and how they were read; a single column of values may have the name of its file."""
    sources, problems, names, notes = list[Source](), list[str](), list[set[str]](), list[list[str]]()
    for path in paths:
        with collecting(problems):
            table = Table.read(path)
            own = sources_of(table, how, time_zone)
            has_values = [any(is_value(row[0]) for row in one.table.rows[:_ROWS_LOOKED_AT]) for one in own]
            for column, has in zip((one.table for one in own), has_values, strict=True):
                label, unit = label_and_unit(column.header[0])
                of_column = {column.header[0], label}
                of_file = {str(path), path.name, path.stem} if has else set()
                names.append(of_column | of_file | {f"{path.name}:{one}" for one in of_column})
                is_named = label in POINTS or (path.stem not in POINTS and meaning_of(label) is not None)
                if has and sum(has_values) == 1 and not is_named:
                    column.header = [f"{path.stem} [{unit}]" if unit else path.stem]
            sources += own
            notes.append(table.notes)
    every = Counter(chain(*names))
    for name, target in (how.columns or {}).items():
        if every[target] > 1:
            problems.append(f"--column {name}={target}: it is in {every[target]} columns, give FILE:HEADER")
    refuse(problems)
    joined = {name: i for i, own in enumerate(names, start=1) for name in own if every[name] == 1}
    whole = Table("", [], [], [], joined=joined)
    points = points_of(sources, whole, how, Wanted((), POINTS))
    which = f"say which one it is, with --column NAME=FILE or NAME=FILE:HEADER, of {', '.join(POINTS)}"
    idle = {path.name for path in paths} - {point.file for point in points}
    problems += [f"{name} has no point that is known: {which}" for name in sorted(idle)]
    unused = how.units.keys() - {point.name for point in points}
    problems += [f"--unit {name}={how.units[name]}: no file has the point {name}" for name in sorted(unused)]
    refuse(problems)
    of_files = [f"{path.name}: {note}" for path, said in zip(paths, notes, strict=True) for note in dict.fromkeys(said)]
    return points, whole.notes + of_files


_NICE = (1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 900, 1800, 3600)  # steps of a clock, s
_MOST_CELLS = 20_000_000
_DIGITS, _EXACT = 10, 17  # of a value in a file; of one that reads back to the bit


def _clock(points: Sequence[Point], step: float | None) -> Index:
    """The times at which all points have values, µs."""
    if step is None:
        usual = [np.median(np.diff(point.times)) for point in points if point.times.size > 1]
        least = min(usual) / SECOND if usual else 60.0
        step = float(max((one for one in _NICE if one <= least), default=_NICE[0]))
    every = round(step * SECOND)
    start, end = _span(points, every)
    first, last = -(-start // every), end // every
    if (last - first) * len(points) > _MOST_CELLS:
        raise InputError(f"a clock of {step:g} s has {last - first:,} rows for {len(points)} points: raise --step")
    return np.arange(first, last + 1, dtype=np.int64) * every


def _span(points: Sequence[Point], step: int = 1) -> tuple[int, int]:
    """The first and last time [µs] at which all points have values, two multiples of ``step`` [µs] apart at least."""
    start = max(int(point.times[0]) for point in points)
    ends = [int(point.times[-1]) for point in points if point.is_regular]
    end = min(ends) if ends else max(int(point.times[-1]) for point in points)
    if end // step <= -(-start // step):
        ends_of = {p.name: p.times[[0, -1]].astype(MICROSECONDS).astype("datetime64[s]") for p in points}
        spans = "; ".join(f"{name} {first} to {last}" for name, (first, last) in ends_of.items())
        raise InputError(f"there are no two times at which all points have values ({spans}): give files of one time")
    return start, end


def _on_clock(
    points: Sequence[Point], clock: Index, max_gap: float | None, digits: int
) -> tuple[Index, list[list[str]], list[str]]:
    """The times of the clock at which all points have values; header and rows of their table; how they were made."""
    values, good_of, said = zip(*(_at_times(point, clock, max_gap) for point in points), strict=True)
    good, notes = np.all(good_of, axis=0), list(said)
    if good.sum() < 2:
        raise InputError("every point has a value in fewer than two rows: raise --max-gap, or leave one out")
    if not good.all():
        notes.append(f"{counted(~good, 'row')} of {good.size:,} left out: a point has no sample within its longest gap")
    offsets = {point.offset for point in points}
    offset = offsets.pop() if len(offsets) == 1 else 0
    zone = offset_text(offset // MINUTE)[3:] or "+00:00" if points[0].clock == "UTC" else ""
    header = ["timestamp", *(f"{point.name} [{point.unit}]" for point in points)]
    cells = [[f"{stamp.isoformat()}{zone}" for stamp in (clock[good] + offset).astype(MICROSECONDS).tolist()]]
    cells += [[f"{value:.{digits}g}" for value in series[good].tolist()] for series in values]
    return clock[good], [header, *map(list, zip(*cells, strict=True))], notes


def _at_times(point: Point, clock: Index, max_gap: float | None) -> tuple[Array, Mask, str]:
    """Values of a point at the times of the clock; where it has any; and a sentence on how they were made."""
    latest = np.searchsorted(point.times, clock, side="right") - 1
    following = np.minimum(latest + 1, point.times.size - 1)
    steps = np.diff(point.times)
    held = COLUMNS[point.name].hold or not point.is_regular
    limit = max_gap
    if limit is None and point.is_regular:
        limit = LONG_STEP * float(np.median(steps)) / SECOND
    apart = np.where(following > latest, point.times[following] - point.times[latest], clock - point.times[latest])
    good = (clock == point.times[latest]) | (apart <= (np.inf if limit is None else limit * SECOND))
    values = point.values[latest] if held else np.interp(clock, point.times, point.values)
    how = "held from sample to sample" if held else "on straight lines"
    what = "" if point.is_regular else ", written when it changes"
    longest = f"over {limit:g} s at most" if limit is not None else f"up to {steps.max(initial=0) / SECOND:g} s"
    return values, good, f"{point.name}: {counted(point.times.size, 'sample')} of {point.file}{what}, {how} {longest}"
