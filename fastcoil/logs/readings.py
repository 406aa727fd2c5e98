"""The cells of a column as checked numbers in our unit; bad ones are refused, or left out and counted."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fastcoil.arrays import Array, Mask
from fastcoil.errors import InputError, shown
from fastcoil.logs.arguments import Declared, Wanted
from fastcoil.logs.columns import find_unit
from fastcoil.logs.notes import counted, first_row
from fastcoil.logs.series import COLUMNS, Series, in_total
from fastcoil.logs.table import Table
from fastcoil.logs.time import timestamp_of
from fastcoil.logs.units import TEMPERATURE

_SCATTER = 0.02
"""Readings up to this share of the column's span outside a bound are taken as the bound."""
_WARM = 5.0
"""A temperature of exactly 0 among others above this, °C, is a sensor that is off."""


def read_columns(
    table: Table, found: Mapping[str, int], declared: Declared, wanted: Wanted, drop: bool | None, *, strict: bool
) -> tuple[dict[str, Array], list[str]]:
    """Every column ``found`` but ``timestamp`` as numbers in our units, (n,), and notes on what was left out.

    A bad value of a measured column becomes NaN; rows with any other bad value are cut from the table.  Both are
    problems of the table unless ``drop`` is true; None where the caller does not offer it.  With ``strict``,
    readings just outside a bound are bad values too, and a temperature of 0 never means a sensor that is off.
    """
    known: dict[str, Array] = {}
    bad: dict[str, Mask] = {}
    notes: list[str] = []
    complaints: list[str] = []
    for name, column in found.items():
        if name == "timestamp":
            bad[name] = np.array([bool(drop) and timestamp_of(row[column]) is None for row in table.rows])
            continue
        series = COLUMNS[name]
        option = f", --unit {name}='{series.unit}'" if declared.has_command else ""
        unit = find_unit(table, series, column, declared.units.get(name), option)
        if unit is None:
            continue
        values = _convert(table, series, column, unit)
        if series.scatters and not strict:
            values = _at_bounds(table, series, values, notes)
        known[name], bad[name] = values, series.is_bad(values)
        off = np.zeros(values.size, dtype=bool) if strict else _sensor_off(table, series, column, values)
        if off.any() and name in wanted.measured:
            first = first_row(table.row_numbers, off)
            notes.append(f"{counted(off, 'value')} left out: {name} is 0, sensor off ({first})")
            bad[name] &= ~off
            values[off] = np.nan
        elif off.any():
            first = first_row(table.row_numbers, off)
            complaints.append(f"{name} is 0, {first}, where others are far above: sensor off")
            bad[name] |= off
        elif bad[name].any():
            complaints.append(_complaint(table, series, column, unit, bad[name]))
    if complaints and not drop:
        if drop is not None:
            complaints[-1] += f"; or leave such rows out and count them: {declared.cure('drop=True', '--drop')}"
        table.problems += complaints
        return known, notes
    _drop_measured(table, known, bad, wanted, notes)
    return _drop_rows(table, known, bad, notes), notes


def read_numbers(table: Table, series: Series, column: int, unit: str | None = None) -> Array:
    """A column as checked numbers in our unit, (n_rows,); ``unit`` is for a header that declares none.

    Anything wrong is added to the problems; the numbers then mean nothing.
    """
    nothing = np.arange(len(table.rows), dtype=np.float64)
    known = find_unit(table, series, column, unit)
    if known is None:
        return nothing
    values = _convert(table, series, column, known)
    bad = series.is_bad(values)
    if bad.any():
        table.problems.append(_complaint(table, series, column, known, bad))
        return nothing
    return values


def _convert(table: Table, series: Series, column: int, unit: str) -> Array:
    """A column in our unit, (n_rows,), NaN where a cell is no number; the values are not yet checked."""
    cells = [_number(row[column]) for row in table.rows]
    return series.convert(np.array([np.nan if cell is None else cell for cell in cells]), unit)


def _complaint(table: Table, series: Series, column: int, unit: str, bad: Mask) -> str:
    """A sentence on the first ``bad`` cell of a column in ``unit``: its row, how many there are, and the cure."""
    i, n_bad = int(np.argmax(bad)), int(bad.sum())
    cell, row = table.rows[i][column], table.row_numbers[i]
    value = _number(cell)
    if value is not None:
        return series.sentence(value, f" in row {row}", n_bad, unit)
    what = f"= {shown(cell)}" if cell.strip() else "is blank"
    cure = "give a number with a decimal point, or fill or cut the gap"
    return f"{series.name} {what} in row {row}: {cure}{in_total(n_bad)}"


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


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


def _sensor_off(table: Table, series: Series, column: int, values: Array) -> Mask:
    """Where a temperature reads exactly 0 in its own unit, and nearly all others are far above freezing."""
    nowhere = np.zeros(values.size, dtype=bool)
    if series.units is not TEMPERATURE:
        return nowhere
    zero = np.array([_number(row[column]) == 0.0 for row in table.rows])
    others = values[~zero & ~series.is_bad(values)]
    return zero if zero.any() and others.size and np.quantile(others, 0.01) >= _WARM else nowhere


def _drop_measured(
    table: Table, known: dict[str, Array], bad: dict[str, Mask], wanted: Wanted, notes: list[str]
) -> None:
    """Make the bad values of measured columns NaN, and take them out of ``bad``."""
    for name in [n for n in wanted.measured if n in bad]:
        lost = bad.pop(name)
        if lost.any():
            notes.append(_left_out(table, name, lost, "value"))
            known[name][lost] = np.nan
        if np.isnan(known[name]).all():
            raise InputError(f"{table.name}: {name} has no admissible number: check its unit")


def _drop_rows(table: Table, known: dict[str, Array], bad: Mapping[str, Mask], notes: list[str]) -> dict[str, Array]:
    """The columns without the rows in which one of them is bad; these are cut from the table too."""
    notes += [_left_out(table, name, lost, "row") for name, lost in bad.items() if lost.any()]
    kept = ~np.any(list(bad.values()), axis=0)
    if kept.all():
        return known
    table.keep(kept)
    if len(table.rows) < 2:
        raise InputError(f"{table.name}: fewer than two rows are left: mend the log ({'; '.join(notes)})")
    return {name: values[kept] for name, values in known.items()}


def _left_out(table: Table, name: str, lost: Mask, noun: str) -> str:
    first = first_row(table.row_numbers, lost)
    return f"{counted(lost, noun)} left out: {name} is no admissible number ({first})"
