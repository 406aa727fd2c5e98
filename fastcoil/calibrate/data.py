"""A log to fit to: a CSV file or a Dataset as checked arrays in our units, with what was left out counted.

Same CSV format as a trend log, see ``fastcoil.boundary.trends``: the header names each column and its unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastcoil.boundary.series import TEMPERATURE, TRAVEL, WATER_FLOW, Array, Series
from fastcoil.boundary.table import Table, label_and_unit
from fastcoil.boundary.trends import LOG_COLUMNS, seconds_since_first
from fastcoil.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

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
_LONG_STEP = 3.0
"""Steps longer than this many median steps are gaps."""


@dataclass
class Log:
    """Checked columns by name, (n,) each in the units of ``COLUMNS``; measured ones are NaN where a value was bad.

    time: seconds since the first row.  batch: number of the unbroken piece that a sample belongs to, from 0 on.
    rows: where each sample stands in the file.  notes: what was left out, and why.
    """

    name: str
    time: Array
    values: dict[str, Array]
    batch: NDArray[np.int64]
    rows: NDArray[np.int64]
    notes: list[str] = field(default_factory=list)

    @property
    def step(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.time)))


def read_log(
    source: Any,
    needed: Sequence[str | tuple[str, ...]],
    *,
    measured: Sequence[str] = (),
    optional: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, float] | None = None,
    drop: bool = False,
    jumps: str = "refuse",
    max_gap: float | None = None,
) -> Log:
    """Read a log and check every number.

    Parameters
    ----------
    source
        Path of a CSV file, or an ``xarray.Dataset`` with the coordinate ``elapsed_time`` and units as attributes.
    needed
        Names that must be there; of a tuple exactly one.
    measured
        The needed or optional names that are outputs of the model: dropped ones become NaN, their row stays.
    units, columns, constants
        As in ``fc.Boundary.from_csv``.
    drop
        Whether rows with a blank, NaN or impossible value are left out (and counted) instead of refused.
    jumps
        ``refuse`` time that goes back or stands still within a batch, or ``split`` the batch there.
    max_gap
        Longest step that does not end a batch [s]; three times the median step if left out.

    Raises
    ------
    InputError
        With one sentence for each mistake: column, row, cure.
    """
    if jumps not in ("refuse", "split"):
        raise InputError(f"jumps = {jumps!r}: choose 'refuse' or 'split'")
    table = Table.read(source) if isinstance(source, (str, Path)) else _table_of(source)
    wanted = [name for one in needed for name in ((one,) if isinstance(one, str) else one)] + list(optional)
    units, constants = dict(units or {}), dict(constants or {})
    found = _columns(table, columns, units, constants, needed, wanted)
    table.stop_if_wrong()
    for name in _NEEDS_NO_UNIT:
        if name in found and not label_and_unit(table.header[found[name]])[1]:
            units.setdefault(name, "1")
    notes, bad = [], _bad(table, found, units)
    lost: dict[str, NDArray[np.bool_]] = {n: bad.pop(n) for n in measured if n in bad and drop}
    if drop and any(b.any() for b in bad.values()):
        keep = ~np.any(list(bad.values()), axis=0)
        notes += [_dropped(table, name, b, "rows left out") for name, b in bad.items() if b.any()]
        lost = {name: b[keep] for name, b in lost.items()}
        _cut(table, keep)
    notes += [_dropped(table, name, b, "values left out") for name, b in lost.items() if b.any()]
    for name, b in lost.items():
        _blank(table, found[name], b, units.get(name))
    known = {n: table.numbers(COLUMNS[n], c, units.get(n)) for n, c in found.items() if n != "timestamp"}
    time = known.pop("elapsed_time") if "elapsed_time" in known else seconds_since_first(table, found["timestamp"])
    if table.problems and not drop:
        table.problems[-1] += "; or leave such rows out, they are counted: drop=True, --drop"
    table.stop_if_wrong()
    for name, b in lost.items():
        known[name][b] = np.nan
    batch = _batches(table, time, known.pop("batch", None), jumps, max_gap, notes)
    table.stop_if_wrong()
    known |= {name: np.full(time.size, float(value)) for name, value in constants.items()}
    return Log(table.path.name, np.round(time - time[0], 6), known, batch, np.array(table.row_numbers), notes)


def _table_of(ds: xr.Dataset) -> Table:
    """A Dataset as the table that a CSV file of it would be; rows count from 0, as ``isel`` does."""
    if not hasattr(ds, "data_vars"):
        raise InputError(f"log is a {type(ds).__name__}: give the path of a CSV file or an xarray.Dataset")
    problems, names, cells = [], [], []
    if "elapsed_time" not in ds.coords or ds["elapsed_time"].dims != ("elapsed_time",):
        raise InputError("the Dataset has no coordinate elapsed_time: give every variable the dimension elapsed_time")
    for name in ("elapsed_time", *(n for n in ds.data_vars if n in COLUMNS)):
        values, unit = ds[name], ds[name].attrs.get("units")
        if values.dims != ("elapsed_time",):
            problems.append(f"{name} has dims {values.dims}: choose one loop, so that only elapsed_time is left")
            continue
        numbers = values.values
        if numbers.dtype.kind in "mM":
            numbers, unit = (numbers - numbers[0]) / np.timedelta64(1, "s"), "s"
        names.append(f"{name} [{unit}]" if unit else str(name))
        cells.append([repr(float(v)) for v in numbers])
    if problems:
        raise InputError(problems)
    if len(cells[0]) < 2:
        raise InputError("the Dataset has fewer than two samples: give a longer log")
    return Table(Path("Dataset"), names, [list(row) for row in zip(*cells, strict=True)], list(range(len(cells[0]))))


def _columns(
    table: Table,
    columns: Mapping[str, str] | None,
    units: Mapping[str, str],
    constants: Mapping[str, float],
    needed: Sequence[str | tuple[str, ...]],
    wanted: Sequence[str],
) -> dict[str, int]:
    """Index of each wanted column; unknown, missing and doubled ones are problems."""
    names = [*COLUMNS, "timestamp"]
    table.check_names("columns", columns or {}, names)
    table.check_names("units", units, COLUMNS)
    table.check_names("constants", constants, COLUMNS)
    cure = "or say what to read: columns={'m_w': 'its header', ...}, --column m_w='its header'"
    found = table.found(columns, names, cure)
    for one in [*needed, ("elapsed_time", "timestamp")]:
        choices = (one,) if isinstance(one, str) else one
        given = [name for name in choices if name in found or name in constants]
        if not given:
            unit = COLUMNS[choices[0]].unit
            table.problems.append(
                f"{' or '.join(choices)} is missing: add a column '{choices[0]} [{unit}]', or say which one it is: "
                f"columns={{{choices[0]!r}: 'its header'}}, --column {choices[0]}='its header'"
            )
        elif len(given) > 1:
            table.problems.append(f"{' and '.join(given)} are both there: give one of them")
    return {n: c for n, c in found.items() if n in (*wanted, "elapsed_time", "timestamp", "batch")}


def _bad(table: Table, found: Mapping[str, int], units: Mapping[str, str]) -> dict[str, NDArray[np.bool_]]:
    """Where a cell of a column is no number, or an impossible one, (n_rows,)."""
    bad = {}
    for name, column in found.items():
        if name == "timestamp":
            continue
        series = COLUMNS[name]
        unit = label_and_unit(table.header[column])[1] or units.get(name) or series.unit
        if unit not in series.units:
            continue  # said by Table.numbers
        raw = np.array([_number(row[column]) for row in table.rows])
        bad[name] = series.is_bad(series.convert(raw, unit))
    return bad


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _dropped(table: Table, name: str, bad: NDArray[np.bool_], what: str) -> str:
    first = table.row_numbers[int(np.argmax(bad))] if bad.size == len(table.rows) else "?"
    return f"{int(bad.sum()):,} {what}: {name} is no admissible number (first in row {first})"


def _cut(table: Table, keep: NDArray[np.bool_]) -> None:
    table.rows = [row for row, k in zip(table.rows, keep, strict=True) if k]
    table.row_numbers = [number for number, k in zip(table.row_numbers, keep, strict=True) if k]
    if len(table.rows) < 2:
        raise InputError(f"{table.path.name}: fewer than two rows are left: mend the log")


def _blank(table: Table, column: int, bad: NDArray[np.bool_], unit: str | None) -> None:
    """Put a good number where a measured value is bad, so that its row passes; it becomes NaN afterwards."""
    good = np.flatnonzero(~bad)
    if good.size == 0:
        raise InputError(f"{table.path.name}: {table.header[column]!r} has no admissible number: check its unit")
    for i in np.flatnonzero(bad):
        table.rows[i] = [*table.rows[i]]
        table.rows[i][column] = table.rows[good[0]][column]


def _batches(
    table: Table, time: Array, given: Array | None, jumps: str, max_gap: float | None, notes: list[str]
) -> NDArray[np.int64]:
    """Number of the unbroken piece of each row: a new one where ``batch`` changes, after a gap, after a jump."""
    steps, rows = np.diff(time), table.row_numbers
    new = np.zeros(steps.size, dtype=bool) if given is None else np.diff(given) != 0.0
    back = (steps <= 0.0) & ~new
    if back.any() and jumps == "refuse":
        k = int(np.argmax(back))
        what = "is at the same time as" if steps[k] == 0.0 else "is earlier than"
        table.problems.append(
            f"elapsed_time: row {rows[k + 1]} {what} row {rows[k]} ({int(back.sum())} such): sort the rows and drop "
            "doubles, or begin anew there: jumps='split', --jumps split"
        )
        return np.zeros(time.size, dtype=np.int64)
    if back.any():
        notes.append(f"time goes back or stands still {int(back.sum())} times: begun anew there")
    forward = steps[~new & ~back]
    longest = max_gap or _LONG_STEP * (np.median(forward) if forward.size else np.inf)
    gaps = ~new & ~back & (steps > longest)
    if gaps.any():
        k = int(np.argmax(gaps))
        notes.append(
            f"{int(gaps.sum())} gaps in time (first: {steps[k]:g} s between rows {rows[k]} and {rows[k + 1]}): "
            "begun anew after each"
        )
    return np.concatenate([[0], np.cumsum(new | back | gaps)])
