"""The column ``timestamp`` as seconds: ISO 8601, a national form, serial days of a spreadsheet, epoch.

The order of day and month comes from numbers above 12, or from the order in which time goes on, and is refused where
neither shows it.  Date and time of day may have a column each.
"""

import re
import zoneinfo
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime, timedelta, timezone, tzinfo
from itertools import chain
from typing import Any, NamedTuple, cast

import numpy as np

from fastcoil.base.arguments import require_text
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, did_you_mean, short_repr
from fastcoil.logs.series import VOCABULARY

MAX_CELL_CHARACTERS = 64  # longest cell that can be a time or a number
MICROSECOND_DTYPE = np.dtype("datetime64[us]")
SECOND_US = 1_000_000  # a second in µs
MINUTE_US = 60 * SECOND_US
_EXAMPLE_TIME = datetime(2024, 7, 1, 8, 5, 30)


class Timestamps(NamedTuple):
    """The times of a column, (n,)."""

    microseconds: Index  # since 1970-01-01, of UTC where ``absolute``, else of the clock that wrote them
    good: Mask  # where a cell holds a time
    absolute: bool
    problem: str  # what the others are not, and the cure
    notes: list[str]  # how the column was read
    time_zone: str = ""  # of that clock, ``UTC`` if its offset changes; else the name beside the times, or blank
    offset: int = 0  # by which that clock is ahead, µs

    def seconds_since_first(self) -> Array:
        """Return the seconds since the first good time, (n,); NaN where there is none."""
        return np.where(self.good, (self.microseconds - self.microseconds[np.argmax(self.good)]) / 1e6, np.nan)

    def seem_set_back(self) -> bool:
        """Whether times go back or stand still as where a local clock is set back: at night, by an hour at most."""
        seconds = self.microseconds[self.good] / SECOND_US
        steps = np.diff(seconds)
        times = seconds[1:][steps <= 0.0]
        if self.absolute or not times.size or (steps < -3600.0).any() or (times % 86400.0 >= 4 * 3600.0).any():
            return False
        return bool((steps < 0.0).any() or 0.0 < np.ptp(times) < 3600.0)

    def first_time(self) -> tuple[np.datetime64, str]:
        """Return the first time, to the second, on the clock that wrote it; and its time zone, blank if unknown."""
        local = int(self.microseconds[np.argmax(self.good)] + self.offset)
        return np.datetime64((local + SECOND_US // 2) // SECOND_US, "s"), self.time_zone if self.absolute else ""


def format_utc_offset(minutes: int) -> str:
    """Format an offset from UTC as the name of a time zone, ``UTC-08:00``; refuse one that no clock has."""
    name = f"UTC{'-' if minutes < 0 else '+'}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}" if minutes else "UTC"
    if not -12 * 60 <= minutes <= 14 * 60:
        raise InputError(f"{name} is no time zone: give an offset from UTC-12:00 to UTC+14:00", "time_zone", "choice")
    return name


def time_zone_from_name(name: str) -> tzinfo:
    """Return the time zone of a name: ``America/New_York``, or as of `format_utc_offset`."""
    offset = re.fullmatch(r"UTC([+-][0-9:]{5})", name)
    return cast(tzinfo, datetime.strptime(offset[1], "%z").tzinfo) if offset else zoneinfo.ZoneInfo(name)


def require_time_zone(name: str, value: Any) -> str:
    """Return the name of a time zone, or an offset from UTC; blank if it is None or blank."""
    text = "" if value is None else require_text(name, value).strip()
    if offset := re.fullmatch(r"UTC([+-])(\d\d):([0-5]\d)", text, re.ASCII):
        format_utc_offset(int(offset[1] + offset[2]) * 60 + int(offset[1] + offset[3]))
    if not text or offset or text in (known_zones := zoneinfo.available_timezones()):
        return text
    cure = "give a name such as 'America/Los_Angeles', or an offset such as 'UTC-08:00'"
    raise InputError(f"{name} = {short_repr(text)}{did_you_mean(text, known_zones)}: {cure}", name, "choice")


def require_time_format(name: str, value: Any) -> str:
    """Require a format of times: a pattern as of strftime, ``excel`` or ``epoch``."""
    text = require_text(name, value)
    if text.strip().lower() in _NUMBER_KINDS:
        return text.strip().lower()
    with suppress(Exception):  # patterns fail in many ways, not all of them documented
        if "%" in text and datetime.strptime(_EXAMPLE_TIME.strftime(text), text).year > 0:
            return text
    cure = "give a pattern such as '%d/%m/%Y %H:%M', or excel or epoch"
    raise InputError(f"{name} = {short_repr(text)}: {cure}", name, "format")


class _NumberKind(NamedTuple):
    """A way to write times as numbers: serial days, seconds or milliseconds."""

    text: str
    least: float
    most: float
    number_in_1970: float  # of 1970-01-01
    ticks: float  # in the number 1
    tick_us: int  # µs; the decimals of serial days have round-off, so that they are read to the second
    time_zone: str

    def timestamps(self, numbers: Array) -> Timestamps:
        """Convert numbers to times; those out of range count as no time."""
        with np.errstate(invalid="ignore"):
            is_good = (numbers >= self.least) & (numbers <= self.most)
        ticks = self.ticks * (np.where(is_good, numbers, self.number_in_1970) - self.number_in_1970)
        problem = f"is not one of the {self.text}, {self.least:g} to {self.most:g}"
        microseconds = self.tick_us * np.rint(ticks).astype(np.int64)
        return Timestamps(microseconds, is_good, bool(self.time_zone), problem, [], self.time_zone)


_NUMBER_KINDS = {
    "excel": [_NumberKind("serial days of a spreadsheet", 20_000.0, 80_000.0, 25_569.0, 86400.0, SECOND_US, "")],
    "epoch": [
        _NumberKind("seconds since 1970 (UTC)", 1e8, 1e10, 0.0, 1e6, 1, "UTC"),
        _NumberKind("milliseconds since 1970 (UTC)", 1e11, 1e13, 0.0, 1e3, 1, "UTC"),
    ],
}
"""Ways to write times as numbers, by time format: days from 1954 to 2119, epoch from 1973 to 2286."""


def read_timestamps(
    cells: Sequence[str], row_numbers: Sequence[int], time_format: str | None, cure: str, *, month_first: bool = False
) -> Timestamps:
    """Read the times in the cells of a column, in ``time_format`` or recognised; cure: advice with ``{format}``."""
    if time_format in _NUMBER_KINDS:
        numbers = np.array([_parse_number_or_nan(cell) for cell in cells])
        stamps_by_kind = [kind.timestamps(numbers) for kind in _NUMBER_KINDS[time_format]]
        return max(stamps_by_kind, key=lambda stamps: stamps.good.sum())
    no_zones = [""] * len(cells)
    if time_format is not None:
        times = [_parse_by_pattern(cell, time_format) for cell in cells]
        problem = f"is not as {time_format!r} says: mend it or time_format"
        return _timestamps_from_times(times, no_zones, row_numbers, problem, [])
    times = [parse_iso_time(cell) for cell in cells]
    n_iso = sum(time is not None for time in times)
    format_advice = f"say how to read it: {cure.format(format='%d/%m/%Y %H:%M')}"
    if 2 * n_iso < len(times):
        numbers = np.array([_parse_number_or_nan(cell) for cell in cells])
        for kind in chain(*_NUMBER_KINDS.values()):
            stamps = kind.timestamps(numbers)
            if 2 * stamps.good.sum() > numbers.size:
                example = short_repr(cells[int(np.argmax(stamps.good))].strip())
                return stamps._replace(notes=[f"timestamp read as {kind.text}: {example} is {stamps.first_time()[0]}"])
        date_parts_by_cell = [parse_date_parts(cell) for cell in cells]
        n_parts = sum(date_parts is not None for date_parts in date_parts_by_cell)
        if 2 * n_parts >= len(date_parts_by_cell) and n_parts >= n_iso:
            problem = f"is not as the others: mend it, or {format_advice}"
            return _timestamps_from_parts(date_parts_by_cell, row_numbers, problem, cure, month_first)
    problem = f"is not ISO 8601: write it as 2024-07-01T08:00:00, or {format_advice}"
    return _timestamps_from_times(times, no_zones, row_numbers, problem, [])


_COMPACT_TIME_PATTERN = re.compile(r"(?:19|20)[0-9]{2}(?:0[1-9]|1[0-2])[0-3][0-9][0-2][0-9](?:[0-5][0-9]){0,2}")


def parse_iso_time(cell: str) -> datetime | None:
    """Parse the time in a cell (ISO 8601, also without any marks between the digits); None if there is none."""
    text = cell.strip()
    if _COMPACT_TIME_PATTERN.fullmatch(text):
        text = f"{text[:8]}T{text[8:]}"
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def is_time(cell: str) -> bool:
    """Whether a cell holds a date, with or without a time, in a writing that is recognised."""
    return parse_iso_time(cell) is not None or parse_date_parts(cell) is not None


def is_date_beside_clock(date: str, clock: str) -> bool:
    """Whether the first cell holds a date without a time of day, the second a time of day without a date."""
    return is_time(date) and ":" not in date and ":" in clock and is_time(f"2024-07-01 {clock.strip()}")


def _parse_by_pattern(cell: str, pattern: str) -> datetime | None:
    """Parse a time by a pattern of ``strptime``; None if the cell is written otherwise."""
    try:
        return datetime.strptime(cell.strip(), pattern) if len(cell) <= 2 * MAX_CELL_CHARACTERS else None
    except (ValueError, OverflowError, re.error):
        return None


def _parse_number_or_nan(cell: str) -> float:
    try:
        return float(cell.replace(",", ".")) if len(cell) <= MAX_CELL_CHARACTERS and "_" not in cell else np.nan
    except ValueError:
        return np.nan


# ------------------------------------------------------------------------------------------------- clocks and zones

_ZONE_HOURS = VOCABULARY["zones"]  # hours by which the clocks of named zones are ahead of UTC
_AMBIGUOUS_ZONES = {"cst": "cdt", "ast": "adt", "bst": "gmt"}
"""Names of zones on several continents, each clear only if the name on the right is in the log as well."""


def apply_time_zone(stamps: Timestamps, time_zone: str, row_numbers: Sequence[int]) -> Timestamps:
    """Convert times of a local clock to absolute ones, given its zone: ``America/New_York`` or ``UTC-05:00``.

    Where clocks are set back an hour comes twice; the order of the rows shows which one is meant, or they are refused.
    """
    zone, microsecond = time_zone_from_name(time_zone), timedelta(microseconds=1)
    local_times = [time.replace(tzinfo=zone) for time in stamps.microseconds.astype(MICROSECOND_DTYPE).tolist()]
    offsets = np.array([(time.utcoffset() or timedelta()) // microsecond for time in local_times])
    later_times = [time.replace(fold=1) for time in local_times]
    later_offsets = np.array([(time.utcoffset() or timedelta()) // microsecond for time in later_times])
    is_skipped, is_double = (stamps.good & mask for mask in (later_offsets > offsets, later_offsets < offsets))
    if is_skipped.any():
        k = int(np.argmax(is_skipped))
        place = f"row {row_numbers[k]} is at {local_times[k]:%Y-%m-%d %H:%M}, which clocks in {time_zone} skip"
        cure = f"check the zone; if the clock was not set forward, {_standard_offset(local_times[k])}"
        raise InputError(f"timestamp: {place}: {cure}", "timestamp", "time")
    good_rows = np.flatnonzero(stamps.good)
    positions = np.flatnonzero(is_double[good_rows])
    for run_positions in np.split(positions, np.flatnonzero(np.diff(positions) > 1) + 1) if positions.size else ():
        run = good_rows[run_positions]
        steps = np.diff(stamps.microseconds[run])
        if np.sum(steps < 0) != 1 and steps.tolist() != [0]:
            times = sorted(f"{local_times[k]:%H:%M}" for k in run)
            place = f"{times[0]} to {times[-1]} of {local_times[run[0]]:%Y-%m-%d}, from row {row_numbers[run[0]]} on"
            cause = f"clocks in {time_zone} were set back, and the order of the rows does not show which hour is meant"
            cure = f"log UTC or the UTC offset; if the clock was not set back, {_standard_offset(local_times[run[0]])}"
            raise InputError(f"timestamp: {place}: {cause}: {cure}", "timestamp", "time")
        second_hour = run[int(np.argmin(steps)) + 1 :]
        offsets[second_hour] = later_offsets[second_hour]
    first_offset = int(offsets[np.argmax(stamps.good)])
    absolute = stamps.microseconds - offsets
    return stamps._replace(microseconds=absolute, absolute=True, time_zone=time_zone, offset=first_offset)


def _standard_offset(time: datetime) -> str:
    """Return the advice to give the standard time of a zone, such as UTC-05:00 of America/New_York, as its offset."""
    offsets = [time.replace(fold=fold).utcoffset() or timedelta() for fold in (0, 1)]
    return f"its zone is {format_utc_offset(min(offsets) // timedelta(minutes=1))}"


def _timestamps_from_times(
    times: Sequence[datetime | None], zones: Sequence[str], row_numbers: Sequence[int], problem: str, notes: list[str]
) -> Timestamps:
    """Convert datetimes and names of zones to timestamps; absolute if each has an offset or a known zone."""
    is_good = np.array([time is not None for time in times])
    local_times = [(time or _EXAMPLE_TIME).replace(tzinfo=None) for time in times]
    local_microseconds = np.array(local_times, dtype=MICROSECOND_DTYPE).astype(np.int64)
    good_indices = np.flatnonzero(is_good).tolist()
    names = {zones[k] for k in good_indices} - {""}
    ambiguous_names = {name for name, companion in _AMBIGUOUS_ZONES.items() if companion not in names}
    hours = {name: _ZONE_HOURS[name] for name in names - ambiguous_names if name in _ZONE_HOURS}
    offsets: dict[int, int] = {}
    for k, time in enumerate(times):
        utc_offset = timedelta(hours=hours[zones[k]]) if zones[k] in hours else time.utcoffset() if time else None
        if utc_offset is not None:
            offsets[k] = utc_offset // timedelta(microseconds=1)
    clocks = ["absolute" if k in offsets else zones[k] for k in good_indices]
    first_other = next((k for k, clock in zip(good_indices, clocks, strict=True) if clock != clocks[0]), None)
    if first_other is not None:
        row = row_numbers[first_other]
        sentence = f"timestamp in row {row} has another time zone than the first, or one of them has none"
        raise InputError(f"{sentence}: write one time zone, with or without UTC offset", "timestamp", "time")
    if not good_indices or good_indices[0] not in offsets:
        if name := clocks[0].upper() if good_indices else "":
            notes.append(f"timestamp is in {name} throughout: its times are read as they stand")
        return Timestamps(local_microseconds, is_good, False, problem, notes, name)
    for offset in {*offsets.values()}:
        format_utc_offset(offset // MINUTE_US)
    first_offset = offsets[good_indices[0]]
    first_changed = next((k for k in good_indices if offsets[k] != first_offset), None)
    if names:
        notes.append(f"timestamp is in {' and '.join(sorted(name.upper() for name in names))}: read by UTC offset")
    elif first_changed is not None:
        notes.append(f"timestamp has another UTC offset from row {row_numbers[first_changed]} on: read in UTC")
    offset_microseconds = np.array([offsets.get(k, 0) for k in range(len(times))], dtype=np.int64)
    microseconds = local_microseconds - (first_offset if first_changed is None else offset_microseconds)
    zone, offset = ("UTC", 0) if first_changed else (format_utc_offset(first_offset // MINUTE_US), first_offset)
    return Timestamps(microseconds, is_good, True, problem, notes, zone, offset)


# ---------------------------------------------------------------------------------------------------- national forms

_MONTH_NAMES = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_DATE_AND_TIME_PATTERN = re.compile(
    r"\s*(?:(?i:mon|tue|wed|thu|fri|sat|sun)[a-z]{0,6},?\s+)?"
    r"(?P<a>[0-9]{1,4}|[A-Za-z]{3,9})(?P<mark>[-./ ])(?P<b>[0-9]{1,2}|[A-Za-z]{3,9}),?(?P=mark)(?P<c>[0-9]{1,4})"
    r"(?:[T,\s]\s*(?P<h>[0-9]{1,2}):(?P<min>[0-9]{2})(?::(?P<s>[0-9]{2})(?:[.,](?P<part>[0-9]{1,9}))?)?"
    r"\s*(?:(?P<half>[AaPp])\.?[Mm]\.?(?![A-Za-z]))?"
    r"\s*\(?(?:(?P<utc>Z)|(?:UTC|GMT)?(?P<offset>[+-][0-9]{2}:?[0-9]{2}|[+-][0-9]{1,2}))?"
    r"\s*[\[]?(?P<zone>[A-Za-z_/]{1,32})?[)\]]?)?\s*"
)


class DateParts(NamedTuple):
    """A time as it is written, before the order of day and month is known."""

    date: tuple[int, int, int]
    month: int  # index of the number that is a name, -1 if none is
    clock: timedelta  # time of day
    has_half: bool  # whether AM or PM is written
    offset: timedelta | None  # from UTC
    zone: str  # its name, blank if there is none
    mark: str  # between the numbers of the date

    def in_order(self, order: tuple[int, int, int]) -> datetime | None:
        """Return the time with year, month and day at these places of ``date``; None if there is no such day."""
        year, month, day = (self.date[place] for place in order)
        year += 2000 if year < 70 else 1900 if year < 100 else 0
        try:
            zone = None if self.offset is None else timezone(self.offset)
            return datetime(year, month, day, tzinfo=zone) + self.clock if year >= 1900 else None
        except (ValueError, OverflowError):
            return None


def parse_date_parts(cell: str) -> DateParts | None:
    """Parse the numbers of a date and a time; None if the cell is written otherwise."""
    match = _DATE_AND_TIME_PATTERN.fullmatch(cell) if len(cell) <= MAX_CELL_CHARACTERS else None
    if match is None:
        return None
    words = match.group("a", "b", "c")
    month_places = [k for k, text in enumerate(words) if not text.isdigit()]
    if len(month_places) > 1 or any(words[k][:3].lower() not in _MONTH_NAMES for k in month_places):
        return None
    months = [1 + _MONTH_NAMES.index(words[k][:3].lower()) for k in month_places]
    a, b, c = (months[0] if k in month_places else int(text) for k, text in enumerate(words))
    hour, minute, second = (int(match[name] or 0) for name in ("h", "min", "s"))
    if minute > 59 or second > 59 or hour > 24 or (match["half"] and not 1 <= hour <= 12):
        return None
    if match["half"]:
        hour = hour % 12 + 12 * (match["half"] in "Pp")
    microsecond = int((match["part"] or "0")[:6].ljust(6, "0"))
    clock = timedelta(hours=hour, minutes=minute, seconds=second, microseconds=microsecond)
    offset = timedelta(0) if match["utc"] else None
    if text := match["offset"]:
        digits = text[1:].replace(":", "")
        offset = timedelta(hours=int(digits[:2]), minutes=int(digits[2:] or 0)) * (-1 if text[0] == "-" else 1)
    zone = "" if match["offset"] else (match["zone"] or "").lower()
    month = month_places[0] if month_places else -1
    return DateParts((a, b, c), month, clock, bool(match["half"]), offset, zone, match["mark"])


UNKNOWN_ORDER = "the order cannot be told, and makes no difference within this log"
MONTH_FIRST_NOTE = "timestamp read as mm/dd/yyyy"
_DAY_FIRST_ORDER = (2, 1, 0)  # places of year, month and day in a written date
_MONTH_FIRST_ORDER = (2, 0, 1)


def _timestamps_from_parts(
    parts: Sequence[DateParts | None], row_numbers: Sequence[int], problem: str, cure: str, month_first: bool
) -> Timestamps:
    """Convert parts of dates, None for a cell that is no time, to timestamps; cure: as in `read_timestamps`."""
    parts_by_row = {row: each for row, each in zip(row_numbers, parts, strict=True) if each is not None}
    notes: list[str] = []
    month_places = {date_parts.month for date_parts in parts_by_row.values()}
    if all(date_parts.date[0] > 999 for date_parts in parts_by_row.values()):
        order = (0, 1, 2)
    elif month_places in ({0}, {1}):
        order = _MONTH_FIRST_ORDER if month_places == {0} else _DAY_FIRST_ORDER
    else:
        order = _find_date_order(parts_by_row, cure, notes, month_first)
    has_halves = any(date_parts.has_half for date_parts in parts_by_row.values())  # a time without AM or PM is none
    times = [each.in_order(order) if each and each.has_half == has_halves else None for each in parts]
    return _timestamps_from_times(times, [each.zone if each else "" for each in parts], row_numbers, problem, notes)


def _find_date_order(
    parts: Mapping[int, DateParts], cure: str, notes: list[str], month_first: bool
) -> tuple[int, int, int]:
    """Find whether the day or the month comes first, by numbers above 12 or by which order lets time advance."""
    day_row, month_row = (next((row for row, each in parts.items() if each.date[k] > 12), None) for k in (0, 1))
    if day_row is not None and month_row is not None:
        sentence = f"timestamp has the day before the month in row {day_row} and after it in row {month_row}"
        raise InputError(f"{sentence}: write one order, such as 2024-07-01T08:00:00", "timestamp", "time")
    steps_by_order = []
    for order in (_DAY_FIRST_ORDER, _MONTH_FIRST_ORDER):
        times = [time.replace(tzinfo=None) for each in parts.values() if (time := each.in_order(order))]
        steps_by_order.append(np.diff(np.array(times, dtype=MICROSECOND_DTYPE)))
    steps = [np.abs(order_steps.astype(float)) for order_steps in steps_by_order]
    shorter, longer = sorted(steps, key=np.sum)
    has_dots = all(each.mark == "." for each in parts.values())
    order = _DAY_FIRST_ORDER
    if day_row is not None:
        reason = f"a number exceeds 12 in row {day_row}"
    elif month_row is not None:
        order, reason = _MONTH_FIRST_ORDER, f"a number exceeds 12 in row {month_row}"
    elif has_dots:
        reason = "the order that goes with points"
    elif np.array_equal(steps_by_order[0], steps_by_order[1]):
        order, reason = (_MONTH_FIRST_ORDER if month_first else order), UNKNOWN_ORDER
    elif longer.sum() > 5.0 * shorter.sum() and longer.max() > 5.0 * np.median(longer[longer > 0.0]):
        order = _DAY_FIRST_ORDER if shorter is steps[0] else _MONTH_FIRST_ORDER
        reason = "in the other order time would jump"
    else:
        sentence = "timestamp: no number shows whether the day or the month comes first: say it with "
        cure = f"{cure.format(format='%d/%m/%Y %H:%M')} or '%m/%d/%Y %H:%M'"
        raise InputError(sentence + cure, "timestamp", "time")
    words = ("dd", "mm", "yyyy") if order == _DAY_FIRST_ORDER else ("mm", "dd", "yyyy")
    notes.append(f"timestamp read as {('.' if has_dots else '/').join(words)}: {reason}")
    return order
