"""A log as checked arrays in our units, with notes on what was left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs.columns import Declared, Wanted, find_columns, max_gap_of, require_mappings
from fastcoil.logs.pieces import RowTimes, TimeRules, longest_bridged, number_pieces, rows_at
from fastcoil.logs.readings import fill_or_cut, read_columns
from fastcoil.logs.series import COLUMNS
from fastcoil.logs.table import Table, table_of
from fastcoil.logs.timestamps import time_format_of
from fastcoil.model import moist_air


@dataclass(kw_only=True)
class Log:
    """Checked columns by name, (n,) each in the units of ``COLUMNS``; measured ones are NaN where a value was bad.

    names: of the log, and of the second log for validation if there is one.  source: index in ``names`` of the log that
    each sample comes from.  time: seconds since the first row of that log.  batch: number of the unbroken piece that
    each sample belongs to, from 0.  rows: row number of each sample in its file.  notes: how it was read, what was left
    out, and why.  told: those of them on how it was read.  change_of_value: whether its rows were written when a value
    changed, so that values hold between them.  start: date and time of the first row of the first log, to the second,
    on the clock of ``time_zone``; None and blank if unknown.
    """

    names: tuple[str, ...]
    source: Index
    time: Array
    values: dict[str, Array]
    batch: Index
    rows: Index
    notes: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    change_of_value: bool = False
    start: np.datetime64 | None = None
    time_zone: str = ""

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
        """Seconds since the start of each sample's batch, (n,)."""
        first = np.searchsorted(self.batch, np.arange(self.n_batches))
        return self.time - self.time[first][self.batch]

    def humidity_ratio(self, pressure: float) -> Array:
        """Humidity ratio of the entering air, (n,): as logged, or from relative humidity or dew point [kg/kg].

        pressure: barometric pressure [Pa].
        """
        if "RH_a_in" in self.values:
            return moist_air.humidity_ratio(self.values["T_a_in"], self.values["RH_a_in"], pressure)
        if "T_dp_in" in self.values:
            return moist_air.humidity_ratio_from_dew_point(self.values["T_dp_in"], pressure)
        return self.values["W_a_in"]

    def followed_by(self, other: Log) -> Log:
        """The samples of both logs: those of ``other``, for validation, in batches of their own."""
        name = other.name if other.name != self.name else f"{other.name} (validation)"
        uneven = (self.values.keys() ^ other.values.keys()) - {"T_w_out"}
        if uneven:
            raise InputError(f"{self.name} or {name} has no {', '.join(sorted(uneven))}: log the same in both")
        values = {
            column: np.concatenate([log.values.get(column, np.full(log.time.size, np.nan)) for log in (self, other)])
            for column in self.values | other.values
        }
        return replace(
            self,
            names=(*self.names, name),
            source=np.concatenate([self.source, other.source + 1]),
            time=np.concatenate([self.time, other.time]),
            values=values,
            batch=np.concatenate([self.batch, other.batch + self.n_batches]),
            rows=np.concatenate([self.rows, other.rows]),
            notes=self.notes + [f"{name}: {note}" for note in other.notes],
            told=self.told + [f"{name}: {note}" for note in other.told],
        )

    def where(self, kept: Mask) -> Log:
        """The samples that are ``kept``, (n,); a batch ends where some are left out."""
        index = np.flatnonzero(kept)
        new = (np.diff(index) > 1) | (np.diff(self.batch[index]) > 0)
        return replace(
            self,
            source=self.source[kept],
            time=self.time[kept],
            values={name: values[kept] for name, values in self.values.items()},
            batch=np.concatenate([[0], np.cumsum(new)]),
            rows=self.rows[kept],
        )


