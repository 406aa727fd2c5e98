"""`read_log` and its result, and a log as checked arrays in our units, with notes on what was left out."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from fastcoil.base.arguments import argument_checks, collect_problems, require_choice, require_mapping
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, Problem
from fastcoil.logs.join import POINT_NAMES, find_value_columns, pivot_points
from fastcoil.logs.own_values import find_own_values
from fastcoil.logs.pieces import longest_regular_step, number_pieces, read_times
from fastcoil.logs.series import COLUMNS, TIME_COLUMNS, format_count
from fastcoil.logs.table import Table, table_from_data
from fastcoil.model import moist_air

from fastcoil.logs.columns import (  # isort: skip
    ColumnSpec, ReadingOptions, check_reading_options, find_columns, find_requested_columns, interpret_header,
    require_columns_with_units, require_log,
)  # fmt: skip
from fastcoil.logs.readings import (  # isort: skip
    check_plausible_units, fill_or_cut_rows, leave_out_optional, mark_supersaturation, read_columns,
)  # fmt: skip

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

_DEFAULT_OPTIONS = ReadingOptions()


@dataclass(kw_only=True)
class CheckedLog:
    """A log as checked arrays by name, (n,) each in the units of ``COLUMNS``; measured ones are NaN where bad."""

    name: str
    time: Array  # seconds since the first row
    values: dict[str, Array]
    batch: Index  # number of the unbroken piece of each sample, from 0
    rows: Index  # row number of each sample in its file
    units: dict[str, str] = field(default_factory=dict)  # in which each column was logged
    headers: dict[str, str] = field(default_factory=dict)  # of each column in the file
    notes: list[str] = field(default_factory=list)  # how it was read, what was left out, and why
    change_of_value: bool = False  # whether rows were written at changes, so that values hold between them
    start: np.datetime64 | None = None  # of the first row, to the second
    time_zone: str = ""  # of ``start``, blank if unknown

    @property
    def step(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def n_batches(self) -> int:
        return int(self.batch[-1]) + 1

    def seconds_since_batch_start(self) -> Array:
        """Return the seconds since the start of each sample's batch, (n,)."""
        return self.time - self.time[np.searchsorted(self.batch, np.arange(self.n_batches))][self.batch]

    def humidity_ratio(self, pressure: float) -> Array:
        """Return the humidity ratio of the entering air, kg/kg, (n,); from RH or dew point at a ``pressure``, Pa."""
        if "RH_a_in" in self.values:
            return moist_air.humidity_ratio(self.values["T_a_in"], self.values["RH_a_in"], pressure)
        if "T_dp_in" in self.values:
            return moist_air.humidity_ratio_from_dew_point(self.values["T_dp_in"], pressure)
        return self.values["W_a_in"]

    def where(self, mask: Mask) -> Self:
        """Return the log with only the samples that ``mask`` marks, (n,); a batch ends where some are left out."""
        index = np.flatnonzero(mask)
        is_new_batch = (np.diff(index) > 1) | (np.diff(self.batch[index]) > 0)
        return replace(
            self, time=self.time[mask], values={name: values[mask] for name, values in self.values.items()},
            batch=np.concatenate([[0], np.cumsum(is_new_batch)]), rows=self.rows[mask],
        )  # fmt: skip


def read_checked_log(source: Any, spec: ColumnSpec, options: ReadingOptions = _DEFAULT_OPTIONS) -> CheckedLog:
    """Read the series of ``spec`` from the source of a log, see ``read_log``, and check every number."""
    return check_table(_read_table(source, options), spec, options)


def _read_table(source: Any, options: ReadingOptions) -> Table:
    """Return a CSV file, a Dataset or a DataFrame as a table of text."""
    if isinstance(source, (str, Path)):
        return Table.read(source)
    named_series = [name for name in getattr(source, "data_vars", ()) if interpret_header(str(name))]
    return table_from_data(source, options.columns, [*COLUMNS, *named_series])


