"""Convert labelled input (DataArray, pandas Series, DataFrame) to arrays in the units of the tables.

Labels are honoured or refused, never ignored: units are converted, dims have known names, samples are 1 s apart in
ascending order, and the time of the first one is kept for comparison with other data.  A bare array has no labels.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base.arguments import require_array
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.logs.series import COLUMNS, PRESSURE, Units, resolve_unit
from fastcoil.logs.timestamps import format_utc_offset

_PARAMETER_SCALES = (
    {"kJ K-1": 1.0, "kJ/K": 1.0, "J K-1": 1e-3, "J/K": 1e-3},
    {"kJ kg-1 K-1": 1.0, "kJ/(kg K)": 1.0, "J kg-1 K-1": 1e-3, "J/(kg K)": 1e-3},
    {"K-1": 1.0, "1/K": 1.0, "%/K": 0.01, "percent/K": 0.01},
    {"s-1": 1.0, "1/s": 1.0, "1/min": 1 / 60, "%/s": 0.01},
    {"rad s-1": 1.0, "rad/s": 1.0, "Hz": 2.0 * np.pi},
)
_PARAMETER_UNITS = [{unit: (scale, 0.0) for unit, scale in family.items()} for family in _PARAMETER_SCALES]
_SERIES_UNITS = [COLUMNS[name].units for name in ("RH_a_in", "elapsed_time", "T_sup", "noise", "m_w")]
_ACCEPTED_UNITS = {next(iter(units)): units for units in (*_SERIES_UNITS, PRESSURE, *_PARAMETER_UNITS)}


def accepted_units(unit: str) -> Units:
    """Return the units in which values of a table's ``unit`` may be given."""
    return _ACCEPTED_UNITS.get(unit, {unit: (1.0, 0.0)})


def as_data_array(name: str, value: Any, dim: str) -> xr.DataArray | None:
    """Convert a labelled ``value`` to a DataArray, None if it is bare; ``dim``: of a pandas index without a name."""
    if isinstance(value, xr.DataArray):
        return value
    if isinstance(value, xr.Variable):
        return xr.DataArray(value)
    if isinstance(value, pd.Series):
        return _from_pandas(name, value, [(value.index, dim)])
    if isinstance(value, pd.DataFrame):
        axes = [(index, dim if _is_time(index) else None) for index in (value.index, value.columns)]
        return _from_pandas(name, value, axes)
    first_item = value[0] if isinstance(value, (list, tuple)) and value else value
    if isinstance(first_item, (xr.DataArray, xr.Variable, pd.Series)) or isinstance(value, xr.Dataset):
        sentence = f"{name} is a {type(value).__name__} with labels: give one DataArray, Series or bare array"
        raise InputError(sentence, name, "type")
    return None


def _is_time(index: Any) -> bool:
    return isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex))


def _from_pandas(name: str, value: Any, axes: list[tuple[Any, str | None]]) -> xr.DataArray:
    """Convert times in an index to seconds since the first, and to a coordinate ``start``."""
    dims: list[str] = []
    coords: dict[str, xr.Variable] = {}
    for index, default in axes:
        if isinstance(index, pd.MultiIndex) or (index.name is None and default is None):
            raise InputError(f"{name}: name the axes of the DataFrame, such as day and elapsed_time", name, "shape")
        if _is_time(index) and index.hasnans:
            raise InputError(f"{name} has a time that is missing (NaT): drop or fill it", name, "time")
        dim = str(default if index.name is None or _is_time(index) else index.name)
        labels = index
        if isinstance(index, pd.DatetimeIndex) and index.size:
            first, labels, attrs = index[0], index - index[0], {}
            if (zone := first.tzinfo) is not None:  # its name, or its offset from UTC
                zone_name = getattr(zone, "key", None) or getattr(zone, "zone", None)
                attrs["time_zone"] = str(zone_name or format_utc_offset(round(first.utcoffset().total_seconds() / 60)))
            coords["start"] = xr.Variable((), np.datetime64(first.tz_localize(None), "ns"), attrs)
        if index.name is not None or not labels.equals(pd.RangeIndex(index.size)):
            coords[dim] = xr.Variable(dim, labels.values)
        if dim in dims:
            sentence = f"{name} has {dim} along both axes of the DataFrame: give the other one its own name"
            raise InputError(sentence, name, "duplicate")
        dims.append(dim)
    return xr.DataArray(value.to_numpy(), coords, dims, attrs=dict(value.attrs))


