"""The column ``timestamp`` as seconds: ISO 8601, a national form, serial days of a spreadsheet, epoch.

National forms are 01/07/2024 8:05 PM, 01.07.2024 20:05, 01-Jul-24 20:05:00 PDT and the like; the order of day and month
comes from numbers above 12, or from the order in which time goes on, and is refused where neither shows it.  Date and
time of day may have a column each.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arguments import text_of
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, shown
from fastcoil.logs.series import counted

MOST_LETTERS = 64
"""Of a cell that can be a time or a number."""
_MONTHS = (
    "january", "february", "march", "april", "may", "june",
    "july", "august", "september", "october", "november", "december",
)  # fmt: skip
_WRITTEN = re.compile(
    r"\s*(?:(?i:mon|tue|wed|thu|fri|sat|sun)[a-z]{0,6},?\s+)?"
    r"(?P<a>\d{1,4}|[A-Za-z]{3,9})(?P<mark>[-./ ])(?P<b>\d{1,2}|[A-Za-z]{3,9}),?(?P=mark)(?P<c>\d{1,4})"
    r"(?:[T,\s]\s*(?P<h>\d{1,2}):(?P<min>\d{2})(?::(?P<s>\d{2})(?:[.,](?P<part>\d{1,9}))?)?"
    r"\s*(?:(?P<half>[AaPp])\.?[Mm]\.?(?![A-Za-z]))?"
    r"\s*\(?(?:Z|(?:UTC|GMT)?(?P<offset>[+-]\d{2}:?\d{2}|[+-]\d{1,2}))?\s*[\[]?(?P<zone>[A-Za-z_/]{1,32})?[)\]]?)?\s*"
)
_DAYLIGHT = {
    "pdt": "pst", "mdt": "mst", "cdt": "cst", "edt": "est", "akdt": "akst", "adt": "ast", "ndt": "nst",
    "cest": "cet", "mesz": "mez", "eest": "eet", "west": "wet", "bst": "gmt", "aedt": "aest", "acdt": "acst",
    "nzdt": "nzst",
}  # fmt: skip
"""Zones an hour ahead of the one that the same place has in winter."""
_UNEVEN = 5.0  # the order of day and month that makes a log this much longer than the other one, and uneven, is wrong
_SECOND = 1_000_000
MICROSECONDS = np.dtype("datetime64[us]")


class Parts(NamedTuple):
    """A time as it is written, before the order of day and month is known.

    a, b, c: the three numbers of the date.  month: index of the one that is a name, -1 if none is.  half: 0 AM, 1 PM,
    -1 neither.  offset: from UTC in minutes; None if there is none.
    """

    a: int
    b: int
    c: int
    month: int
    clock: int
    half: int
    hour: int
    offset: int | None
    zone: str
    dotted: bool
    year_first: bool


class Dates(NamedTuple):
    """Times of the rows since 1970, µs, (n,); ``good`` where a cell holds one; how they were read."""

    microseconds: Index
    good: Mask
    notes: list[str]


def parts_of(cell: str) -> Parts | None:
    """The numbers of a date and a time, or None if the cell is written otherwise."""
    found = _WRITTEN.fullmatch(cell) if len(cell) <= MOST_LETTERS else None
    if found is None:
        return None
    numbers, month = [], -1
    for k, text in enumerate(found.group("a", "b", "c")):
        if text.isdigit():
            numbers.append(int(text))
        elif month >= 0 or not (named := [n for n, name in enumerate(_MONTHS, 1) if name.startswith(text.lower())]):
            return None
        else:
            numbers.append(named[0])
            month = k
    hour, minute, second = (int(found[name] or 0) for name in ("h", "min", "s"))
    if minute > 59 or second > 59 or hour > 24:
        return None
    part = int((found["part"] or "0")[:6].ljust(6, "0"))
    half = -1 if found["half"] is None else int(found["half"] in "Pp")
    if half >= 0 and not 1 <= hour <= 12:
        return None
    return Parts(
        a=numbers[0],
        b=numbers[1],
        c=numbers[2],
        month=month,
        clock=(60 * minute + second) * _SECOND + part,
        half=half,
        hour=hour if half < 0 else hour % 12 + 12 * half,
        offset=_offset(found["offset"]) if found["offset"] else 0 if _is_utc(cell, found["zone"]) else None,
        zone="" if found["offset"] else (found["zone"] or "").lower(),
        dotted=found["mark"] == ".",
        year_first=len(found["a"]) == 4 and month != 0,
    )


def _is_utc(cell: str, zone: str | None) -> bool:
    return zone is None and cell.rstrip().endswith("Z")


def _offset(text: str) -> int:
    sign, digits = (-1 if text[0] == "-" else 1), text[1:].replace(":", "")
    return sign * (60 * int(digits[:2]) + int(digits[2:] or 0))


def read_dates(parts: list[Parts | None], row_numbers: list[int], cure: str) -> Dates:
    """The times of a column of ``parts``; None is a cell that is no time.

    cure: how to give the format, for messages.
    """
    good = np.array([one is not None for one in parts])
    some = [one for one in parts if one is not None]
    rows = [number for number, is_good in zip(row_numbers, good, strict=True) if is_good]
    notes: list[str] = []
    a, b, c = (np.array([one[k] for one in some], dtype=np.int64) for k in range(3))
    clock = np.array([3600 * _SECOND * one.hour + one.clock for one in some], dtype=np.int64)
    late = _zones(some, rows, notes)
    halves = np.array([one.half >= 0 for one in some])
    complete = halves | ~halves.any()  # a time without AM or PM among others is none
    named = {one.month for one in some}
    if all(one.year_first for one in some):
        day, valid = _days(a, b, c)
    elif named == {0}:
        day, valid = _days(c, a, b)
    elif named == {1}:
        day, valid = _days(c, b, a)
    else:
        first = _day_is_first(a, b, c, clock, rows, all(one.dotted for one in some), cure, notes)
        day, valid = _days(c, b, a) if first else _days(c, a, b)
    valid &= complete
    microseconds = np.zeros(len(parts), dtype=np.int64)
    microseconds[good] = np.where(valid, 86400 * _SECOND * day + clock - late, 0)
    good[good] = valid
    return Dates(microseconds, good, notes)


def _days(year: Index, month: Index, day: Index) -> tuple[Index, Mask]:
    """Days since 1970, and where there is such a day; years of two digits are from 1970 to 2069."""
    year = np.where(year < 70, year + 2000, np.where(year < 100, year + 1900, year))
    valid = (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31) & (year >= 1900)
    months = np.where(valid, 12 * (year - 1970) + month - 1, 0).astype("datetime64[M]")
    days = months.astype("datetime64[D]") + (np.where(valid, day, 1) - 1).astype("timedelta64[D]")
    return days.astype(np.int64), valid & (days.astype("datetime64[M]") == months)


def _day_is_first(
    a: Index, b: Index, c: Index, clock: Index, rows: list[int], dotted: bool, cure: str, notes: list[str]
) -> bool:
    """Whether the day is written before the month: from numbers above 12, or from the order in which time goes on."""
    large_a, large_b = a > 12, b > 12
    if large_a.any() and large_b.any():
        i, j = rows[int(np.argmax(large_a))], rows[int(np.argmax(large_b))]
        raise InputError(
            f"timestamp has the day before the month in row {i} and after it in row {j}: write one order, "
            "such as 2024-07-01T08:00:00"
        )
    if large_a.any() or large_b.any():
        which, much = ("first", large_a) if large_a.any() else ("second", large_b)
        notes.append(f"timestamp read as {_words(bool(large_a.any()), dotted)}: the {which} number exceeds 12 in "
                     f"{counted(much, 'row')}")  # fmt: skip
        return bool(large_a.any())
    if dotted:
        notes.append(f"timestamp read as {_words(True, True)}, the order that goes with points")
        return True
    ways = [86400 * _SECOND * _days(c, *order)[0] + clock for order in ((b, a), (a, b))]
    if np.ptp(ways[0] - ways[1]) == 0:
        notes.append("timestamp: the order of day and month cannot be told, and makes no difference within this log")
        return True
    (day_length, _), (month_length, _) = lengths = [_length_and_unevenness(way) for way in ways]
    day_first = day_length < month_length
    length, uneven = lengths[day_first]  # of the other order
    if uneven and length > _UNEVEN * min(day_length, month_length):
        notes.append(f"timestamp read as {_words(day_first, dotted)}: in the other order time would jump")
        return day_first
    raise InputError(
        "timestamp: no number shows whether the day or the month comes first: say it with "
        f"{cure.format(format='%d/%m/%Y %H:%M')} or '%m/%d/%Y %H:%M'"
    )


def _words(day_first: bool, dotted: bool) -> str:
    return ("dd.mm.yyyy" if day_first else "mm.dd.yyyy") if dotted else "dd/mm/yyyy" if day_first else "mm/dd/yyyy"


def _length_and_unevenness(times: Index) -> tuple[float, bool]:
    """Length of the way that time goes, µs, and whether one of its steps is far longer than the others."""
    steps = np.abs(np.diff(times)).astype(np.float64)
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    return float(steps.sum()), bool(steps.size and steps.max() > _UNEVEN * usual)


def _zones(some: list[Parts], rows: list[int], notes: list[str]) -> NDArray[np.int64]:
    """How much later than the first zone the clock of each time shows, µs; mixed zones are refused."""
    with_offset = [one.offset is not None for one in some]
    zones = dict.fromkeys(one.zone for one in some)
    if any(with_offset) and not all(with_offset):
        k = with_offset.index(not with_offset[0])
        raise InputError(
            f"timestamp in row {rows[k]} has {'a' if with_offset[k] else 'no'} UTC offset, unlike the first: "
            "write one time zone"
        )
    if all(with_offset):
        return np.array([60 * (one.offset or 0) * _SECOND for one in some], dtype=np.int64)
    if set(zones) == {""}:
        return np.zeros(len(some), dtype=np.int64)
    if "" in zones:
        k = next(i for i, one in enumerate(some) if bool(one.zone) != bool(some[0].zone))
        raise InputError(f"timestamp names a time zone in some rows only, first unlike in row {rows[k]}: write one")
    winter = {_DAYLIGHT.get(zone, zone) for zone in zones}
    shown_zones = " and ".join(zone.upper() for zone in list(zones)[:2])
    if len(zones) == 1:
        notes.append(f"timestamp is in {shown_zones} throughout: its times are read as they stand")
    elif len(zones) == 2 and len(winter) == 1:
        notes.append(f"timestamp is in {shown_zones}: read as one time, an hour apart")
    else:
        raise InputError(f"timestamp has the time zones {shown(', '.join(map(str.upper, zones)))}: write one")
    return np.array([3600 * _SECOND * (len(zones) == 2 and one.zone in _DAYLIGHT) for one in some], dtype=np.int64)


SERIAL, EPOCH = "excel", "epoch"
"""Formats that are numbers."""
_EPOCH = datetime(1970, 1, 1)
_UTC = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_DAYS = (20_000.0, 80_000.0)  # serial days of a spreadsheet from 1954 to 2119; 25,569 is 1970-01-01
_SERIAL_OF_1970 = 25_569
_SECONDS = (1e8, 1e10)  # epoch seconds from 1973 to 2286; milliseconds are a thousand times as many
_EXAMPLE = datetime(2024, 7, 1, 8, 5, 30)
_LONGEST_FORMAT = 100


class Stamps(NamedTuple):
    """The times of a column.

    microseconds: since 1970-01-01, of UTC where ``absolute``, else of the clock that wrote them, (n,).  good: where a
    cell holds a time.  wrong: what the others are not, and the cure.  notes: how the column was read.  offset: minutes
    by which the clock that wrote them is ahead of UTC, if ``absolute``; 0 where there are several.
    """

    microseconds: Index
    good: Mask
    absolute: bool
    wrong: str
    notes: list[str]
    offset: int = 0

    def first(self) -> tuple[np.datetime64, str]:
        """The first time, to the second, on the clock that wrote it; its time zone, blank if unknown."""
        there = self.microseconds[np.argmax(self.good)] + self.absolute * 60_000_000 * self.offset
        zone = offset_text(self.offset) if self.absolute else ""
        return np.datetime64(int(there + 500_000) // 1_000_000, "s"), zone


def offset_text(minutes: int) -> str:
    """An offset from UTC as the name of a time zone: ``UTC-08:00``."""
    return f"UTC{'-' if minutes < 0 else '+'}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}" if minutes else "UTC"


def time_format_of(name: str, value: Any) -> str:
    """A format of times: a pattern as of strftime, ``excel`` or ``epoch``."""
    text = text_of(name, value)
    cure = f"give a pattern such as '%d/%m/%Y %H:%M', or {SERIAL} or {EPOCH}"
    if text.strip().lower() in (SERIAL, EPOCH):
        return text.strip().lower()
    try:
        usable = "%" in text and len(text) <= _LONGEST_FORMAT
        usable = usable and datetime.strptime(_EXAMPLE.strftime(text), text).year > 0
    except Exception:  # patterns fail in many ways, not all of them documented
        usable = False
    if not usable:
        raise InputError(f"{name} = {shown(text)}: {cure}")
    return text


def read_stamps(cells: Sequence[str], row_numbers: list[int], time_format: str | None, cure: str) -> Stamps:
    """The times of the cells of a column.

    Parameters
    ----------
    cells, row_numbers
        Its cells, and their rows in the file.
    time_format
        As checked by ``time_format_of``; if None, the format is recognised.
    cure
        How to give a format, with ``{format}`` in it, for messages.
    """
    if time_format in (SERIAL, EPOCH):
        numbers = np.array([_number(cell) for cell in cells])
        return _serial(numbers, "") if time_format == SERIAL else _epoch(numbers, "")
    if time_format is not None:
        times = [_by_pattern(cell, time_format) for cell in cells]
        return _of_datetimes(times, row_numbers, f"is not as {time_format!r} says: mend it or time_format")
    times = [timestamp_of(cell) for cell in cells]
    n_iso = sum(time is not None for time in times)
    iso = "is not ISO 8601: write it as 2024-07-01T08:00:00, or say how to read it: "
    iso += cure.format(format="%d/%m/%Y %H:%M")
    if 2 * n_iso >= len(times):
        return _of_datetimes(times, row_numbers, iso)
    numbers = np.array([_number(cell) for cell in cells])
    for (low, high), read in ((_DAYS, _serial), (_SECONDS, _epoch), ((1e3 * _SECONDS[0], 1e3 * _SECONDS[1]), _epoch)):
        with np.errstate(invalid="ignore"):
            if 2 * ((numbers >= low) & (numbers <= high)).sum() > numbers.size:
                return read(numbers, cells[int(np.argmax((numbers >= low) & (numbers <= high)))].strip())
    parts: list[Parts | None] = [parts_of(cell) for cell in cells]
    n_parts = sum(one is not None for one in parts)
    if 2 * n_parts < len(parts) or n_parts < n_iso:
        return _of_datetimes(times, row_numbers, iso)
    dates = read_dates(parts, row_numbers, cure)
    absolute = any(one is not None and one.offset is not None for one in parts)
    wrong = f"is not as the others: mend it, or say how to read them: {cure.format(format='%d/%m/%Y %H:%M')}"
    offsets = {one.offset or 0 for one in parts if one is not None}
    offset = offsets.pop() if len(offsets) == 1 else 0
    return Stamps(dates.microseconds, dates.good, absolute, wrong, dates.notes, offset)


def timestamp_of(cell: str) -> datetime | None:
    """The time in a cell (ISO 8601), or None."""
    try:
        return datetime.fromisoformat(cell.strip())
    except ValueError:
        return None


def is_time(cell: str) -> bool:
    """Whether a cell holds a date, with or without a time, in a writing that is recognised."""
    return timestamp_of(cell) is not None or parts_of(cell) is not None


def _of_datetimes(times: list[datetime | None], row_numbers: list[int], wrong: str) -> Stamps:
    """Times that all have a UTC offset, or none has one; different offsets are different clocks of one time."""
    good = np.array([time is not None for time in times])
    if not any(time is not None and time.tzinfo for time in times):
        on_clock = np.array([time or _EPOCH for time in times], dtype=MICROSECONDS)
        return Stamps(on_clock.astype(np.int64), good, False, wrong, [])
    offsets = [None if time is None else time.utcoffset() for time in times]
    known = [k for k, time in enumerate(times) if time is not None]
    notes: list[str] = []
    for k in known:
        if (offsets[k] is None) != (offsets[known[0]] is None):
            raise InputError(
                f"timestamp in row {row_numbers[k]} has another UTC offset than the first: write one time zone, "
                "with or without offset"
            )
        if not notes and offsets[k] != offsets[known[0]]:
            notes.append(f"timestamp has another UTC offset from row {row_numbers[k]} on: read in UTC")
    since = [0 if time is None else (time - _UTC) // _MICROSECOND for time in times]
    one_clock = offsets[known[0]] if not notes else None
    minutes = 0 if one_clock is None else round(one_clock.total_seconds() / 60)
    return Stamps(np.array(since, dtype=np.int64), good, True, wrong, notes, minutes)


def _serial(numbers: Array, example: str) -> Stamps:
    """Serial days of a spreadsheet, to the second: their decimals have round-off."""
    with np.errstate(invalid="ignore"):
        good = (numbers >= _DAYS[0]) & (numbers <= _DAYS[1])
    seconds = np.rint(86400.0 * (np.where(good, numbers, _SERIAL_OF_1970) - _SERIAL_OF_1970)).astype(np.int64)
    wrong = f"is no serial day of a spreadsheet: these are from {_DAYS[0]:g} to {_DAYS[1]:g}"
    return Stamps(1_000_000 * seconds, good, False, wrong, _read_as("serial days of a spreadsheet", example, seconds))


def _epoch(numbers: Array, example: str) -> Stamps:
    """Seconds or milliseconds since 1970-01-01 in UTC."""
    finite = numbers[np.isfinite(numbers)]
    thousandths = bool(finite.size) and float(np.median(finite)) > _SECONDS[1]
    scale = 1e3 if thousandths else 1.0
    with np.errstate(invalid="ignore"):
        good = (numbers >= scale * _SECONDS[0]) & (numbers <= scale * _SECONDS[1])
    microseconds = np.rint(np.where(good, numbers, 0.0) * (1e6 / scale)).astype(np.int64)
    what = f"{'milliseconds' if thousandths else 'seconds'} since 1970 (UTC)"
    return Stamps(microseconds, good, True, f"is not {what}", _read_as(what, example, microseconds // 1_000_000))


def _read_as(what: str, example: str, seconds: Index) -> list[str]:
    if not example:
        return []
    first = np.datetime_as_string((1_000_000 * seconds[:1]).astype(MICROSECONDS), unit="s")[0]
    return [f"timestamp read as {what}: {shown(example)} is {first}"]


def _by_pattern(cell: str, pattern: str) -> datetime | None:
    try:
        return datetime.strptime(cell.strip(), pattern) if len(cell) <= 2 * MOST_LETTERS else None
    except (ValueError, OverflowError, re.error):
        return None


def _number(cell: str) -> float:
    try:
        return float(cell.replace(",", ".")) if len(cell) <= MOST_LETTERS else np.nan
    except ValueError:
        return np.nan


_DATES, _CLOCKS = ("date", "datum"), ("time", "time of day", "zeit", "uhrzeit")  # headers, in small letters
_CLOCK = re.compile(r"\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d{1,9})?)?\s*(?:[AaPp]\.?[Mm]\.?)?(?:\s?[A-Za-z+:\d-]{1,9})?")
_ROWS_LOOKED_AT = 3


class ClockColumns(NamedTuple):
    """Index of the column of dates, and of the one of times of day."""

    date: int
    clock: int


def find_clock_columns(header: list[str], rows: list[list[str]]) -> ClockColumns | None:
    """The two columns of a date and a time of day; None if the table has none, or more than one of either."""
    found = []
    for names in (_DATES, _CLOCKS):
        fits = [k for k, cell in enumerate(header) if cell.strip().lower() in names]
        if len(fits) != 1:
            return None
        found += fits
    columns = ClockColumns(*found)
    first = rows[:_ROWS_LOOKED_AT]
    dates = all(is_time(row[columns.date]) and ":" not in row[columns.date] for row in first)
    clocks = all(_CLOCK.fullmatch(row[columns.clock].strip()) for row in first)
    return columns if dates and clocks else None


def join_cells(row: list[str], columns: ClockColumns) -> str:
    """Date and time of day of a row as one text; blank if one of them is."""
    date, clock = row[columns.date].strip(), row[columns.clock].strip()
    return f"{date} {clock}" if date and clock else ""
