"""Convert labelled input (arrays, Series, numbers with a unit) to arrays in our units; labels are never ignored."""

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base.arguments import carried_unit, raise_problems, require_array
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.logs.series import COLUMNS, PRESSURE, Units, find_unit, resolve_unit
from fastcoil.logs.table import is_time_like, split_label_and_unit
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
    """Convert a labelled ``value`` to a DataArray, None if it is bare; ``dim``: of an axis without a name."""
    array = _as_data_array(name, value, dim)
    unit = carried_unit(name, value if array is None or isinstance(value, pd.Series) else array)
    if unit is None or (array is not None and type(array.data) is np.ndarray and array.dtype != object):
        return array  # convert_units finds the unit
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that the unit is lost
            numbers = np.asarray(value if array is None else array.data, dtype=float)
    except Exception:  # a user's class may raise anything
        raise InputError(f"{name} = {short_repr(value)}: give one array in one unit", name, "type") from None
    if array is not None:
        return array.copy(data=numbers).drop_attrs(deep=False).assign_attrs(units=unit)
    return xr.DataArray(numbers, dims={1: (dim,), 2: ("day", dim)}.get(numbers.ndim), attrs={"units": unit})


def to_bare_numbers(name: str, value: Any, units: Units) -> Any:
    """Return a value that has a unit or labels as an array in the first of ``units``, and a bare one as it is."""
    array = as_data_array(name, value, name)
    return value if array is None else convert_units(name, array, units)


def _as_data_array(name: str, value: Any, dim: str) -> xr.DataArray | None:
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
    series_name = value.name if isinstance(value, pd.Series) else None
    return xr.DataArray(value.to_numpy(), coords, dims, series_name, attrs=dict(value.attrs))


def convert_units(name: str, array: xr.DataArray, units: Units) -> NDArray[Any]:
    """Convert values to the first of ``units`` from the unit beside them or in their name; ``ti_min`` is refused."""
    label = "" if array.name is None else str(array.name)
    given_units = [unit for unit in (carried_unit(name, array), split_label_and_unit(label)[1]) if unit is not None]
    scales = {units[resolve_unit(name, unit or "1", units)] for unit in given_units}
    if len(scales) > 1:
        sentence = f"{name} is in {given_units[0]!r}, and by its name in {given_units[1]!r}: give one unit"
        raise InputError(sentence, name, "unit")
    last_word = find_unit(label.replace(" ", "_").rpartition("_")[2], units)
    if not scales and label != name and last_word and units[last_word] != (1.0, 0.0):
        cure = "give attrs['units'], or rename it"
        raise InputError(f"{name} is called {short_repr(label)}, perhaps by its unit: {cure}", name, "unit")
    scale, offset = next(iter(scales), (1.0, 0.0))
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
    seconds: dict[str, Any] = {}  # first one, of coordinates that count from the start
    starts: dict[str, Any] = {}  # first one, of dates
    zones: dict[str, str] = {}
    for label, coord in array.coords.items():
        if "elapsed_time" in coord.dims and coord.size:
            first = _read_times(name, str(label), coord.transpose(..., "elapsed_time"))[..., 0]
            if coord.dtype.kind == "M":
                starts[str(label)], zones[str(label)] = first, coord.attrs.get("time_zone", "")
            else:
                seconds[str(label)] = np.unique(np.round(first, 6)).squeeze()
        elif label not in ("start", "day") and is_time_like(coord):
            sentence = f"{label} is a time that is not along elapsed_time: call it start, or drop_vars({str(label)!r})"
            raise InputError(sentence, str(label), "time")
    if "start" in array.coords:
        start_coord = array.coords["start"]
        if start_coord.dtype.kind != "M" or not set(start_coord.dims) <= {"day"}:
            sentence = f"start is of type {start_coord.dtype}: give dates and times, datetime64"
            raise InputError(sentence, "start", "type")
        offset = np.max(next(iter(seconds.values()), 0.0))
        first = start_coord.values.astype("datetime64[us]") + np.timedelta64(round(1e6 * offset), "us")
        starts = {"start": first} | {label: times.astype("datetime64[us]") for label, times in starts.items()}
        zones["start"] = start_coord.attrs.get("time_zone", "")
    known_zones = {label: zone for label, zone in zones.items() if zone}
    for labels in (seconds, starts, known_zones):
        text = "the time zone {}" if labels is known_zones else "its first sample at {}"
        raise_problems(label_mismatches(text, labels, "drop the one that is wrong", "time", name))
    first_second, start = (next(iter(labels.values()), None) for labels in (seconds, starts))
    zone = next(iter((known_zones or zones).values()), None)
    day = array.coords["day"].values if "day" in array.coords else None
    return SeriesLabels(array.sizes.get("elapsed_time"), array.sizes.get("day"), day, first_second, start, zone)


def _read_times(argument: str, name: str, coord: xr.DataArray) -> NDArray[Any]:
    """Return dates, or seconds, of an argument along ``elapsed_time``, the last dim, checked to be 1 s apart."""
    if coord.dtype.kind not in "mMiuf":
        cure = f"give the seconds 0, 1, ..., dates as datetime64, or drop_vars({name!r})"
        raise InputError(f"{argument}: {name} is of type {coord.dtype}: {cure}", name, "type")
    is_number = coord.dtype.kind in "iuf"
    times = convert_units(name, coord, COLUMNS["elapsed_time"].units) if is_number else coord.values
    steps = np.diff(times).ravel() / (1.0 if is_number else np.timedelta64(1, "s"))
    wrong = np.flatnonzero(~(np.abs(steps - 1.0) < 1e-6))
    if wrong.size:
        sentence = f"{name} has a step of {steps[wrong[0]]:g} s after sample {wrong[0]}: give 1-s steps"
        raise InputError(sentence, name, "time")
    return times / np.timedelta64(1, "s") if coord.dtype.kind == "m" else times


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
