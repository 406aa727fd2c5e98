"""What a weather file may hold, and CSV files of hourly weather."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.errors import shown
from fastcoil.logs.columns import asked_columns
from fastcoil.logs.readings import read_numbers
from fastcoil.logs.series import Series
from fastcoil.logs.table import Table
from fastcoil.logs.units import FRACTION, NUMBER, PRESSURE, TEMPERATURE
from fastcoil.model.moist_air import humidity_ratio, humidity_ratio_from_dew_point

STANDARD_PRESSURE = 101325.0
"""At sea level, Pa."""


class Weather(NamedTuple):
    """What is in a weather file.

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


class WeatherColumn(NamedTuple):
    """A series of a weather file, its usual header, and the unit under that header."""

    series: Series
    header: str
    unit: str


WEATHER_COLUMNS = {
    series.name: WeatherColumn(series, header, unit)
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
"""What a column of a weather file may be."""


def read_weather_csv(path: Path, columns: Mapping[str, str] | None, units: Mapping[str, str] | None) -> Weather:
    """Read a CSV file of hourly weather; ``columns`` and ``units`` say what differs from `WEATHER_COLUMNS`.

    Raises
    ------
    InputError
        If it cannot be read, columns are missing, a value is bad or an hour is left out.
    """
    table = Table.read(path)
    columns, units = dict(columns or {}), dict(units or {})
    table.check_names("columns", columns, WEATHER_COLUMNS)
    table.check_names("units", units, WEATHER_COLUMNS)
    found = asked_columns(table, columns)
    for name, usual in WEATHER_COLUMNS.items():
        column = table.column(usual.header)
        if name not in columns and column is not None:
            found[name] = column
            units.setdefault(name, usual.unit)
    for name in ("hour_of_year", "T_drybulb"):
        if name not in found and name not in columns:
            header = WEATHER_COLUMNS[name].header
            table.problems.append(f"{name} is missing: add a column {header!r}, or name one in columns")
    if not {"T_dewpoint", "RH"} & {*found, *columns}:
        table.problems.append("T_dewpoint and RH are both missing: add or name a column for one of them")
    table.stop_if_wrong()
    if "T_dewpoint" in found:
        found.pop("RH", None)
    weather = {
        name: read_numbers(table, WEATHER_COLUMNS[name].series, column, units.get(name))
        for name, column in found.items()
    }
    jump = int(np.argmax(np.diff(weather["hour_of_year"]) != 1.0))
    if weather["hour_of_year"][jump + 1] != weather["hour_of_year"][jump] + 1.0:
        row = table.row_numbers[jump]
        table.problems.append(f"hour_of_year does not rise by 1 from row {row} to the next: give every hour")
    table.stop_if_wrong()
    return Weather(weather, 60, table.notes)


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
