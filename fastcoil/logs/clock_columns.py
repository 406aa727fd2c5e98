"""Date and time of day in columns of their own, as many building systems export them, as one column of times."""

from __future__ import annotations

import re
from typing import NamedTuple

from fastcoil.logs.timestamps import is_time

_DATES, _CLOCKS = ("date", "datum"), ("time", "time of day", "zeit", "uhrzeit")
"""Headers, in small letters."""
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