def convert_units(name: str, array: xr.DataArray, units: Units) -> NDArray[Any]:
    """Convert values to the first of ``units`` from the unit in the attribute ``units``, if it has one."""
    unit = array.attrs.get("units")
    if unit is None:
        return np.asarray(array.values)
    if not isinstance(unit, str):
        raise InputError(f"{name} has units = {short_repr(unit)}: give a text ({', '.join(units)})", name, "type")
    scale, offset = units[resolve_unit(name, unit or "1", units)]
    if (scale, offset) == (1.0, 0.0):
        return np.asarray(array.values)
    with np.errstate(over="ignore"):  # what overflows is out of bounds
        return require_array(name, array.values, "give numbers").astype(float) * scale + offset


class SeriesLabels(NamedTuple):
    """Labels of a series of 1-s samples; None where it has none."""

    n_steps: int | None = None  # samples of a day
    n_days: int | None = None
    day: NDArray[Any] | None = None  # labels, () or (n_days,)
    second: float | None = None  # ``elapsed_time`` of the first sample, s
    start: NDArray[np.datetime64] | None = None  # of the first sample, () or (n_days,), in µs
    time_zone: str | None = None  # of ``start``; blank if that has none


def read_series_labels(name: str, array: xr.DataArray) -> SeriesLabels:
    """Read the labels of a series along ``day`` and ``elapsed_time``; refuse other dims, and steps other than 1 s."""
    if not set(array.dims) <= {"day", "elapsed_time"}:
        sentence = f"{name} has dims {array.dims}: name them elapsed_time and, for several days, day"
        raise InputError(sentence, name, "shape")
    first_second, start, zone = None, None, None
    for name_of_time in ("elapsed_time", "timestamp", "time"):
        time_coord = array.coords.get(name_of_time)
        if time_coord is None or "elapsed_time" not in time_coord.dims or not time_coord.size:
            continue
        time_coord = time_coord.transpose(..., "elapsed_time")
        if time_coord.dtype.kind == "M":
            _check_steps(name_of_time, np.diff(time_coord.values).ravel() / np.timedelta64(1, "s"))
            start, zone = time_coord.values[..., 0], time_coord.attrs.get("time_zone", "")
        elif name_of_time == "elapsed_time":
            seconds = _elapsed_seconds(name_of_time, time_coord)
            _check_steps(name_of_time, np.diff(seconds))
            first_second = float(seconds[0])
    if "start" in array.coords:
        start_coord = array.coords["start"]
        if start_coord.dtype.kind != "M" or not set(start_coord.dims) <= {"day"}:
            sentence = f"start is of type {start_coord.dtype}: give dates and times, datetime64"
            raise InputError(sentence, "start", "type")
        start = start_coord.values.astype("datetime64[us]") + np.timedelta64(round(1e6 * (first_second or 0.0)), "us")
        zone = start_coord.attrs.get("time_zone", "")
    day = array.coords["day"].values if "day" in array.coords else None
    return SeriesLabels(array.sizes.get("elapsed_time"), array.sizes.get("day"), day, first_second, start, zone)


def _elapsed_seconds(name: str, time_coord: xr.DataArray) -> Array:
    if time_coord.dtype.kind == "m":
        return np.asarray(time_coord.values / np.timedelta64(1, "s"))
    if time_coord.dtype.kind not in "iuf":
        raise InputError(f"{name} is of type {time_coord.dtype}: give the seconds 0, 1, ...", name, "type")
    return np.asarray(convert_units(name, time_coord, COLUMNS["elapsed_time"].units), dtype=float)


def _check_steps(name: str, steps: Array) -> None:
    wrong = np.flatnonzero(~(np.abs(steps - 1.0) < 1e-6))
    if wrong.size:
        sentence = f"{name} has a step of {steps[wrong[0]]:g} s after sample {wrong[0]}: give 1-s steps"
        raise InputError(sentence, name, "time")


def label_mismatches(template: str, labels: Mapping[str, Any], cure: str, code: str, field: str = "") -> list[Problem]:
    """Return a problem of ``field``, by default its name, for each label, put in ``template``, unlike the first."""
    first_name, first = next(iter(labels.items()), ("", None))
    return [
        Problem(f"{name} has {template.format(_short_text(label))} where {first_name} has {_short_text(first)}: {cure}",
                field or name, code)
        for name, label in labels.items()
        if not np.array_equal(np.atleast_1d(label), np.atleast_1d(first))  # type: ignore[arg-type]
    ]  # fmt: skip


def _short_text(value: Any) -> str:
    array = np.asarray(value)
    text = str(array.astype("M8[s]") if array.dtype.kind == "M" else value) or "unknown"
    return text if len(text) <= 40 else f"{text[:39]}…"
