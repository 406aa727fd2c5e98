"""Days of a weather file as days of a calendar: dates, days of the week, hours of the fan."""

from __future__ import annotations

import re
from calendar import isleap
from collections.abc import Iterable, Mapping, Sequence
from datetime import date, timedelta
from itertools import islice
from typing import NamedTuple, cast

from fastcoil.base.arguments import is_number, plain, text_of, whole_of
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.loops.boundary.weather_files import Weather
from fastcoil.loops.boundary.weather_formats import WEEKDAYS

_MOST = 366
_FIRST_YEAR, _LAST_YEAR = 1970, 2199
_USUAL_YEAR = 2001
_MONTH_DAY = re.compile(r"(\d\d?)-(\d\d?)", re.ASCII)
Hours = tuple[float, float] | None


class Calendar(NamedTuple):
    """The year that a weather file stands for: its number, and whether the file has a 29th of February."""

    year: int
    leap: bool

    def labels(self, first: tuple[int, int] | None, last: tuple[int, int] | None, available: range) -> list[int]:
        """Days of the year from a date to another, across the end of the year if the last one comes first."""
        low = available[0] if first is None else self._label("first_date", first)
        high = available[-1] if last is None else self._label("last_date", last)
        if low <= high:
            return list(range(low, high + 1))
        return [*range(low, 366 + self.leap), *range(1, high + 1)]

    def _label(self, name: str, month_day: tuple[int, int]) -> int:
        try:
            day = date(2000 if self.leap else 2001, *month_day)
        except ValueError:
            raise InputError(f"{name} = 02-29: the weather has no 29 February, give another day") from None
        return day.timetuple().tm_yday

    def dates(self, labels: Sequence[int]) -> list[date]:
        """Dates of days of the year; a day before the one in front of it is one of the next year."""
        year, before, found = self.year, 0, []
        for label in labels:
            year += label < before
            day = date(2000 if self.leap else 2001, 1, 1) + timedelta(days=label - 1)
            if self.leap and year != self.year:
                raise InputError("days go on into the next year, but the weather has a 29 February: end at 12-31")
            found.append(day.replace(year=year))
            before = label
        return found


def calendar_of(year: int | None, weather: Weather, file: str) -> Calendar:
    """The year of a file; without one the first from 2001 on that fits the day of the week of its first row."""
    hours, series = weather.series["hour_of_year"], weather.series
    leap = bool(hours[-1] > 8760)
    if "month" in series and "day" in series:
        leap = leap or bool(((series["month"] == 2) & (series["day"] == 29)).any())
    if year is None:
        if not weather.first_weekday:
            raise InputError(f"year is missing: {file} does not tell the day of the week, give a year such as 2023")
        after = timedelta(days=int((hours[0] - 1.0) // 24.0))
        return next(
            Calendar(one, leap)
            for one in range(_USUAL_YEAR, _USUAL_YEAR + 40)
            if isleap(one) == leap and WEEKDAYS[(date(one, 1, 1) + after).weekday()] == weather.first_weekday
        )
    if isleap(year) != leap:
        has, other = ("a", "a leap year") if leap else ("no", "a year that is no leap year")
        raise InputError(f"year = {year}: {file} has {has} 29 February, give {other}")
    return Calendar(year, leap)


def year_of(name: str, value: object) -> int:
    """Number of a year."""
    cure = f"give a year from {_FIRST_YEAR} to {_LAST_YEAR}"
    return whole_of(name, value, _FIRST_YEAR, _LAST_YEAR, cure)


def month_day_of(name: str, value: object) -> tuple[int, int]:
    """Month and day of a text such as ``06-15``."""
    text = text_of(name, value)
    match = _MONTH_DAY.fullmatch(text.strip())
    try:
        month, day = (int(match[1]), int(match[2])) if match else (0, 0)
        date(2000, month, day)
    except ValueError:
        raise InputError(f"{name} = {shown(text)}: give month and day, such as 06-15") from None
    return month, day


def month_days_of(name: str, value: object) -> list[tuple[int, int]]:
    """Several of them."""
    return [month_day_of(name, one) for one in _several(name, value, "give a list such as 01-01, 12-25")]


def days_of(name: str, value: object) -> list[int]:
    """Days of the year."""
    cure = "give a list of days of the year"
    days = [
        whole_of(name, one, 1, _MOST, f"give whole numbers from 1 to {_MOST}") for one in _several(name, value, cure)
    ]
    if not days or len(set(days)) < len(days):
        raise InputError(f"{name} {'has a day twice' if days else 'is empty'}: give each day once")
    return days


def hours_of(name: str, value: object) -> tuple[float, float]:
    """First and last hour of a day, in whole seconds."""
    cure = "give the hours of start and stop, such as 6, 20"
    pair = _several(name, value, cure)
    if len(pair) != 2 or not all(is_number(hour) for hour in pair):
        raise InputError(f"{name} = {shown(value)}: {cure}")
    start, stop = (float(plain(hour)) for hour in pair)
    if not 0.0 <= start < stop <= 24.0:
        raise InputError(f"{name} = {start:g}, {stop:g}: give a start before the stop, from 0 to 24")
    if any(abs(3600 * hour - round(3600 * hour)) > 1e-6 for hour in (start, stop)) or stop - start < 0.25:
        raise InputError(f"{name} = {start:g}, {stop:g}: give whole seconds (n / 3600), a quarter of an hour at least")
    return start, stop


def fan_days(
    labels: Sequence[int], dates: Sequence[date], weekday: Hours, weekend: Hours, holidays: Iterable[tuple[int, int]]
) -> Mapping[int, tuple[float, float]]:
    """Hours of the fan by day; days without are days of rest.  Holidays are run like a Saturday or Sunday."""
    free = set(holidays)
    hours = {
        label: weekend if day.weekday() >= 5 or (day.month, day.day) in free else weekday
        for label, day in zip(labels, dates, strict=True)
    }
    return {label: pair for label, pair in hours.items() if pair is not None}


def _several(name: str, value: object, cure: str) -> list[object]:
    if isinstance(value, str | bytes):
        raise InputError(WrongType(f"{name} = {shown(value)}: {cure}"))
    try:
        return list(islice(cast("Iterable[object]", value), _MOST + 1))
    except Exception:  # nothing to iterate over; a user's class may raise anything
        raise InputError(WrongType(f"{name} = {shown(value)}: {cure}")) from None


def require_days(labels: Sequence[int], available: range, file: str) -> None:
    """Refuse days that a file does not hold."""
    absent = [label for label in labels if label not in available]
    if absent:
        more = f" ({len(absent)} days in total)" if len(absent) > 1 else ""
        raise InputError(
            f"days: {file} holds the whole days {available[0]} to {available[-1]} of the year, not {absent[0]}"
            f"{more}: choose among them"
        )
