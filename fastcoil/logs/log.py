"""A log as checked arrays in our units, with notes on what was left out."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from fastcoil.base.arguments import collect_problems
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs.columns import ColumnSpec, ReadingOptions, find_columns, interpret_header
from fastcoil.logs.join import find_value_columns, pivot_points
from fastcoil.logs.pieces import longest_regular_step, number_pieces, read_times
from fastcoil.logs.readings import check_plausible_units, fill_or_cut_rows, mark_supersaturation, read_columns
from fastcoil.logs.series import COLUMNS
from fastcoil.logs.table import Table, table_from_data
from fastcoil.model import moist_air

_DEFAULT_OPTIONS = ReadingOptions()


@dataclass(kw_only=True)
class CheckedLog:
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

    def seconds_since_batch_start(self) -> Array:
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

    def with_validation_log(self, validation_log: Self) -> Self:
        """The samples of both logs: those of ``validation_log``, for validation, in separate batches."""
        name = validation_log.name if validation_log.name != self.name else f"{validation_log.name} (validation)"
        missing_columns = (self.values.keys() ^ validation_log.values.keys()) - {"T_w_out"}
        if missing_columns:
            raise InputError(f"{self.name} or {name} has no {', '.join(sorted(missing_columns))}: log the same in both")
        values = {
            column: np.concatenate(
                [log.values.get(column, np.full(log.time.size, np.nan)) for log in (self, validation_log)]
            )
            for column in self.values | validation_log.values
        }
        return replace(
            self,
            names=(*self.names, name),
            source=np.concatenate([self.source, validation_log.source + 1]),
            time=np.concatenate([self.time, validation_log.time]),
            values=values,
            batch=np.concatenate([self.batch, validation_log.batch + self.n_batches]),
            rows=np.concatenate([self.rows, validation_log.rows]),
            notes=self.notes + [f"{name}: {note}" for note in validation_log.notes],
        )

    def where(self, mask: Mask) -> Self:
        """The samples that are ``mask``, (n,); a batch ends where some are left out."""
        index = np.flatnonzero(mask)
        is_new_batch = (np.diff(index) > 1) | (np.diff(self.batch[index]) > 0)
        return replace(
            self,
            source=self.source[mask],
            time=self.time[mask],
            values={name: values[mask] for name, values in self.values.items()},
            batch=np.concatenate([[0], np.cumsum(is_new_batch)]),
            rows=self.rows[mask],
        )


def read_checked_log(source: Any, spec: ColumnSpec, options: ReadingOptions = _DEFAULT_OPTIONS) -> CheckedLog:
    """Read the ``spec`` series of a log and check every number.

    source: path of a CSV file, or a pandas DataFrame with the columns of one, both perhaps with a row for each value
    (time, point, value); or an ``xarray.Dataset`` along ``elapsed_time`` (or ``timestamp``, of datetime64) with units
    as attributes.
    """
    if isinstance(source, (str, Path)):
        table = Table.read(source)
    else:
        named_series = [name for name in getattr(source, "data_vars", ()) if interpret_header(str(name))]
        table = table_from_data(source, options.columns, [*COLUMNS, *named_series])
    if find_value_columns(table) is not None:
        table = pivot_points(table, options, spec)
        options = replace(options, columns=None, units={}, time_format=None)
    column_by_name = find_columns(table, options, spec)
    has_timestamps = "timestamp" in column_by_name
    if options.time_format is not None and not has_timestamps:
        table.problems.append(
            f"time_format = {options.time_format!r}: it is for the column timestamp, which the log lacks"
        )
    table.raise_problems()
    stamps = None
    if has_timestamps:
        with collect_problems(table.problems):
            stamps = read_times(table, column_by_name["timestamp"], options)
    readings = read_columns(table, column_by_name, options, spec)
    check_plausible_units(table, readings, column_by_name, options)
    mark_supersaturation(table, readings, options.constants or {})
    columns = readings.values
    if stamps is None and "elapsed_time" not in columns:  # there is a problem of either
        table.problems += readings.complaints
        table.raise_problems()
    time = stamps.seconds_since_first() if stamps else columns["elapsed_time"]
    columns, time = fill_or_cut_rows(
        table, readings, time, options, spec, longest_regular_step(time, options.max_gap), has_timestamps=has_timestamps
    )
    columns.pop("elapsed_time", None)
    batch, is_change_log = np.zeros(0, dtype=np.int64), False
    if np.isfinite(time).all():
        batch, is_change_log = number_pieces(
            table, time, columns, options, readings.notes, has_timestamps=has_timestamps
        )
    table.raise_problems()
    start, zone = stamps.first() if stamps else (None, "")
    columns.pop("batch", None)
    values = {name: np.full(time.size, float(value)) for name, value in (options.constants or {}).items()} | columns
    rows = np.array(table.row_numbers)
    return CheckedLog(
        names=(table.name,),
        source=np.zeros_like(rows),
        time=np.round(time - time[0], 6),
        values=values,
        batch=batch,
        rows=rows,
        notes=table.notes + readings.notes,
        change_of_value=is_change_log,
        start=None if start is None else start + np.timedelta64(round(float(time[0])), "s"),
        time_zone=zone,
    )
