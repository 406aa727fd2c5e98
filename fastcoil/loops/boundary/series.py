"""The series of a boundary, and the checks of the values that a user gives for them.

A loop without air flow is not in operation: its seconds count in no metric, and a warning says so.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fastcoil.base.arrays import Array, array_of
from fastcoil.base.errors import InputError, WrongType, collecting, shown
from fastcoil.logs.series import COLUMNS, Series

Values: TypeAlias = Any
"""A series as a user gives it: a number, array-like or DataArray; checked at run time."""

ADDED_SERIES = ("backlash_scale",)
"""Series that count in a digest only where they do something."""
_NAMES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set", "noise", "enabled", *ADDED_SERIES)
BOUNDARY_SERIES = {name: COLUMNS[name] for name in _NAMES}
"""Every series of a `Boundary` by name."""
LARGEST_DAY_LABEL = 2**32 - 1


class Given(NamedTuple):
    """One series as read: dims (of ``day``, ``elapsed_time``), values, and day labels if it has them."""

    dims: tuple[str, ...]
    values: Array
    day: NDArray[Any] | None = None

    def spread(self, n_days: int, n_steps: int) -> Array:
        shape = (n_days if "day" in self.dims else 1, n_steps if "elapsed_time" in self.dims else 1)
        # Adding 0.0 makes -0.0 a 0.0: equal series have equal bytes, hence equal digests.
        return np.broadcast_to(self.values.reshape(shape), (n_days, n_steps)) + 0.0

    def of_day(self, k: int) -> Array:
        return self.values[k] if "day" in self.dims else self.values


def read_series(
    values: Mapping[str, Values],
    problems: list[str],
    *,
    day: Values = None,
    known: NDArray[Any] | None = None,
    n_steps: int | None = None,
) -> tuple[dict[str, Given], NDArray[Any], int | None]:
    """Series as a user gives them in our units, the labels of the days, and the samples of each if known.

    Mistakes are added to ``problems``, a sentence each.  Labels that series carry must be alike, and the ``known``
    ones; ``day`` replaces them.
    """
    given: dict[str, Given] = {}
    for name, value in values.items():
        with collecting(problems):
            given[name] = _read(BOUNDARY_SERIES[name], value)
    n_steps = _common_size("elapsed_time", "samples", given, problems, n_steps)
    n_days = _common_size("day", "days", given, problems, None if known is None else known.size)
    labels = _carried_labels(given, problems, known) if day is None else label_array(day, problems)
    if labels is None:
        labels = np.arange(n_days) if n_days else np.asarray(0)
    elif n_days is not None and labels.size != n_days:
        problems.append(f"day has {labels.size} labels for {n_days} days: give one label for each day")
    elif any("day" in one.dims for one in given.values()):
        labels = np.atleast_1d(labels)
    for name, one in given.items():
        problems += _value_problems(BOUNDARY_SERIES[name], one, labels)
    return given, labels, n_steps


def series_of(given: Mapping[str, Given], n_days: int, n_steps: int, *, by_air: bool) -> tuple[dict[str, Array], int]:
    """All series, (n_days, n_steps), and the samples that are off for want of air flow where it decides ``by_air``."""
    whole = {name: values.spread(n_days, n_steps) for name, values in given.items()}
    stopped = 0
    if by_air:
        flows = whole["m_a"] > 0.0
        whole["enabled"], stopped = flows.astype(np.float64), int(flows.size - np.count_nonzero(flows))
    return whole, stopped


def warn_of_stops(seconds: int, stacklevel: int = 3) -> None:
    """Warn of the seconds that count in no metric because no air flows."""
    if seconds:
        warnings.warn(
            f"m_a is 0 during {seconds / 3600:,.4g} h and enabled is left out: the loop is off there, and these hours "
            "count in no metric; give enabled to have it otherwise",
            UserWarning,
            stacklevel=stacklevel,
        )


def label_array(day: Values, problems: list[str]) -> NDArray[Any] | None:
    """Day labels as an array; None, and a problem, if they are not distinct whole numbers."""
    cure = f"give whole numbers from 0 to {LARGEST_DAY_LABEL}, one a day"
    with collecting(problems):
        labels = array_of("day", day, cure)
        wide = labels.astype(np.float64)
        if labels.ndim > 1 or not labels.size or np.any((wide % 1 != 0) | (wide < 0) | (wide > LARGEST_DAY_LABEL)):
            raise InputError(f"day = {shown(day)}: {cure}")
        values, counts = np.unique(labels, return_counts=True)
        if counts.max() > 1:
            raise InputError(f"day label {values[counts.argmax()]} appears twice: give each day its own label")
        return labels
    return None


def _read(series: Series, value: Values) -> Given:
    """``value`` as numbers in our unit, with its dims."""
    if value is None:
        if series.default is None:
            raise InputError(f"{series.name} is missing: give the {series.long_name} ({series.known_units})")
        value = series.default
    if isinstance(value, xr.DataArray):
        return _read_labelled(series, value)
    values = _numbers(series, value)
    if values.ndim > 2:
        raise InputError(f"{series.name} has {values.ndim} dimensions: give (seconds) or (days, seconds)")
    return Given(("day", "elapsed_time")[2 - values.ndim :], values)


def _read_labelled(series: Series, value: xr.DataArray) -> Given:
    dims = tuple(dim for dim in ("day", "elapsed_time") if dim in value.dims)
    if len(dims) != value.ndim:
        raise InputError(f"{series.name} has dims {value.dims}: name them elapsed_time and, for several days, day")
    if "elapsed_time" in dims and "elapsed_time" in value.coords:
        seconds = value.coords["elapsed_time"].values
        if seconds.dtype.kind not in "iufm":
            raise InputError(f"elapsed_time is of type {seconds.dtype}: give the seconds 0, 1, ...")
        steps = np.diff(seconds) / (np.timedelta64(1, "s") if seconds.dtype.kind == "m" else 1.0)
        wrong = np.flatnonzero(~(np.abs(steps - 1.0) < 1e-6))
        if wrong.size:
            raise InputError(
                f"elapsed_time has a step of {steps[wrong[0]]:g} s after sample {wrong[0]}: "
                "give 1-s steps (interpolate first)"
            )
    values = _numbers(series, value.transpose(*dims).values)
    unit = value.attrs.get("units", series.unit)
    if not isinstance(unit, str):
        raise InputError(WrongType(f"{series.name} has units = {shown(unit)}: give a text ({series.known_units})"))
    return Given(dims, series.convert(values, unit), value.coords["day"].values if "day" in value.coords else None)


def _numbers(series: Series, value: Values) -> Array:
    values = array_of(series.name, value, "give numbers", "iufb" if series.whole else "iuf")
    if values.size == 0:
        raise InputError(f"{series.name} is empty: give at least one 1-s sample")
    with np.errstate(over="ignore"):  # a number that overflows is refused as infinite
        return values.astype(np.float64)


def _common_size(dim: str, word: str, given: Mapping[str, Given], problems: list[str], known: int | None) -> int | None:
    """Size of ``dim``, None if unknown; a series of another size than the boundary or the first one is a problem."""
    sizes = {} if known is None else {"the boundary": known}
    sizes |= {name: one.values.shape[one.dims.index(dim)] for name, one in given.items() if dim in one.dims}
    first, size = next(iter(sizes.items()), ("", None))
    problems += [
        f"{name} has {other} {word} where {first} has {size}: give every series the same number"
        for name, other in sizes.items()
        if other != size
    ]
    return size


def _carried_labels(given: Mapping[str, Given], problems: list[str], known: NDArray[Any] | None) -> NDArray[Any] | None:
    """The day labels that series carry as a coordinate, None if none does; others than the first's are problems."""
    carried = {name: one.day for name, one in given.items() if one.day is not None}
    several = {name: day for name, day in carried.items() if day.ndim}
    labelled = several or carried if known is None else {"the boundary": np.atleast_1d(known)} | several
    if not labelled:
        return None
    first, labels = next(iter(labelled.items()))
    problems += [
        f"{name} has day {day!s:.40} where {first} has {labels!s:.40}: align them, or give day=..."
        for name, day in labelled.items()
        if not np.array_equal(day, labels)
    ]
    return label_array(labels if known is None else known, problems)


def _value_problems(series: Series, given: Given, labels: NDArray[Any]) -> list[str]:
    """A sentence on the first bad value of a series, if it has one."""
    bad = series.is_bad(given.values)
    if not bad.any():
        return []
    first = np.unravel_index(int(np.argmax(bad)), bad.shape)
    where = dict(zip(given.dims, first, strict=True))
    text = f" at second {where['elapsed_time']}" if "elapsed_time" in where else ""
    if "day" in where:
        i = where["day"]
        text += f" of day {labels[i] if labels.ndim and i < labels.size else i}"
    return [series.sentence(float(given.values[first]), text, int(bad.sum()))]
