"""Weather files: CSV files of hourly weather, EnergyPlus weather files (EPW) and TMY3 files.

Fields, units and marks of missing values of EPW files: EnergyPlus documentation, "Auxiliary Programs", section
"EnergyPlus Weather File (EPW) Data Dictionary".  TMY3 files: S. Wilcox and W. Marion, "Users Manual for TMY3 Data
Sets", NREL/TP-581-43156 (2008): temperature, humidity and pressure are those at the time that a row names, in local
standard time, and 24:00 ends the day of its date.
"""

import csv
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.base.files import read_text
from fastcoil.logs import warn_of_reading_notes
from fastcoil.logs.columns import find_requested_columns
from fastcoil.logs.plausibility import find_supersaturation
from fastcoil.logs.readings import read_numbers
from fastcoil.logs.series import DIMENSIONLESS, FRACTION, PRESSURE, TEMPERATURE, Series, count_suffix, format_count
from fastcoil.logs.table import Table
from fastcoil.logs.timestamps import format_utc_offset
from fastcoil.loops.boundary.series import DATETIME_SECONDS, YEAR_RANGE, Times
from fastcoil.model.moist_air import humidity_ratio, humidity_ratio_from_dew_point

_MAX_FILE_BYTES = 2**26  # a year has 2 MB

WEATHER_COLUMNS = {
    series.name: (series, header, unit)
    for series, header, unit in (
        (Series("hour_of_year", "hour of the year", DIMENSIONLESS, 1, 8784, whole=True), "hour_of_year", "1"),
        (Series("T_drybulb", "outdoor temperature", TEMPERATURE, -70.0, 70.0), "T_drybulb_C", "degC"),
        (Series("T_dewpoint", "outdoor dew point", TEMPERATURE, -70.0, 70.0), "T_dewpoint_C", "degC"),
        (Series("RH", "outdoor relative humidity", FRACTION, 0.0, 1.0), "RH_pct", "percent"),
        (Series("p", "barometric pressure", PRESSURE, 50e3, 110e3), "p_Pa", "Pa"),
    )
}
"""Columns of a weather file by name: the series, its usual header, and the unit under that header."""


class Weather(NamedTuple):
    """Content of a weather file.

    series: by the names of `WEATHER_COLUMNS`, in our units, each (n_rows,).  notes: how it was read.  is_leap: whether
    it has a 29 February.  dates: date and time at which each row holds, (n_rows,); None if the rows name no years.
    time_zone: standard time such as ``UTC-08:00``; blank if the file does not say.
    """

    series: dict[str, Array]
    notes: list[str]
    is_leap: bool
    dates: Times | None = None
    time_zone: str = ""

    def pressure(self, pressure: float | None) -> Array | float:
        """The pressure that was given, else that of the rows, (n_rows,), else that at sea level [Pa]."""
        return self.series.get("p", 101325.0) if pressure is None else pressure

    def humidity(self, pressure: Array | float) -> Array:
        """Humidity ratio of the rows, (n_rows,), from the dew point if there is one, at ``pressure`` [Pa]."""
        if "T_dewpoint" in self.series:
            return humidity_ratio_from_dew_point(self.series["T_dewpoint"], pressure)
        return humidity_ratio(self.series["T_drybulb"], self.series["RH"], pressure)

    def dates_at(self, hours: Array) -> Times | None:
        """Date and time at hours of the year at which there are rows, (n,); None if the rows name no years."""
        return None if self.dates is None else self.dates[np.searchsorted(self.series["hour_of_year"], hours)]


def read_weather(
    path: Path, columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None,
    pressure: float | None = None,
) -> Weather:  # fmt: skip
    """Read an EPW, TMY3 or CSV file, and warn about assumptions; its pressure is not read if ``pressure`` is given."""
    text = read_text(path, "an EPW, TMY3 or CSV file", _MAX_FILE_BYTES, utf_16=True, latin_1=True)
    lines = re.split("\r\n|\n|\r", text)
    is_epw = lines[0].upper().startswith("LOCATION,")
    is_tmy3 = len(lines) > 1 and tuple(cell.strip() for cell in lines[1].split(",")[:2]) == _TMY3_DATE_HEADERS
    if not is_epw and not is_tmy3:
        weather = _read_csv(path, columns, units)
    else:
        layout = (_epw_layout if is_epw else _tmy3_layout)(path.name, lines)
        if columns or units:
            sentence = f"columns, units: {path.name} is {layout.format}, which has its own: leave them out"
            raise InputError(sentence, "columns" if columns else "units", "conflict")
        fields = {name: field for name, field in layout.fields.items() if name != "p" or pressure is None}
        weather = _read_year(path.name, lines, layout, fields)
    warn_of_reading_notes(path.name, weather.notes)
    return weather


