"""The series of a boundary from the trend log of a building, on 1-s steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fastcoil.base.arguments import checking, path_of, plain
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.logs import Log, read_log, warn_of_reading
from fastcoil.logs.columns import Wanted, checked_reading
from fastcoil.logs.pieces import at_seconds, require_span, require_whole_seconds
from fastcoil.logs.series import HUMIDITIES
from fastcoil.loops.boundary.conditions import condition_of, whole_seconds
from fastcoil.loops.boundary.series import BOUNDARY_SERIES

_WANTED = Wanted(needed=("m_a", "T_a_in", HUMIDITIES, "T_w_in", "T_set"), optional=("noise", "enabled"))
_HOLD = [name for name, series in BOUNDARY_SERIES.items() if series.hold]


def trend_log_series(
    path: str | Path, *, pressure: float, start: float, hours: float | None, **reading: Any
) -> dict[str, Any]:
    """Series by name, each (n_steps,), ``start`` and ``time_zone``; arguments as of `fastcoil.Boundary.from_csv`."""
    with checking() as check:
        path = check(path_of, "path", path, "give the path of a CSV file")
        pressure = check(condition_of, "pressure", pressure)
        start = check(condition_of, "start", start)
        if hours is not None:
            check(whole_seconds, hours)
        how = checked_reading(check, **reading, strict=True, unbroken=True)
    log = read_log(path, _WANTED, how)
    require_whole_seconds(log.name, log.step)
    warn_of_reading(log.name, log.reading_notes)
    values = {name: log.values[name] for name in BOUNDARY_SERIES if name in log.values}
    values["W_a_in"] = log.humidity_ratio(pressure)
    seconds = _wanted_seconds(log, start, hours)
    begins = None if log.start is None else log.start + np.timedelta64(round(float(seconds[0])), "s")
    series = at_seconds(log.time, values, seconds, list(values) if log.change_of_value else _HOLD)
    return {**series, "start": begins, "time_zone": log.time_zone}


def _wanted_seconds(log: Log, start: float, hours: float | None) -> Array:
    """The seconds of the log to sample at, (n_steps,)."""
    first, covered = start * 3600, float(log.time[-1])
    if hours is None:
        require_span(log.name, covered - first, "give hours")
    n_steps = int(np.floor(covered - first + 1e-6)) + 1 if hours is None else whole_seconds(hours)
    if n_steps < 1 or first + n_steps - 1 > covered + 1e-6:
        asked = f"start = {start:g} h" + ("" if hours is None else f", hours = {plain(hours):g}")
        raise InputError(f"{log.name}: {asked} needs more than the {covered:g} s of the log: lower it")
    return np.asarray(np.minimum(first + np.arange(n_steps), covered))
