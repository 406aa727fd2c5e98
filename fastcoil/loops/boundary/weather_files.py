"""Weather files: CSV files of hourly weather, EnergyPlus weather files (EPW) and TMY3 files.

Fields, units and marks of missing values of EPW files: EnergyPlus documentation, "Auxiliary Programs", section
"EnergyPlus Weather File (EPW) Data Dictionary".  TMY3 files: S. Wilcox and W. Marion, "Users Manual for TMY3 Data
Sets", NREL/TP-581-43156 (2008): temperature, humidity and pressure are those at the time that a row names, in local
standard time, and 24:00 ends the day of its date.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError, shown
from fastcoil.base.files import read_text
from fastcoil.logs.columns import asked_columns
from fastcoil.logs.readings import read_numbers
from fastcoil.logs.series import FRACTION, NUMBER, PRESSURE, TEMPERATURE, Series, counted, in_total, warn_of_reading
from fastcoil.logs.table import Table
from fastcoil.loops.boundary.clock import YEARS, Times
from fastcoil.model.moist_air import humidity_ratio, humidity_ratio_from_dew_point

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


STANDARD_PRESSURE = 101325.0
"""At sea level, Pa."""


class Weather(NamedTuple):
    """Content of a weather file.

    series: by the names of `WEATHER_COLUMNS`, in our units, each (n_rows,).  minutes: from row to row.  notes: how it
    was read.  site: where it was measured; blank if the file does not say.  first_weekday: of the first row, such as
    ``Monday``; blank likewise.  time_zone: standard time of the site, such as ``UTC-08:00``; blank likewise.
    """

    series: dict[str, Array]
    minutes: int
    notes: list[str]
    site: str = ""
    first_weekday: str = ""
    time_zone: str = ""

    def pressure(self, given: float | None) -> Array | float:
        """The pressure that was given, else that of the rows, (n_rows,), else that at sea level [Pa]."""
        return self.series.get("p", STANDARD_PRESSURE) if given is None else given

    def humidity(self, pressure: Array | float) -> Array:
        """Humidity ratio of the rows, (n_rows,), from the dew point if there is one, at ``pressure`` [Pa]."""
        if "T_dewpoint" in self.series:
            return humidity_ratio_from_dew_point(self.series["T_dewpoint"], pressure)
        return humidity_ratio(self.series["T_drybulb"], self.series["RH"], pressure)


WEATHER_COLUMNS = {
    series.name: (series, header, unit)
    for series, header, unit in (
        (Series("hour_of_year", "hour of the year", NUMBER, 1, 8784, whole=True), "hour_of_year", "1"),
        (Series("month", "month", NUMBER, 1, 12, whole=True), "month", "1"),
        (Series("day", "day of the month", NUMBER, 1, 31, whole=True), "day", "1"),
        (Series("hour", "hour of the day", NUMBER, 0, 24, whole=True), "hour", "1"),
        (Series("T_drybulb", "outdoor temperature", TEMPERATURE, -40.0, 60.0), "T_drybulb_C", "degC"),
        (Series("T_dewpoint", "outdoor dew point", TEMPERATURE, -60.0, 50.0), "T_dewpoint_C", "degC"),
        (Series("RH", "outdoor relative humidity", FRACTION, 0.0, 1.0), "RH_pct", "percent"),
        (Series("p", "barometric pressure", PRESSURE, 50e3, 110e3), "p_Pa", "Pa"),
    )
}
"""Columns that a weather file may have by name: the series, its usual header, and the unit under that header."""


def _read_csv(path: Path, columns: Mapping[str, str] | None, units: Mapping[str, str] | None) -> Weather:
    """A CSV file of hourly weather; ``columns`` and ``units`` say what differs from `WEATHER_COLUMNS`."""
    table = Table.read(path)
    columns, units = dict(columns or {}), dict(units or {})
    table.check_names("columns", columns, WEATHER_COLUMNS)
    table.check_names("units", units, WEATHER_COLUMNS)
    found = asked_columns(table, columns)
    for name, (_, header, unit) in WEATHER_COLUMNS.items():
        column = table.column(header)
        if name not in columns and column is not None:
            found[name] = column
            units.setdefault(name, unit)
        elif name in ("hour_of_year", "T_drybulb") and name not in columns:
            table.problems.append(f"{name} is missing: add a column {header!r}, or name one in columns")
    if not {"T_dewpoint", "RH"} & {*found, *columns}:
        table.problems.append("T_dewpoint and RH are both missing: add or name a column for one of them")
    table.stop_if_wrong()
    if "T_dewpoint" in found:
        found.pop("RH", None)
    weather = {
        name: read_numbers(table, WEATHER_COLUMNS[name][0], column, units.get(name)) for name, column in found.items()
    }
    jump = int(np.argmax(np.diff(weather["hour_of_year"]) != 1.0))
    if weather["hour_of_year"][jump + 1] != weather["hour_of_year"][jump] + 1.0:
        row = table.row_numbers[jump]
        table.problems.append(f"hour_of_year does not rise by 1 from row {row} to the next: give every hour")
    table.stop_if_wrong()
    return Weather(weather, 60, table.notes)


def read_weather(
    path: Path,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    pressure: float | None = None,
) -> Weather:
    """Read an EPW, TMY3 or CSV file, told apart by its content, and warn about assumptions made in reading it.

    The pressure of a file is not read where ``pressure`` [Pa] is given.

    Raises
    ------
    InputError
        If it cannot be read, columns are missing, a value is bad, or its rows do not follow each other.
    """
    text = read_text(path, "an EPW, TMY3 or CSV file", _LARGEST, utf_16=True, latin_1=True)
    lines = _LINE_END.split(text)
    is_epw = lines[0].upper().startswith("LOCATION,")
    is_tmy3 = len(lines) > 1 and tuple(cell.strip() for cell in lines[1].split(",")[:2]) == _TMY3_DATE
    if not is_epw and not is_tmy3:
        weather = _read_csv(path, columns, units)
    else:
        layout = (_epw_layout if is_epw else _tmy3_layout)(path.name, lines)
        if columns or units:
            raise InputError(f"columns, units: {path.name} is {layout.format}, which has its own: leave them out")
        weather = _read_year(path.name, lines, layout, with_pressure=pressure is None)
    warn_of_reading(path.name, weather.notes)
    return weather


def warn_of_hours(weather: Weather) -> None:
    """Warn of what straight lines between the rows cannot show."""
    often, step = (
        ("hourly", "an hour") if weather.minutes == 60 else (f"{weather.minutes}-min", f"{weather.minutes} min")
    )
    site = f" of {shown(weather.site)}" if weather.site else ""
    warnings.warn(
        f"{often} weather{site} is interpolated to 1 s: it says nothing about disturbances faster than {step}",
        UserWarning,
        stacklevel=3,
    )


_LARGEST = 2**28
"""Bytes; a year by minutes has half as many."""
_LINE_END = re.compile("\r\n|\n|\r")
WEEKDAYS = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")
_MONTH_DAY = re.compile(r"(\d\d?)\s*/\s*(\d\d?)", re.ASCII)
_HOURS_AHEAD = re.compile(r"[+-]?\d\d?(\.\d{1,2})?", re.ASCII)
_DAYS = (31, 29, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31)


class Field(NamedTuple):
    """A field of a format.

    name: in the format's documents.  cell: its place in a row, from 0.  missing: this value and those beyond it, away
    from zero, stand for a missing one.
    """

    name: str
    cell: int
    unit: str
    missing: float


class RowFormat(NamedTuple):
    """Where a file in one of the formats has what.

    n_top: lines above the rows.  date: places of the cells that tell month, day and hour, as ``clock`` matches them
    when they are joined by blanks.  weekday: month, day and name of a day of the week; blank if it does not tell.
    time_zone: as of `Weather`.
    """

    format: str
    site: str
    weekday: str
    time_zone: str
    n_top: int
    per_hour: int
    date: Sequence[int]
    clock: re.Pattern[str]
    fields: Mapping[str, Field]


_EPW_CLOCK = re.compile(r"\s*(\d\d?)\s+(\d\d?)\s+(\d\d?)\s*", re.ASCII)
_EPW_FIELDS = {
    "T_drybulb": Field("Dry Bulb Temperature", 6, "degC", 99.9),
    "T_dewpoint": Field("Dew Point Temperature", 7, "degC", 99.9),
    "RH": Field("Relative Humidity", 8, "percent", 999.0),
    "p": Field("Atmospheric Station Pressure", 9, "Pa", 999999.0),
}
_TMY3_DATE = ("Date (MM/DD/YYYY)", "Time (HH:MM)")
_TMY3_CLOCK = re.compile(r"\s*(\d\d?)/(\d\d?)/\d{2,4}\s+(\d\d?):00\s*", re.ASCII)
_TMY3_HEADERS = {
    "T_drybulb": ("Dry-bulb (C)", "degC"),
    "T_dewpoint": ("Dew-point (C)", "degC"),
    "RH": ("RHum (%)", "percent"),
    "p": ("Pressure (mbar)", "hPa"),
}
_TMY3_MISSING = -99.0
"""Files mark a missing reading with -9900; no reading is as low as -99."""


def _read_year(file: str, lines: Sequence[str], layout: RowFormat, *, with_pressure: bool) -> Weather:
    """An EPW or TMY3 file."""
    fields = {name: field for name, field in layout.fields.items() if name != "p" or with_pressure}
    width = 1 + max(*layout.date, *(field.cell for field in fields.values()))
    numbered = [
        (i, line.split(",", width)[:width]) for i, line in enumerate(lines, 1) if i > layout.n_top and line.strip()
    ]
    for i, row in numbered:
        if len(row) < width:
            raise InputError(
                f"{file}: row {i} has {counted(len(row), 'cell')}, {layout.format} at least {width}: mend it"
            )
    if len(numbered) < 2:
        raise InputError(f"{file} has {counted(len(numbered), 'row')} of data: give at least two")
    table = Table(
        file,
        list(fields),
        [[row[field.cell] for field in fields.values()] for _, row in numbered],
        [i for i, _ in numbered],
    )
    times = _times_of(table, layout, [" ".join(row[i] for i in layout.date) for _, row in numbered])
    times |= years_of([row[0] for _, row in numbered])  # in both formats they are in the first cell
    used = _used_fields(table, fields)
    table.stop_if_wrong()
    series = {
        name: read_numbers(table, WEATHER_COLUMNS[name][0], table.header.index(name), field.unit)
        for name, field in used.items()
    }
    table.stop_if_wrong()
    begin, _, weekday = layout.weekday.partition(" ")
    known = begin == f"{times['month'][0]:g}/{times['day'][0]:g}"
    return Weather(
        times | series, 60 // layout.per_hour, table.notes, layout.site, weekday if known else "", layout.time_zone
    )


def _epw_layout(file: str, lines: Sequence[str]) -> RowFormat:
    for i, line in enumerate(lines, start=1):
        cells = [cell.strip() for cell in line.split(",")]
        if cells[0].upper() != "DATA PERIODS":
            continue
        records = cells[2] if len(cells) > 2 else ""
        per_hour = int(records) if re.fullmatch(r"\d\d?", records, re.ASCII) else 0
        if not per_hour or 60 % per_hour:
            raise InputError(
                f"{file}: DATA PERIODS in row {i} tells {shown(records)} records per hour: give 1, or another number "
                "that divides 60"
            )
        place = lines[0].split(",")
        named = cells[4].capitalize() if len(cells) > 5 else ""
        begins = _MONTH_DAY.match(cells[5]) if named in WEEKDAYS else None
        weekday = f"{int(begins[1])}/{int(begins[2])} {named}" if begins else ""
        told = (_site(place[1:4]), weekday, _time_zone(place[8:9]))
        return RowFormat("an EPW file", *told, i, per_hour, (1, 2, 3), _EPW_CLOCK, _EPW_FIELDS)
    raise InputError(f"{file} begins as an EPW file, but has no line DATA PERIODS: give all eight lines of its header")


def _tmy3_layout(file: str, lines: Sequence[str]) -> RowFormat:
    header = [cell.strip() for cell in lines[1].split(",")]
    absent = [label for label, _ in _TMY3_HEADERS.values() if label not in header]
    if absent:
        raise InputError(f"{file} begins as a TMY3 file, but has no column {', '.join(absent)}: give the whole file")
    fields = {
        name: Field(label, header.index(label), unit, _TMY3_MISSING) for name, (label, unit) in _TMY3_HEADERS.items()
    }
    try:
        cells = next(csv.reader(lines[:1]))
    except csv.Error:
        cells = lines[0].split(",")
    return RowFormat("a TMY3 file", _site(cells[1:3]), "", _time_zone(cells[3:4]), 2, 1, (0, 1), _TMY3_CLOCK, fields)


def _site(words: Sequence[str]) -> str:
    """A place, without the parts that are blank or a dash."""
    return ", ".join(word.strip() for word in words if word.strip(" -"))


def _time_zone(cells: Sequence[str]) -> str:
    """Hours ahead of UTC as text; blank if there are none."""
    match = _HOURS_AHEAD.fullmatch(cells[0].strip()) if cells else None
    minutes = round(60 * float(match[0])) if match else 24 * 60
    if abs(minutes) > 14 * 60:
        return ""
    return f"UTC{'-' if minutes < 0 else '+'}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}"


def _times_of(table: Table, layout: RowFormat, written: Sequence[str]) -> dict[str, Array]:
    """Month, day, hour and hour of the year at which each row stands: those at the end of its interval, (n_rows,).

    A year has the 29th of February if the file has.  What is no date, and rows that do not follow each other, are
    problems.
    """
    dates = np.zeros((len(written), 3), dtype=np.int64)
    for k, text in enumerate(written):
        match = layout.clock.fullmatch(text)
        m, d, h = map(int, match.groups()) if match else (0, 0, 0)
        if not (1 <= m <= 12 and 1 <= d <= _DAYS[m - 1] and 1 <= h <= 24):
            table.problems.append(
                f"row {table.row_numbers[k]} has the date and hour {shown(text)}: give month, day and a full hour "
                "from 1 to 24"
            )
            table.stop_if_wrong()
        dates[k] = m, d, h
    month, day, hour = dates.T
    lengths = np.array(_DAYS)
    lengths[1] = 29 if ((month == 2) & (day == 29)).any() else 28
    days_before = np.concatenate(([0], np.cumsum(lengths)))[month - 1]
    hour_of_year = 24 * (days_before + day - 1) + hour
    index = np.arange(len(written))
    out_of_step = hour_of_year != hour_of_year[0] + index // layout.per_hour
    if out_of_step.any():
        first = int(np.argmax(out_of_step))
        many = "one row" if layout.per_hour == 1 else f"{layout.per_hour} rows"
        table.problems.append(
            f"row {table.row_numbers[first]}, {month[first]}/{day[first]} hour {hour[first]}, does not follow the one "
            f"before: give {many} for each hour, in the order of one calendar year"
        )
    early = 1.0 - (index % layout.per_hour + 1) / layout.per_hour
    return {
        "month": month.astype(np.float64),
        "day": day.astype(np.float64),
        "hour": hour - early,
        "hour_of_year": hour_of_year - early,
    }


def _used_fields(table: Table, fields: Mapping[str, Field]) -> dict[str, Field]:
    """The fields that are needed: one humidity, the dew point unless it alone has gaps.  Gaps are problems."""
    gaps = {
        name: [k for k, row in enumerate(table.rows) if _is_gap(row[j], field)]
        for j, (name, field) in enumerate(fields.items())
    }
    by_rh = bool(gaps["T_dewpoint"]) and not gaps["RH"]
    if by_rh:
        first, n_gaps = table.row_numbers[gaps["T_dewpoint"][0]], len(gaps["T_dewpoint"])
        table.notes.append(
            f"the dew point is missing in row {first}{in_total(n_gaps)}: the relative humidity is used in all rows"
        )
    used = {name: field for name, field in fields.items() if name != ("T_dewpoint" if by_rh else "RH")}
    for name, field in used.items():
        if gaps[name]:
            k = gaps[name][0]
            cell = shown(table.rows[k][table.header.index(name)].strip())
            cure = "fill the gap, or give pressure" if name == "p" else "fill the gap"
            table.problems.append(
                f"{name} ({field.name}) is missing, {cell}, in row {table.row_numbers[k]}: "
                f"{cure}{in_total(len(gaps[name]))}"
            )
    return used


def _is_gap(cell: str, field: Field) -> bool:
    """Whether a cell says that its value is missing."""
    try:
        value = float(cell)
    except ValueError:
        return not cell.strip()
    return value >= field.missing if field.missing > 0 else value <= field.missing
