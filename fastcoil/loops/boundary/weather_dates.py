"""Dates of the rows of a weather file, of the years that it names: in a typical year each month has another."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.loops.boundary.clock import YEARS, Times

_YEAR = re.compile(r"\s*(?:\d\d?/\d\d?/)?(\d{4})\s*", re.ASCII)


def years_of(cells: Sequence[str]) -> dict[str, Array]:
    """The series ``year`` of cells that hold a year, or a date that ends with one; nothing if a cell has none."""
    found = [_YEAR.fullmatch(cell) for cell in cells]
    years = np.array([float(match[1]) for match in found if match])
    told = years.size == len(cells) and bool(((years >= YEARS[0]) & (years <= YEARS[1])).all())
    return {"year": years} if told else {}


def dates_at(hours: Array, weather: Mapping[str, Array]) -> Times | None:
    """Date and time at hours of the year at which there are rows, (n,); None if the rows name no years.

    weather: the series of a weather file, each (n_rows,).
    """
    if "year" not in weather:
        return None
    rows = np.searchsorted(weather["hour_of_year"], hours)
    # hour 24 ends a day: the next one begins, with the year, month and day of the row after it
    after = np.minimum(rows + 1, weather["hour_of_year"].size - 1)
    begins = (weather["hour"][rows] == 24.0) & (after > rows)
    at = np.where(begins, after, rows)
    year, month, day = (weather[name][at].astype(np.int64) for name in ("year", "month", "day"))
    seconds = np.rint(3600.0 * np.where(begins, 0.0, weather["hour"][rows])).astype(np.int64)
    months = (12 * (year - 1970) + month - 1).astype("datetime64[M]")
    return np.asarray(months.astype("datetime64[s]") + (86400 * (day - 1) + seconds).astype("timedelta64[s]"))
