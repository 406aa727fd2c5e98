"""A boundary as a Dataset, and the arguments of a boundary from a Dataset or a trend log."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fastcoil.base.arguments import checking, instance_of, path_of, plain
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.logs import Log, read_log, warn_of_reading
from fastcoil.logs.arguments import Wanted, max_gap_of, require_mappings
from fastcoil.logs.seconds import at_seconds, require_span, require_whole_seconds
from fastcoil.logs.series import HUMIDITIES, Series
from fastcoil.logs.timestamps import time_format_of
from fastcoil.logs.units import DIFFERENCE
from fastcoil.loops.boundary.clock import Clock
from fastcoil.loops.boundary.conditions import condition_of, whole_seconds
from fastcoil.loops.boundary.rearranged import rows_of
from fastcoil.loops.boundary.series import BOUNDARY_SERIES
from fastcoil.loops.boundary.source import Source

if TYPE_CHECKING:
    import xarray as xr


START = {"long_name": "date and time at elapsed_time 0", "standard_name": "time"}
"""Attributes of the coordinate ``start``; one more, ``time_zone``, says whose clock it is on."""


def dataset_of(source: Source, clock: Clock) -> xr.Dataset:
    """The series with dims (``day``,) ``elapsed_time``, units, long names and the clock."""
    import xarray as xr

    dims = ("day", "elapsed_time") if source.has_day_dim else ("elapsed_time",)
    rows = rows_of(source)
    variables = {name: (dims, values.copy(), _attributes(BOUNDARY_SERIES[name])) for name, values in rows.items()}
    seconds = np.arange(source.n_steps, dtype=np.float64)
    labels = source.day if source.has_day_dim else source.day[0]
    coordinates: dict[str, Any] = {
        "elapsed_time": ("elapsed_time", seconds, {"units": "s", "long_name": "time since the start"}),
        "day": (dims[:-1], labels, {"long_name": "label of the day"}),
    }
    ds = xr.Dataset(variables, coordinates)
    start = start_coordinate(clock, has_day_dim=source.has_day_dim)
    return ds if start is None else ds.assign_coords(start=start)


def start_coordinate(clock: Clock, *, has_day_dim: bool) -> xr.DataArray | None:
    """The coordinate ``start``, along ``day`` if there is that dim; None if it is unknown."""
    import xarray as xr

    if clock.start is None:
        return None
    values = clock.start.astype("datetime64[ns]")
    attrs = START | ({"time_zone": clock.time_zone} if clock.time_zone else {})
    return xr.DataArray(values, dims="day", attrs=attrs) if has_day_dim else xr.DataArray(values[0], attrs=attrs)


def arguments_of(ds: xr.Dataset) -> dict[str, Any]:
    """Arguments of a boundary from a Dataset; variables of other names do not count.

    Raises
    ------
    InputError
        With one sentence for each mistake.
    """
    import xarray as xr

    instance_of("ds", ds, xr.Dataset, "give a Dataset, as of to_dataset")
    problems = [
        f"{name} has no units attribute: set ds[{name!r}].attrs['units'] ({series.known_units})"
        for name, series in BOUNDARY_SERIES.items()
        if name in ds and "units" not in ds[name].attrs
    ]
    if "elapsed_time" in ds.dims and "elapsed_time" not in ds.coords:
        problems.append("elapsed_time has no coordinate: give ds['elapsed_time'] the seconds 0, 1, ...")
    start = time_zone = None
    if "start" in ds.coords:
        start, time_zone = ds["start"].values, ds["start"].attrs.get("time_zone")
        if start.dtype.kind != "M":
            problems.append(
                WrongType(f"start = {shown(start)} is of type {start.dtype}: give dates and times, datetime64")
            )
    if problems:
        raise InputError(problems)
    if start is not None and "elapsed_time" in ds.dims:
        first = ds["elapsed_time"].values[:1]
        if first.dtype.kind in "iufm" and first.size:
            seconds = first[0] / np.timedelta64(1, "s") if first.dtype.kind == "m" else float(first[0])
            start = start + np.timedelta64(round(1e6 * seconds), "us").astype(start.dtype.str.replace("M8", "m8"))
    return {name: ds.get(name) for name in BOUNDARY_SERIES} | {"start": start, "time_zone": time_zone}


def _attributes(series: Series) -> dict[str, str]:
    attrs = {"units": series.unit, "long_name": series.long_name}
    # CF-1.11: a difference in K is not a temperature in K.
    return attrs | {"units_metadata": "temperature: difference"} if series.units is DIFFERENCE else attrs


_WANTED = Wanted(needed=("m_a", "T_a_in", HUMIDITIES, "T_w_in", "T_set"), optional=("noise", "enabled"))
_HOLD = [name for name, series in BOUNDARY_SERIES.items() if series.hold]


def trend_log_series(
    path: str | Path,
    *,
    units: Mapping[str, str] | None,
    columns: Mapping[str, str] | None,
    constants: Mapping[str, float] | None,
    pressure: float,
    start: float,
    hours: float | None,
    max_gap: float | None,
    time_format: str | None,
) -> dict[str, Any]:
    """Series by name, each (n_steps,), ``start`` and ``time_zone``; arguments as of `fastcoil.Boundary.from_csv`."""
    with checking() as check:
        path = check(path_of, "path", path, "give the path of a CSV file")
        pressure = check(condition_of, "pressure", pressure)
        start = check(condition_of, "start", start)
        if hours is not None:
            check(whole_seconds, hours)
        check(max_gap_of, max_gap)
        time_format = check.unless_none(time_format_of, "time_format", time_format)
        check(require_mappings, columns=columns, units=units, constants=constants)
    log = read_log(
        path,
        _WANTED,
        units=units,
        columns=columns,
        constants={} if constants is None else constants,
        max_gap=max_gap,
        time_format=time_format,
        strict=True,
        unbroken=True,
    )
    require_whole_seconds(log.name, log.step)
    warn_of_reading(log.name, log.told)
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
