"""What a user gives of a boundary, its series, the clock of its days and numbers that describe a day, and the checks.

All labels must agree.  A loop without air flow is not in operation: its seconds count in no
metric, and a warning says so.
"""

import math
import re
import warnings
import zoneinfo
from collections.abc import Iterable, Mapping
from datetime import UTC, date, datetime, timedelta
from itertools import islice
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arguments import array_of, collecting, plain, refuse, text_of, whole_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, WrongType, nearest, shown
from fastcoil.logs.series import COLUMNS, Series
from fastcoil.logs.timestamps import offset_text, zone_named
from fastcoil.loops.labelled import Course, as_labelled, course_of, differing, in_our_unit
from fastcoil.model.parameter_table import PARAMETERS, Parameter

Values: TypeAlias = Any
"""A series as a user gives it: a number, array-like or DataArray; checked at run time."""

ADDED_SERIES = ("backlash_scale",)  # they count in a digest only where they do something
_NAMES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set", "noise", "enabled", *ADDED_SERIES)
BOUNDARY_SERIES = {name: COLUMNS[name] for name in _NAMES}
"""Every series of a `Boundary` by name."""
LARGEST_DAY_LABEL = 2**32 - 1


class Given(NamedTuple):
    """One series as read: dims (of ``day``, ``elapsed_time``), values in our unit, and what its labels say."""

    dims: tuple[str, ...]
    values: Array
    course: Course

    def spread(self, n_days: int, n_steps: int) -> Array:
        shape = (n_days if "day" in self.dims else 1, n_steps if "elapsed_time" in self.dims else 1)
        # Adding 0.0 makes -0.0 a 0.0: equal series have equal bytes, hence equal digests.
        return np.broadcast_to(self.values.reshape(shape), (n_days, n_steps)) + 0.0

    def of_day(self, k: int) -> Array:
        return self.values[k] if "day" in self.dims else self.values


_NOTHING = Course()


def read_series(
    values: Mapping[str, Values], problems: list[str], *, day: Values = None, known: Course = _NOTHING
) -> tuple[dict[str, Given], Course]:
    """Series as a user gives them in our units, and what their labels and sizes say of all of them.

    Mistakes are added to ``problems``, a sentence each.  Labels that series carry must be alike, and as ``known``;
    ``day`` replaces those of days.
    """
    given: dict[str, Given] = {}
    for name, value in values.items():
        with collecting(problems):
            given[name] = _read(COLUMNS[name], value)
    if known.time_zone:  # times without a zone are on the clock of the boundary
        local = [name for name, one in given.items() if one.course.time_zone == ""]
        given |= {name: given[name]._replace(course=given[name].course._replace(time_zone=None)) for name in local}
    if known.day is not None:
        known = known._replace(n_days=known.day.size)
    course = Course()
    for field, text, cure in _LABELS:
        of_boundary = getattr(known, field)
        every = ({} if of_boundary is None else {"the boundary": of_boundary}) | _carried(given, field)
        problems += differing(text, every, cure)
        course = course._replace(**{field: next(iter(every.values()), None)})
    labels = course.day if day is None else day
    if labels is not None:
        labels = label_array(labels, problems)
    if day is not None and labels is not None and known.day is None:
        problems += differing("day {}", {"day": labels} | _carried(given, "day"), "leave day out, or give bare arrays")
    if labels is None:
        labels = np.arange(course.n_days) if course.n_days else np.asarray(0)
    elif course.n_days is not None and labels.size != course.n_days:
        problems.append(f"day has {labels.size} labels for {course.n_days} days: give one label for each day")
    elif any("day" in one.dims for one in given.values()):
        labels = np.atleast_1d(labels)
    for name, one in given.items():
        problems += _value_problems(COLUMNS[name], one, labels)
    return given, course._replace(day=labels)


