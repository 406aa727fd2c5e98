"""A log to fit to: a CSV file or a Dataset as checked arrays in our units, with what was left out counted.

Same CSV format as a trend log, see ``fastcoil.boundary.trends``: the header names each column and its unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastcoil.boundary.conditions import require
from fastcoil.boundary.series import Array
from fastcoil.boundary.table import Table
from fastcoil.boundary.trends import seconds_since_first
from fastcoil.calibrate.columns import COLUMNS, checked, counted, found_columns, require_mappings
from fastcoil.calibrate.dataset import table_of
from fastcoil.errors import InputError

_LONG_STEP = 3.0
"""Steps longer than this many median steps are gaps."""
_MANY = 0.1
"""Share of the steps back in time from which on they are no mishap."""


@dataclass
class Log:
    """Checked columns by name, (n,) each in the units of ``COLUMNS``; measured ones are NaN where a value was bad.

    names: of the log, and of the one to validate with if there is one.  log: which of them a sample belongs to, 0 or
    1.  time: seconds since the first row of that.  batch: number of the unbroken piece that a sample belongs to, from
    0 on.  rows: where each sample stands in its file.  notes: what was left out, and why.
    """

    names: tuple[str, ...]
    log: NDArray[np.int64]
    time: Array
    values: dict[str, Array]
    batch: NDArray[np.int64]
    rows: NDArray[np.int64]
    notes: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        return self.names[0]

    @property
    def step(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def n_batches(self) -> int:
        return int(self.batch[-1]) + 1

    def since_batch(self) -> Array:
        """Seconds since the batch of each sample began, (n,)."""
        began = np.searchsorted(self.batch, np.arange(self.n_batches))
        return self.time - self.time[began][self.batch]

    def followed_by(self, other: Log) -> Log:
        """The samples of both: ``other`` is to validate with, in batches of its own."""
        name = other.name if other.name != self.name else f"{other.name} (validation)"
        uneven = (self.values.keys() ^ other.values.keys()) - {"T_w_out"}
        if uneven:
            raise InputError(f"{self.name} or {name} has no {', '.join(sorted(uneven))}: log the same in both")
        values = {
            column: np.concatenate([log.values.get(column, np.full(log.time.size, np.nan)) for log in (self, other)])
            for column in self.values | other.values
        }
        return Log(
            (*self.names, name),
            np.concatenate([self.log, other.log + 1]),
            np.concatenate([self.time, other.time]),
            values,
            np.concatenate([self.batch, other.batch + self.n_batches]),
            np.concatenate([self.rows, other.rows]),
            self.notes + [f"{name}: {note}" for note in other.notes],
        )

    def where(self, kept: NDArray[np.bool_]) -> Log:
        """The samples that are ``kept``, (n,); where some are left out a batch ends."""
        index = np.flatnonzero(kept)
        new = (np.diff(index) > 1) | (np.diff(self.batch[index]) > 0)
        return Log(
            self.names,
            self.log[kept],
            self.time[kept],
            {name: values[kept] for name, values in self.values.items()},
            np.concatenate([[0], np.cumsum(new)]),
            self.rows[kept],
            self.notes,
        )


def read_log(
    source: Any,
    needed: Sequence[str | tuple[str, ...]],
    *,
    measured: Sequence[str] = (),
    optional: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, float] | None = None,
    drop: bool | None = None,
    jumps: str | None = None,
    max_gap: float | None = None,
) -> Log:
    """Read a log and check every number.

    Parameters
    ----------
    source
        Path of a CSV file, or an ``xarray.Dataset`` along ``elapsed_time`` (or ``timestamp``, of datetime64) with
        units as attributes.
    needed
        Names that must be there; of a tuple exactly one.
    measured
        The needed or optional names that are outputs of the model: dropped ones become NaN, their row stays.
    units, columns, constants
        As in ``fc.Boundary.from_csv``.
    drop
        Whether rows with a blank, NaN or impossible value are left out (and counted) instead of refused; None where
        the caller does not offer it.
    jumps
        ``refuse`` time that goes back or stands still within a batch, or ``split`` the batch there; None where the
        caller does not offer it.
    max_gap
        Longest step that does not end a batch [s]; three times the median step if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake: column, row, cure.
    """
    if jumps not in ("refuse", "split", None):
        raise InputError(f"jumps = {jumps!r}: choose 'refuse' or 'split'")
    require(max_gap=max_gap)
    require_mappings(columns=columns, units=units, constants=constants)
    if isinstance(source, (str, Path)):
        table = Table.read(source)
        table.unit_cure += ", --unit {name}='{unit}'"
    else:
        table = table_of(source, columns, COLUMNS)
    units, constants = dict(units or {}), dict(constants or {})
    found = found_columns(table, columns, units, constants, needed, optional)
    table.stop_if_wrong()
    known, notes = checked(table, found, units, measured, drop)
    table.stop_if_wrong()
    if "timestamp" in found:
        known["elapsed_time"] = seconds_since_first(table, found["timestamp"])
    time = known.pop("elapsed_time")
    batch = _batches(table, time, known.pop("batch", None), jumps, max_gap, notes)
    table.stop_if_wrong()
    known |= {name: np.full(time.size, float(value)) for name, value in constants.items()}
    rows = np.array(table.row_numbers)
    return Log((table.path.name,), np.zeros_like(rows), np.round(time - time[0], 6), known, batch, rows, notes)


def _batches(
    table: Table, time: Array, given: Array | None, jumps: str | None, max_gap: float | None, notes: list[str]
) -> NDArray[np.int64]:
    """Number of the unbroken piece of each row: a new one where ``batch`` changes, after a gap, after a jump."""
    steps, rows = np.diff(time), table.row_numbers
    new = np.zeros(steps.size, dtype=bool) if given is None else np.diff(given) != 0.0
    back = (steps <= 0.0) & ~new
    if back.any() and jumps != "split":
        k = int(np.argmax(back))
        what = "is at the same time as" if steps[k] == 0.0 else "is earlier than"
        cure = "sort the rows and drop doubles"
        cure += ", or begin anew there: jumps='split', --jumps split" if jumps else ""
        if back.mean() > _MANY:
            cure = "give every row a time of its own, to the second, and sort the rows, oldest first"
        table.problems.append(f"elapsed_time: row {rows[k + 1]} {what} row {rows[k]} ({int(back.sum())} such): {cure}")
        return np.zeros(time.size, dtype=np.int64)
    if back.any():
        notes.append(f"time goes back or stands still {counted(back, 'time')}: begun anew there")
    forward = steps[~new & ~back]
    longest = max_gap or _LONG_STEP * (np.median(forward) if forward.size else np.inf)
    gaps = ~new & ~back & (steps > longest)
    if gaps.any():
        k = int(np.argmax(gaps))
        notes.append(
            f"{counted(gaps, 'gap')} in time (first: {steps[k]:g} s between rows {rows[k]} and {rows[k + 1]}): "
            "begun anew after each"
        )
    return np.concatenate([[0], np.cumsum(new | back | gaps)])