def warn_of_interpolation() -> None:
    """Warn of what straight lines between the rows cannot show."""
    sentence = "hourly weather is interpolated to 1 s: it says nothing about disturbances faster than an hour"
    warnings.warn(sentence, UserWarning, stacklevel=3)


def _read_csv(path: Path, columns: Mapping[str, str] | None, units: Mapping[str, str] | None) -> Weather:
    """Read a CSV file of hourly weather; ``columns`` and ``units``: differences from `WEATHER_COLUMNS`."""
    table = Table.read(path)
    columns, units = dict(columns or {}), dict(units or {})
    table.check_names("columns", columns, WEATHER_COLUMNS)
    table.check_names("units", units, WEATHER_COLUMNS)
    column_indices = find_requested_columns(table, columns)
    for name, (series, header, unit) in WEATHER_COLUMNS.items():
        column = table.find_column(header)
        if name not in columns and column is not None:
            column_indices[name] = column
            if series.units[series.resolve_unit(units.setdefault(name, unit))] != series.units[unit]:
                sentence = f"units has {units[name]} for {name}: the header {header!r} says {unit}, drop one"
                table.problems.append(Problem(sentence, name, "unit"))
        elif name in ("hour_of_year", "T_drybulb") and name not in columns:
            sentence = f"{name} is missing: add a column {header!r}, or name one in columns"
            table.problems.append(Problem(sentence, name, "missing"))
    if not {"T_dewpoint", "RH"} & {*column_indices, *columns}:
        sentence = "T_dewpoint and RH are both missing: add or name a column for one of them"
        table.problems.append(Problem(sentence, "T_dewpoint", "missing"))
    table.raise_problems()
    if "T_dewpoint" in column_indices:
        column_indices.pop("RH", None)
    columns_read = column_indices.items()
    weather = {name: read_numbers(table, WEATHER_COLUMNS[name][0], k, units.get(name)) for name, k in columns_read}
    jump = int(np.argmax(np.diff(weather["hour_of_year"]) != 1.0))
    if weather["hour_of_year"][jump + 1] != weather["hour_of_year"][jump] + 1.0:
        sentence = f"hour_of_year does not rise by 1 from row {table.row_numbers[jump]} to the next: give every hour"
        table.problems.append(Problem(sentence, "hour_of_year", "time"))
    _require_plausible(table, weather)
    return Weather(weather, table.notes, is_leap=bool(weather["hour_of_year"][-1] > 8760))


def _require_plausible(table: Table, series: Mapping[str, Array]) -> None:
    """Refuse dew points above the temperature, fractions read as percent, and all other problems of the table."""
    if not table.problems and "T_dewpoint" in series:
        dew, T = series["T_dewpoint"], series["T_drybulb"]
        _, is_above = find_supersaturation({"T_dp_in": dew, "T_a_in": T})
        if is_above.any():
            k = int(np.argmax(is_above))
            place = f"T_dewpoint = {dew[k]:g} degC in row {table.row_numbers[k]} is above T_drybulb = {T[k]:g} degC"
            cure = f"check their units, or exchange the columns{count_suffix(int(is_above.sum()))}"
            table.problems.append(Problem(f"{place}: {cure}", "T_dewpoint", "data"))
    if not table.problems and "RH" in series and series["RH"].max() <= 0.01:
        place = f"RH is at most {100 * series['RH'].max():.3g} %, first in row {table.row_numbers[0]}"
        cure = "if it is a fraction, write 'RH [1]' in the header and pass columns={'RH': 'RH'}"
        table.problems.append(Problem(f"{place}: {cure}", "RH", "unit"))
    table.raise_problems()


class Field(NamedTuple):
    """A field: name in the format, cell in a row, unit, and the value that, as any farther from zero, marks a gap."""

    name: str
    cell: int
    unit: str
    missing: float

    def is_gap(self, cell: str) -> bool:
        try:
            value = float(cell)
        except ValueError:
            return not cell.strip()
        return value >= self.missing if self.missing > 0 else value <= self.missing