_LABELS = (
    ("n_steps", "{} samples", "give every series the same number"),
    ("n_days", "{} days", "give every series the same number"),
    ("day", "day {}", "align them, or give bare arrays"),
    ("second", "its first sample at elapsed_time {} s", "align them, or drop_vars('elapsed_time')"),
    ("start", "its first sample at {}", "align them, or give bare arrays"),
    ("time_zone", "the time zone {}", "align them, or convert to one zone"),
)
"""Labels of a ``Course``, in words, and what to do where they differ."""


def _carried(given: Mapping[str, Given], field: str) -> dict[str, Any]:
    """What series say of a label; those with several days first."""
    carried = {name: found for name, one in given.items() if (found := getattr(one.course, field)) is not None}
    return dict(sorted(carried.items(), key=lambda item: np.ndim(item[1]) == 0))


def series_of(given: Mapping[str, Given], n_days: int, n_steps: int, *, by_air: bool) -> tuple[dict[str, Array], int]:
    """All series, (n_days, n_steps), and the samples that are off for want of air flow where it decides ``by_air``."""
    whole = {name: values.spread(n_days, n_steps) for name, values in given.items()}
    stopped = 0
    if by_air:
        flows = whole["m_a"] > 0.0
        whole["enabled"], stopped = flows.astype(np.float64), int(flows.size - np.count_nonzero(flows))
    return whole, stopped


