"""Hourly weather, mixed with return air, as the air that enters the coil."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fastcoil.base.arguments import checking, path_of, whole_of
from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.logs.columns import require_mappings
from fastcoil.logs.pieces import MOST_SECONDS
from fastcoil.logs.plausibility import above_saturation
from fastcoil.loops.boundary.conditions import condition_of, days_of, whole_seconds
from fastcoil.loops.boundary.record import Boundary
from fastcoil.loops.boundary.series import Values
from fastcoil.loops.boundary.weather_files import MOST_APART, read_weather, warn_of_hours
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
        bounds = {"start_hour": (1, 8784), "month": (1, 12), "day": (1, 31), "hour": (0, 24)}
        given = {"start_hour": start_hour, "month": month, "day": day, "hour": hour}
        date: dict[str, Any] = {
            name: check.unless_none(whole_of, name, value, *bounds[name]) for name, value in given.items()
        }
        check(require_mappings, columns=columns, units=units)
        date["days"] = check.unless_none(days_of, "days", days)
    if (RH_return is None) == (W_return is None):
        raise InputError("RH_return and W_return: give one of them")
    if W_return is not None and above_saturation({"W_a_in": W_return, "T_a_in": T_return})[1]:
        raise InputError(
            f"W_return = {W_return:g} is above saturation at T_return = {T_return:g} degC: give kg of water per kg of "
            "dry air, such as 0.009"
        )
    file = read_weather(path, columns, units, pressure)
    weather = file.series
    p = file.pressure(pressure)
    W_hourly = file.humidity(p)
    starts = _start_hours(weather, path.name, date)
    low, high = weather["hour_of_year"][[0, -1]]
    for start in starts:
        end = start + (n_steps - 1) / 3600
        if start < low or end > high:
            raise InputError(
                f"{path.name} holds hours of the year {low:g} to {high:g}, not {start:g} to {end:g}: "
                "start elsewhere, or take fewer hours"
            )
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
    begins = file.dates_at(starts)
    boundary = Boundary(
        m_a=m_a, T_a_in=T_a_in[rows], W_a_in=W_a_in[rows], T_w_in=T_w_in, T_set=T_set, day=date["days"],
        start=None if begins is None else begins[rows], time_zone=file.time_zone,
    )  # fmt: skip
    if begins is None and boundary.start is not None:  # of a series that has dates
        apart = np.abs((boundary.start - boundary.start.astype("datetime64[Y]")) / np.timedelta64(1, "h") - starts)
        if (np.minimum(apart, 8760.0 - apart) > MOST_APART).any():
            raise InputError(
                f"the series begin at {boundary.start[0]}, the weather at hour {starts[0]:g} of the year: take one "
                "date, or give bare arrays"
            )
    return boundary


def _start_hours(weather: Mapping[str, Array], file: str, date: Mapping[str, Any]) -> Array:
    """Hours of the year at which the days start, (n_days,)."""
    start_hour, days, hour = date["start_hour"], date["days"], date["hour"]
    of_row = {name: date[name] for name in ("month", "day", "hour")}
    ways = {
        "start_hour": start_hour is not None,
        "month, day and hour": date["month"] is not None or date["day"] is not None,
        "days and hour": days is not None,
    }
    if sum(ways.values()) != 1 or (start_hour is not None and hour is not None):
        given = [way for way, is_given in ways.items() if is_given]
        raise InputError(f"the start is given as {given}: give start_hour, or month, day, hour, or days and hour")
    if start_hour is not None:
        return np.array([start_hour], dtype=np.float64)
    missing = [name for name, value in of_row.items() if value is None and (name == "hour" or days is None)]
    if missing:
        raise InputError(f"{' and '.join(missing)} missing: give month, day and hour, or days and hour")
    if days is not None:
        return np.array([24 * (one - 1) + hour for one in days], dtype=np.float64)
    if absent := [name for name in of_row if name not in weather]:
        raise InputError(f"{file} has no column {', '.join(absent)}: name it, or give start_hour")
    rows = np.flatnonzero(np.all([weather[name] == value for name, value in of_row.items()], axis=0))
    if rows.size != 1:
        wanted = ", ".join(f"{name} {value}" for name, value in of_row.items())
        raise InputError(f"{file} has {rows.size} rows for {wanted}: give one of the file's own dates")
    return weather["hour_of_year"][rows]
