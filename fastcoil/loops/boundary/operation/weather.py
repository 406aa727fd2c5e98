"""The weather of a file, day by day at every second."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.loops.boundary.weather_files import Weather

DAY = 86_400
"""Seconds."""


class Outdoors(NamedTuple):
    """Weather of a file: hour of the year of each row, temperature [degC] and humidity ratio, (n_rows,) each.

    pressure: its mean [Pa].
    """

    hour_of_year: Array
    T: Array
    W: Array
    pressure: float

    @property
    def days(self) -> range:
        """The days of the year that the rows cover; before the first row its values hold, up to an hour."""
        first, last = float(self.hour_of_year[0]), float(self.hour_of_year[-1])
        return range(int(-(-(first - 1.0) // 24.0)) + 1, int(last // 24.0) + 1)

    def of_day(self, label: int) -> tuple[Array, Array]:
        """Temperature and humidity ratio at the seconds of a day of the year, (86400,) each."""
        begin = 24.0 * (label - 1)
        low = max(int(np.searchsorted(self.hour_of_year, begin, side="right")) - 1, 0)
        rows = slice(low, int(np.searchsorted(self.hour_of_year, begin + 24.0)) + 1)
        at = begin + np.arange(DAY) / 3600.0
        hours = self.hour_of_year[rows]
        return np.interp(at, hours, self.T[rows]), np.interp(at, hours, self.W[rows])


def outdoors_of(weather: Weather, pressure: float | None, file: str) -> Outdoors:
    """The weather that was read; ``pressure`` [Pa] in the place of that of the file.

    Raises
    ------
    InputError
        If it has no whole day.
    """
    series, p = weather.series, weather.pressure(pressure)
    outdoors = Outdoors(series["hour_of_year"], series["T_drybulb"], weather.humidity(p), float(np.mean(p)))
    if not outdoors.days:
        raise InputError(f"{file} has no whole day from midnight to midnight: give at least 24 h")
    return outdoors