def warn_of_stops(seconds: int) -> None:
    """Warn of the seconds that count in no metric because no air flows."""
    if seconds:
        warnings.warn(
            f"m_a is 0 during {seconds / 3600:,.4g} h and enabled is left out: the loop is off there, and these hours "
            "count in no metric; give enabled to have it otherwise",
            stacklevel=3,
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
    sizes = dict(zip(("n_days", "n_steps")[2 - values.ndim :], values.shape, strict=True))
    return Given(("day", "elapsed_time")[2 - values.ndim :], values, Course(**sizes))


def _numbers(series: Series, value: Values) -> Array:
    values = array_of(series.name, value, "give numbers", "iufb" if series.whole else "iuf")
    if values.size == 0:
        raise InputError(f"{series.name} is empty: give at least one 1-s sample")
    with np.errstate(over="ignore"):  # a number that overflows is refused as infinite
        return values.astype(np.float64)


def _value_problems(series: Series, given: Given, labels: NDArray[Any]) -> list[str]:
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


Times: TypeAlias = NDArray[np.datetime64]

SECONDS = np.dtype("datetime64[s]")
YEARS = (1700, 2200)  # every file of results can hold the dates between
_CURE = "give a date and time such as '2024-07-01T08:00', one for each day or one for the first"
_ZONE_CURE = "give a name such as 'America/Los_Angeles', or an offset such as 'UTC-08:00'"
_OFFSET = re.compile(r"UTC[+-](0\d|1[0-4]):[0-5]\d", re.ASCII)


class Clock(NamedTuple):
    """When days start, (n_days,), on the clock of a time zone; None and blank if unknown."""

    start: Times | None = None
    time_zone: str = ""


def clock_of(start: Any, time_zone: Any, day: NDArray[Any], n_steps: int, carried: Course = _NOTHING) -> Clock:
    """The clock of a boundary; one start is that of the first of consecutive days of 24 h.

    day: labels of its days.  carried: what its series say; that stands in for what is not given, or must agree.
    """
    zone = time_zone_of("time_zone", time_zone)
    if start is None and carried.start is None:
        return Clock(None, zone)
    named = {"time_zone": zone, "the first sample": time_zone_of("time_zone", carried.time_zone)}
    if start is None:
        start = carried.start
    elif hasattr(start, "to_numpy") and hasattr(start, "dtype"):  # of xarray or pandas
        array = as_labelled("start", start, "day") if hasattr(start, "dims") else None
        labels = {} if array is None or "day" not in array.coords else {"start": array["day"].values}
        refuse(differing("day {}", {"the boundary": day} | labels, "align them"))
        named["start"] = time_zone_of("time_zone", getattr(start, "attrs", {}).get("time_zone"))
        start = start.to_numpy()
    named = {name: one for name, one in named.items() if one}
    refuse(differing("the time zone {}", named, "convert to one zone"))
    is_list = isinstance(start, (list, tuple)) or (isinstance(start, np.ndarray) and start.ndim)
    several = start if is_list else [start]
    times = [_time_of(one[()] if isinstance(one, np.ndarray) else one) for one in several]
    if len(times) not in (1, day.size):
        raise InputError(f"start has {len(times)} times for {day.size} days: {_CURE}")
    zone = _zone_of(times, next(iter(named.values()), ""))
    refuse([
        f"start = {shown(str(time))}: clocks of {zone} are put forward over that time: give one that they show"
        for time in times
        if time.tzinfo is None and _is_skipped(time, zone)
    ])  # fmt: skip
    found = _to_seconds(np.array([time.replace(tzinfo=None) for time in times], dtype="datetime64[us]"))
    if carried.start is not None:
        both = {"start": found, "the first sample": _to_seconds(np.atleast_1d(carried.start))}
        refuse(differing("the time {}", both, "leave start out, or give bare arrays"))
    if len(times) < day.size:
        if n_steps > 86400:
            raise InputError(f"start = {shown(start)}: days of {n_steps / 3600:g} h overlap, give one start for each")
        found = found[0] + np.arange(day.size) * np.timedelta64(86400, "s")
    return Clock(found, zone)


def _to_seconds(times: Any) -> Times:
    return np.asarray((times.astype("datetime64[us]") + np.timedelta64(500_000, "us")).astype(SECONDS))


def time_zone_of(name: str, value: Any) -> str:
    """The name of a time zone or an offset from UTC; blank if it is None or blank."""
    text = "" if value is None else text_of(name, value).strip()
    if not text or _OFFSET.fullmatch(text) or text in (known := zoneinfo.available_timezones()):
        return text
    raise InputError(f"{name} = {shown(text)}{nearest(text, known)}: {_ZONE_CURE}")


def is_changed(time_zone: str, start: np.datetime64, n_steps: int) -> bool:
    """Whether clocks of the zone are changed within ``n_steps`` s of ``start``, or may show it twice."""
    first = cast(datetime, start.astype(SECONDS).item())
    zone = zone_named(time_zone or "UTC")
    there = first.replace(tzinfo=zone)
    last = (there.astimezone(UTC) + timedelta(seconds=n_steps - 1)).astimezone(zone)
    return len({there.utcoffset(), there.replace(fold=1).utcoffset(), last.utcoffset()}) > 1


def _is_skipped(local: datetime, time_zone: str) -> bool:
    """Whether clocks of the zone never show a local time."""
    zone = zone_named(time_zone or "UTC")
    return local.replace(tzinfo=zone).astimezone(UTC).astimezone(zone).replace(tzinfo=None) != local


def _time_of(value: Any) -> datetime:
    if not isinstance(value, (str, date, np.datetime64)):
        raise InputError(WrongType(f"start = {shown(value)}: {_CURE}"))
    try:
        found = datetime.fromisoformat(value.strip()) if isinstance(value, str) else value
    except ValueError:
        found = None
    if isinstance(found, np.datetime64):
        found = found.astype("datetime64[us]").item()  # None if it is not a time
    if isinstance(found, date) and not isinstance(found, datetime):
        found = datetime(found.year, found.month, found.day)
    if not isinstance(found, datetime) or not YEARS[0] <= found.year <= YEARS[1]:
        raise InputError(f"start = {shown(value)}: {_CURE}, of the years {YEARS[0]} to {YEARS[1]}")
    return found


def _zone_of(times: list[datetime], zone: str) -> str:
    """The zone, from the offsets that the times themselves have if it is not given."""
    offsets = {time.utcoffset() for time in times}
    if offsets == {None}:
        return zone
    for time in times if zone else []:
        if time.replace(tzinfo=zone_named(zone)).utcoffset() != time.utcoffset():
            raise InputError(
                f"start = {shown(str(time))} has another UTC offset than {zone} at that time: give local times"
            )
    names = {getattr(time.tzinfo, "key", None) for time in times}
    if zone or (len(names) == 1 and None not in names):
        return zone or time_zone_of("the time zone of start", names.pop())
    if len(offsets) > 1:
        raise InputError("start has times of different UTC offsets, or some without: give local times, and time_zone")
    return offset_text(round(cast(timedelta, offsets.pop()).total_seconds() / 60))


_BOUNDS: tuple[tuple[str, str, float, float], ...] = (
    ("relative_humidity outdoor_fraction RH_return internal_load zone_spread", "1", 0.0, 1.0),
    ("W_return", "1", 0.0, 0.1),
    ("disturbances", "1", 0.0, 10.0),
    ("T_a_in T_design T_balance economiser_limit", "degC", -40.0, 60.0),
    ("T_out_min T_out_max T_out_w_min T_out_w_max", "degC", -40.0, 60.0),
    ("T_wet_bulb", "degC", -40.0, 40.0),
    ("T_return", "degC", -20.0, 60.0),
    ("T_set T_set_min T_set_max", "degC", 0.0, 60.0),
    ("T_w_in T_w_min T_w_max", "degC", 0.5, 95.0),
    ("T_daily_range", "K", 0.0, 40.0),
    ("trim respond respond_max", "K", 0.0, 10.0),
    ("start_hour", "h", 0.0, 24.0),
    ("start", "h", 0.0, 8784.0),
    ("hours", "h", 0.0, 8760.0),
    ("m_a_design m_a_min outdoor_air_min", "kg s-1", 0.0, math.inf),
)
_ABOVE_0 = ("hours", "m_a_design", "m_a_min")
CONDITIONS = {
    name: Parameter(name, "boundary", unit, None, "", least, most, open_lower=name in _ABOVE_0)
    for names, unit, least, most in _BOUNDS
    for name in names.split()
} | {"pressure": PARAMETERS["pressure"]}
"""The numbers that describe a day, each with its unit and bounds."""
_MOST_DAYS = 366
_MOST_ITEMS = 1_000_000


def condition_of(name: str, value: Any) -> Any:
    """A number that describes a day, within its bounds."""
    number = plain(value)
    if problem := CONDITIONS[name].problem(number):
        raise InputError(problem)
    return number


def whole_seconds(hours: float | None) -> int:
    """``hours`` in seconds, or an `InputError` if they are not a whole number of them."""
    hours = float(condition_of("hours", hours))
    seconds = round(hours * 3600)
    if abs(hours * 3600 - seconds) > 1e-6 or seconds < 1:
        raise InputError(f"hours = {hours:g}: give a whole number of seconds (n / 3600)")
    return seconds


def several_of(name: str, value: object, cure: str) -> list[object]:
    """The items of an iterable of at most ``_MOST_ITEMS``."""
    if isinstance(value, str | bytes) or not isinstance(value, Iterable) or getattr(value, "ndim", 1) == 0:
        raise InputError(WrongType(f"{name} = {shown(value)}: {cure}"))
    items = list(islice(value, _MOST_ITEMS + 1))
    if len(items) > _MOST_ITEMS:
        raise InputError(f"{name} has more than {_MOST_ITEMS:,} items: give fewer")
    return items


def days_of(name: str, value: object) -> list[int]:
    """Days of the year."""
    whole = f"give whole numbers from 1 to {_MOST_DAYS}"
    several = several_of(name, value, "give a list of days of the year")
    days = [whole_of(name, one, 1, _MOST_DAYS, whole) for one in several]
    if not days or len(set(days)) < len(days):
        raise InputError(f"{name} {'has a day twice' if days else 'is empty'}: give each day once")
    return days