def check_table(table: Table, spec: ColumnSpec, options: ReadingOptions) -> CheckedLog:
    """Convert the columns of ``spec`` to checked arrays; the table is used up."""
    if find_value_columns(table) is not None:
        table = pivot_points(table, options, spec)
        options = replace(options, columns=None, units={}, ignore=(), time_format=None, time_zone="")
    column_by_name = find_columns(table, options, spec)
    time_name = "timestamp" if "timestamp" in column_by_name else "elapsed_time"
    for name, value in (("time_format", options.time_format), ("time_zone", options.time_zone)):
        if value and time_name == "elapsed_time":
            sentence = f"{name} = {value!r}: it is for the column timestamp, which the log lacks"
            table.add_problem(sentence, name, "conflict")
    table.raise_problems()
    stamps = None
    if time_name == "timestamp":
        with collect_problems(table.problems):
            stamps = read_times(table, column_by_name["timestamp"], options)
    readings = read_columns(table, column_by_name, options, spec)
    columns = readings.values
    no_time = stamps is None and "elapsed_time" not in columns  # there is a problem of either
    time = stamps.seconds_since_first() if stamps else columns.get("elapsed_time", np.zeros(2))
    check_plausible_units(table, readings, column_by_name, options)
    mark_supersaturation(table, readings, options.constants or {})
    leave_out_optional(table, readings, options, spec)
    if no_time:
        table.problems += readings.complaints
        table.raise_problems()
    longest_step = longest_regular_step(time, options.max_gap)
    columns, time = fill_or_cut_rows(table, readings, time, options, spec, longest_step, time_name)
    columns.pop("elapsed_time", None)
    batch, is_change_log = np.zeros(0, dtype=np.int64), False
    if np.isfinite(time).all():
        is_set_back = stamps is not None and stamps.seem_set_back()
        batch, is_change_log = number_pieces(table, time, columns, options, readings.notes, time_name, is_set_back)
    table.raise_problems()
    start, zone = stamps.first_time() if stamps else (None, "")
    columns.pop("batch", None)
    values = {name: np.full(time.size, float(value)) for name, value in (options.constants or {}).items()} | columns
    rows = np.array(table.row_numbers)
    return CheckedLog(
        name=table.name, time=np.round(time - time[0], 6), values=values, batch=batch, rows=rows, units=readings.units,
        headers={name: table.header[k] for name, k in column_by_name.items() if name in (*values, time_name, "batch")},
        notes=table.notes + readings.notes, change_of_value=is_change_log,
        start=None if start is None else start + np.timedelta64(round(float(time[0])), "s"), time_zone=zone,
    )  # fmt: skip


class Log:
    """A trend log and how it is to be read, as ``fc.read_log`` returns it.

    ``fc.diagnose``, ``fc.read_test``, ``fc.fit_valve``, ``fc.fit_coil`` and ``fc.replay`` take it, and
    each reads the columns that it needs.  Print it to see its columns, units and times, and what was left out.

    Attributes
    ----------
    name : str
        Name of the file, or ``DataFrame`` or ``Dataset``.
    """

    def __init__(self, source: Any, options: ReadingOptions) -> None:
        self._source, self.options = source, options
        self._table: Table | None = None
        self._names_read: set[str] = {*TIME_COLUMNS, "batch"}

    @property
    def name(self) -> str:
        if isinstance(self._source, Path):
            return self._source.name
        return "DataFrame" if hasattr(self._source, "iloc") else "Dataset"

    def table(self) -> Table:
        """Return the log as a table of text, a copy that may be changed."""
        return self._table.copy() if self._table is not None else _read_table(self._source, self.options)

    def with_options(self, **options: Any) -> Log:
        """Return the same log with some options of reading changed."""
        log = Log(self._source, replace(self.options, **options))
        log._table = self._table
        return log

    def check(self) -> None:
        """Check that the source is a table with the columns that were named; the table of a file is kept."""
        table = _read_table(self._source, self.options)
        if isinstance(self._source, Path):
            self._table = table
        table = table.copy()
        columns = self.options.columns or {}
        table.check_names("columns", columns, [*COLUMNS, "timestamp"])
        table.check_names("units", self.options.units, COLUMNS)
        table.check_names("constants", self.options.constants or {}, POINT_NAMES)
        if find_value_columns(table) is None:
            find_requested_columns(table, columns)
            require_columns_with_units(table, self.options)
        table.raise_problems()

    def read(self, spec: ColumnSpec, *, refuse_gaps: bool = False, use_sensor: bool = False) -> CheckedLog:
        """Read the columns of ``spec`` as checked numbers; ``use_sensor``: of a simulation, what its sensor shows."""
        # constants are for whichever caller needs them
        constants = {name: x for name, x in (self.options.constants or {}).items() if name in spec.names}
        self._names_read |= {*spec.names}
        options = replace(self.options, refuse_gaps=refuse_gaps, constants=constants)
        if self._table is not None:
            return check_table(self._table.copy(), spec, options)
        source = self._source
        if use_sensor and hasattr(source, "data_vars") and "T_measured" in source:
            source = source if "T_sup" in (options.columns or {}) else source.assign(T_sup=source["T_measured"])
        return read_checked_log(source, spec, options)

    def require_options_used(self) -> None:
        """Refuse headers and units of columns that no function has read since."""
        options = [("columns", "--column", self.options.columns or {}), ("units", "--unit", self.options.units)]
        with argument_checks() as check:
            for argument, option, texts in options:
                for name in sorted(texts.keys() - self._names_read):
                    sentence = f"{option} {name}={texts[name]}: {name} is not read here: leave it out"
                    check.problems.append(Problem(sentence, argument, "name"))

    def summary(self) -> list[str]:
        """Return the log as lines of text: rows, times, columns with their units as read, and notes."""
        try:
            data = self.read(ColumnSpec((), POINT_NAMES))
        except InputError as error:
            return [f"cannot be read as it is: {problem}" for problem in error.problems]
        span = f"{data.time[-1]:,.0f} s" + (f" from {data.start} {data.time_zone}".rstrip() if data.start else "")
        lines = [f"{data.time.size:,} rows, {data.step:g} s apart, in {format_count(data.n_batches, 'piece')}: {span}"]
        for name, values in data.values.items():
            if name not in data.units:
                lines.append(f"{name} = {values[0]:g}, a constant")
                continue
            holds = COLUMNS[name].hold
            own = None if data.change_of_value else find_own_values(values, np.isfinite(values), holds=holds)
            rhythm = f", {own.describe(data.step)}" if own else ""
            lines.append(f"{name} [{data.units[name]}] from the column {data.headers[name]!r}{rhythm}")
        return lines + [f"Note: {note}" for note in data.notes]

    def __repr__(self) -> str:
        return "\n".join([f"<fastcoil Log> {self.name}", *self.summary()])


