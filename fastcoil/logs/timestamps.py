"""The column ``timestamp`` as seconds: ISO 8601, a national form, serial days of a spreadsheet, epoch.

National forms are 01/07/2024 8:05 PM, 01.07.2024 20:05, 01-Jul-24 20:05:00 PDT and the like; the order of day and month
comes from numbers above 12, or from the order in which time goes on, and is refused where neither shows it.  Date and
time of day may have a column each.
"""

import re
import zoneinfo
from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import text_of
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, shown
from fastcoil.logs.series import counted

MOST_LETTERS = 64
"""Of a cell that can be a time or a number."""
MICROSECONDS = np.dtype("datetime64[us]")
_SECOND, _MINUTE, _DAY = 1_000_000, 60_000_000, 86_400_000_000  # µs
SERIAL, EPOCH = "excel", "epoch"
"""Formats that are numbers."""
_DAYS = (20_000.0, 80_000.0)  # serial days of a spreadsheet from 1954 to 2119; 25,569 is 1970-01-01
_SERIAL_OF_1970 = 25_569
_SECONDS = (1e8, 1e10)  # epoch seconds from 1973 to 2286; milliseconds are a thousand times as many
_EXAMPLE = datetime(2024, 7, 1, 8, 5, 30)
_LONGEST_FORMAT = 100


