"""The cells of the columns as checked numbers in our units; bad ones are refused, left out, bridged or cut."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fastcoil.base.arguments import collect_problems
from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.logs import plausibility
from fastcoil.logs.cells import NumberStyle, ParsedCells, detect_number_style, parse_cells
from fastcoil.logs.columns import ColumnSpec, ReadingOptions
from fastcoil.logs.table import Table

from fastcoil.logs.series import (  # isort: skip
    COLUMNS, FRACTION, TEMPERATURE, TRAVEL, Series, count_suffix, describe_first_row, format_count,
)  # fmt: skip


@dataclass
class ColumnReadings:
    """The columns of a log as numbers in our units, by name, (n,), and what is wrong with them."""

    values: dict[str, Array] = field(default_factory=dict)
    bad: dict[str, Mask] = field(default_factory=dict)  # by name, where they may not be used
    missing: dict[str, Mask] = field(default_factory=dict)  # where a cell says that there is no value
    notes: list[str] = field(default_factory=list)  # what was taken for something else
    complaints: list[Problem] = field(default_factory=list)  # one for each column with bad numbers
    units: dict[str, str] = field(default_factory=dict)  # as declared, where most numbers are possible

    def report_complaints(self, table: Table, options: ReadingOptions) -> None:
        """Add the complaints to the problems of a table, with the cure that the caller offers."""
        table.problems += self.complaints
        if self.complaints and options.drop is False:
            cure = f"; or leave such values out and count them: {options.cure('drop=True', '--drop')}"
            last = self.complaints[-1]
            table.problems[-1] = Problem(last + cure, last.field, last.code)


def read_columns(
    table: Table, column_by_name: Mapping[str, int], options: ReadingOptions, spec: ColumnSpec, *, sparse: bool = False
) -> ColumnReadings:
    """Read every column but ``timestamp`` as numbers in our units; ``sparse``: a missing value is no mistake."""
    readings = ColumnReadings()
    columns = {name: column for name, column in column_by_name.items() if name != "timestamp"}
    style = detect_table_style(table, columns)
    for name, column in columns.items():
        series = COLUMNS[name]
        cells = parse_cells([row[column] for row in table.rows], style, is_switch=series.is_switch)
        unit = _resolve_column_unit(table, series, column, cells, options)
        if unit is None:
            continue
        if series.hold and name != "batch" and not sparse:
            _hold_between_changes(table, series, cells, readings.notes)
        values = series.convert(cells.values, unit)
        if series.scatters:
            values = _clip_to_bounds(table, series, values, readings.notes)
        values[cells.has_bad_status] = np.nan
        is_bad = series.is_bad(values)
        is_missing = cells.missing | cells.has_bad_status | np.isin(cells.values, (-99.0, -999.0, -9999.0))
        readings.units[name] = unit
        is_sensor_off = _sensor_off_mask(series, cells.values, values)
        is_wrong = is_bad & ~is_missing if sparse else is_bad
        if is_sensor_off.any():
            k, first_row_text = int(np.argmax(is_sensor_off)), describe_first_row(table.row_numbers, is_sensor_off)
            reading_text = f"{name} is {cells.values[k]:g}{f' {unit}' if cells.values[k] else ''}, "
            if name in spec.measured:
                subject = f"{format_count(is_sensor_off, 'value')} left out"
                readings.notes.append(f"{subject}: {reading_text}sensor off ({first_row_text})")
                values[is_sensor_off] = np.nan
            else:
                sentence = f"{reading_text}{first_row_text}, where others are far away: sensor off"
                readings.complaints.append(Problem(sentence, name, "data"))
            is_bad = is_bad & ~is_sensor_off if name in spec.measured else is_bad | is_sensor_off
        elif is_wrong.any():
            complaint = _describe_bad_cells(table, series, column, unit, is_wrong, cells)
            is_impossible = is_wrong & ~is_missing & np.isfinite(values)
            if 2 * is_impossible.sum() > np.isfinite(values).sum():  # the unit is wrong, not some readings
                table.problems.append(complaint)
                del readings.units[name]
            else:
                readings.complaints.append(complaint)
        if series.units is TRAVEL and name not in options.units:
            numbers = cells.values[~is_bad]
            if likely_signal := plausibility.detect_signal(numbers, unit)[0]:
                reading_text = f"{name} is from {numbers.min():.3g} to {numbers.max():.3g}, read in {unit}"
                cure = f"write '[{likely_signal}]' in the header, or {options.unit_cure(name, likely_signal)}"
                table.notes.append(f"{reading_text}: if it is a signal in {likely_signal}, {cure}")
        readings.values[name], readings.bad[name], readings.missing[name] = values, is_bad, is_missing
    return readings


def _hold_between_changes(table: Table, series: Series, cells: ParsedCells, notes: list[str]) -> None:
    """Fill the blank cells of a column that has values at changes only: each value holds until the next.

    Before its first change a switch was the other way.
    """
    rows = np.flatnonzero(np.isfinite(cells.values) & ~cells.has_bad_status)
    is_changed = np.diff(cells.values[rows]) != 0.0
    is_logged_at_changes = np.mean(is_changed) >= 0.5 if series.is_switch and rows.size > 1 else is_changed.all()
    if not rows.size or 2 * cells.missing.sum() <= cells.missing.size or not is_logged_at_changes:
        return
    latest = np.searchsorted(rows, np.arange(cells.values.size), side="right") - 1
    held = cells.values[rows[np.maximum(latest, 0)]]
    is_filled = cells.missing & ~cells.has_bad_status & ((latest >= 0) | series.is_switch)
    cells.values[is_filled] = np.where(latest < 0, 1.0 - held, held)[is_filled]
    cells.missing[is_filled] = False
    subject = f"{series.name} has values at its changes, {format_count(int(rows.size), 'row')} of {cells.values.size:,}"
    notes.append(f"{subject}: held until the next ({describe_first_row(table.row_numbers, is_filled)})")


def leave_out_optional(table: Table, readings: ColumnReadings, options: ReadingOptions, spec: ColumnSpec) -> None:
    """Leave out optional columns that cannot be used, with a note; not the set-point, nor what the caller named.

    With ``drop`` those whose bad values would take most rows, or all values, with them.  Of a log of which nothing is
    required, which is read to be looked at, none is left out.
    """
    if options.reader != "read_log" or not spec.required:
        return
    names = {*spec.optional} - {"T_set", *(options.columns or {}), *options.units}
    problems = InputError(table.problems).problems
    mistakes = {problem.field: problem for problem in [*readings.complaints, *problems] if problem.field in names}
    for complaint in readings.complaints if options.drop else ():
        share = float(np.mean(readings.bad[complaint.field]))
        if share <= 0.5 or (complaint.field in spec.measured and share < 1.0):
            mistakes.pop(complaint.field, None)
    for name, mistake in mistakes.items():
        readings.notes.append(f"{name} is left out, it is not needed: {mistake}")
        for entries in (readings.values, readings.bad, readings.missing, readings.units):
            entries.pop(name, None)
    table.problems = [problem for problem in problems if problem.field not in mistakes]
    readings.complaints = [complaint for complaint in readings.complaints if complaint.field not in mistakes]


def check_plausible_units(
    table: Table, readings: ColumnReadings, column_by_name: Mapping[str, int], options: ReadingOptions
) -> None:
    """Add a problem for each declared unit that the numbers contradict, and if T_sup and T_set seem exchanged."""
    trusted = {name for name in options.units if name in column_by_name and table.declared_units(column_by_name[name])}
    values = {name: np.where(readings.missing[name], np.nan, readings.values[name]) for name in readings.units}
    for name, likely_unit in plausibility.find_misread_units(values, readings.units, trusted).items():
        unit, k = readings.units[name], int(np.argmax(np.isfinite(values[name])))
        cell, row = short_repr(table.rows[k][column_by_name[name]].strip()), table.row_numbers[k]
        likeness = plausibility.describe_likely_unit(likely_unit)
        cure = table.unit_declaration_cure(column_by_name[name], likely_unit)
        cure += f"; if {unit} is right, declare it in the log and with {options.unit_cure(name, unit)}"
        table.add_problem(f"{name} = {cell} in row {row} is declared in {unit}, and {likeness}: {cure}", name, "unit")
    for name in sorted({"T_sup", "T_set", "T_a_in"} & values.keys() - trusted):
        if k := plausibility.find_unit_change(values[name]):
            sentence = f"{name} jumps in row {table.row_numbers[k]} as if °C and °F were in one column: write one unit"
            table.add_problem(sentence, name, "unit")
    if "command" in values.keys() - trusted:
        scale, offset = TRAVEL[readings.units["command"]]
        command = (values["command"] - offset) / scale
        if k := plausibility.find_scale_change(command) if scale == TRAVEL["%"][0] else 0:
            mistake = f"command goes on in row {table.row_numbers[k]} as if in another unit than before"
            table.add_problem(f"{mistake}: write one unit", "command", "unit")
    has_both = {"T_sup", "T_set"} <= values.keys() - (options.columns or {}).keys()
    if has_both and plausibility.is_set_point_exchanged(values["T_sup"], values["T_set"]):
        mistake = f"T_set, first in row {table.row_numbers[0]}, moves all the time, and T_sup hardly ever"
        both = {name: table.header[column_by_name[name]] for name in ("T_sup", "T_set")}
        naming = " ".join(f"--column {name}={header!r}" for name, header in both.items())
        cure = f"exchange the two headers; if they are right, name both: {options.cure(f'columns={both}', naming)}"
        table.add_problem(f"{mistake}, as if they were exchanged: {cure}", "T_set", "data")


def mark_supersaturation(table: Table, readings: ColumnReadings, constants: Mapping[str, float]) -> None:
    """Mark the humidity of air above saturation as bad; add a problem if most rows have such air."""
    values: dict[str, Any] = {**constants, **readings.values}
    name, is_above = plausibility.find_supersaturation(values)
    if not is_above.any():
        return
    bad_column = name if name in readings.values else "T_a_in"
    if bad_column in readings.values:
        is_above &= ~(readings.bad[bad_column] | readings.bad.get("T_a_in", False))
    k, n_rows = int(np.argmax(is_above)), len(table.rows)
    humidity, T = (float(np.broadcast_to(values[column], n_rows)[k]) for column in (name, "T_a_in"))
    row, unit = table.row_numbers[k], "kg/kg" if COLUMNS[name].unit == "1" else COLUMNS[name].unit
    mistake = f"{name} = {humidity:.4g} {unit} in row {row} is above saturation at T_a_in = {T:.4g} degC"
    cure = f"check the units of both, or give the values that belong together{count_suffix(int(is_above.sum()))}"
    complaint = Problem(f"{mistake}: {cure}", name, "data")
    if bad_column not in readings.values or 2 * is_above.sum() > n_rows:
        table.problems.append(complaint)
    elif is_above.any():
        readings.complaints.append(complaint)
        readings.bad[bad_column] = readings.bad[bad_column] | is_above


def read_numbers(table: Table, series: Series, column: int, unit: str | None = None) -> Array:
    """Read a column as checked numbers in our unit, (n_rows,); add problems; ``unit``: of a header without one."""
    style = detect_table_style(table, {series.name: column})
    cells = parse_cells([row[column] for row in table.rows], style, is_switch=False)
    options = ReadingOptions(units={} if unit is None else {series.name: unit})
    known_unit = _resolve_column_unit(table, series, column, cells, options)
    if known_unit is not None:
        values = series.convert(cells.values, known_unit)
        is_bad = series.is_bad(values)
        if not is_bad.any():
            return values
        table.problems.append(_describe_bad_cells(table, series, column, known_unit, is_bad, cells))
    return np.arange(len(table.rows), dtype=np.float64)


def detect_table_style(table: Table, columns: Mapping[str, int]) -> NumberStyle:
    """Detect how the numbers of the table are written; raise if that is ambiguous."""
    style = detect_number_style(([row[column] for row in table.rows] for column in columns.values()), table.separator)
    if number := style.ambiguous_number:
        meanings = f"{number.replace(',', '')} or {number.replace(',', '.')}"
        cure = "write decimal points and no separators of thousands"
        table.add_problem(f"a number such as {number!r} may mean {meanings}: {cure}", table.name, "format")
        table.raise_problems()
    if style.note and style.note not in table.notes:
        table.notes.append(style.note)
    return style


_LEAST_FAHRENHEIT = 45.0  # median of air, above which its numbers are °F: no coil blows 45 °C all the time


def propose_unit(series: Series, values: Array) -> str:
    """Propose the unit of a column that has none by its numbers; blank where they do not show it."""
    if not np.isfinite(values).any() or series.name.startswith("T_w"):
        return ""
    if series.units is TEMPERATURE:
        return "degF" if float(np.nanmedian(values)) > _LEAST_FAHRENHEIT else "degC"
    is_share = series.units in (TRAVEL, FRACTION)
    return ("1" if float(np.nanmax(values)) <= 1.05 else "percent") if is_share else ""  # readings lie a little above 1


def _resolve_column_unit(
    table: Table, series: Series, column: int, cells: ParsedCells, options: ReadingOptions
) -> str | None:
    """Return the unit of a column by its header, the row below, its cells or the caller; None, with a problem."""
    caller_unit = options.units.get(series.name)
    numbers = np.flatnonzero(~np.isnan(cells.values)).tolist()
    cell_unit = next(iter(cells.units.values()), "") if 2 * len(cells.units) >= len(numbers) else ""
    declared_units = table.declared_units(column) | ({"by units": caller_unit} if caller_unit else {})
    units = [*declared_units.items(), *([("by its cells", cell_unit)] if cell_unit else [])]
    if not units and len(series.units) > 1:  # of a number without dimension the only unit is 1
        unit = propose_unit(series, cells.values)
        if unit == "percent":  # numbers up to 10 or 20 may be a signal
            unit = plausibility.detect_signal(cells.values[np.isfinite(cells.values)], unit)[0] or unit
        unit = unit or "UNIT"
        cure = f"{table.unit_declaration_cure(column, unit)}, or use {options.unit_cure(series.name, unit)}"
        table.add_problem(f"{series.name} has no unit: {cure} ({series.known_units})", series.name, "unit")
        return None
    source, unit = units[0] if units else ("", "1")
    with collect_problems(table.problems):
        resolved_unit = series.resolve_unit(unit)
        for other_source, other_unit in units[1:]:
            if not series.is_same_unit(unit, other_unit):
                two_units = f"{short_repr(unit)} {source}, in {short_repr(other_unit)} {other_source}"
                raise InputError(f"{series.name} is in {two_units}: drop one", series.name, "unit")
        misfits = [k for k, text in cells.units.items() if not series.is_same_unit(text, unit)]
        if not cell_unit:
            cells.values[misfits] = np.nan  # a number with another unit among others is no number of this column
            return resolved_unit
        misfits += [] if declared_units else [k for k in numbers if k not in cells.units]
        if misfits:
            cell, row = short_repr(table.rows[misfits[0]][column]), table.row_numbers[misfits[0]]
            cure = f"others are in {short_repr(cell_unit)}, write one unit"
            raise InputError(f"{series.name} = {cell} in row {row}: {cure}", series.name, "unit")
        table.notes.append(f"{series.name} is in {short_repr(cell_unit)} by its cells")
        return resolved_unit
    return None


def _describe_bad_cells(
    table: Table, series: Series, column: int, unit: str, is_bad: Mask, cells: ParsedCells
) -> Problem:
    """Return the problem of the first bad cell of a column in ``unit``: its row, how many there are, the cure."""
    i, n_bad = int(np.argmax(is_bad)), int(is_bad.sum())
    if np.isfinite(cells.values[i]) and not cells.has_bad_status[i]:
        return series.describe_bad_value(float(cells.values[i]), f" in row {table.row_numbers[i]}", n_bad, unit)
    status = ", bad by its status" if cells.has_bad_status[i] else ""
    cell = short_repr(table.rows[i][column].strip())
    cure = f"give a number with a decimal point, or fill or cut the gap{count_suffix(n_bad)}"
    return Problem(f"{series.name} = {cell} in row {table.row_numbers[i]}{status}: {cure}", series.name, "value")


def _clip_to_bounds(table: Table, series: Series, values: Array, notes: list[str]) -> Array:
    """Clip values a little outside their bounds, such as a valve that reads 100.3 %, and count them."""
    is_bad = series.is_bad(values)
    if is_bad.all() or not is_bad.any():
        return values
    slack = 0.02 * np.ptp(values[~is_bad])
    is_near = is_bad & (values >= series.lower - slack) & (values <= series.upper + slack)
    if is_near.any():
        subject = f"{format_count(is_near, 'value')} of {series.name} just outside the possible range"
        notes.append(f"{subject}: taken as its bound ({describe_first_row(table.row_numbers, is_near)})")
    return np.where(is_near, np.clip(values, series.lower, series.upper), values)


def _sensor_off_mask(series: Series, numbers: Array, values: Array) -> Mask:
    """Return where a temperature sensor seems off, (n,): exactly 0 while others are above 5 °C, or a leap and back."""
    is_off: Mask = (numbers == 0.0) & (series.units is TEMPERATURE)
    other_values = values[~is_off & ~series.is_bad(values)]
    is_off &= not other_values.size or float(np.quantile(other_values, 0.01)) >= 5.0
    if series.units is TEMPERATURE and not series.hold:
        is_off |= plausibility.find_sensor_faults(np.where(series.is_bad(values), np.nan, values))
    return is_off


def fill_or_cut_rows(
    table: Table, readings: ColumnReadings, time: Array, options: ReadingOptions, spec: ColumnSpec, longest_step: float,
    time_name: str,
) -> tuple[dict[str, Array], Array]:  # fmt: skip
    """Cut the rows with bad values; return the columns and the time of those left; the table is cut as well.

    A bad value of a measured column becomes NaN.  An input that is missing in one row alone is bridged; rows with any
    other bad value are cut.  All that is a problem of the table unless ``drop`` is true.  time: of the rows [s], NaN
    where it is bad.  longest_step: over which an input is bridged [s].  time_name: of the column of the time.
    """
    columns, masks = readings.values, dict(readings.bad)
    if table.problems or (readings.complaints and not options.drop):
        readings.report_complaints(table, options)
        return columns, time
    for name in [n for n in spec.measured if n in masks]:
        is_bad = masks.pop(name)
        columns[name][is_bad] = np.nan
        if is_bad.any():
            readings.notes.append(describe_left_out(table, name, is_bad, "value"))
        if is_bad.all():
            raise InputError(f"{table.name}: {name} has no admissible number: check its unit", name, "data")
    if time_name == "timestamp":
        masks = {"timestamp": np.isnan(time)} | masks
    if options.drop:
        _bridge_missing_inputs(table, readings, masks, time, spec.measured, longest_step)
    readings.notes += [describe_left_out(table, name, is_bad, "row") for name, is_bad in masks.items() if is_bad.any()]
    is_kept = ~np.any(list(masks.values()), axis=0)
    if is_kept.all():
        return columns, time
    table.keep_rows(np.flatnonzero(is_kept).tolist())
    if len(table.rows) < 2:
        sentence = f"{table.name}: fewer than two rows are left: mend the log ({'; '.join(readings.notes)})"
        raise InputError(sentence, table.name, "data")
    return {name: values[is_kept] for name, values in columns.items()}, time[is_kept]


def _bridge_missing_inputs(
    table: Table, readings: ColumnReadings, masks: dict[str, Mask], time: Array, measured: Collection[str],
    longest_step: float,
) -> None:  # fmt: skip
    """Fill inputs that are missing in a single row from the rows beside it, and mark them good in ``masks``."""
    is_usable = ~np.any([masks[name] for name in ("timestamp", "elapsed_time", "batch") if name in masks], axis=0)
    steps = np.where(is_usable[1:] & is_usable[:-1], np.diff(time), np.inf)
    is_near = (steps > 0.0) & (steps <= longest_step)
    if "batch" in readings.values:
        is_near &= np.diff(readings.values["batch"]) == 0.0
    has_near_neighbours = np.zeros(time.size, dtype=bool)
    has_near_neighbours[1:-1] = is_near[1:] & is_near[:-1]
    for name in [n for n in readings.values if n not in (*measured, "elapsed_time", "batch")]:
        values, is_bad = readings.values[name], masks[name]
        is_filled = is_bad & readings.missing[name] & has_near_neighbours
        is_filled[1:-1] &= ~is_bad[2:] & ~is_bad[:-2]
        holes = np.flatnonzero(is_filled)
        if not holes.size:
            continue
        is_held = COLUMNS[name].hold
        time_share = 0.0 if is_held else (time[holes] - time[holes - 1]) / (time[holes + 1] - time[holes - 1])
        values[holes] = values[holes - 1] + time_share * (values[holes + 1] - values[holes - 1])
        is_bad &= ~is_filled
        method = "held" if is_held else "on a straight line between its neighbours"
        subject = f"{format_count(is_filled, 'missing value')} of {name} bridged"
        readings.notes.append(f"{subject}: {method} ({describe_first_row(table.row_numbers, is_filled)})")


def describe_left_out(table: Table, name: str, is_bad: Mask, noun: str) -> str:
    """Describe how many values or rows (``noun``) were left out since column ``name`` was bad, and the first."""
    first_row_text = describe_first_row(table.row_numbers, is_bad)
    return f"{format_count(is_bad, noun)} left out: {name} is not an admissible number ({first_row_text})"
