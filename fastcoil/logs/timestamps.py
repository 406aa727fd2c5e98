"""The column ``timestamp`` as seconds: ISO 8601, a national form, serial days of a spreadsheet, epoch.

National forms are 01/07/2024 8:05 PM, 01.07.2024 20:05, 01-Jul-24 20:05:00 PDT and the like; the order of day and month
comes from numbers above 12, or from the order in which time goes on, and is refused where neither shows it.  Date and
time of day may have a column each.
"""

import re
import zoneinfo
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta, timezone, tzinfo
from typing import Any, NamedTuple, cast

import numpy as np

from fastcoil.base.arguments import text_of
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, shown
from fastcoil.logs.series import NAMES

MOST_LETTERS = 64  # of a cell that can be a time or a number
MICROSECONDS = np.dtype("datetime64[us]")
SECOND, MINUTE = 1_000_000, 60_000_000  # µs
SERIAL, EPOCH = "excel", "epoch"  # formats that are numbers
_EXAMPLE = datetime(2024, 7, 1, 8, 5, 30)


class Stamps(NamedTuple):
    """The times of a column, (n,)."""

    microseconds: Index  # since 1970-01-01, of UTC where ``absolute``, else of the clock that wrote them
    good: Mask  # where a cell holds a time
    absolute: bool
    wrong: str  # what the others are not, and the cure
    notes: list[str]  # how the column was read
    time_zone: str = ""  # of that clock, ``UTC`` if its offset changes; else the name beside the times, or blank
    offset: int = 0  # by which that clock is ahead, µs

    def since_first(self) -> Array:
        """Seconds since the first good time, (n,); NaN where there is none."""
        since = self.microseconds - self.microseconds[np.argmax(self.good)]
        return np.where(self.good, since / 1e6, np.nan)

    def first(self) -> tuple[np.datetime64, str]:
        """The first time, to the second, on the clock that wrote it; its time zone, blank if unknown."""
        there = self.microseconds[np.argmax(self.good)] + self.offset
        return np.datetime64(int(there + SECOND // 2) // SECOND, "s"), self.time_zone if self.absolute else ""


def offset_text(minutes: int) -> str:
    """An offset from UTC as the name of a time zone: ``UTC-08:00``."""
    return f"UTC{'-' if minutes < 0 else '+'}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}" if minutes else "UTC"


def zone_named(name: str) -> tzinfo:
    """The time zone of a name: ``America/New_York``, or as of `offset_text`."""
    offset = re.fullmatch(r"UTC([+-][0-9:]{5})", name)
    return cast(tzinfo, datetime.strptime(offset[1], "%z").tzinfo) if offset else zoneinfo.ZoneInfo(name)


def time_format_of(name: str, value: Any) -> str:
    """A format of times: a pattern as of strftime, ``excel`` or ``epoch``."""
    text = text_of(name, value)
    if text.strip().lower() in (SERIAL, EPOCH):
        return text.strip().lower()
    try:
        usable = "%" in text and datetime.strptime(_EXAMPLE.strftime(text), text).year > 0
    except Exception:  # patterns fail in many ways, not all of them documented
        usable = False
    if not usable:
        raise InputError(f"{name} = {shown(text)}: give a pattern such as '%d/%m/%Y %H:%M', or {SERIAL} or {EPOCH}")
    return text


_DAYS = ("serial days of a spreadsheet", 20_000.0, 80_000.0, 25_569.0, 86400.0, SECOND, "")
_SECONDS = ("seconds since 1970 (UTC)", 1e8, 1e10, 0.0, 1e6, 1, "UTC")
_MILLISECONDS = ("milliseconds since 1970 (UTC)", 1e11, 1e13, 0.0, 1e3, 1, "UTC")
"""The arguments of ``_of_numbers``: days from 1954 to 2119, to the second, as their decimals have round-off; epoch from
1973 to 2286."""
_NUMBERS = {SERIAL: [_DAYS], EPOCH: [_SECONDS, _MILLISECONDS]}


def _of_numbers(
    numbers: Array, what: str, least: float, most: float, of_1970: float, ticks: float, tick: int, time_zone: str
) -> Stamps:
    """Numbers from ``least`` to ``most`` as times: 1 is so many ticks of so many µs; ``of_1970`` is 1970-01-01."""
    with np.errstate(invalid="ignore"):
        good = (numbers >= least) & (numbers <= most)
    since = tick * np.rint(ticks * (np.where(good, numbers, of_1970) - of_1970)).astype(np.int64)
    return Stamps(since, good, bool(time_zone), f"is not one of the {what}, {least:g} to {most:g}", [], time_zone)


def read_stamps(cells: Sequence[str], row_numbers: Sequence[int], time_format: str | None, cure: str) -> Stamps:
    """The times of a column, by ``time_format`` or recognised; ``cure``: how to give one, with ``{format}`` in it."""
    if time_format in _NUMBERS:
        numbers = np.array([_number(cell) for cell in cells])
        return max((_of_numbers(numbers, *kind) for kind in _NUMBERS[time_format]), key=lambda found: found.good.sum())
    no_zones = [""] * len(cells)
    if time_format is not None:
        times, wrong = [_by_pattern(cell, time_format) for cell in cells], f"is not as {time_format!r} says"
        return _on_clock(times, no_zones, row_numbers, f"{wrong}: mend it or time_format", [])
    times = [timestamp_of(cell) for cell in cells]
    n_iso = sum(time is not None for time in times)
    say_how = f"say how to read it: {cure.format(format='%d/%m/%Y %H:%M')}"
    if 2 * n_iso < len(times):
        numbers = np.array([_number(cell) for cell in cells])
        for kind in (_DAYS, _SECONDS, _MILLISECONDS):
            found = _of_numbers(numbers, *kind)
            if 2 * found.good.sum() > numbers.size:
                example = shown(cells[int(np.argmax(found.good))].strip())
                return found._replace(notes=[f"timestamp read as {kind[0]}: {example} is {found.first()[0]}"])
        parts = [parts_of(cell) for cell in cells]
        n_parts = sum(one is not None for one in parts)
        if 2 * n_parts >= len(parts) and n_parts >= n_iso:
            return _of_parts(parts, row_numbers, f"is not as the others: mend it, or {say_how}", cure)
    wrong = f"is not ISO 8601: write it as 2024-07-01T08:00:00, or {say_how}"
    return _on_clock(times, no_zones, row_numbers, wrong, [])


_DIGITS_OF_TIME = re.compile(r"(?:19|20)[0-9]{2}(?:0[1-9]|1[0-2])[0-3][0-9][0-2][0-9](?:[0-5][0-9]){0,2}")


def timestamp_of(cell: str) -> datetime | None:
    """The time in a cell (ISO 8601, also without any marks between the digits), or None."""
    text = cell.strip()
    if _DIGITS_OF_TIME.fullmatch(text):
        text = f"{text[:8]}T{text[8:]}"
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def is_time(cell: str) -> bool:
    """Whether a cell holds a date, with or without a time, in a writing that is recognised."""
    return timestamp_of(cell) is not None or parts_of(cell) is not None


def are_date_and_clock(date: str, clock: str) -> bool:
    """Whether the first cell holds a date without a time of day, the second a time of day without a date."""
    return is_time(date) and ":" not in date and ":" in clock and is_time(f"2024-07-01 {clock.strip()}")


def _by_pattern(cell: str, pattern: str) -> datetime | None:
    try:
        return datetime.strptime(cell.strip(), pattern) if len(cell) <= 2 * MOST_LETTERS else None
    except (ValueError, OverflowError, re.error):
        return None


def _number(cell: str) -> float:
    try:
        return float(cell.replace(",", ".")) if len(cell) <= MOST_LETTERS and "_" not in cell else np.nan
    except ValueError:
        return np.nan


# ------------------------------------------------------------------------------------------------- clocks and zones

_NAMED = NAMES["zones"]  # hours by which the clocks of named zones are ahead of UTC
_OF_SEVERAL_PLACES = {"cst": "cdt", "ast": "adt", "bst": "gmt"}
"""Names that other continents use as well, unless the name on the right is in the log too."""


def in_zone(stamps: Stamps, time_zone: str) -> Stamps:
    """Times of a local clock as absolute ones, given its zone: ``America/New_York`` or ``UTC-05:00``."""
    zone = zone_named(time_zone)
    there = [time.replace(tzinfo=zone) for time in stamps.microseconds.astype(MICROSECONDS).tolist()]
    offsets = np.array([(time.utcoffset() or timedelta()) // timedelta(microseconds=1) for time in there])
    of_first = int(offsets[np.argmax(stamps.good)])
    absolute = stamps.microseconds - offsets
    return stamps._replace(microseconds=absolute, absolute=True, time_zone=time_zone, offset=of_first)


def _on_clock(
    times: Sequence[datetime | None], zones: Sequence[str], row_numbers: Sequence[int], wrong: str, notes: list[str]
) -> Stamps:
    """Times by the clock that wrote them, absolute if each has an offset or the name of a zone that is known."""
    good = np.array([time is not None for time in times])
    local = np.array([(time or _EXAMPLE).replace(tzinfo=None) for time in times], dtype=MICROSECONDS).astype(np.int64)
    known = np.flatnonzero(good).tolist()
    names = {zones[k] for k in known} - {""}
    unclear = {name for name, other in _OF_SEVERAL_PLACES.items() if other not in names}
    hours = {name: _NAMED[name] for name in names - unclear if name in _NAMED}
    offsets: dict[int, int] = {}
    for k, time in enumerate(times):
        since_utc = time.utcoffset() if time else None
        if zones[k] in hours:
            since_utc = timedelta(hours=hours[zones[k]])
        if since_utc is not None:
            offsets[k] = since_utc // timedelta(microseconds=1)
    clocks = ["absolute" if k in offsets else zones[k] for k in known]
    unlike = next((k for k, clock in zip(known, clocks, strict=True) if clock != clocks[0]), None)
    if unlike is not None:
        which = f"timestamp in row {row_numbers[unlike]} has another time zone than the first, or one of them has none"
        raise InputError(f"{which}: write one time zone, with or without UTC offset")
    if not known or known[0] not in offsets:
        name = clocks[0].upper() if known else ""
        if name:
            notes.append(f"timestamp is in {name} throughout: its times are read as they stand")
        return Stamps(local, good, False, wrong, notes, name)
    first = offsets[known[0]]
    changed = next((k for k in known if offsets[k] != first), None)
    if names:
        notes.append(f"timestamp is in {' and '.join(sorted(name.upper() for name in names))}: read by UTC offset")
    elif changed is not None:
        notes.append(f"timestamp has another UTC offset from row {row_numbers[changed]} on: read in UTC")
    ahead = np.array([offsets.get(k, 0) for k in range(len(times))], dtype=np.int64)
    if changed is None:
        return Stamps(local - first, good, True, wrong, notes, offset_text(first // MINUTE), first)
    return Stamps(local - ahead, good, True, wrong, notes, "UTC")


# ---------------------------------------------------------------------------------------------------- national forms

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_WRITTEN = re.compile(
    r"\s*(?:(?i:mon|tue|wed|thu|fri|sat|sun)[a-z]{0,6},?\s+)?"
    r"(?P<a>[0-9]{1,4}|[A-Za-z]{3,9})(?P<mark>[-./ ])(?P<b>[0-9]{1,2}|[A-Za-z]{3,9}),?(?P=mark)(?P<c>[0-9]{1,4})"
    r"(?:[T,\s]\s*(?P<h>[0-9]{1,2}):(?P<min>[0-9]{2})(?::(?P<s>[0-9]{2})(?:[.,](?P<part>[0-9]{1,9}))?)?"
    r"\s*(?:(?P<half>[AaPp])\.?[Mm]\.?(?![A-Za-z]))?"
    r"\s*\(?(?:(?P<utc>Z)|(?:UTC|GMT)?(?P<offset>[+-][0-9]{2}:?[0-9]{2}|[+-][0-9]{1,2}))?"
    r"\s*[\[]?(?P<zone>[A-Za-z_/]{1,32})?[)\]]?)?\s*"
)
_UNEVEN = 5.0  # the order of day and month that makes a log this much longer than the other one, and uneven, is wrong


class Parts(NamedTuple):
    """A time as it is written, before the order of day and month is known."""

    date: tuple[int, int, int]
    month: int  # index of the number that is a name, -1 if none is
    clock: timedelta  # time of day
    half: bool  # whether AM or PM is written
    offset: timedelta | None  # from UTC
    zone: str  # its name, blank if there is none
    mark: str  # between the numbers of the date

    def at(self, order: tuple[int, int, int]) -> datetime | None:
        """The time if year, month and day are in these places; None if there is no such day."""
        year, month, day = (self.date[place] for place in order)
        year += 2000 if year < 70 else 1900 if year < 100 else 0
        try:
            zone = None if self.offset is None else timezone(self.offset)
            return datetime(year, month, day, tzinfo=zone) + self.clock if year >= 1900 else None
        except (ValueError, OverflowError):
            return None


def parts_of(cell: str) -> Parts | None:
    """The numbers of a date and a time, or None if the cell is written otherwise."""
    found = _WRITTEN.fullmatch(cell) if len(cell) <= MOST_LETTERS else None
    if found is None:
        return None
    words = found.group("a", "b", "c")
    named = [k for k, text in enumerate(words) if not text.isdigit()]
    if len(named) > 1 or any(words[k][:3].lower() not in _MONTHS for k in named):
        return None
    a, b, c = (1 + _MONTHS.index(text[:3].lower()) if k in named else int(text) for k, text in enumerate(words))
    hour, minute, second = (int(found[name] or 0) for name in ("h", "min", "s"))
    if minute > 59 or second > 59 or hour > 24 or (found["half"] and not 1 <= hour <= 12):
        return None
    if found["half"]:
        hour = hour % 12 + 12 * (found["half"] in "Pp")
    part = int((found["part"] or "0")[:6].ljust(6, "0"))
    clock = timedelta(hours=hour, minutes=minute, seconds=second, microseconds=part)
    offset = timedelta(0) if found["utc"] else None
    if text := found["offset"]:
        digits = text[1:].replace(":", "")
        offset = timedelta(hours=int(digits[:2]), minutes=int(digits[2:] or 0)) * (-1 if text[0] == "-" else 1)
    zone = "" if found["offset"] else (found["zone"] or "").lower()
    return Parts((a, b, c), named[0] if named else -1, clock, bool(found["half"]), offset, zone, found["mark"])


_DAY_FIRST, _MONTH_FIRST = (2, 1, 0), (2, 0, 1)  # where year, month and day are


def _of_parts(parts: Sequence[Parts | None], row_numbers: Sequence[int], wrong: str, cure: str) -> Stamps:
    """The times of a column of ``parts``; None is a cell that is no time.  cure: as of `read_stamps`."""
    known = {row: one for row, one in zip(row_numbers, parts, strict=True) if one is not None}
    notes: list[str] = []
    named = {one.month for one in known.values()}
    if all(one.date[0] > 999 for one in known.values()):
        order = (0, 1, 2)
    elif named in ({0}, {1}):
        order = _MONTH_FIRST if named == {0} else _DAY_FIRST
    else:
        order = _order_of(known, cure, notes)
    by_halves = any(one.half for one in known.values())  # a time without AM or PM among others is none
    times = [one.at(order) if one and one.half == by_halves else None for one in parts]
    return _on_clock(times, [one.zone if one else "" for one in parts], row_numbers, wrong, notes)


def _order_of(parts: Mapping[int, Parts], cure: str, notes: list[str]) -> tuple[int, int, int]:
    """The order of day and month in times by row: from numbers above 12, or from the order in which time goes on."""
    day_first, month_first = (next((row for row, one in parts.items() if one.date[k] > 12), None) for k in (0, 1))
    if day_first is not None and month_first is not None:
        both = f"the day before the month in row {day_first} and after it in row {month_first}"
        raise InputError(f"timestamp has {both}: write one order, such as 2024-07-01T08:00:00")
    times = [[one.at(order) for one in parts.values()] for order in (_DAY_FIRST, _MONTH_FIRST)]
    ways = [np.diff(np.array([time.replace(tzinfo=None) for time in way if time], dtype=MICROSECONDS)) for way in times]
    steps = [np.abs(way.astype(float)) for way in ways]
    shorter, longer = sorted(steps, key=np.sum)
    dotted = all(one.mark == "." for one in parts.values())
    order = _DAY_FIRST
    if day_first is not None:
        why = f"a number exceeds 12 in row {day_first}"
    elif month_first is not None:
        order, why = _MONTH_FIRST, f"a number exceeds 12 in row {month_first}"
    elif dotted:
        why = "the order that goes with points"
    elif np.array_equal(ways[0], ways[1]):
        why = "the order cannot be told, and makes no difference within this log"
    elif longer.sum() > _UNEVEN * shorter.sum() and longer.max() > _UNEVEN * np.median(longer[longer > 0.0]):
        order, why = _DAY_FIRST if shorter is steps[0] else _MONTH_FIRST, "in the other order time would jump"
    else:
        raise InputError(
            "timestamp: no number shows whether the day or the month comes first: say it with "
            f"{cure.format(format='%d/%m/%Y %H:%M')} or '%m/%d/%Y %H:%M'"
        )
    words = ("dd", "mm", "yyyy") if order == _DAY_FIRST else ("mm", "dd", "yyyy")
    notes.append(f"timestamp read as {('.' if dotted else '/').join(words)}: {why}")
    return order
