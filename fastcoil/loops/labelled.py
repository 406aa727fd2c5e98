"""The one door for labelled data: a DataArray, a pandas Series or a DataFrame becomes numbers in our units.

What the labels say is honoured or refused, never passed over: units are converted, dims have known names, samples are
1 s apart in ascending order, and the time of the first one is kept, to be compared with that of other data.  A bare
array has no labels and stays as it is.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base.arguments import array_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.logs.series import COLUMNS, DIFFERENCE, FRACTION, PRESSURE, TEMPERATURE, TIME, WATER_FLOW, Units, spelled
from fastcoil.logs.timestamps import offset_text

_SCALES = (
    {"kJ K-1": 1.0, "kJ/K": 1.0, "J K-1": 1e-3, "J/K": 1e-3},
    {"kJ kg-1 K-1": 1.0, "kJ/(kg K)": 1.0, "J kg-1 K-1": 1e-3, "J/(kg K)": 1e-3},
    {"K-1": 1.0, "1/K": 1.0, "%/K": 0.01, "percent/K": 0.01},
    {"s-1": 1.0, "1/s": 1.0, "1/min": 1 / 60, "%/s": 0.01},
    {"rad s-1": 1.0, "rad/s": 1.0, "Hz": 2.0 * np.pi},
)
_OF_PARAMETERS = [{unit: (scale, 0.0) for unit, scale in family.items()} for family in _SCALES]
_FAMILIES = (FRACTION, TIME, TEMPERATURE, DIFFERENCE, WATER_FLOW, PRESSURE, *_OF_PARAMETERS)
_UNITS = {next(iter(units)): units for units in _FAMILIES}


def units_of(unit: str) -> Units:
    """The units that values in ``unit``, one of our tables, may be given in."""
    return _UNITS.get(unit, {unit: (1.0, 0.0)})


def as_labelled(name: str, value: Any, dim: str) -> xr.DataArray | None:
    """``value`` as a DataArray if it has labels, None if it is bare; ``dim``: of a pandas index without a name."""
    if isinstance(value, xr.DataArray):
        return value
    if isinstance(value, xr.Variable):
        return xr.DataArray(value)
    if isinstance(value, pd.Series):
        return _of_pandas(name, value, [(value.index, dim)])
    if isinstance(value, pd.DataFrame):
        axes = [(index, dim if _is_time(index) else None) for index in (value.index, value.columns)]
        return _of_pandas(name, value, axes)
    first = value[0] if isinstance(value, (list, tuple)) and value else value
    if isinstance(first, (xr.DataArray, xr.Variable, pd.Series)) or isinstance(value, xr.Dataset):
        kind = type(value).__name__
        raise InputError(WrongType(f"{name} is a {kind} with labels: give one DataArray, Series or bare array"))
    return None


def _is_time(index: Any) -> bool:
    return isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex))


def _of_pandas(name: str, value: Any, axes: list[tuple[Any, str | None]]) -> xr.DataArray:
    """Times in an index become seconds since the first, and a coordinate ``start``."""
    dims: list[str] = []
    coords: dict[str, xr.Variable] = {}
    for index, default in axes:
        if isinstance(index, pd.MultiIndex) or (index.name is None and default is None):
            raise InputError(f"{name}: name the axes of the DataFrame, such as day and elapsed_time")
        if _is_time(index) and index.hasnans:
            raise InputError(f"{name} has a time that is missing (NaT): drop or fill it")
        dim = str(default if index.name is None or _is_time(index) else index.name)
        labels = index
        if isinstance(index, pd.DatetimeIndex) and index.size:
            first, labels = index[0], index - index[0]
            zone = {}
            if first.tzinfo is not None:  # its name, or its offset from UTC
                named = getattr(first.tzinfo, "key", None) or getattr(first.tzinfo, "zone", None)
                zone["time_zone"] = str(named or offset_text(round(first.utcoffset().total_seconds() / 60)))
            coords["start"] = xr.Variable((), np.datetime64(first.tz_localize(None), "ns"), zone)
        if index.name is not None or not labels.equals(pd.RangeIndex(index.size)):
            coords[dim] = xr.Variable(dim, labels.values)
        if dim in dims:
            raise InputError(f"{name} has {dim} along both axes of the DataFrame: give the other one its own name")
        dims.append(dim)
    return xr.DataArray(value.to_numpy(), coords, dims, attrs=dict(value.attrs))


def in_our_unit(name: str, array: xr.DataArray, units: Units) -> NDArray[Any]:
    """Numbers in the first of ``units``, from the unit in the attribute ``units``, if it has one."""
    unit = array.attrs.get("units")
    if unit is None:
        return np.asarray(array.values)
    if not isinstance(unit, str):
        raise InputError(WrongType(f"{name} has units = {shown(unit)}: give a text ({', '.join(units)})"))
    scale, offset = units[spelled(name, unit or "1", units)]
    if (scale, offset) == (1.0, 0.0):
        return np.asarray(array.values)
    with np.errstate(over="ignore"):  # what overflows is out of bounds
        return array_of(name, array.values, "give numbers").astype(float) * scale + offset


class Course(NamedTuple):
    """What the labels of a series of 1-s samples say; None where they say nothing."""

    n_steps: int | None = None  # samples of a day
    n_days: int | None = None
    day: NDArray[Any] | None = None  # labels, () or (n_days,)
    second: float | None = None  # ``elapsed_time`` of the first sample, s
    start: NDArray[np.datetime64] | None = None  # of the first sample, () or (n_days,), in µs
    time_zone: str | None = None  # of ``start``; blank if that has none


def course_of(name: str, array: xr.DataArray) -> Course:
    """The labels of a series along ``day`` and ``elapsed_time``; refused with other dims or steps than 1 s."""
    if not set(array.dims) <= {"day", "elapsed_time"}:
        raise InputError(f"{name} has dims {array.dims}: name them elapsed_time and, for several days, day")
    second, start, zone = None, None, None
    for time in ("elapsed_time", "timestamp", "time"):
        along = array.coords.get(time)
        if along is None or "elapsed_time" not in along.dims or not along.size:
            continue
        along = along.transpose(..., "elapsed_time")
        if along.dtype.kind == "M":
            _check_steps(time, np.diff(along.values).ravel() / np.timedelta64(1, "s"))
            start, zone = along.values[..., 0], along.attrs.get("time_zone", "")
        elif time == "elapsed_time":
            seconds = _seconds(time, along)
            _check_steps(time, np.diff(seconds))
            second = float(seconds[0])
    if "start" in array.coords:
        of_zero = array.coords["start"]
        if of_zero.dtype.kind != "M" or not set(of_zero.dims) <= {"day"}:
            raise InputError(WrongType(f"start is of type {of_zero.dtype}: give dates and times, datetime64"))
        start = of_zero.values.astype("datetime64[us]") + np.timedelta64(round(1e6 * (second or 0.0)), "us")
        zone = of_zero.attrs.get("time_zone", "")
    day = array.coords["day"].values if "day" in array.coords else None
    return Course(array.sizes.get("elapsed_time"), array.sizes.get("day"), day, second, start, zone)


def _seconds(name: str, along: xr.DataArray) -> Array:
    if along.dtype.kind == "m":
        return np.asarray(along.values / np.timedelta64(1, "s"))
    if along.dtype.kind not in "iuf":
        raise InputError(f"{name} is of type {along.dtype}: give the seconds 0, 1, ...")
    return np.asarray(in_our_unit(name, along, COLUMNS["elapsed_time"].units), dtype=float)


def _check_steps(name: str, steps: Array) -> None:
    wrong = np.flatnonzero(~(np.abs(steps - 1.0) < 1e-6))
    if wrong.size:
        raise InputError(f"{name} has a step of {steps[wrong[0]]:g} s after sample {wrong[0]}: give 1-s steps")


def differing(what: str, found: Mapping[str, Any], cure: str) -> list[str]:
    """A sentence for each of ``found``, by name, that differs from the first; ``what``: with a place for it."""
    first = next(iter(found), "")
    return [
        f"{name} has {what.format(_short(one))} where {first} has {_short(found[first])}: {cure}"
        for name, one in found.items()
        if not np.array_equal(np.atleast_1d(one), np.atleast_1d(found[first]))
    ]


def _short(value: Any) -> str:
    array = np.asarray(value)
    text = str(array.astype("M8[s]") if array.dtype.kind == "M" else value) or "unknown"
    return text if len(text) <= 40 else f"{text[:39]}…"