class Stamps(NamedTuple):
    """The times of a column.

    microseconds: since 1970-01-01, of UTC where ``absolute``, else of the clock that wrote them, (n,).  good: where a
    cell holds a time.  wrong: what the others are not, and the cure.  notes: how the column was read.  time_zone: of
    the clock that wrote them, such as ``UTC-07:00`` or ``America/New_York``, ``UTC`` where the offset changes; of times
    that are not absolute the name beside them, such as ``CST``, or blank.  offset: by which that clock is ahead [µs].
    """

    microseconds: Index
    good: Mask
    absolute: bool
    wrong: str
    notes: list[str]
    time_zone: str = ""
    offset: int = 0

    def since_first(self) -> Array:
        """Seconds since the first good time, (n,); NaN where there is none."""
        since = self.microseconds - self.microseconds[np.argmax(self.good)]
        return np.where(self.good, since / 1e6, np.nan)

    def first(self) -> tuple[np.datetime64, str]:
        """The first time, to the second, on the clock that wrote it; its time zone, blank if unknown."""
        there = self.microseconds[np.argmax(self.good)] + self.offset
        return np.datetime64(int(there + _SECOND // 2) // _SECOND, "s"), self.time_zone if self.absolute else ""


def offset_text(minutes: int) -> str:
    """An offset from UTC as the name of a time zone: ``UTC-08:00``."""
    return f"UTC{'-' if minutes < 0 else '+'}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}" if minutes else "UTC"


def time_format_of(name: str, value: Any) -> str:
    """A format of times: a pattern as of strftime, ``excel`` or ``epoch``."""
    text = text_of(name, value)
    if text.strip().lower() in (SERIAL, EPOCH):
        return text.strip().lower()
    try:
        usable = "%" in text and len(text) <= _LONGEST_FORMAT
        usable = usable and datetime.strptime(_EXAMPLE.strftime(text), text).year > 0
    except Exception:  # patterns fail in many ways, not all of them documented
        usable = False
    if not usable:
        raise InputError(f"{name} = {shown(text)}: give a pattern such as '%d/%m/%Y %H:%M', or {SERIAL} or {EPOCH}")
    return text


def read_stamps(cells: Sequence[str], row_numbers: Sequence[int], time_format: str | None, cure: str) -> Stamps:
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
    how_to_say = cure.format(format="%d/%m/%Y %H:%M")
    iso = f"is not ISO 8601: write it as 2024-07-01T08:00:00, or say how to read it: {how_to_say}"
    if 2 * n_iso >= len(times):
        return _of_datetimes(times, row_numbers, iso)
    numbers = np.array([_number(cell) for cell in cells])
    for (low, high), read in ((_DAYS, _serial), (_SECONDS, _epoch), ((1e3 * _SECONDS[0], 1e3 * _SECONDS[1]), _epoch)):
        with np.errstate(invalid="ignore"):
            fits = (numbers >= low) & (numbers <= high)
        if 2 * fits.sum() > numbers.size:
            return read(numbers, cells[int(np.argmax(fits))].strip())
    parts = [parts_of(cell) for cell in cells]
    n_parts = sum(one is not None for one in parts)
    if 2 * n_parts < len(parts) or n_parts < n_iso:
        return _of_datetimes(times, row_numbers, iso)
    return _of_parts(parts, row_numbers, f"is not as the others: mend it, or say how to read them: {how_to_say}", cure)


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


_CLOCK = re.compile(r"\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d{1,9})?)?\s*(?:[AaPp]\.?[Mm]\.?)?(?:\s?[A-Za-z+:\d-]{1,9})?")


def is_date(cell: str) -> bool:
    """Whether a cell holds a date without a time of day."""
    return is_time(cell) and ":" not in cell


def is_clock(cell: str) -> bool:
    """Whether a cell holds a time of day without a date."""
    return _CLOCK.fullmatch(cell.strip()) is not None


def _by_pattern(cell: str, pattern: str) -> datetime | None:
    try:
        return datetime.strptime(cell.strip(), pattern) if len(cell) <= 2 * MOST_LETTERS else None
    except (ValueError, OverflowError, re.error):
        return None


# ------------------------------------------------------------------------------------------------- numbers as times


def _number(cell: str) -> float:
    try:
        return float(cell.replace(",", ".")) if len(cell) <= MOST_LETTERS and "_" not in cell else np.nan
    except ValueError:
        return np.nan


def _serial(numbers: Array, example: str) -> Stamps:
    """Serial days of a spreadsheet, to the second: their decimals have round-off."""
    with np.errstate(invalid="ignore"):
        good = (numbers >= _DAYS[0]) & (numbers <= _DAYS[1])
    seconds = np.rint(86400.0 * (np.where(good, numbers, _SERIAL_OF_1970) - _SERIAL_OF_1970)).astype(np.int64)
    wrong = f"is no serial day of a spreadsheet: these are from {_DAYS[0]:g} to {_DAYS[1]:g}"
    return Stamps(_SECOND * seconds, good, False, wrong, _read_as("serial days of a spreadsheet", example, seconds))


def _epoch(numbers: Array, example: str) -> Stamps:
    """Seconds or milliseconds since 1970-01-01 in UTC."""
    finite = numbers[np.isfinite(numbers)]
    thousandths = bool(finite.size) and float(np.median(finite)) > _SECONDS[1]
    scale = 1e3 if thousandths else 1.0
    with np.errstate(invalid="ignore"):
        good = (numbers >= scale * _SECONDS[0]) & (numbers <= scale * _SECONDS[1])
    microseconds = np.rint(np.where(good, numbers, 0.0) * (1e6 / scale)).astype(np.int64)
    what = f"{'milliseconds' if thousandths else 'seconds'} since 1970 (UTC)"
    notes = _read_as(what, example, microseconds // _SECOND)
    return Stamps(microseconds, good, True, f"is not {what}", notes, "UTC")


def _read_as(what: str, example: str, seconds: Index) -> list[str]:
    if not example:
        return []
    first = np.datetime_as_string((_SECOND * seconds[:1]).astype(MICROSECONDS), unit="s")[0]
    return [f"timestamp read as {what}: {shown(example)} is {first}"]


# ------------------------------------------------------------------------------------------------- clocks and zones

_NAMED = {
    "utc": 0, "gmt": 0, "wet": 0, "west": 1, "bst": 1, "cet": 1, "cest": 2, "mez": 1, "mesz": 2, "eet": 2, "eest": 3,
    "nst": -3.5, "ndt": -2.5, "ast": -4, "adt": -3, "est": -5, "edt": -4, "cst": -6, "cdt": -5, "mst": -7, "mdt": -6,
    "pst": -8, "pdt": -7, "akst": -9, "akdt": -8, "hst": -10, "awst": 8, "acst": 9.5, "acdt": 10.5, "aest": 10,
    "aedt": 11, "nzst": 12, "nzdt": 13, "jst": 9,
}  # fmt: skip
"""Hours by which the clocks of named zones are ahead of UTC."""
_OF_SEVERAL_PLACES = {"cst": "cdt", "ast": "adt", "bst": "gmt"}
"""Names that other continents use as well, unless the name on the right is in the log too."""


def in_zone(stamps: Stamps, time_zone: str) -> Stamps:
    """Times of a local clock as absolute ones, given its zone: ``America/New_York`` or ``UTC-05:00``."""
    offset_alone = re.fullmatch(r"UTC([+-][0-9:]{5})", time_zone)
    zone = datetime.strptime(offset_alone[1], "%z").tzinfo if offset_alone else zoneinfo.ZoneInfo(time_zone)
    there = [time.replace(tzinfo=zone) for time in stamps.microseconds.astype(MICROSECONDS).tolist()]
    offsets = np.array([(time.utcoffset() or timedelta()) // timedelta(microseconds=1) for time in there])
    offset = int(offsets[np.argmax(stamps.good)])
    return stamps._replace(
        microseconds=stamps.microseconds - offsets, absolute=True, time_zone=time_zone, offset=offset
    )


def _of_datetimes(times: Sequence[datetime | None], row_numbers: Sequence[int], wrong: str) -> Stamps:
    good = np.array([time is not None for time in times])
    local = np.array([(time or _EXAMPLE).replace(tzinfo=None) for time in times], dtype=MICROSECONDS).astype(np.int64)
    since_utc = [time.utcoffset() if time else None for time in times]
    offsets = [None if one is None else one // timedelta(microseconds=1) for one in since_utc]
    return _on_clock(local, good, offsets, [""] * len(times), row_numbers, wrong, [])


def _on_clock(
    local: Index, good: Mask, offsets: list[int | None], zones: list[str], row_numbers: Sequence[int],
    wrong: str, notes: list[str],
) -> Stamps:  # fmt: skip
    """Times by the clock that wrote them, absolute if each has an offset [µs] or the name of a zone that is known."""
    known = np.flatnonzero(good).tolist()
    names = {zones[k] for k in known} - {""}
    unclear = {name for name, other in _OF_SEVERAL_PLACES.items() if other not in names}
    for name in names - unclear:
        named = round(60 * _MINUTE * _NAMED[name]) if name in _NAMED else None
        offsets = [named if zones[k] == name else offset for k, offset in enumerate(offsets)]
    clocks = [(zones[k] if offsets[k] is None else "absolute") for k in known]
    unlike = next((k for k, clock in zip(known, clocks, strict=True) if clock != clocks[0]), None)
    if unlike is not None:
        raise InputError(
            f"timestamp in row {row_numbers[unlike]} has another time zone than the first, or one of them has none: "
            "write one time zone, with or without UTC offset"
        )
    if not known or offsets[known[0]] is None:
        name = clocks[0].upper() if known else ""
        if name:
            notes.append(f"timestamp is in {name} throughout: its times are read as they stand")
        return Stamps(local, good, False, wrong, notes, name)
    ahead = np.array([offset or 0 for offset in offsets], dtype=np.int64)
    first = int(ahead[known[0]])
    changed = next((k for k in known if ahead[k] != first), None)
    if names:
        notes.append(f"timestamp is in {' and '.join(sorted(name.upper() for name in names))}: read by UTC offset")
    if changed is None:
        return Stamps(local - first, good, True, wrong, notes, offset_text(first // _MINUTE), first)
    if not names:
        notes.append(f"timestamp has another UTC offset from row {row_numbers[changed]} on: read in UTC")
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
    """A time as it is written, before the order of day and month is known.

    date: its three numbers.  month: index of the one that is a name, -1 if none is.  clock: time of day [µs].  half:
    whether AM or PM is written.  offset: from UTC [µs]; None if there is none.  mark: between the numbers.
    """

    date: tuple[int, int, int]
    month: int
    clock: int
    half: bool
    offset: int | None
    zone: str
    mark: str


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
    clock = (3600 * hour + 60 * minute + second) * _SECOND + part
    offset = _offset(found["offset"]) if found["offset"] else 0 if found["utc"] else None
    zone = "" if found["offset"] else (found["zone"] or "").lower()
    return Parts((a, b, c), named[0] if named else -1, clock, bool(found["half"]), offset, zone, found["mark"])


def _offset(text: str) -> int:
    sign, digits = (-1 if text[0] == "-" else 1), text[1:].replace(":", "")
    return sign * (60 * int(digits[:2]) + int(digits[2:] or 0)) * _MINUTE


def _of_parts(parts: Sequence[Parts | None], row_numbers: Sequence[int], wrong: str, cure: str) -> Stamps:
    """The times of a column of ``parts``; None is a cell that is no time.  cure: as of `read_stamps`."""
    good = np.array([one is not None for one in parts])
    some = [one for one in parts if one is not None]
    rows = [number for number, is_good in zip(row_numbers, good, strict=True) if is_good]
    notes: list[str] = []
    a, b, c = np.array([one.date for one in some], dtype=np.int64).T
    clock = np.array([one.clock for one in some], dtype=np.int64)
    halves = np.array([one.half for one in some])
    named = {one.month for one in some}
    if (a > 999).all():
        day, valid = _days(a, b, c)
    elif named == {0}:
        day, valid = _days(c, a, b)
    elif named == {1}:
        day, valid = _days(c, b, a)
    else:
        first = _day_is_first(a, b, c, clock, rows, all(one.mark == "." for one in some), cure, notes)
        day, valid = _days(c, b, a) if first else _days(c, a, b)
    local = np.zeros(len(parts), dtype=np.int64)
    local[good] = _DAY * day + clock
    good[good] = valid & (halves | ~halves.any())  # a time without AM or PM among others is none
    offsets, zones = [one and one.offset for one in parts], [one.zone if one else "" for one in parts]
    return _on_clock(local, good, offsets, zones, row_numbers, wrong, notes)


def _days(year: Index, month: Index, day: Index) -> tuple[Index, Mask]:
    """Days since 1970, and where there is such a day; years of two digits are from 1970 to 2069."""
    year = np.where(year < 70, year + 2000, np.where(year < 100, year + 1900, year))
    valid = (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31) & (year >= 1900)
    months = np.where(valid, 12 * (year - 1970) + month - 1, 0).astype("datetime64[M]")
    days = months.astype("datetime64[D]") + (np.where(valid, day, 1) - 1).astype("timedelta64[D]")
    return days.astype(np.int64), valid & (days.astype("datetime64[M]") == months)


def _day_is_first(
    a: Index, b: Index, c: Index, clock: Index, rows: Sequence[int], dotted: bool, cure: str, notes: list[str]
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
    ways = [_DAY * _days(c, *order)[0] + clock for order in ((b, a), (a, b))]
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
