"""The columns of a log as checked numbers in our units; what is bad is refused, or left out and counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastcoil.arguments import is_number
from fastcoil.boundary.series import TEMPERATURE, TRAVEL, WATER_FLOW, Array, Series
from fastcoil.boundary.table import Table, label_and_unit
from fastcoil.boundary.trends import LOG_COLUMNS
from fastcoil.errors import InputError, shown

COLUMNS: dict[str, Series] = LOG_COLUMNS | {
    s.name: s
    for s in (
        Series("command", "command to the valve", TRAVEL, 0.0, 1.0, hold=True),
        Series("m_w", "water flow", WATER_FLOW, 0.0, 1000.0),
        Series("T_sup", "supply air temperature", TEMPERATURE, -40.0, 100.0),
        Series("T_w_out", "leaving water temperature", TEMPERATURE, 0.1, 150.0),
        Series("batch", "number of the experiment", {"1": (1.0, 0.0)}, 0.0, 1e9, hold=True, whole=True),
    )
}
"""What a column of a log may be; besides, ``timestamp``."""
_NEEDS_NO_UNIT = ("batch", "enabled")
_SCATTERED, _SCATTER = ("command", "m_w", "m_a", "RH_a_in"), 0.02
"""Readings scatter about a bound: up to this share of what the column spans beyond it, they are taken as it."""
_WARM = 5.0
"""A temperature of exactly 0 among others that are above this, °C, is a sensor that is off."""
_CURE = "; or leave such rows out, they are counted: drop=True, --drop"
_MAPPINGS = {"columns": "{'m_w': 'its header'}", "units": "{'m_w': 'kg/s'}", "constants": "{'m_a': 1.2}"}

Mask = NDArray[np.bool_]


def require_mappings(**given: Any) -> None:
    """Raise one `InputError` for all of columns, units and constants that do not map names; None passes."""
    wrong = [
        f"{name} = {shown(value)}: give a mapping of names, such as {_MAPPINGS[name]}"
        for name, value in given.items()
        if value is not None and not _maps_names(value, to_text=name != "constants")
    ]
    if wrong:
        raise InputError(wrong)


def _maps_names(value: Any, *, to_text: bool) -> bool:
    if not isinstance(value, Mapping):
        return False
    return all(isinstance(text, str) for text in (*value, *(value.values() if to_text else ())))


def found_columns(
    table: Table,
    columns: Mapping[str, str] | None,
    units: Mapping[str, str],
    constants: Mapping[str, float],
    needed: Sequence[str | tuple[str, ...]],
    optional: Sequence[str],
) -> dict[str, int]:
    """Index of each column to read; unknown, missing and doubled ones, and bad constants, are problems."""
    names, columns_ = [*COLUMNS, "timestamp"], columns or {}
    wanted = [name for one in needed for name in ((one,) if isinstance(one, str) else one)] + [*optional]
    table.check_names("columns", columns_, names)
    table.check_names("units", units, COLUMNS)
    table.check_names("constants", constants, wanted)
    for name, series in COLUMNS.items():
        if name not in constants:
            continue
        value = constants[name]
        if not is_number(value) or series.is_bad(np.array([value], dtype=float))[0]:
            must = f"must be from {series.lower:g} to {series.upper:g} {series.unit}"
            table.problems.append(f"constants has {name} = {shown(value)}: {must}")
    cure = "or say what to read: columns={'m_w': 'its header', ...}, --column m_w='its header'"
    found = table.found(columns, names, cure)
    for one in [*needed, *optional, ("elapsed_time", "timestamp")]:
        choices = (one,) if isinstance(one, str) else one
        given = [name for name in choices if name in found] + [f"constant {n}" for n in choices if n in constants]
        asked = [name for name in choices if name in columns_]
        if len(given) > 1 and len(asked) == 1 and not any(n in constants for n in choices):
            for name in set(choices) - set(asked):
                found.pop(name, None)
        elif len(given) > 1:
            which = f", or say which to read: columns={{{given[0]!r}: 'its header'}}, --column {given[0]}='its header'"
            which = "" if any(n in constants for n in choices) else which
            table.problems.append(f"{' and '.join(given)} are both there: leave one out{which}")
        elif not given and one not in optional:
            unit = COLUMNS[choices[0]].unit
            table.problems.append(
                f"{' or '.join(choices)} is missing: add a column '{choices[0]} [{unit}]', or say which one it is: "
                f"columns={{{choices[0]!r}: 'its header'}}, --column {choices[0]}='its header'"
            )
    return {n: c for n, c in found.items() if n in (*wanted, "elapsed_time", "timestamp", "batch")}


def checked(
    table: Table, found: Mapping[str, int], units: Mapping[str, str], measured: Sequence[str], drop: bool | None
) -> tuple[dict[str, Array], list[str]]:
    """Every column ``found`` but ``timestamp`` as numbers in our units, (n,), and what was left out.

    A bad value of a ``measured`` column becomes NaN; rows with any other bad value are cut from the table.  Both are
    problems of the table unless ``drop`` says otherwise; None where that is not offered.
    """
    known: dict[str, Array] = {}
    bad: dict[str, Mask] = {}
    notes: list[str] = []
    complaints: list[str] = []
    for name, column in found.items():
        if name == "timestamp":
            bad[name] = np.array([bool(drop) and not _is_timestamp(row[column]) for row in table.rows])
            continue
        series = COLUMNS[name]
        declared = label_and_unit(table.header[column])[1]
        unit = table.unit(series, column, units.get(name, "1" if name in _NEEDS_NO_UNIT and not declared else None))
        if unit is None:
            continue
        values = table.values(series, column, unit)
        if name in _SCATTERED:
            values = _at_bounds(table, series, values, notes)
        bad[name], off = series.is_bad(values), _sensor_off(table, series, column, values)
        if name in measured and off.any():
            notes.append(f"{counted(off, 'value')} left out: {name} is 0, sensor off ({_first(table, off)})")
            bad[name] &= ~off
            values[off] = np.nan
        elif off.any():
            complaints.append(f"{name} is 0, {_first(table, off)}, where others are far above: sensor off")
        elif bad[name].any():
            complaints.append(table.complaint(series, column, unit, bad[name]))
        if name not in measured:
            bad[name] |= off
        known[name] = values
    if complaints and not drop:
        table.problems += [*complaints[:-1], complaints[-1] + ("" if drop is None else _CURE)]
        return known, notes
    for name in [n for n in measured if n in bad]:
        lost = bad.pop(name)
        if lost.any():
            notes.append(f"{counted(lost, 'value')} left out: {name} is no admissible number ({_first(table, lost)})")
            known[name][lost] = np.nan
        if np.isnan(known[name]).all():
            raise InputError(f"{table.path.name}: {name} has no admissible number: check its unit")
    return _kept(table, known, bad, notes), notes


def _kept(table: Table, known: dict[str, Array], bad: Mapping[str, Mask], notes: list[str]) -> dict[str, Array]:
    """The columns without the rows in which one of them is bad, which are cut from the table as well."""
    notes += [
        f"{counted(b, 'row')} left out: {name} is no admissible number ({_first(table, b)})"
        for name, b in bad.items()
        if b.any()
    ]
    keep = ~np.any(list(bad.values()), axis=0)
    if keep.all():
        return known
    table.rows = [row for row, k in zip(table.rows, keep, strict=True) if k]
    table.row_numbers = [number for number, k in zip(table.row_numbers, keep, strict=True) if k]
    if len(table.rows) < 2:
        raise InputError(f"{table.path.name}: fewer than two rows are left: mend the log ({'; '.join(notes)})")
    return {name: values[keep] for name, values in known.items()}


def counted(what: Mask | int, noun: str) -> str:
    """``1 row``, ``2 rows``; of a mask, how many it marks."""
    n = int(np.sum(what))
    return f"{n:,} {noun}{'' if n == 1 else 's'}"


def _first(table: Table, where: Mask) -> str:
    return f"first in row {table.row_numbers[int(np.argmax(where))]}"


def _at_bounds(table: Table, series: Series, values: Array, notes: list[str]) -> Array:
    """A valve that reads 100.3 %, a flow meter that reads a little less than 0: taken as the bound, and counted."""
    bad = series.is_bad(values)
    if bad.all() or not bad.any():
        return values
    slack = _SCATTER * np.ptp(values[~bad])
    near = bad & (values >= series.lower - slack) & (values <= series.upper + slack)
    if near.any():
        what = f"{counted(near, 'value')} of {series.name}"
        notes.append(f"{what} just outside what can be: taken as its bound ({_first(table, near)})")
    return np.where(near, np.clip(values, series.lower, series.upper), values)


def _sensor_off(table: Table, series: Series, column: int, values: Array) -> Mask:
    """Where a temperature reads exactly 0 in its own unit, and nearly all others are far above freezing."""
    zero = np.array([_reads_0(row[column]) for row in table.rows])
    others = values[~zero & ~series.is_bad(values)]
    if series.units is not TEMPERATURE or not zero.any() or not others.size or np.quantile(others, 0.01) < _WARM:
        return np.zeros(values.size, dtype=bool)
    return zero


def _reads_0(cell: str) -> bool:
    try:
        return float(cell) == 0.0
    except ValueError:
        return False


def _is_timestamp(cell: str) -> bool:
    try:
        datetime.fromisoformat(cell.strip())
    except ValueError:
        return False
    return True
