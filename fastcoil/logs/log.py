"""A log as checked arrays in our units, with notes on what was left out."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from fastcoil.base.arguments import collecting
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs.columns import Reading, Wanted, find_columns, meaning_of
from fastcoil.logs.join import pivoted, value_columns
from fastcoil.logs.pieces import longest_bridged, number_pieces, read_times
from fastcoil.logs.readings import fill_or_cut, question_units, read_columns, refuse_supersaturation
from fastcoil.logs.series import COLUMNS
from fastcoil.logs.table import Table, table_of
from fastcoil.model import moist_air

_AS_IT_IS = Reading()


@dataclass(kw_only=True)
class Log:
    """Checked columns by name, (n,) each in the units of ``COLUMNS``; measured ones are NaN where a value was bad."""

    names: tuple[str, ...]  # of the log, and of a second one for validation
    source: Index  # index in ``names`` of the log of each sample
    time: Array  # seconds since the first row of that log
    values: dict[str, Array]
    batch: Index  # number of the unbroken piece of each sample, from 0
    rows: Index  # row number of each sample in its file
    notes: list[str] = field(default_factory=list)  # how it was read, what was left out, and why
    change_of_value: bool = False  # whether rows were written at changes, so that values hold between them
    start: np.datetime64 | None = None  # of the first row of the first log, to the second
    time_zone: str = ""  # of ``start``, blank if unknown

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
        """Humidity ratio of the entering air, kg/kg, (n,): as logged, or from RH or dew point at a ``pressure``, Pa."""
        if "RH_a_in" in self.values:
            return moist_air.humidity_ratio(self.values["T_a_in"], self.values["RH_a_in"], pressure)
        if "T_dp_in" in self.values:
            return moist_air.humidity_ratio_from_dew_point(self.values["T_dp_in"], pressure)
        return self.values["W_a_in"]

    def followed_by(self, other: Self) -> Self:
        """The samples of both logs: those of ``other``, for validation, in separate batches."""
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
        )

    def where(self, kept: Mask) -> Self:
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


def read_log(source: Any, wanted: Wanted, how: Reading = _AS_IT_IS) -> Log:
    """Read the ``wanted`` series of a log and check every number.

    source: path of a CSV file, or a pandas DataFrame with the columns of one, both perhaps with a row for each value
    (time, point, value); or an ``xarray.Dataset`` along ``elapsed_time`` (or ``timestamp``, of datetime64) with units
    as attributes.
    """
    if isinstance(source, (str, Path)):
        table = Table.read(source)
    else:
        meant = [name for name in getattr(source, "data_vars", ()) if meaning_of(str(name))]
        table = table_of(source, how.columns, [*COLUMNS, *meant])
    if value_columns(table) is not None:
        table = pivoted(table, how, wanted)
        how = replace(how, columns=None, units={}, time_format=None)
    found = find_columns(table, how, wanted)
    stamped = "timestamp" in found
    if how.time_format is not None and not stamped:
        table.problems.append(f"time_format = {how.time_format!r}: it is for the column timestamp, which the log lacks")
    table.stop_if_wrong()
    stamps = None
    if stamped:
        with collecting(table.problems):
            stamps = read_times(table, found["timestamp"], how)
    readings = read_columns(table, found, how, wanted)
    question_units(table, readings, found, how)
    refuse_supersaturation(table, readings, how.constants or {})
    known = readings.known
    if stamps is None and "elapsed_time" not in known:  # there is a problem of either
        table.problems += readings.complaints
        table.stop_if_wrong()
    time = stamps.since_first() if stamps else known["elapsed_time"]
    known, time = fill_or_cut(table, readings, time, how, wanted, longest_bridged(time, how.max_gap), stamped=stamped)
    known.pop("elapsed_time", None)
    batch, of_changes = np.zeros(0, dtype=np.int64), False
    if np.isfinite(time).all():
        batch, of_changes = number_pieces(table, time, known, how, readings.notes, stamped=stamped)
    table.stop_if_wrong()
    start, zone = stamps.first() if stamps else (None, "")
    known.pop("batch", None)
    values = {name: np.full(time.size, float(value)) for name, value in (how.constants or {}).items()} | known
    rows = np.array(table.row_numbers)
    return Log(
        names=(table.name,),
        source=np.zeros_like(rows),
        time=np.round(time - time[0], 6),
        values=values,
        batch=batch,
        rows=rows,
        notes=table.notes + readings.notes,
        change_of_value=of_changes,
        start=None if start is None else start + np.timedelta64(round(float(time[0])), "s"),
        time_zone=zone,
    )