class FileLayout(NamedTuple):
    """Layout of a file; ``clock`` matches its cells ``date`` of month, day and hour when they are joined by blanks."""

    format: str
    n_header_lines: int
    date: Sequence[int]
    clock: str
    fields: Mapping[str, Field]
    time_zone: str


_EPW_HEADER_LINES = 8
_EPW_FIELDS = {
    "T_drybulb": Field("Dry Bulb Temperature", 6, "degC", 99.9),
    "T_dewpoint": Field("Dew Point Temperature", 7, "degC", 99.9),
    "RH": Field("Relative Humidity", 8, "percent", 999.0),
    "p": Field("Atmospheric Station Pressure", 9, "Pa", 999999.0),
}
_TMY3_DATE_HEADERS = ("Date (MM/DD/YYYY)", "Time (HH:MM)")
_TMY3_HEADERS = {
    "T_drybulb": ("Dry-bulb (C)", "degC"),
    "T_dewpoint": ("Dew-point (C)", "degC"),
    "RH": ("RHum (%)", "percent"),
    "p": ("Pressure (mbar)", "hPa"),
}
_DAYS_PER_MONTH = np.array([31, 29, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31])


def _epw_layout(file: str, lines: Sequence[str]) -> FileLayout:
    last_line = "".join(lines[_EPW_HEADER_LINES - 1 : _EPW_HEADER_LINES])
    if [cell.strip().upper() for cell in last_line.split(",")[:3:2]] != ["DATA PERIODS", "1"]:
        place = f"line {_EPW_HEADER_LINES} is not DATA PERIODS of 1 record an hour"
        sentence = f"{file} begins as an EPW file, but {place}: give an hourly file with its whole header"
        raise InputError(sentence, "DATA PERIODS", "format")
    clock = r"\s*(\d\d?)\s+(\d\d?)\s+(\d\d?)\s*"
    zone = _parse_time_zone(lines[0].split(",")[8:9])
    return FileLayout("an EPW file", _EPW_HEADER_LINES, (1, 2, 3), clock, _EPW_FIELDS, zone)


def _tmy3_layout(file: str, lines: Sequence[str]) -> FileLayout:
    header = [cell.strip() for cell in lines[1].split(",")]
    absent = [label for label, _ in _TMY3_HEADERS.values() if label not in header]
    if absent:
        sentence = f"{file} begins as a TMY3 file, but has no column {', '.join(absent)}: give the whole file"
        raise InputError(sentence, absent[0], "format")
    # files mark a missing reading with -9900; no reading is as low as -99
    fields = {name: Field(label, header.index(label), unit, -99.0) for name, (label, unit) in _TMY3_HEADERS.items()}
    station = next(csv.reader(lines[:1]))
    clock = r"\s*(\d\d?)/(\d\d?)/\d{2,4}\s+(\d\d?):00\s*"
    return FileLayout("a TMY3 file", 2, (0, 1), clock, fields, _parse_time_zone(station[3:4]))


def _parse_time_zone(cells: Sequence[str]) -> str:
    """Format hours ahead of UTC as a time zone; blank if there are none."""
    match = re.fullmatch(r"[+-]?\d\d?(\.\d{1,2})?", "".join(cells).strip(), re.ASCII)
    minutes = round(60 * float(match[0])) if match else 24 * 60
    return format_utc_offset(minutes) if -12 * 60 <= minutes <= 14 * 60 else ""


def _read_year(file: str, lines: Sequence[str], layout: FileLayout, fields: Mapping[str, Field]) -> Weather:
    width = 1 + max(*layout.date, *(field.cell for field in fields.values()))
    first = layout.n_header_lines + 1
    rows = {i: line.split(",", width)[:width] for i, line in enumerate(lines[first - 1 :], first) if line.strip()}
    for i, row in rows.items():
        if len(row) < width:
            sentence = f"{file}: row {i} has {format_count(len(row), 'cell')}, {layout.format} at least {width}"
            raise InputError(f"{sentence}: fix it", f"row {i}", "format")
    if len(rows) < 2:
        sentence = f"{file} has {format_count(len(rows), 'row')} of data: give at least two"
        raise InputError(sentence, file, "data")
    table = Table(file, list(fields), [[row[f.cell] for f in fields.values()] for row in rows.values()], list(rows))
    dates = _row_dates(table, layout, [" ".join(row[i] for i in layout.date) for row in rows.values()])
    is_leap = ((dates[0] == 2) & (dates[1] == 29)).any()
    hour_of_year = _hours_of_year(table, dates, is_leap)
    # in both formats the year is in the first cell, alone or at the end of a date
    year_matches = [re.fullmatch(r"\s*(?:\d\d?/\d\d?/)?(\d{4})\s*", row[0], re.ASCII) for row in rows.values()]
    years = np.array([int(match[1]) if match else 0 for match in year_matches])
    used = _used_fields(table, fields)
    table.raise_problems()
    indices = {name: table.header.index(name) for name in used}
    series = {name: read_numbers(table, WEATHER_COLUMNS[name][0], k, fields[name].unit) for name, k in indices.items()}
    _require_plausible(table, series)
    times = _end_times(years, dates) if ((years >= YEAR_RANGE[0]) & (years <= YEAR_RANGE[1])).all() else None
    return Weather({"hour_of_year": hour_of_year} | series, table.notes, bool(is_leap), times, layout.time_zone)


