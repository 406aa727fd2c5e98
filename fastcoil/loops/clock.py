"""Date and time in results: coordinates, and how a file holds them.

In a file they are whole seconds since 1970 on the clock of the place, CF-1.11 section 4.4; an attribute names its zone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.as_dataset import start_coordinate
from fastcoil.loops.boundary.clock import is_changed
from fastcoil.loops.loop import Loop

CLOCK = ("start", "time")
"""Coordinates of a result whose boundary has a start."""
_STORED = {"units": "seconds since 1970-01-01 00:00:00", "calendar": "standard"}
_SECOND = np.timedelta64(1, "s")


def check_names(loop: Loop, boundary: Boundary) -> None:
    """Refuse dims and coordinates of a sweep that have the name of one of the clock."""
    names = {*loop.sizes, *loop.swept} & set(CLOCK)
    if boundary.start is not None and names:
        raise InputError(
            [f"{name} is swept, and the boundary has a start: give the dim another name" for name in sorted(names)]
        )


def clock_coordinates(boundary: Boundary, elapsed_time: xr.Variable | None = None) -> dict[str, xr.DataArray]:
    """``start``; of a single day also the ``time`` of its traces, unless its clock is changed on the way."""
    start = start_coordinate(boundary.clock, has_day_dim=boundary.has_day_dim)
    if start is None or boundary.clock.start is None:
        return {}
    found = {"start": start}
    if elapsed_time is None or boundary.has_day_dim:
        return found
    if not is_changed(boundary.time_zone, boundary.clock.start[0], boundary.n_steps):
        time = start.values + np.rint(elapsed_time.values).astype(np.int64) * _SECOND
        attrs = {"long_name": "date and time", "standard_name": "time"}
        zone = {"time_zone": boundary.time_zone} if boundary.time_zone else {}
        found["time"] = xr.DataArray(time.astype("datetime64[ns]"), dims="elapsed_time", attrs=attrs | zone)
    return found


def encoded(variable: xr.Variable) -> xr.Variable:
    """A variable as a file holds it: times as numbers."""
    if variable.dtype.kind != "M":
        return variable
    seconds = variable.values.astype("datetime64[s]").astype(np.int64)
    return xr.Variable(variable.dims, seconds, variable.attrs | _STORED)


def with_numbers(ds: xr.Dataset) -> xr.Dataset:
    """A Dataset as a file holds it."""
    return _replaced(ds, {name: encoded(v) for name, v in ds.variables.items() if v.dtype.kind == "M"})


def with_times(ds: xr.Dataset) -> xr.Dataset:
    """A Dataset as it was before it was written."""
    times = {}
    for name in CLOCK:
        variable = ds.variables.get(name)
        if variable is None or variable.dtype.kind != "i" or variable.attrs.get("units") != _STORED["units"]:
            continue
        attrs = {key: value for key, value in variable.attrs.items() if key not in _STORED}
        values = variable.values.astype("datetime64[s]").astype("datetime64[ns]")
        times[name] = xr.Variable(variable.dims, values, attrs)
    return _replaced(ds, times)


def _replaced(ds: xr.Dataset, variables: dict[Any, xr.Variable]) -> xr.Dataset:
    coordinates = {name: variable for name, variable in variables.items() if name in ds.coords}
    others = {name: variable for name, variable in variables.items() if name not in ds.coords}
    return ds.assign_coords(coordinates).assign(others) if variables else ds
