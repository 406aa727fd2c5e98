"""The time of a log: how it is written, where it jumps or has gaps, and the unbroken pieces between.

New formats of a time go into `timestamp_of`.  A lag between two columns is to be sought piece by piece, as
`number_pieces` numbers them.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import NamedTuple

import numpy as np

from fastcoil.arrays import Array, Index, Mask
from fastcoil.errors import shown
from fastcoil.logs.notes import counted
from fastcoil.logs.table import Table

_LONG_STEP = 3.0
"""Steps longer than this many median steps are gaps."""
_MANY = 0.1
"""If more than this share of the steps go back in time, the log is out of order."""


class TimeRules(NamedTuple):
    """What to do where time does not simply go on.

    jumps: ``refuse`` time that goes back or stands still within a batch, or ``split`` the batch there; None where the
    caller does not offer it.  max_gap: longest step that ends no piece, s; None for three times the median step.
    unbroken: refuse a log of more than one piece.  jumps_cure: how to ask for ``split``.
    """

    jumps: str | None
    max_gap: float | None
    unbroken: bool
    jumps_cure: str


def timestamp_of(cell: str) -> datetime | None:
    """The time in a cell (ISO 8601), or None."""
    try:
        return datetime.fromisoformat(cell.strip())
    except ValueError:
        return None


def seconds_of(table: Table, found: Mapping[str, int], known: dict[str, Array]) -> Array | None:
    """Time of every row, s, (n_rows,), taken out of ``known`` or from timestamps; None if a row has none."""
    if "timestamp" in found:
        return _seconds_since_first(table, found["timestamp"])
    time = known.pop("elapsed_time", None)
    return time if time is not None and np.isfinite(time).all() else None


def _seconds_since_first(table: Table, column: int) -> Array | None:
    times: list[datetime] = []
    for row, number in zip(table.rows, table.row_numbers, strict=True):
        time = timestamp_of(row[column])
        if time is None:
            wrong = "is not ISO 8601: write it as 2024-07-01T08:00:00"
        else:
            times.append(time)
            if time.utcoffset() == times[0].utcoffset():
                continue
            wrong = "has another UTC offset than the first: write one time zone, without daylight saving"
        table.problems.append(f"timestamp = {shown(row[column])} in row {number} {wrong}")
        return None
    return np.array([(time - times[0]).total_seconds() for time in times])


def number_pieces(table: Table, time: Array, batch: Array | None, rules: TimeRules, notes: list[str]) -> Index:
    """Number of the unbroken piece of each row, (n_rows,), from 0.

    A new piece starts where ``batch`` changes, after a gap, and after a jump.  What is not allowed becomes a problem of
    the table.
    """
    steps, rows = np.diff(time), table.row_numbers
    new = np.zeros(steps.size, dtype=bool) if batch is None else np.diff(batch) != 0.0
    back = (steps <= 0.0) & ~new
    if back.any() and rules.jumps != "split":
        table.problems.append(_backward(steps, back, rows, rules))
        return np.zeros(time.size, dtype=np.int64)
    if back.any():
        notes.append(f"time goes back or stands still {counted(back, 'time')}: the record starts again there")
    forward = steps[~new & ~back]
    median = float(np.median(forward)) if forward.size else np.inf
    gaps = ~new & ~back & (steps > (rules.max_gap or _LONG_STEP * median))
    if rules.unbroken and (new | gaps).any():
        table.problems.append(_broken(steps, new, gaps, median, rows))
    elif gaps.any():
        k = int(np.argmax(gaps))
        notes.append(
            f"{counted(gaps, 'gap')} in time (first: {steps[k]:g} s between rows {rows[k]} and {rows[k + 1]}): "
            "the record starts again after each"
        )
    return np.concatenate([[0], np.cumsum(new | back | gaps)])


def _backward(steps: Array, back: Mask, rows: list[int], rules: TimeRules) -> str:
    """Where time first goes back, how often it does, and the cure."""
    k, times = int(np.argmax(back)), int(back.sum())
    what = "is at the same time as" if steps[k] == 0.0 else "is earlier than"
    cure = "sort the rows and drop doubles"
    if rules.jumps is not None:
        cure += f", or let the record start again there: {rules.jumps_cure}"
    if times > 1 and back.mean() > _MANY:
        cure = "give every row a time of its own, to the second, and sort the rows, oldest first"
    more = f" ({times} such rows)" if times > 1 else ""
    return f"elapsed_time: row {rows[k + 1]} {what} row {rows[k]}{more}: {cure}"


def _broken(steps: Array, new: Mask, gaps: Mask, median: float, rows: list[int]) -> str:
    """Where a log that should be one piece breaks, and the cure."""
    if new.any():
        k = int(np.argmax(new))
        return f"batch changes between rows {rows[k]} and {rows[k + 1]}: give the rows of one batch only"
    k = int(np.argmax(np.where(gaps, steps, 0.0)))
    gap, ends = f"{steps[k]:g}", f"{rows[k]} and {rows[k + 1]}"
    return (
        f"rows {ends} are {gap} s apart, others {median:g} s: fill the gap, cut the log, "
        f"or pass max_gap={gap} to bridge it"
    )
