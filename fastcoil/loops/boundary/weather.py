"""Hourly weather, mixed with return air, as the air that enters the coil."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fastcoil.base.arguments import checking, path_of, whole_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.logs.columns import require_mappings
from fastcoil.logs.pieces import MOST_SECONDS
from fastcoil.loops.boundary.conditions import condition_of, days_of, whole_seconds
from fastcoil.loops.boundary.record import Boundary
from fastcoil.loops.boundary.series import Values
from fastcoil.loops.boundary.weather_files import dates_at, read_weather, warn_of_hours
from fastcoil.model.moist_air import humidity_ratio, mix


def weather_day(
    path: str | Path,
    *,
    m_a: Values,
    T_w_in: Values,
    T_set: Values,
    outdoor_fraction: float,
    T_return: float,
    RH_return: float | None = None,
    W_return: float | None = None,
    hours: float = 8.0,
    start_hour: int | None = None,
    month: int | None = None,
    day: int | None = None,
    hour: int | None = None,
    days: Sequence[int] | None = None,
    pressure: float | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Boundary:
    """Hourly weather, mixed with return air, as the air that enters the coil.

    The file is an EnergyPlus weather file (EPW), a TMY3 file or any CSV file, recognised by its content.
    A row gives the values at the full hour it names (hour 1 is 01:00, in the standard time of the site; of several rows
    an hour, the last one); between rows they run straight, and a warning says what this cannot show.  The humidity
    comes from the dew point if the file has one, else from the relative humidity.  The mixture keeps dry air, water and
    enthalpy.  The years in EPW and TMY3 files, which change from month to month, do not count; the days start at their
    dates, in the time zone of the file.

    Parameters
    ----------
    path
        The file.  EPW and TMY3 files are read as they are distributed; a value that is needed and marked as missing is
        refused.
    m_a, T_w_in, T_set
        Air flow [kg/s], entering water [degC] and set-point [degC]: numbers or series of 1-s samples.
    outdoor_fraction
        Share of outdoor air in the dry air of the mixture, 0 to 1.
    T_return, RH_return, W_return
        Return air: temperature [degC], and relative humidity [1] or humidity ratio [kg/kg].
    hours
        Length of the day [h].
    start_hour
        First hour as an hour of the year, from 1.  Or give ``month``, ``day`` and ``hour`` as in the file.  Or
        ``days``, several days of the year from 1, and ``hour``: a dim ``day`` with those labels.
    pressure
        Barometric pressure [Pa]; that of the file if left out, 101325 if it has none.
    columns, units
        Headers and units of a CSV file that differ from `WEATHER_COLUMNS`.
    """
    with checking() as check:
        path = check(path_of, "path", path, "give the path of an EPW, TMY3 or CSV file")
        n_steps = check(whole_seconds, hours)
        outdoor_fraction = check(condition_of, "outdoor_fraction", outdoor_fraction)
        T_return = check(condition_of, "T_return", T_return)
        RH_return = check.unless_none(condition_of, "RH_return", RH_return)
        W_return = check.unless_none(condition_of, "W_return", W_return)
        pressure = check.unless_none(condition_of, "pressure", pressure)
        start_hour = check.unless_none(_whole, "start_hour", start_hour, 1, 8784)
        month = check.unless_none(_whole, "month", month, 1, 12)
        day = check.unless_none(_whole, "day", day, 1, 31)
        hour = check.unless_none(_whole, "hour", hour, 0, 24)
        check(require_mappings, columns=columns, units=units)
        days = check.unless_none(days_of, "days", days)
    if (RH_return is None) == (W_return is None):
        raise InputError("RH_return and W_return: give one of them")
    file = read_weather(path, columns, units, pressure)
    weather = file.series
    p = file.pressure(pressure)
    W_hourly = file.humidity(p)
    starts = _start_hours(weather, path.name, n_steps, start_hour, month, day, hour, days)
    if starts.size * n_steps > MOST_SECONDS:
        raise InputError(
            f"days: {starts.size} days of {n_steps:,} s each: give {MOST_SECONDS:,} s in all, fewer days or hours"
        )
    at = np.add.outer(starts, np.arange(n_steps) / 3600)
    T_out, W_out, p_out = (
        np.interp(at, weather["hour_of_year"], np.broadcast_to(hourly, W_hourly.shape))
        for hourly in (weather["T_drybulb"], W_hourly, p)
    )
    W_back: Values = W_return if RH_return is None else humidity_ratio(T_return, RH_return, p_out)
    T_a_in, W_a_in = mix(outdoor_fraction, T_out, W_out, T_return, W_back)
    warn_of_hours(file)
    rows = slice(None) if days is not None else 0
    begins = dates_at(starts, weather)
    return Boundary(
        m_a=m_a, T_a_in=T_a_in[rows], W_a_in=W_a_in[rows], T_w_in=T_w_in, T_set=T_set, day=days,
        start=None if begins is None else begins[rows], time_zone=file.time_zone,
    )  # fmt: skip


def _start_hours(
    weather: Mapping[str, Array],
    file: str,
    n_steps: int,
    start_hour: int | None,
    month: int | None,
    day: int | None,
    hour: int | None,
    days: Sequence[int] | None,
) -> Array:
    """Hours of the year at which the days start, (n_days,)."""
    ways = {
        "start_hour": start_hour is not None,
        "month, day and hour": month is not None or day is not None,
        "days and hour": days is not None,
    }
    if sum(ways.values()) != 1 or (start_hour is not None and hour is not None):
        given = [way for way, is_given in ways.items() if is_given]
        raise InputError(f"the start is given as {given}: give start_hour, or month, day, hour, or days and hour")
    date = {"month": month, "day": day, "hour": hour}
    if start_hour is not None:
        starts = [start_hour]
    elif days is not None and hour is not None:
        starts = [24 * (one - 1) + hour for one in days]
    elif missing := [name for name in date if date[name] is None and (name == "hour" or days is None)]:
        raise InputError(f"{' and '.join(missing)} missing: give month, day and hour, or days and hour")
    else:
        absent = [name for name in date if name not in weather]
        if absent:
            raise InputError(f"{file} has no column {', '.join(absent)}: name it, or give start_hour")
        rows = np.flatnonzero(np.all([weather[name] == value for name, value in date.items()], axis=0))
        if rows.size != 1:
            wanted = ", ".join(f"{name} {value}" for name, value in date.items())
            raise InputError(f"{file} has {rows.size} rows for {wanted}: give one of the file's own dates")
        starts = [int(weather["hour_of_year"][rows[0]])]
    low, high = weather["hour_of_year"][[0, -1]]
    for start in starts:
        end = start + (n_steps - 1) / 3600
        if start < low or end > high:
            raise InputError(
                f"{file} holds hours of the year {low:g} to {high:g}, not {start} to {end:g}: "
                "start elsewhere, or take fewer hours"
            )
    return np.array(starts, dtype=np.float64)


def _whole(name: str, value: object, low: int, high: int) -> int:
    return whole_of(name, value, low, high, f"give a whole number from {low} to {high}")
