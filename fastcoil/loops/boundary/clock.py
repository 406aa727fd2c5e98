"""Date and time of the first sample of each day, and the time zone that they are in."""

import re
import zoneinfo
from datetime import UTC, date, datetime, timedelta
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arguments import refuse, text_of
from fastcoil.base.errors import InputError, WrongType, nearest, shown
from fastcoil.logs.timestamps import offset_text, zone_named
from fastcoil.loops.labelled import Course, as_labelled, differing

Times: TypeAlias = NDArray[np.datetime64]

SECONDS = np.dtype("datetime64[s]")
DAY = np.timedelta64(86400, "s")
YEARS = (1700, 2200)
"""Every file of results can hold the dates between."""
_CURE = "give a date and time such as '2024-07-01T08:00', one for each day or one for the first"
_ZONE_CURE = "give a name such as 'America/Los_Angeles', or an offset such as 'UTC-08:00'"
_OFFSET = re.compile(r"UTC[+-](0\d|1[0-4]):[0-5]\d", re.ASCII)


_NOTHING = Course()


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
        found = found[0] + np.arange(day.size) * DAY
    return Clock(found, zone)


def _to_seconds(times: Any) -> Times:
    return np.asarray((times.astype("datetime64[us]") + np.timedelta64(500_000, "us")).astype(SECONDS))


def time_zone_of(name: str, value: Any) -> str:
    """The name of a time zone or an offset from UTC; blank if it is None or blank."""
    text = "" if value is None else text_of(name, value).strip()
    known = zoneinfo.available_timezones()
    if not text or text in known or _OFFSET.fullmatch(text):
        return text
    raise InputError(f"{name} = {shown(text)}{nearest(text, known)}: {_ZONE_CURE}")


def _is_skipped(local: datetime, time_zone: str) -> bool:
    """Whether clocks of the zone never show a local time."""
    zone = zone_named(time_zone or "UTC")
    return local.replace(tzinfo=zone).astimezone(UTC).astimezone(zone).replace(tzinfo=None) != local


def is_changed(time_zone: str, start: np.datetime64, n_steps: int) -> bool:
    """Whether clocks of the zone are changed within ``n_steps`` s of ``start``, or may show it twice."""
    first = cast(datetime, start.astype(SECONDS).item())
    zone = zone_named(time_zone or "UTC")
    there = first.replace(tzinfo=zone)
    last = (there.astimezone(UTC) + timedelta(seconds=n_steps - 1)).astimezone(zone)
    return len({there.utcoffset(), there.replace(fold=1).utcoffset(), last.utcoffset()}) > 1


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
    if None in offsets:
        raise InputError("start: some times have a UTC offset and some have none: write all alike")
    for time in times if zone else []:
        if time.replace(tzinfo=zone_named(zone)).utcoffset() != time.utcoffset():
            raise InputError(
                f"start = {shown(str(time))} has another UTC offset than {zone} at that time: give local times"
            )
    names = {getattr(time.tzinfo, "key", None) for time in times}
    if zone or (len(names) == 1 and None not in names):
        return zone or time_zone_of("the time zone of start", names.pop())
    if len(offsets) > 1:
        raise InputError("start has times of different UTC offsets: give local times, and time_zone")
    return offset_text(round(cast(timedelta, offsets.pop()).total_seconds() / 60))
