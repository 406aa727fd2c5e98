"""The cells of the columns as checked numbers in our units, and what becomes of the bad ones.

They are refused; or else measured ones are left out, single missing inputs bridged, and other rows cut, all counted.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fastcoil.base.arguments import collecting
from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError, shown
from fastcoil.logs import plausibility
from fastcoil.logs.cells import Cells, Writing, cells_of, writing_of
from fastcoil.logs.columns import Reading, Wanted
from fastcoil.logs.series import COLUMNS, NUMBER, TEMPERATURE, TRAVEL, Series, counted, first_row, in_total
from fastcoil.logs.table import Table

_MISSING_MARKS = (-99.0, -999.0, -9999.0)
_SCATTER = 0.02  # readings up to this share of the column's span outside a bound are taken as the bound
_WARM = 5.0  # A temperature of exactly 0 among others above this, °C, is a sensor that is off


@dataclass
class Readings:
    """The columns of a log as numbers in our units, by name, (n,), and what is wrong with them."""

    known: dict[str, Array] = field(default_factory=dict)
    bad: dict[str, Mask] = field(default_factory=dict)  # where they may not be used
    missing: dict[str, Mask] = field(default_factory=dict)  # where a cell says that there is no value
    notes: list[str] = field(default_factory=list)  # what was taken for something else
    complaints: list[str] = field(default_factory=list)  # a sentence for each column with bad numbers
    units: dict[str, str] = field(default_factory=dict)  # as declared, where most numbers are possible

    def refuse(self, table: Table, how: Reading) -> None:
        """Make problems of the complaints, with the cure that the caller offers."""
        cure = f"; or leave such values out and count them: {how.cure('drop=True', '--drop')}"
        last = [complaint + cure * (how.drop is False) for complaint in self.complaints[-1:]]
        table.problems += self.complaints[:-1] + last


def read_columns(
    table: Table, found: Mapping[str, int], how: Reading, wanted: Wanted, *, sparse: bool = False
) -> Readings:
    """Every column ``found`` but ``timestamp`` as numbers in our units; ``sparse``: a missing value is no mistake."""
    readings = Readings()
    columns = {name: column for name, column in found.items() if name != "timestamp"}
    writing = _writing(table, columns)
    for name, column in columns.items():
        series = COLUMNS[name]
        cells = cells_of([row[column] for row in table.rows], writing, switch=series.is_switch)
        unit = _unit_of(table, series, column, how.units.get(name), cells, how.has_command)
        if unit is None:
            continue
        values = series.convert(cells.values, unit)
        if series.scatters:
            values = _at_bounds(table, series, values, readings.notes)
        values[cells.marked] = np.nan
        bad = series.is_bad(values)
        missing = cells.missing | cells.marked | np.isin(cells.values, _MISSING_MARKS)
        readings.units[name] = unit
        off = _sensor_off(series, cells.values, values)
        wrong = bad & ~missing if sparse else bad
        if off.any():
            k, first = int(np.argmax(off)), first_row(table.row_numbers, off)
            said = f"{name} is {cells.values[k]:g}{f' {unit}' if cells.values[k] else ''}, "
            if name in wanted.measured:
                readings.notes.append(f"{counted(off, 'value')} left out: {said}sensor off ({first})")
                values[off] = np.nan
            else:
                readings.complaints.append(f"{said}{first}, where others are far away: sensor off")
            bad = bad & ~off if name in wanted.measured else bad | off
        elif wrong.any():
            complaint = _complaint(table, series, column, unit, wrong, cells.marked, cells.values)
            impossible = wrong & ~missing & np.isfinite(values)
            if 2 * impossible.sum() > np.isfinite(values).sum():  # the unit is wrong, not some readings
                table.problems.append(complaint)
                del readings.units[name]
            else:
                readings.complaints.append(complaint)
        if series.units is TRAVEL and name not in how.units:
            numbers = cells.values[~bad]
            meant, _ = plausibility.signal_of(numbers, unit)
            said = f"{name} is from {numbers.min():.3g} to {numbers.max():.3g}, read in {unit}" if meant else ""
            cure = f"write '[{meant}]' in the header, or {how.unit_cure(name, meant)}"
            table.notes += [f"{said}: if it is a signal in {meant}, {cure}"] if meant else []
        readings.known[name], readings.bad[name], readings.missing[name] = values, bad, missing
    return readings


def question_units(table: Table, readings: Readings, found: Mapping[str, int], how: Reading) -> None:
    """Make a problem of each unit that the numbers contradict, and of set-point and temperature exchanged."""
    trusted = {name for name in how.units if name in found and table.declared_units(found[name])}
    values = {name: np.where(readings.missing[name], np.nan, readings.known[name]) for name in readings.units}
    for name, meant in plausibility.misread_units(values, readings.units, trusted).items():
        unit, k = readings.units[name], int(np.argmax(np.isfinite(values[name])))
        cell, row = shown(table.rows[k][found[name]].strip()), table.row_numbers[k]
        table.problems.append(
            f"{name} = {cell} in row {row} is declared in {unit}, and {plausibility.looks_like(meant)}: "
            f"{table.cure_of_unit(found[name], meant)}; if {unit} is right, declare it in the log and "
            f"with {how.unit_cure(name, unit)}"
        )
    for name in sorted({"T_sup", "T_set", "T_a_in"} & values.keys() - trusted):
        if k := plausibility.row_of_new_unit(values[name]):
            row = table.row_numbers[k]
            table.problems.append(f"{name} jumps in row {row} as if °C and °F were in one column: write one unit")
    if "command" in values.keys() - trusted:
        scale, offset = TRAVEL[readings.units["command"]]
        command = (values["command"] - offset) / scale
        if k := plausibility.row_of_new_scale(command) if scale == TRAVEL["%"][0] else 0:
            row = table.row_numbers[k]
            table.problems.append(f"command goes on in row {row} as if in another unit than before: write one unit")
        if k := plausibility.row_of_exchange(values["T_sup"], command) if "T_sup" in values else 0:
            row = table.row_numbers[k]
            table.problems.append(f"T_sup and command go on exchanged in row {row}: write one order of columns")
    other = plausibility.exchanged_with_supply(values) if not table.problems else ""
    if other and not {"T_sup", other} <= trusted:
        table.problems.append(
            f"T_sup, first in row {table.row_numbers[0]}, is outside what air and water enter with, as if {other} and "
            "it were exchanged: exchange the two headers, or check both sensors"
        )
    if {"T_sup", "T_set"} <= values.keys() and plausibility.are_exchanged(values["T_sup"], values["T_set"]):
        k = int(np.argmax(np.diff(values["T_set"]) != 0.0)) + 1
        table.problems.append(
            f"T_set changes in most rows (first in row {table.row_numbers[k]}) while T_sup is constant, as if they "
            "were exchanged: exchange the two headers; if they are right, log T_sup in finer steps"
        )


def refuse_supersaturation(table: Table, readings: Readings, constants: Mapping[str, float]) -> None:
    """Air above saturation is a bad value of its humidity, and a problem where most rows have it."""
    known: dict[str, Any] = {**constants, **readings.known}
    name, above = plausibility.above_saturation(known)
    if not above.any():
        return
    rows = name if name in readings.known else "T_a_in"
    if rows in readings.known:
        above &= ~(readings.bad[rows] | readings.bad.get("T_a_in", False))
    k, n_rows = int(np.argmax(above)), len(table.rows)
    humidity, T = (float(np.broadcast_to(known[one], n_rows)[k]) for one in (name, "T_a_in"))
    unit = COLUMNS[name].unit
    said = (
        f"{name} = {humidity:.4g}{' kg/kg' if unit == '1' else f' {unit}'} in row {table.row_numbers[k]} is above "
        f"saturation at T_a_in = {T:.4g} degC: check the units of both, or give the values that belong together"
        f"{in_total(int(above.sum()))}"
    )
    if rows not in readings.known or 2 * above.sum() > n_rows:
        table.problems.append(said)
    elif above.any():
        readings.complaints.append(said)
        readings.bad[rows] = readings.bad[rows] | above


def read_numbers(table: Table, series: Series, column: int, unit: str | None = None) -> Array:
    """A column as checked numbers in our unit, (n_rows,), else problems; ``unit``: of a header without one."""
    cells = cells_of([row[column] for row in table.rows], _writing(table, {series.name: column}), switch=False)
    known = _unit_of(table, series, column, unit, cells, False)
    if known is not None:
        values = series.convert(cells.values, known)
        bad = series.is_bad(values)
        if not bad.any():
            return values
        table.problems.append(_complaint(table, series, column, known, bad, cells.marked, cells.values))
    return np.arange(len(table.rows), dtype=np.float64)


def _writing(table: Table, columns: Mapping[str, int]) -> Writing:
    """How the numbers of the table are written; a problem if that is ambiguous."""
    writing = writing_of(([row[column] for row in table.rows] for column in columns.values()), table.separator)
    if writing.unclear:
        table.problems.append(
            f"a number such as {writing.unclear!r} may mean {writing.unclear.replace(',', '')} or "
            f"{writing.unclear.replace(',', '.')}: write decimal points and no separators of thousands"
        )
        table.stop_if_wrong()
    if writing.note and writing.note not in table.notes:
        table.notes.append(writing.note)
    return writing


def _unit_of(
    table: Table, series: Series, column: int, given: str | None, cells: Cells, has_command: bool
) -> str | None:
    """Unit of a column: by its header, the row below it, its cells, or ``given``; None, and a problem, without one."""
    numbers = np.flatnonzero(~np.isnan(cells.values)).tolist()
    by_cells = next(iter(cells.units.values()), "") if 2 * len(cells.units) >= len(numbers) else ""
    declared = table.declared_units(column) | ({"by units": given} if given else {})
    units = [*declared.items(), *([("by its cells", by_cells)] if by_cells else [])]
    if not units and series.units is not NUMBER:
        cure = f"{table.cure_of_unit(column, 'UNIT')}, or pass units={{{series.name!r}: 'UNIT'}}"
        cure += f", --unit {series.name}='UNIT'" * has_command
        table.problems.append(f"{series.name} has no unit: {cure} ({series.known_units})")
        return None
    source, unit = units[0] if units else ("", "1")
    with collecting(table.problems):
        found = series.spelled(unit)
        for other, second in units[1:]:
            if not series.is_same_unit(unit, second):
                raise InputError(f"{series.name} is in {shown(unit)} {source}, in {shown(second)} {other}: drop one")
        odd = [k for k, text in cells.units.items() if not series.is_same_unit(text, unit)]
        if not by_cells:
            cells.values[odd] = np.nan  # a number with another unit among others is no number of this column
            return found
        odd += [] if declared else [k for k in numbers if k not in cells.units]
        if odd:
            cell, row = shown(table.rows[odd[0]][column]), table.row_numbers[odd[0]]
            raise InputError(f"{series.name} = {cell} in row {row}: others are in {shown(by_cells)}, write one unit")
        table.notes.append(f"{series.name} is in {shown(by_cells)} by its cells")
        return found
    return None


def _complaint(table: Table, series: Series, column: int, unit: str, bad: Mask, marked: Mask, numbers: Array) -> str:
    """A sentence on the first ``bad`` cell of a column in ``unit``: its row, how many there are, and the cure."""
    i, n_bad = int(np.argmax(bad)), int(bad.sum())
    if np.isfinite(numbers[i]) and not marked[i]:
        return series.sentence(float(numbers[i]), f" in row {table.row_numbers[i]}", n_bad, unit)
    status = ", bad by its status" if marked[i] else ""
    return (
        f"{series.name} = {shown(table.rows[i][column].strip())} in row {table.row_numbers[i]}{status}: give a number "
        f"with a decimal point, or fill or cut the gap{in_total(n_bad)}"
    )


def _at_bounds(table: Table, series: Series, values: Array, notes: list[str]) -> Array:
    """A valve that reads 100.3 %, a flow meter that reads a little less than 0: taken as the bound, and counted."""
    bad = series.is_bad(values)
    if bad.all() or not bad.any():
        return values
    slack = _SCATTER * np.ptp(values[~bad])
    near = bad & (values >= series.lower - slack) & (values <= series.upper + slack)
    if near.any():
        what, first = f"{counted(near, 'value')} of {series.name}", first_row(table.row_numbers, near)
        notes.append(f"{what} just outside the possible range: taken as its bound ({first})")
    return np.where(near, np.clip(values, series.lower, series.upper), values)


def _sensor_off(series: Series, numbers: Array, values: Array) -> Mask:
    """Where a temperature reads exactly 0 in its own unit, and nearly all others are far above freezing; or leaps."""
    zero: Mask = (numbers == 0.0) & (series.units is TEMPERATURE)
    others = values[~zero & ~series.is_bad(values)]
    zero &= not others.size or float(np.quantile(others, 0.01)) >= _WARM
    if series.units is TEMPERATURE and not series.hold:
        zero |= plausibility.sensor_faults(np.where(series.is_bad(values), np.nan, values))
    return zero


def fill_or_cut(
    table: Table, readings: Readings, time: Array, how: Reading, wanted: Wanted, longest: float, *, stamped: bool
) -> tuple[dict[str, Array], Array]:
    """The columns, and the time, of the rows that are left; the table is cut to the same rows.

    A bad value of a measured column becomes NaN.  An input that is missing in one row alone is bridged; rows with any
    other bad value are cut.  All that is a problem of the table unless ``drop`` is true.  time: of the rows [s], NaN
    where it is bad.  longest: step over which an input is bridged [s].  stamped: whether the time is from timestamps.
    """
    known, bad = readings.known, dict(readings.bad)
    if table.problems or (readings.complaints and not how.drop):
        readings.refuse(table, how)
        return known, time
    for name in [n for n in wanted.measured if n in bad]:
        lost = bad.pop(name)
        known[name][lost] = np.nan
        if lost.any():
            readings.notes.append(left_out(table, name, lost, "value"))
        if lost.all():
            raise InputError(f"{table.name}: {name} has no admissible number: check its unit")
    if stamped:
        bad = {"timestamp": np.isnan(time)} | bad
    if how.drop:
        _bridge(table, readings, bad, time, wanted.measured, longest)
    readings.notes += [left_out(table, name, lost, "row") for name, lost in bad.items() if lost.any()]
    kept = ~np.any(list(bad.values()), axis=0)
    if kept.all():
        return known, time
    table.take(np.flatnonzero(kept).tolist())
    if len(table.rows) < 2:
        raise InputError(f"{table.name}: fewer than two rows are left: mend the log ({'; '.join(readings.notes)})")
    return {name: values[kept] for name, values in known.items()}, time[kept]


def _bridge(
    table: Table, readings: Readings, bad: dict[str, Mask], time: Array, measured: Collection[str], longest: float
) -> None:
    """Fill an input that is missing in one row, from the rows before and after; and take it out of ``bad``."""
    usable = ~np.any([bad[name] for name in ("timestamp", "elapsed_time", "batch") if name in bad], axis=0)
    steps = np.where(usable[1:] & usable[:-1], np.diff(time), np.inf)
    near = (steps > 0.0) & (steps <= longest)
    if "batch" in readings.known:
        near &= np.diff(readings.known["batch"]) == 0.0
    between = np.zeros(time.size, dtype=bool)
    between[1:-1] = near[1:] & near[:-1]
    for name in [n for n in readings.known if n not in (*measured, "elapsed_time", "batch")]:
        values, lost = readings.known[name], bad[name]
        filled = lost & readings.missing[name] & between
        filled[1:-1] &= ~lost[2:] & ~lost[:-2]
        holes = np.flatnonzero(filled)
        if not holes.size:
            continue
        held = COLUMNS[name].hold
        share = 0.0 if held else (time[holes] - time[holes - 1]) / (time[holes + 1] - time[holes - 1])
        values[holes] = values[holes - 1] + share * (values[holes + 1] - values[holes - 1])
        lost &= ~filled
        how = "held" if held else "on a straight line between its neighbours"
        first = first_row(table.row_numbers, filled)
        readings.notes.append(f"{counted(filled, 'missing value')} of {name} bridged: {how} ({first})")


def left_out(table: Table, name: str, lost: Mask, noun: str) -> str:
    """A note on what was left out."""
    first = first_row(table.row_numbers, lost)
    return f"{counted(lost, noun)} left out: {name} is not an admissible number ({first})"
