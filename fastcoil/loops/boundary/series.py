"""The series of a boundary, and the checks of the values that a user gives for them; labels of all must agree.

A loop without air flow is not in operation: its seconds count in no metric, and a warning says so.
"""

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arguments import array_of, collecting
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, shown
from fastcoil.logs.series import COLUMNS, Series
from fastcoil.loops.labelled import Course, as_labelled, course_of, differing, in_our_unit

Values: TypeAlias = Any
"""A series as a user gives it: a number, array-like or DataArray; checked at run time."""

ADDED_SERIES = ("backlash_scale",)
"""Series that count in a digest only where they do something."""
_NAMES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set", "noise", "enabled", *ADDED_SERIES)
BOUNDARY_SERIES = {name: COLUMNS[name] for name in _NAMES}
"""Every series of a `Boundary` by name."""
LARGEST_DAY_LABEL = 2**32 - 1


class Given(NamedTuple):
    """One series as read: dims (of ``day``, ``elapsed_time``), values in our unit, and what its labels say."""

    dims: tuple[str, ...]
    values: Array
    course: Course = Course()

    def spread(self, n_days: int, n_steps: int) -> Array:
        shape = (n_days if "day" in self.dims else 1, n_steps if "elapsed_time" in self.dims else 1)
        # Adding 0.0 makes -0.0 a 0.0: equal series have equal bytes, hence equal digests.
        return np.broadcast_to(self.values.reshape(shape), (n_days, n_steps)) + 0.0

    def of_day(self, k: int) -> Array:
        return self.values[k] if "day" in self.dims else self.values


class Frame(NamedTuple):
    """What all series of a boundary share: the number of samples of a day, and what their labels say."""

    n_steps: int | None = None
    course: Course = Course()


def read_series(
    values: Mapping[str, Values], problems: list[str], *, day: Values = None, known: Frame | None = None
) -> tuple[dict[str, Given], Frame]:
    """Series as a user gives them in our units, and what they share.

    Mistakes are added to ``problems``, a sentence each.  Labels that series carry must be alike, and as ``known``;
    ``day`` replaces those of days.
    """
    given: dict[str, Given] = {}
    for name, value in values.items():
        with collecting(problems):
            given[name] = _read(COLUMNS[name], value)
    frame = known or Frame()
    sizes = {
        dim: {name: one.values.shape[one.dims.index(dim)] for name, one in given.items() if dim in one.dims}
        for dim in ("elapsed_time", "day")
    }
    cure = "give every series the same number"
    n_steps = _agreed("{} samples", frame.n_steps, sizes["elapsed_time"], problems, cure)
    known_days = None if frame.course.day is None else frame.course.day.size
    n_days = _agreed("{} days", known_days, sizes["day"], problems, cure)
    if frame.course.time_zone:  # times without a zone are on the clock of the boundary
        local = [name for name, one in given.items() if one.course.time_zone == ""]
        given |= {name: given[name]._replace(course=given[name].course._replace(time_zone=None)) for name in local}
    course = {
        field: _agreed(text, getattr(frame.course, field), _carried(given, field), problems, f"align them, or {cure}")
        for field, text, cure in _LABELS
    }
    labels = course["day"] if day is None else day
    if labels is not None:
        labels = label_array(labels, problems)
    if day is not None and labels is not None and frame.course.day is None:
        problems += differing("day {}", {"day": labels} | _carried(given, "day"), "leave day out, or give bare arrays")
    if labels is None:
        labels = np.arange(n_days) if n_days else np.asarray(0)
    elif n_days is not None and labels.size != n_days:
        problems.append(f"day has {labels.size} labels for {n_days} days: give one label for each day")
    elif sizes["day"]:
        labels = np.atleast_1d(labels)
    for name, one in given.items():
        problems += _value_problems(COLUMNS[name], one, labels)
    return given, Frame(n_steps, Course(**course | {"day": labels}))


_LABELS = (
    ("day", "day {}", "give bare arrays"),
    ("second", "its first sample at elapsed_time {} s", "drop_vars('elapsed_time')"),
    ("start", "its first sample at {}", "give bare arrays"),
    ("time_zone", "the time zone {}", "convert to one zone"),
)
"""Labels of a ``Course``, in words, and what to do where they differ."""


def _carried(given: Mapping[str, Given], field: str) -> dict[str, Any]:
    """What series say of a label; those with several days first."""
    carried = {name: getattr(one.course, field) for name, one in given.items()}
    carried = {name: found for name, found in carried.items() if found is not None}
    return dict(sorted(carried.items(), key=lambda item: np.ndim(item[1]) == 0))


def _agreed(text: str, known: Any, found: Mapping[str, Any], problems: list[str], cure: str) -> Any:
    """What is ``known`` of the boundary, or the first of what is found; problems are what differs from it."""
    every = ({} if known is None else {"the boundary": known}) | dict(found)
    problems += differing(text, every, cure)
    return next(iter(every.values()), None)


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
    array = as_labelled(series.name, value, "elapsed_time")
    if array is not None:
        course = course_of(series.name, array)
        dims = tuple(dim for dim in ("day", "elapsed_time") if dim in array.dims)
        _numbers(series, array.values)
        return Given(dims, _numbers(series, in_our_unit(series.name, array.transpose(*dims), series.units)), course)
    values = _numbers(series, value)
    if values.ndim > 2:
        raise InputError(f"{series.name} has {values.ndim} dimensions: give (seconds) or (days, seconds)")
    return Given(("day", "elapsed_time")[2 - values.ndim :], values)


def _numbers(series: Series, value: Values) -> Array:
    values = array_of(series.name, value, "give numbers", "iufb" if series.whole else "iuf")
    if values.size == 0:
        raise InputError(f"{series.name} is empty: give at least one 1-s sample")
    with np.errstate(over="ignore"):  # a number that overflows is refused as infinite
        return values.astype(np.float64)


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
