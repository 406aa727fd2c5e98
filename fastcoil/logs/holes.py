"""What becomes of a log's bad values: measured ones are left out, single missing inputs bridged, other rows cut."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs.arguments import Declared, Wanted
from fastcoil.logs.notes import counted, first_row
from fastcoil.logs.readings import Readings
from fastcoil.logs.series import COLUMNS
from fastcoil.logs.table import Table

_SPARSE, _FEWEST_HOLES = 0.2, 10
"""If more than this share of a column's cells is missing, the points may be logged each at its own times."""


def fill_or_cut(
    table: Table,
    readings: Readings,
    time: Array,
    declared: Declared,
    wanted: Wanted,
    drop: bool | None,
    longest: float,
    *,
    stamped: bool,
) -> tuple[dict[str, Array], Array]:
    """The columns, and the time, of the rows that are left; the table is cut to the same rows.

    A bad value of a measured column becomes NaN.  An input that is missing in one row alone is bridged; rows with any
    other bad value are cut.  All that is a problem of the table unless ``drop`` is true; None where the caller does not
    offer it.

    Parameters
    ----------
    time
        Of the rows [s], NaN where it is bad.
    longest
        Longest step over which an input is bridged [s].
    stamped
        Whether the time is from timestamps.
    """
    known, bad = readings.known, dict(readings.bad)
    if readings.complaints and not drop:
        if drop is not None:
            cure = declared.cure("drop=True", "--drop")
            readings.complaints[-1] += f"; or leave such values out and count them: {cure}"
        table.problems += readings.complaints + _sparse(readings)
        return known, time
    _drop_measured(table, known, bad, wanted, readings.notes)
    if stamped:
        bad = {"timestamp": np.isnan(time)} | bad
    if drop:
        _bridge(table, readings, bad, time, wanted.measured, longest)
    return _drop_rows(table, known, bad, time, readings.notes)


def _sparse(readings: Readings) -> list[str]:
    shares = {name: float(missing.mean()) for name, missing in readings.missing.items()}
    worst = max(shares, key=lambda name: shares[name])
    if shares[worst] <= _SPARSE or readings.missing[worst].sum() < _FEWEST_HOLES:
        return []
    return [
        f"{worst} is missing in {100 * shares[worst]:.0f} % of the rows: if each point is logged at its own times, put "
        "them on one clock first, with fastcoil join"
    ]


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
        sound = np.zeros(time.size, dtype=bool)
        sound[1:-1] = ~lost[2:] & ~lost[:-2]
        holes = np.flatnonzero(lost & readings.missing[name] & between & sound)
        if not holes.size:
            continue
        held = COLUMNS[name].hold
        share = 0.0 if held else (time[holes] - time[holes - 1]) / (time[holes + 1] - time[holes - 1])
        values[holes] = values[holes - 1] + share * (values[holes + 1] - values[holes - 1])
        filled = np.zeros(time.size, dtype=bool)
        filled[holes] = True
        lost &= ~filled
        how = "held" if held else "on a straight line between its neighbours"
        first = first_row(table.row_numbers, filled)
        readings.notes.append(f"{counted(filled, 'missing value')} of {name} bridged: {how} ({first})")


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


def _drop_rows(
    table: Table, known: dict[str, Array], bad: dict[str, Mask], time: Array, notes: list[str]
) -> tuple[dict[str, Array], Array]:
    """The columns without the rows in which one of them is bad; these are cut from the table too."""
    notes += [_left_out(table, name, lost, "row") for name, lost in bad.items() if lost.any()]
    kept = ~np.any(list(bad.values()), axis=0)
    if kept.all():
        return known, time
    table.keep(kept)
    if len(table.rows) < 2:
        raise InputError(f"{table.name}: fewer than two rows are left: mend the log ({'; '.join(notes)})")
    return {name: values[kept] for name, values in known.items()}, time[kept]


def _left_out(table: Table, name: str, lost: Mask, noun: str) -> str:
    first = first_row(table.row_numbers, lost)
    return f"{counted(lost, noun)} left out: {name} is no admissible number ({first})"