def _row_dates(table: Table, layout: FileLayout, dates_text: Sequence[str]) -> Index:
    """Return month, day and hour, 1 to 24, of each row, (3, n_rows)."""
    dates = np.zeros((len(dates_text), 3), dtype=np.int64)
    for k, text in enumerate(dates_text):
        match = re.fullmatch(layout.clock, text, re.ASCII)
        m, d, h = map(int, match.groups()) if match else (0, 0, 0)
        if not (1 <= m <= 12 and 1 <= d <= _DAYS_PER_MONTH[m - 1] and 1 <= h <= 24):
            row = f"row {table.row_numbers[k]}"
            sentence = f"{table.name}: {row} has the date and hour {short_repr(text)}"
            raise InputError(f"{sentence}: give month, day and a full hour from 1 to 24", row, "format")
        dates[k] = m, d, h
    return dates.T


def _hours_of_year(table: Table, dates: Index, is_leap: bool) -> Array:
    """Return the hour of the year of each row, (n_rows,), 29 February as in the file."""
    month, day, hour = dates
    days_before = np.cumsum(_DAYS_PER_MONTH) - _DAYS_PER_MONTH - np.where(np.arange(12) >= 2, not is_leap, 0)
    hour_of_year = 24 * (days_before[month - 1] + day - 1) + hour
    out_of_step = hour_of_year != hour_of_year[0] + np.arange(hour.size)
    if out_of_step.any():
        k = int(np.argmax(out_of_step))
        row = f"row {table.row_numbers[k]}"
        sentence = f"{row}, {month[k]}/{day[k]} hour {hour[k]}, does not follow the one before"
        cure = "give one row for each hour, in the order of one calendar year"
        table.problems.append(Problem(f"{sentence}: {cure}", row, "time"))
    return np.asarray(hour_of_year, float)


def _end_times(years: Index, dates: Index) -> Times:
    """Return the date and time at which the hour of each row ends, which is where the next row begins."""
    month, day, hour = dates
    months = (12 * (years - 1970) + month - 1).astype("datetime64[M]").astype(DATETIME_SECONDS)
    begins = months + (86400 * (day - 1) + 3600 * (hour - 1)).astype("timedelta64[s]")
    return np.append(begins[1:], begins[-1:] + np.timedelta64(3600, "s"))


def _used_fields(table: Table, fields: Mapping[str, Field]) -> list[str]:
    """Return the fields to read: of humidities the dew point, unless only it has gaps.  Gaps are problems."""
    gaps = {}
    for j, (name, field) in enumerate(fields.items()):
        gaps[name] = [k for k, row in enumerate(table.rows) if field.is_gap(row[j])]
    uses_relative_humidity = bool(gaps["T_dewpoint"]) and not gaps["RH"]
    if uses_relative_humidity:
        place = f"row {table.row_numbers[gaps['T_dewpoint'][0]]}{count_suffix(len(gaps['T_dewpoint']))}"
        table.notes.append(f"the dew point is missing in {place}: the relative humidity is used in all rows")
    used = [name for name in fields if name != ("T_dewpoint" if uses_relative_humidity else "RH")]
    for name in filter(gaps.get, used):
        k = gaps[name][0]
        cell = short_repr(table.rows[k][table.header.index(name)].strip())
        cure = f"fill the gap{', or give pressure' * (name == 'p')}{count_suffix(len(gaps[name]))}"
        sentence = f"{name} ({fields[name].name}) is missing, {cell}, in row {table.row_numbers[k]}: {cure}"
        table.problems.append(Problem(sentence, name, "data"))
    return used