def read_log(
    source: Any,
    wanted: Wanted,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, float] | None = None,
    drop: bool | None = None,
    jumps: str | None = None,
    max_gap: float | None = None,
    time_format: str | None = None,
    strict: bool = False,
    unbroken: bool = False,
    has_command: bool = False,
) -> Log:
    """Read a log and check every number.

    Parameters
    ----------
    source
        Path of a CSV file, or an ``xarray.Dataset`` along ``elapsed_time`` (or ``timestamp``, of datetime64) with
        units as attributes.
    wanted
        The series to read.
    units, columns, constants
        As in ``fc.Boundary.from_csv``; constants are None where the caller does not offer them.
    drop
        Whether blank, NaN and impossible values are left out (and counted) instead of refused: those of measured
        series become NaN, an input that is missing in one row alone is bridged, other rows with one are left out.  None
        where the caller does not offer it.
    jumps
        ``refuse`` time that goes back or stands still within a batch, or ``split`` the batch there; None where the
        caller does not offer it.
    max_gap
        Longest step that does not end a batch [s]; three times the median step if left out, and more in a log whose
        rows were written when a value changed.
    time_format
        How ``timestamp`` is written: a pattern as of strftime, ``excel`` for serial days, ``epoch`` for seconds or
        milliseconds since 1970; recognised if left out.
    strict
        Take every reading as it is, and refuse columns that are not wanted.  Else readings just outside a bound count
        as the bound, temperatures of a sensor that is off are found, and other known columns are ignored.
    unbroken
        Refuse gaps and changes of batch.
    has_command
        Whether a command of the same options exists, for the messages.

    Raises
    ------
    InputError
        With one sentence for each mistake: column, row, cure.
    """
    if jumps not in ("refuse", "split", None):
        raise InputError(f"jumps = {jumps!r}: choose 'refuse' or 'split'")
    max_gap = max_gap_of(max_gap)
    if time_format is not None:
        time_format = time_format_of("time_format", time_format)
    require_mappings(columns=columns, units=units, constants=constants)
    declared = Declared(columns=columns, units=units or {}, constants=constants, has_command=has_command)
    rules = TimeRules(
        jumps=jumps,
        max_gap=max_gap,
        unbroken=unbroken,
        jumps_cure=declared.cure("jumps='split'", "--jumps split"),
        gap_cure=declared.cure("max_gap", "--max-gap"),
    )
    table = Table.read(source) if isinstance(source, (str, Path)) else table_of(source, columns, COLUMNS)
    found = find_columns(table, declared, wanted, strict=strict)
    if time_format is not None and "timestamp" not in found:
        table.problems.append(f"time_format = {time_format!r}: it is for the column timestamp, which the log lacks")
    table.stop_if_wrong()
    readings, stamped = read_columns(table, found, declared, wanted, strict=strict), "timestamp" in found
    if stamped:
        at = rows_at(table, found["timestamp"], declared, time_format, drop)
    else:
        at = RowTimes(readings.known.get("elapsed_time", np.zeros(0)))
    time = at.since
    known = readings.known
    if time.size:
        longest = longest_bridged(time, max_gap)
        known, time = fill_or_cut(table, readings, time, declared, wanted, drop, longest, stamped=stamped)
        known.pop("elapsed_time", None)
    else:
        table.problems += readings.complaints
    pieces = None
    if time.size and np.isfinite(time).all():
        pieces = number_pieces(table, time, known, rules, readings.notes, stamped=stamped)
    table.stop_if_wrong()
    assert pieces is not None  # a problem otherwise
    known.pop("batch", None)
    values = {name: np.full(time.size, float(value)) for name, value in (constants or {}).items()} | known
    rows = np.array(table.row_numbers)
    return Log(
        names=(table.name,),
        source=np.zeros_like(rows),
        time=np.round(time - time[0], 6),
        values=values,
        batch=pieces.number,
        rows=rows,
        notes=table.notes + readings.notes,
        told=table.notes,
        change_of_value=pieces.change_of_value,
        start=None if at.start is None else at.start + np.timedelta64(round(float(time[0])), "s"),
        time_zone=at.time_zone,
    )
