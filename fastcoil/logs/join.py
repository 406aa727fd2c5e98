"""Points logged each at its own times, in several files or in rows of one value each, as one table."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import argument_checks, collect_problems, raise_problems
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.logs import timestamps
from fastcoil.logs.cells import is_missing_word, is_number_or_switch_word
from fastcoil.logs.columns import ColumnSpec, ReadingOptions, find_columns, interpret_header
from fastcoil.logs.pieces import GAP_MEDIAN_STEPS, has_uneven_steps, read_times
from fastcoil.logs.plausibility import describe_likely_unit, find_misread_units
from fastcoil.logs.readings import describe_left_out, read_columns
from fastcoil.logs.series import COLUMNS, TIME_COLUMNS, VOCABULARY, format_count, is_unit
from fastcoil.logs.table import REVERSED_ROWS_NOTE, Table, normalise_header, split_label_and_unit
from fastcoil.logs.timestamps import MICROSECOND_DTYPE, SECOND_US, Timestamps, apply_time_zone, format_utc_offset

_NON_POINT_COLUMNS = ("elapsed_time", "batch")  # that are about rows
POINT_NAMES = [name for name in COLUMNS if name not in _NON_POINT_COLUMNS]  # that a point may have


class PointSource(NamedTuple):
    """A table of one column, which may be a point, and the times of its rows."""

    table: Table
    stamps: Timestamps


class Point(NamedTuple):
    """One point of a building: a measured or commanded signal with times of its own."""

    name: str  # among ``COLUMNS``
    times: Index  # µs since 1970, ascending, (n,)
    values: Array  # in our unit, (n,)
    unit: str  # in which it was logged
    clock: str  # ``UTC`` where the times are absolute, else the name of the zone beside them, or blank
    offset: int  # by which the clock that wrote absolute times is ahead, µs
    file: str  # where it is from
    is_regular: bool = True  # whether it has samples at equal steps; others are written when they change


def _find_change_points(points: Sequence[Point]) -> list[Point]:
    """Mark the points that are written when they change: by steps that are uneven, or few and far between."""
    median_steps = [float(np.median(np.diff(point.times))) if point.times.size > 1 else np.inf for point in points]
    marked = []
    for point, step in zip(points, median_steps, strict=True):
        n_levels = np.unique(point.values).size
        is_to_and_fro = COLUMNS[point.name].hold and (np.diff(point.values) != 0.0).all()
        is_to_and_fro &= point.times.size <= 10 or n_levels <= 0.5 * point.times.size
        is_sparse = step >= 5.0 * min(median_steps) and (point.times.size < 5 or is_to_and_fro)
        is_uneven = has_uneven_steps(np.diff(point.times) / SECOND_US)
        marked.append(point._replace(is_regular=not (is_uneven or is_sparse)))
    return marked


def split_sources(table: Table, options: ReadingOptions) -> list[PointSource]:
    """Split a table into points: its columns or, if each row has one value, the rows by name; with their times."""
    time_header = (options.columns or {}).get("timestamp")
    time_column = table.find_time_column() if time_header is None else table.find_column(time_header)
    if time_column is None:
        raise InputError(f"{table.name} has no column of times: call it timestamp", "timestamp", "missing")
    columns = find_value_columns(table)
    time_options = options if columns is None else replace(options, time_zone="")  # each point has its own order
    with collect_problems(table.problems):
        stamps = read_times(table, time_column, time_options)
    table.raise_problems()
    if columns is None:
        labels = [split_label_and_unit(header)[0] for header in table.header]
        indices = [k for k, label in enumerate(labels) if k != time_column and label not in _NON_POINT_COLUMNS]
        return [PointSource(_single_column_table(table, k, table.header[k]), stamps) for k in indices]
    if not stamps.good.all():
        table.notes.append(describe_left_out(table, "timestamp", ~stamps.good, "row"))
    point, value, unit = columns
    rows_by_point: dict[str, list[int]] = {}
    for k in np.flatnonzero(stamps.good).tolist():
        row = table.rows[k]
        rows_by_point.setdefault(row[point].strip(), []).append(k)
        number, brace, status = row[value].partition("{")
        unit_text = "" if unit is None or is_missing_word(number) else row[unit].strip()
        cell = " ".join(filter(None, (number.strip(), unit_text if is_unit(unit_text) else "", brace + status)))
        table.rows[k] = [*row[:value], cell, *row[value + 1 :]]
    n_points = format_count(len(rows_by_point), "point")
    table.notes.append(f"a row for each value: {n_points} by {short_repr(table.header[point])}")
    common_unit = split_label_and_unit(table.header[value])[1]
    sources = []
    for name, rows in rows_by_point.items():
        if stamps.microseconds[rows[0]] > stamps.microseconds[rows[-1]]:
            rows.reverse()
            table.notes.append(REVERSED_ROWS_NOTE)
        header = f"{name} [{common_unit}]" if common_unit and not split_label_and_unit(name)[1] else name
        column = _single_column_table(table, value, header, rows)
        column.unit_cure = "give each of its rows {unit!r} in a column Unit"
        point_stamps = stamps._replace(microseconds=stamps.microseconds[rows], good=stamps.good[rows])
        if options.time_zone and not stamps.absolute:
            point_stamps = apply_time_zone(point_stamps, options.time_zone, column.row_numbers)
        sources.append(PointSource(column, point_stamps))
    return sources


def _single_column_table(table: Table, column: int, header: str, rows: Sequence[int] | None = None) -> Table:
    """Return one column of some rows, or of all, with the notes of the table."""
    row_indices = range(len(table.rows)) if rows is None else rows
    cells, numbers = [[table.rows[k][column]] for k in row_indices], [table.row_numbers[k] for k in row_indices]
    units = table.units and [table.units[column]]
    return replace(table, header=[header], rows=cells, row_numbers=numbers, units=units, problems=[])


def find_value_columns(table: Table) -> tuple[int, int, int | None] | None:
    """Find the columns of names, values and units of a log with a row for each value; None for any other log."""
    labels = [normalise_header(header) for header in table.header]
    words_by_kind = [VOCABULARY["headers"][kind].split() for kind in ("point", "value", "unit")]
    points, values, units = ([k for k, label in enumerate(labels) if label in words] for words in words_by_kind)
    if not points or len(values) != 1 or table.find_time_column() is None:
        return None
    # of a path and a short name that one counts which tells more points apart
    return max(points, key=lambda k: len({row[k] for row in table.rows})), values[0], units[0] if units else None


def read_points(sources: Sequence[PointSource], union: Table, options: ReadingOptions, spec: ColumnSpec) -> list[Point]:
    """Read the points that ``spec`` asks for; ``union``: an empty table that gets the headers of all sources."""
    union.header = ["timestamp", *(source.table.header[0] for source in sources)]
    column_by_name = find_columns(union, options, spec)
    union.raise_problems()
    columns = sorted(column_by_name.items(), key=lambda entry: entry[1])
    with argument_checks() as check:
        points = [check(_read_point, sources[column - 1], name, options) for name, column in columns if column]
    return _find_change_points(points)


def _read_point(source: PointSource, name: str, options: ReadingOptions) -> Point:
    """Read one column as a point with this name; blanks are no mistake where ``drop`` is not offered."""
    table, stamps = source.table, source.stamps
    units = {name: options.units[name]} if name in options.units else {}
    spec, point_options = ColumnSpec((), measured=POINT_NAMES), replace(options, columns={}, units=units)
    readings = read_columns(table, {name: 0}, point_options, spec, sparse=options.drop is None)
    if not options.drop:
        readings.report_complaints(table, options)
    elif readings.bad[name].any():
        table.notes.append(describe_left_out(table, name, readings.bad[name], "value"))
    table.raise_problems()
    table.notes += readings.notes
    steps = np.diff(stamps.microseconds)
    is_repeated = np.append(steps == 0, False)
    is_set_back = stamps.seem_set_back()
    if (steps < 0).any() or is_set_back:
        row_before, row_after = table.row_numbers[int(np.argmax(steps <= 0 if is_set_back else steps < 0)) :][:2]
        cure = options.set_back_cure() if is_set_back else "sort the rows by time"
        sentence = f"{table.name}: time goes back between rows {row_before} and {row_after}: {cure}"
        raise InputError(sentence, "timestamp", "time")
    if is_repeated.any():
        table.notes.append(f"{format_count(is_repeated, 'row')} at the time of the next: left out")
    values = readings.values[name]
    is_used = ~is_repeated & ~readings.bad[name] & np.isfinite(values)
    if not is_used.any():
        raise InputError(f"{table.name}: {name} has no value", name, "data")
    clock = "UTC" if stamps.absolute else stamps.time_zone
    times, unit = stamps.microseconds[is_used], readings.units[name]
    return Point(name, times, values[is_used], unit, clock, stamps.offset, table.name)


def pivot_points(table: Table, options: ReadingOptions, spec: ColumnSpec) -> Table:
    """Pivot the points of ``spec`` to columns with our names, at the times of the fastest regular one or of all."""
    sources = split_sources(table, options)
    columns = options.columns and {name: point for name, point in options.columns.items() if name not in TIME_COLUMNS}
    points = read_points(sources, table, replace(options, columns=columns, drop=bool(options.drop)), spec)
    for k, point in enumerate(points):
        scale, offset = COLUMNS[point.name].units[point.unit]
        points[k] = point._replace(values=(point.values - offset) / scale)  # as they were logged
    points.sort(key=lambda point: point.name not in spec.measured)  # of two that are as fast one is measured
    all_times = np.unique(np.concatenate([point.times for point in points]))
    regular_times = [point.times for point in points if point.is_regular]
    clock = min(regular_times, key=lambda times: float(np.median(np.diff(times))), default=all_times)
    start, end = _common_span(points)
    clock = clock[(clock >= start) & (clock <= end)]
    clock, (header, *cells), notes = _sample_on_clock(points, clock, options.max_gap, 17)  # reads back to the bit
    numbered = (zip(source.stamps.microseconds.tolist(), source.table.row_numbers, strict=True) for source in sources)
    row_by_time: dict[int, int] = dict(chain.from_iterable(numbered))
    has_common_times = all(np.array_equal(point.times, points[0].times) for point in points)
    table_notes = list(dict.fromkeys([*table.notes, *notes * (not has_common_times)]))
    return Table(table.name, header, cells, [row_by_time[time] for time in clock.tolist()], notes=table_notes)


def join_points(
    paths: Sequence[Path],
    *,
    columns: Mapping[str, str],
    units: Mapping[str, str],
    time_format: str | None = None,
    time_zone: str | None = None,
    step: float | None = None,
    max_gap: float | None = None,
    ignore: Sequence[str] = (),
) -> tuple[str, list[str]]:
    """Join the points of several files on a common clock: the text of a CSV file, and how it was made.

    Points that are written when they change hold until the next change, and so do commands, set-points and switches;
    others run straight between samples.  The clock runs while all points have values.

    columns: our name → file, header, or ``file:header``.  time_zone: of times that have none.  step: of the clock [s];
    by default the usual step of the fastest point, rounded down.  max_gap: longest time without a sample over which a
    point holds or runs straight [s]; by default three usual steps, no limit for a point that is written when it
    changes.
    """
    reading: Any = {"columns": columns, "units": units, "time_format": time_format, "time_zone": time_zone or ""}
    points, notes = _read_files(paths, options := ReadingOptions(**reading, ignore=ignore, reader="join"))
    values, declared = {point.name: point.values for point in points}, {point.name: point.unit for point in points}
    likely_units = find_misread_units(values, declared, options.units)
    problems = []
    for point in points:
        if unit := likely_units.get(point.name):
            unit_cure = options.unit_cure(point.name, point.unit)
            cure = f"write '[{unit}]' in the header; if {point.unit} is right, say so: {unit_cure}"
            declaration = f"{point.file}: {point.name} is declared in {point.unit}"
            problems.append(Problem(f"{declaration}, and {describe_likely_unit(unit)}: {cure}", point.name, "unit"))
    raise_problems(problems)
    points = [point._replace(unit=COLUMNS[point.name].unit) for point in points]
    points.sort(key=lambda point: list(COLUMNS).index(point.name))
    files = {point.clock: point.file for point in points}
    if len(files) > 1:
        clocks = ", ".join(f"{file} {clock or 'none'}" for clock, file in files.items())
        cure = "export all alike, or give the zone of the others, such as --time-zone America/New_York"
        raise InputError(f"the files have different time zones ({clocks}): {cure}", "--time-zone", "conflict")
    clock, lines, clock_notes = _sample_on_clock(points, _common_clock(points, step), max_gap, 10)
    step_seconds = float(np.median(np.diff(clock))) / SECOND_US
    all_notes = [*notes, *clock_notes, f"{format_count(clock.size, 'row')}, {step_seconds:.4g} s apart"]
    return "\n".join(map(",".join, lines)) + "\n", all_notes


def _read_files(paths: Sequence[Path], options: ReadingOptions) -> tuple[list[Point], list[str]]:
    """Read the points of several files; a single column of values may have the name of its file."""
    sources, problems, names, notes = list[PointSource](), list[str](), list[set[str]](), list[list[str]]()
    for path in paths:
        with collect_problems(problems):
            table = Table.read(path, least_rows=1)
            table_sources = split_sources(table, options)
            columns = [source.table for source in table_sources]
            # a column without a value in many rows is one of remarks
            has_values = [any(is_number_or_switch_word(row[0]) for row in column.rows[:1000]) for column in columns]
            for column, is_value_column in zip(columns, has_values, strict=True):
                label, unit = split_label_and_unit(column.header[0])
                column_names = {column.header[0], label}
                file_names = {str(path), path.name, path.stem} if is_value_column else set()
                names.append(column_names | file_names | {f"{path.name}:{name}" for name in column_names})
                has_meaning = path.stem not in POINT_NAMES and interpret_header(label) is not None
                if is_value_column and sum(has_values) == 1 and label not in POINT_NAMES and not has_meaning:
                    column.header = [f"{path.stem} [{unit}]" if unit else path.stem]
            sources += table_sources
            notes.append(table.notes)
    texts = [*chain(*notes)]
    unclear = [text for text in texts if timestamps.UNKNOWN_ORDER in text]
    is_month_first = any(text.startswith(timestamps.MONTH_FIRST_NOTE) for text in texts if text not in unclear)
    if unclear and is_month_first and not options.month_first:
        return _read_files(paths, replace(options, month_first=True))  # what one file shows holds for the others
    name_counts = Counter(chain(*names))
    for name, target in (options.columns or {}).items():
        if name_counts[target] > 1:
            sentence = f"--column {name}={target}: it is in {name_counts[target]} columns, give FILE:HEADER"
            problems.append(Problem(sentence, "--column", "conflict"))
    raise_problems(problems)
    source_by_name = {name: k for k, texts in enumerate(names, start=1) for name in texts if name_counts[name] == 1}
    all_columns = Table("", [], [], [], column_of_joined_header=source_by_name)
    points = read_points(sources, all_columns, options, ColumnSpec((), POINT_NAMES))
    cure = f"say which one it is, with --column NAME=FILE or NAME=FILE:HEADER, of {', '.join(POINT_NAMES)}"
    unread_files = sorted({path.name for path in paths} - {point.file for point in points})
    problems += [Problem(f"{file} has no point that is known: {cure}", file, "missing") for file in unread_files]
    for name in sorted(options.units.keys() - {point.name for point in points}):
        problems.append(Problem(f"--unit {name}={options.units[name]}: no file has the point {name}", "--unit", "name"))
    raise_problems(problems)
    file_notes = [f"{path.name}: {note}" for path, ls in zip(paths, notes, strict=True) for note in dict.fromkeys(ls)]
    return points, all_columns.notes + file_notes


_CLOCK_STEPS_SECONDS = (1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 900, 1800, 3600)


def _common_clock(points: Sequence[Point], step: float | None) -> Index:
    """Return the ticks of a clock while all points have values, µs; step: s, by default that of the fastest point."""
    if step is None:
        median_steps = [np.median(np.diff(point.times)) for point in points if point.times.size > 1]
        shortest_seconds = min(median_steps) / SECOND_US if median_steps else 60.0
        step = float(max((each for each in _CLOCK_STEPS_SECONDS if each <= shortest_seconds), default=1))
    step_microseconds = round(step * SECOND_US)
    start, end = _common_span(points, step_microseconds)
    first_tick, last_tick = -(-start // step_microseconds), end // step_microseconds
    if (last_tick - first_tick) * len(points) > 20_000_000:
        sentence = f"a clock of {step:g} s has {last_tick - first_tick:,} rows for {len(points)} points: raise --step"
        raise InputError(sentence, "--step", "size")
    return np.arange(first_tick, last_tick + 1, dtype=np.int64) * step_microseconds


def _common_span(points: Sequence[Point], step: int = 1) -> tuple[int, int]:
    """Return the first and last time [µs] at which all points have values, two multiples of ``step`` [µs] apart."""
    start = max(int(point.times[0]) for point in points)
    ends = [int(point.times[-1]) for point in points if point.is_regular]
    end = min(ends) if ends else max(int(point.times[-1]) for point in points)
    if end // step <= -(-start // step):
        ends_by_name = {p.name: p.times[[0, -1]].astype(MICROSECOND_DTYPE).astype("datetime64[s]") for p in points}
        spans = "; ".join(f"{name} {first} to {last}" for name, (first, last) in ends_by_name.items())
        sentence = f"there are no two times at which all points have values ({spans})"
        raise InputError(f"{sentence}: give files of one time", points[0].name, "data")
    return start, end


def _sample_on_clock(
    points: Sequence[Point], clock: Index, max_gap: float | None, digits: int
) -> tuple[Index, list[list[str]], list[str]]:
    """Sample points at the times of a clock; return those with all values, header and rows, and notes."""
    values, point_is_good, point_notes = zip(*(_sample_point(point, clock, max_gap) for point in points), strict=True)
    is_good, notes = np.all(point_is_good, axis=0), list(point_notes)
    if is_good.sum() < 2:
        sentence = "every point has a value in fewer than two rows: raise --max-gap, or leave one out"
        raise InputError(sentence, "--max-gap", "data")
    if not is_good.all():
        n_rows = f"{format_count(~is_good, 'row')} of {is_good.size:,}"
        notes.append(f"{n_rows} left out: a point has no sample within its longest gap")
    offsets = {point.offset for point in points}
    offset = offsets.pop() if len(offsets) == 1 else 0
    zone = format_utc_offset(offset // (60 * SECOND_US))[3:] or "+00:00" if points[0].clock == "UTC" else ""
    header = ["timestamp", *(f"{point.name} [{point.unit}]" for point in points)]
    cells = [[f"{stamp.isoformat()}{zone}" for stamp in (clock[is_good] + offset).astype(MICROSECOND_DTYPE).tolist()]]
    cells += [[f"{value:.{digits}g}" for value in series[is_good].tolist()] for series in values]
    return clock[is_good], [header, *map(list, zip(*cells, strict=True))], notes


def _sample_point(point: Point, clock: Index, max_gap: float | None) -> tuple[Array, Mask, str]:
    """Sample a point at the times of a clock; return values, whether each is good, and a note on how."""
    latest = np.searchsorted(point.times, clock, side="right") - 1
    next_index = np.minimum(latest + 1, point.times.size - 1)
    steps = np.diff(point.times)
    is_held = COLUMNS[point.name].hold or not point.is_regular
    usual_limit = GAP_MEDIAN_STEPS * float(np.median(steps)) / SECOND_US if point.is_regular else None
    limit = usual_limit if max_gap is None else max_gap
    gap_microseconds = np.where(next_index > latest, point.times[next_index], clock) - point.times[latest]
    is_good = (clock == point.times[latest]) | (gap_microseconds <= (np.inf if limit is None else limit * SECOND_US))
    values = point.values[latest] if is_held else np.interp(clock, point.times, point.values)
    method = "held from sample to sample" if is_held else "on straight lines"
    kind = "" if point.is_regular else ", written when it changes"
    longest = max(steps.max(initial=0), clock[-1] - point.times[-1]) / SECOND_US
    limit_text = f"over {limit:g} s at most" if limit is not None else f"up to {longest:g} s"
    samples = f"{format_count(point.times.size, 'sample')} of {point.file}"
    return values, is_good, f"{point.name}: {samples}{kind}, {method} {limit_text}"
