"""Days of hourly weather, whose outdoor air is mixed with return air."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fastcoil.base.arguments import argument_checks, is_number, require_integer, require_path
from fastcoil.base.errors import InputError
from fastcoil.logs.columns import require_name_mappings
from fastcoil.logs.plausibility import find_supersaturation
from fastcoil.loops.boundary.record import Boundary
from fastcoil.loops.boundary.series import Values, days_of_year, hours_to_seconds, require_condition
from fastcoil.loops.boundary.weather_files import read_weather, warn_of_interpolation
from fastcoil.model.moist_air import humidity_ratio, mix

_MAX_DATE_GAP_H = 48.0  # from a date to its hour of the year, in years with and without 29 February


def weather_day(
    path: str | Path, *, days: int | Sequence[int], hour: int, m_a: Values, T_w_in: Values, T_set: Values,
    outdoor_fraction: float, T_return: float, RH_return: float | None = None, W_return: float | None = None,
    hours: float = 8.0, pressure: float | None = None, columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Boundary:  # fmt: skip
    """Return days of hourly weather, mixed with return air, as the air that enters the coil.

    The file is an EnergyPlus weather file (EPW), a TMY3 file or any CSV file, recognised by its content.  A row gives
    the values at the full hour it names (hour 1 is 01:00, in the standard time of the site), with straight lines
    between rows; a warning says what these cannot show.  The humidity comes from the
    dew point if the file has one, else from the relative humidity.  The mixture keeps dry air, water and enthalpy.  The
    years in EPW and TMY3 files, which change from month to month, are ignored; the days start at their dates, in the
    time zone of the file.

    Parameters
    ----------
    path
        The file.  EPW and TMY3 files are read as they are distributed; a value that is needed and marked as missing is
        refused.
    days, hour
        Day of the year, from 1, or several: a dim ``day`` with those labels; hour of the day at which they begin.
    m_a, T_w_in, T_set
        Air flow [kg/s], entering water [degC] and set-point [degC]: numbers or series of 1-s samples.
    outdoor_fraction
        Share of outdoor air in the dry air of the mixture, 0 to 1.
    T_return, RH_return, W_return
        Return air: temperature [degC], and relative humidity [1] or humidity ratio [kg/kg].
    hours
        Length of the day [h].
    pressure
        Barometric pressure [Pa]; by default that of the file, or 101325 if it has none.
    columns, units
        Headers and units of a CSV file that differ from `WEATHER_COLUMNS`.

    Returns
    -------
    Boundary
        One day, or several along ``day``.
    """
    with argument_checks() as check:
        path = check(require_path, "path", path, "give the path of an EPW, TMY3 or CSV file")
        labels = check(days_of_year, "days", [days] if is_number(days) else days)
        hour = check(require_integer, "hour", hour, 0, 24)
        n_steps = check(hours_to_seconds, hours)
        outdoor_fraction = check(require_condition, "outdoor_fraction", outdoor_fraction)
        T_return = check(require_condition, "T_return", T_return)
        RH_return = check.unless_none(require_condition, "RH_return", RH_return)
        W_return = check.unless_none(require_condition, "W_return", W_return)
        pressure = check.unless_none(require_condition, "pressure", pressure)
        check(require_name_mappings, columns=columns, units=units)
    if (RH_return is None) == (W_return is None):
        code = "missing" if W_return is None else "conflict"
        raise InputError("RH_return and W_return: give one of them", "RH_return", code)
    if W_return is not None and find_supersaturation({"W_a_in": W_return, "T_a_in": T_return})[1]:
        sentence = f"W_return = {W_return:g} is above saturation at T_return = {T_return:g} degC"
        raise InputError(f"{sentence}: give kg of water per kg of dry air, such as 0.009", "W_return", "unit")
    file = read_weather(path, columns, units, pressure)
    weather = file.series
    p = file.pressure(pressure)
    W_hourly = file.humidity(p)
    starts = np.array([24 * (label - 1) + hour for label in labels], dtype=np.float64)
    low, high = weather["hour_of_year"][[0, -1]]
    for start in starts:
        end = start + (n_steps - 1) / 3600
        if start < low or end > high:
            sentence = f"{path.name} holds hours of the year {low:g} to {high:g}, not {start:g} to {end:g}"
            raise InputError(f"{sentence}: take other days, or fewer hours", "days", "data")
    sample_hours = np.add.outer(starts, np.arange(n_steps) / 3600)
    T_out, W_out, p_out = (
        np.interp(sample_hours, weather["hour_of_year"], np.broadcast_to(hourly, W_hourly.shape))
        for hourly in (weather["T_drybulb"], W_hourly, p)
    )
    W_back: Values = W_return if RH_return is None else humidity_ratio(T_return, RH_return, p_out)
    T_a_in, W_a_in = mix(outdoor_fraction, T_out, W_out, T_return, W_back)
    warn_of_interpolation()
    rows = 0 if is_number(days) else slice(None)
    start_times = file.dates_at(starts)
    boundary = Boundary(
        m_a=m_a, T_a_in=T_a_in[rows], W_a_in=W_a_in[rows], T_w_in=T_w_in, T_set=T_set, day=days,
        start=None if start_times is None else start_times[rows], time_zone=file.time_zone,
    )  # fmt: skip
    if start_times is None and boundary.start is not None:  # of a series that has dates
        date_gaps = np.abs((boundary.start - boundary.start.astype("datetime64[Y]")) / np.timedelta64(1, "h") - starts)
        if (np.minimum(date_gaps, 8760.0 - date_gaps) > _MAX_DATE_GAP_H).any():
            sentence = f"the series begin at {boundary.start[0]}, the weather at hour {starts[0]:g} of the year"
            raise InputError(f"{sentence}: take one date, or give bare arrays", "days", "time")
    return boundary
