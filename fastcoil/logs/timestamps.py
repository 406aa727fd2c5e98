"""The column ``timestamp`` as seconds: ISO 8601, the writing of a country, serial days of a spreadsheet, epoch."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import text_of
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, shown
from fastcoil.logs.written_dates import MICROSECONDS, MOST_LETTERS, Parts, parts_of, read_dates

SERIAL, EPOCH = "excel", "epoch"
"""Formats that are numbers."""
_EPOCH = datetime(1970, 1, 1)
_UTC = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_DAYS = (20_000.0, 80_000.0)
"""Serial days of a spreadsheet from 1954 to 2119; 25,569 is 1970-01-01."""
_SERIAL_OF_1970 = 25_569
_SECONDS = (1e8, 1e10)
"""Epoch seconds from 1973 to 2286; milliseconds are a thousand times as many."""
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
        """The first time, to the second, on the clock that wrote it; its time zone, blank if it does not tell."""
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

    Raises
    ------
    InputError
        If a format fits, but does not say which time is meant.
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