def as_log(name: str, source: Any) -> Log:
    """Return a `Log`: ``source`` itself, or that of a path, DataFrame or Dataset."""
    if isinstance(source, Log):
        return source
    return Log(require_log(name, source), _DEFAULT_LOG_OPTIONS)


_DEFAULT_LOG_OPTIONS = ReadingOptions(constants={}, drop=False, jumps="refuse", reader="read_log")


def read_log(
    source: str | Path | pd.DataFrame | xr.Dataset,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    drop: bool = False,
    jumps: str = "refuse",
    max_gap: float | None = None,
    time_format: str | None = None,
    time_zone: str | None = None,
    constants: Mapping[str, float] | None = None,
    ignore: Sequence[str] | None = None,
) -> Log:
    """Read a trend log, once, for every function that uses one.

    Parameters
    ----------
    source
        Path of a CSV file, as building systems and spreadsheets write them, with a row for each time or for each value
        (time, point, value); a DataFrame with the columns of one; or a Dataset along ``elapsed_time`` (or
        ``timestamp``, of datetime64) with units as attributes.  Columns are those of fastcoil (``command [%]``,
        ``T_sup [degC]``, ``T_set``, ``m_a``, ``T_a_in``, ``T_w_in``, ``m_w``, ``enabled``, ``test``, ``batch`` …) or
        names of building systems, Haystack and Brick that mean one of them beyond doubt.
    units
        Units by column, for headers without one: ``{"T_sup": "degF"}``.
    columns
        Headers by column, where they differ: ``{"command": "AHU1 CHW VLV"}``; of a log with a row for each value, its
        points.
    drop
        Leave blank, NaN and impossible values out and count them, instead of refusing the log: those of measured
        columns become NaN, an input that is missing in one row alone is bridged, other rows with one are left out.
    jumps
        ``"refuse"`` a log whose time goes back or does not advance, or ``"split"`` it there.
    max_gap
        Longest step that is bridged [s]; three times the median step by default, and more in a log whose rows were
        written when a value changed.
    time_format
        How ``timestamp`` is written: a pattern such as ``"%d/%m/%Y %H:%M"``, ``"excel"`` for serial days, ``"epoch"``
        for seconds or milliseconds since 1970; recognised by default, or refused where two readings fit.
    time_zone
        Zone of timestamps without a UTC offset, such as ``"America/New_York"`` or ``"UTC-05:00"``.
    constants
        Numbers for columns that the log lacks, in the units of fastcoil: ``{"m_a": 1.2}`` in kg/s.
    ignore
        Columns that are not read, by their headers or by the names of fastcoil: ``["SF Sts", "T_a_in"]``.

    Returns
    -------
    Log
        Print it to see rows, times, columns and what was read as what.

    Raises
    ------
    InputError
        With one sentence for each mistake in the arguments, or if the source has no table or lacks a column that
        ``columns`` names.  Values are checked by the functions that use them.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> import fastcoil as fc
    >>> frame = pd.DataFrame({"CHW VLV (%)": [40, 50, 55], "SAT": [55.1, 55.3, 55.2]})
    >>> frame.insert(0, "elapsed_time [s]", 60 * np.arange(3))
    >>> fc.read_log(frame, units={"T_sup": "degF"})
    <fastcoil Log> DataFrame
    3 rows, 60 s apart, in 1 piece: 120 s
    command [%] from the column 'CHW VLV (%)'
    T_sup [degF] from the column 'SAT'
    Note: 'CHW VLV (%)' is read as command, 'SAT' is read as T_sup
    """
    with argument_checks() as check:
        source = check(require_log, "source", source)
        options = check_reading_options(
            check, units=units, columns=columns, drop=drop, jumps=jumps, max_gap=max_gap, time_format=time_format,
            time_zone=time_zone, constants=constants, ignore=ignore, reader="read_log",
        )  # fmt: skip
    log = Log(source, options)
    log.check()
    return log


def check_read_options(options: Any) -> None:
    """Check a mapping of options of ``read_log``, the argument ``read`` of a function that reads many logs."""
    cure = "give a mapping of options of fc.read_log, such as {'drop': True}"
    parameters = inspect.signature(read_log).parameters
    defaults = {name: parameter.default for name, parameter in parameters.items() if name != "source"}
    with argument_checks() as check:
        for name in require_mapping("read", options, cure):
            check(require_choice, "read", name, defaults)
    with argument_checks() as check:
        check_reading_options(check, **(defaults | options), reader="read_log")
