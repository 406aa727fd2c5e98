"""A boundary from the trend log of a building: a CSV file as `fastcoil.boundary.table` reads it.

Every column needs a unit, in its header (``T_a_in [degC]``) or as an argument; a volume flow of air is taken
at 1.2 kg/m3.  The mistakes of a file are raised together, in one `InputError`.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

import numpy as np

from fastcoil.boundary.conditions import require, whole_seconds
from fastcoil.boundary.moist_air import humidity_ratio, humidity_ratio_from_dew_point
from fastcoil.boundary.record import Boundary
from fastcoil.boundary.series import FRACTION, SERIES, TEMPERATURE, TIME, Array, Series
from fastcoil.boundary.table import Table
from fastcoil.errors import InputError

LOG_COLUMNS = SERIES | {
    s.name: s
    for s in (
        Series("elapsed_time", "time", TIME),
        Series("RH_a_in", "relative humidity of the entering air", FRACTION, 0.0, 1.0),
        Series("T_dp_in", "dew point of the entering air", TEMPERATURE, -60.0, 50.0),
    )
}
"""What a column of a trend log may be; besides, ``timestamp``."""
_ALTERNATIVES = (("elapsed_time", "timestamp"), ("W_a_in", "RH_a_in", "T_dp_in"))
_LARGEST_STEP = 3
"""Steps longer than this many median steps are gaps."""


def read_trend_log(
    path: str | Path,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, float] | None = None,
    pressure: float = 101325.0,
    start: float = 0.0,
    hours: float | None = None,
    max_gap: float | None = None,
) -> Boundary:
    """Read a trend log into 1-s samples.

    The header names each column and its unit: ``m_a [kg/s]``, ``T_a_in [degF]``.  Time is
    ``elapsed_time [s]`` (min, h) or ``timestamp`` (ISO 8601, one UTC offset); humidity is ``W_a_in``,
    ``RH_a_in`` or ``T_dp_in``.  Samples are 1 s apart or more; between them ``T_set`` and ``enabled`` hold,
    the others run straight.

    Parameters
    ----------
    units
        Units by series, for headers without one: ``{"T_a_in": "degF"}``.
    columns
        Headers by series, where they differ: ``{"T_a_in": "AHU1 MAT [degF]"}``.  Columns of other names are
        then ignored.
    constants
        Numbers for series that the log lacks, in the units of `Boundary`.
    pressure
        Barometric pressure, for relative humidity and dew point [Pa].
    start, hours
        Hours from the first row at which to begin; how many to take, up to the last row if left out.
    max_gap
        Longest step to be bridged [s]; three times the median step if left out.
    """
    require(pressure=pressure, start=start, max_gap=max_gap)
    constants, units = dict(constants or {}), dict(units or {})
    table = Table.read(path)
    found = _log_columns(table, columns, units, constants)
    table.stop_if_wrong()
    known = {
        name: table.numbers(LOG_COLUMNS[name], column, units.get(name))
        for name, column in found.items()
        if name != "timestamp"
    }
    time = known.pop("elapsed_time") if "elapsed_time" in known else seconds_since_first(table, found["timestamp"])
    check_steps(table, time, max_gap)
    table.stop_if_wrong()
    if "RH_a_in" in known:
        T_a_in = known["T_a_in"] if "T_a_in" in known else constants["T_a_in"]
        known["W_a_in"] = humidity_ratio(T_a_in, known.pop("RH_a_in"), pressure)
    if "T_dp_in" in known:
        known["W_a_in"] = humidity_ratio_from_dew_point(known.pop("T_dp_in"), pressure)
    # Hours and minutes are not exact in binary; a set-point must change on the second that is meant.
    time = np.round(time - time[0], 6)
    wanted = _wanted_seconds(table, time[-1], start, hours)
    latest = np.searchsorted(time, wanted, side="right") - 1
    sampled = {
        name: values[latest] if SERIES[name].hold else np.interp(wanted, time, values) for name, values in known.items()
    }
    return Boundary(**{name: sampled.get(name, constants.get(name)) for name in SERIES})


def _log_columns(
    table: Table, columns: Mapping[str, str] | None, units: Mapping[str, str], constants: Mapping[str, float]
) -> dict[str, int]:
    """Index of the column of each series; unknown, missing and doubled ones are problems."""
    names = [*LOG_COLUMNS, "timestamp"]
    table.check_names("columns", columns or {}, names)
    table.check_names("units", units, LOG_COLUMNS)
    table.check_names("constants", constants, SERIES)
    table.problems += [
        f"constants has {name} = {value!r}: give a number"
        for name, value in constants.items()
        if isinstance(value, bool) or not isinstance(value, int | float | np.number)
    ]
    found = table.found(columns, names, "or say what to read by columns={'T_a_in': 'its header', ...}")
    named = {*(columns or {}), *found, *constants}
    for alternatives in _ALTERNATIVES:
        given = [name for name in alternatives if name in named]
        if len(given) != 1:
            what = f"{' and '.join(given)} are both there" if given else f"{alternatives[0]} is missing"
            table.problems.append(f"{what}: give one of {', '.join(alternatives)}")
    table.problems += [
        f"{name} is missing: add a column '{name} [{series.unit}]', or give it in columns or constants"
        for name, series in SERIES.items()
        if series.default is None and name != "W_a_in" and name not in named
    ]
    return found


def seconds_since_first(table: Table, column: int) -> Array:
    """Timestamps as seconds since the first row."""
    times: list[datetime] = []
    for row, number in zip(table.rows, table.row_numbers, strict=True):
        try:
            times.append(datetime.fromisoformat(row[column].strip()))
        except ValueError:
            wrong = "is not ISO 8601: write it as 2024-07-01T08:00:00"
        else:
            if times[-1].utcoffset() == times[0].utcoffset():
                continue
            wrong = "has another UTC offset than the first: write one time zone, without daylight saving"
        table.problems.append(f"timestamp = {row[column]!r} in row {number} {wrong}")
        return np.arange(len(table.rows), dtype=np.float64)
    return np.array([(time - times[0]).total_seconds() for time in times])


def check_steps(table: Table, time: Array, max_gap: float | None) -> None:
    """Time must rise, by at least a second, without gaps."""
    steps = np.diff(time)
    step, rows = float(np.median(steps)), table.row_numbers
    back, longest = int(np.argmax(steps <= 0.0)), int(np.argmax(steps))
    if steps[back] <= 0.0:
        what = "is at the same time as" if steps[back] == 0.0 else "is earlier than"
        table.problems.append(f"row {rows[back + 1]} {what} row {rows[back]}: sort the rows and drop doubles")
    elif step < 0.999:
        table.problems.append(f"the rows are {step:g} s apart: thin or average the log to 1 s or more")
    elif steps[longest] > (_LARGEST_STEP * step if max_gap is None else max_gap):
        gap, ends = f"{steps[longest]:g}", f"{rows[longest]} and {rows[longest + 1]}"
        table.problems.append(
            f"rows {ends} are {gap} s apart, others {step:g} s: fill the gap, cut the log, "
            f"or pass max_gap={gap} to bridge it"
        )


def _wanted_seconds(table: Table, covered: float, start: float, hours: float | None) -> Array:
    """The seconds to sample at, of a log that covers ``covered`` seconds."""
    first = start * 3600
    n_steps = int(np.floor(covered - first + 1e-6)) + 1 if hours is None else whole_seconds(hours)
    if n_steps < 1 or first + n_steps - 1 > covered + 1e-6:
        asked = f"start = {start:g} h" + ("" if hours is None else f", hours = {hours:g}")
        raise InputError(f"{table.path.name}: {asked} needs more than the {covered:g} s of the log: lower it")
    return np.asarray(np.minimum(first + np.arange(n_steps), covered))
