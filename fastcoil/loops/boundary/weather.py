"""Days of hourly weather, and years of it with the operation of an air handler: schedule, economiser, resets.

Sources of the defaults.  ASHRAE Guideline 36-2021, section 5.16.2.2: set-point from 13 to 18 degC (55 to 65 degF) over
outdoor temperatures of 16 and 21 degC (60 and 70 degF); trim and respond from 10 min after the start, every 2 min, by
0.1, 0.2 and at most 0.6 K, 2 requests ignored.  ANSI/ASHRAE/IES 90.1: table 6.5.1.1.3, the fixed limit of an economiser
(24 degC where it is dry); appendix G, sections G3.1.3.4 and G3.1.3.9, outdoor temperatures between which water is reset
(hot 20 and 50 degF, chilled 60 and 80 degF).  Return air and water are those of `design_day`; flows suit the presets.
The rest are guesses.
"""

from calendar import isleap
from collections.abc import Mapping, Sequence
from datetime import date, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.logs.columns import require_name_mappings
from fastcoil.logs.plausibility import find_supersaturation
from fastcoil.loops.boundary.air_handler import check_settings, make_day_series, make_outdoors, make_settings
from fastcoil.loops.boundary.record import Boundary
from fastcoil.loops.boundary.series import Values, days_of_year, hours_to_seconds, require_condition, require_items
from fastcoil.loops.boundary.weather_files import read_weather, warn_of_interpolation
from fastcoil.model.moist_air import humidity_ratio, mix

from fastcoil.base.arguments import (  # isort: skip
    argument_checks, is_number, require_integer, require_number, require_path, require_text,
)  # fmt: skip

_MAX_DATE_GAP_H = 48.0  # from a date to its hour of the year, in years with and without 29 February


def _require_leap_year(year: int, is_leap: bool, file: str) -> None:
    if isleap(year) != is_leap:
        has, right_year = ("a", "a leap year") if is_leap else ("no", "a year that is not a leap year")
        raise InputError(f"year = {year}: {file} has {has} 29 February, give {right_year}", "year", "conflict")


def _labels_between(first: date | None, last: date | None, available: range, year: int) -> list[int]:
    """Return the days of the year from ``first`` to ``last``, across the end of the year if the last comes first."""
    low = first.timetuple().tm_yday if first else available[0]
    high = last.timetuple().tm_yday if last else available[-1]
    return list(range(low, high + 1)) if low <= high else [*range(low, 366 + isleap(year)), *range(1, high + 1)]


def _dates_of_labels(labels: Sequence[int], first_year: int) -> list[date]:
    """Return the dates of days of the year; a day below the one before it is one of the next year."""
    year, previous_label, dates = first_year, 0, []
    for label in labels:
        year += label < previous_label
        if isleap(first_year) and year != first_year:
            sentence = "days go on into the next year, but the weather has a 29 February: end at 12-31"
            raise InputError(sentence, "days", "conflict")
        # in the next year it is the same date, whatever the number of the day
        dates.append((date(first_year, 1, 1) + timedelta(days=label - 1)).replace(year=year))
        previous_label = label
    return dates


def _parse_date(name: str, value: object, year: int) -> date:
    """Read a date such as ``06-15`` in a year."""
    text = require_text(name, value)
    try:
        return datetime.strptime(f"{year}-{text.strip()}", "%Y-%m-%d").date()
    except ValueError:
        sentence = f"{name} = {short_repr(text)}: give month and day of {year}, such as 06-15"
        raise InputError(sentence, name, "format") from None


def _parse_holidays(name: str, value: object, year: int) -> set[tuple[int, int]]:
    items = require_items(name, value, "give a list such as 01-01, 12-25")
    return {(day.month, day.day) for day in (_parse_date(name, item, year) for item in items)}


def _parse_hours(name: str, value: object) -> tuple[float, float]:
    """Return first and last hour of a day, in whole seconds."""
    cure = "give the hours of start and stop, such as 6, 20"
    pair = [require_number(name, hour, cure, least=0.0, most=24.0) for hour in require_items(name, value, cure)]
    if len(pair) != 2 or pair[1] - pair[0] < 0.25 or any(abs(3600 * h - round(3600 * h)) > 1e-6 for h in pair):
        cure = "give a start before the stop, a quarter of an hour at least, from 0 to 24, in whole seconds (n / 3600)"
        raise InputError(f"{name} = {short_repr(value)}: {cure}", name, "value")
    return pair[0], pair[1]


def weather_year(
    path: str | Path, *, mode: str = "cooling", year: int, days: Sequence[int] | None = None,
    first_date: str | None = None, last_date: str | None = None,
    fan_hours: Sequence[float] = (6.0, 20.0), weekend_fan_hours: Sequence[float] | None = None,
    holidays: Sequence[str] | None = None,
    m_a_design: float = 1.3, m_a_min: float = 0.5, outdoor_air_min: float = 0.25,
    economiser: Literal["differential", "fixed", "none"] | None = None, economiser_limit: float | None = None,
    T_return: float | None = None, RH_return: float | None = None,
    T_balance: float | None = None, T_design: float | None = None, internal_load: float | None = None,
    zones: int = 20, zone_spread: float = 0.3,
    set_point: Literal["fixed", "outdoor_reset", "trim_and_respond"] | None = None, T_set: float | None = None,
    T_set_min: float | None = None, T_set_max: float | None = None,
    T_out_min: float | None = None, T_out_max: float | None = None,
    water: Literal["fixed", "load", "outdoor"] = "fixed", T_w_in: float | None = None,
    T_w_min: float | None = None, T_w_max: float | None = None,
    T_out_w_min: float | None = None, T_out_w_max: float | None = None,
    disturbances: float = 1.0, seed: int = 1, pressure: float | None = None,
    columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None,
) -> Boundary:  # fmt: skip
    r"""Return days of a weather year, of 24 h each, with the operation of an air handler: a stream, made day by day.

    The weather is read as by `weather_day`; before the first row its values hold.  A day runs from midnight to midnight
    in the standard time of the site, its label is the day of the year.  Outside its hours the fan is off (``m_a`` = 0)
    and so is the loop (``enabled`` = 0).  The loop is also off where the mixture does not need the coil: from less than
    0.2 K beyond the set-point until more than 0.5 K.  Load, zones and their requests are a stand-in for a building,
    described with all formulas in docs/years.md.  Arguments left out take the defaults of the mode, `DEFAULTS`.

    Parameters
    ----------
    path, pressure, columns, units
        The file, as for `weather_day`; ``pressure`` [Pa].
    mode
        ``cooling`` or ``heating``: of the coil.
    year
        Year of the dates and of the days of the week, 1970 to 2199.
    days
        Days of the year, from 1; by default all.  A day below the one before it is one of the next year.
    first_date, last_date
        Or month and day of the first and the last one, ``"06-01"``; also across the end of the year.
    fan_hours, weekend_fan_hours, holidays
        Hours of start and stop of the fan, Monday to Friday, and Saturday and Sunday (off by default); dates such as
        ``"12-25"`` that are run like a Saturday or Sunday.
    m_a_design, m_a_min
        Air flow at full load and least air flow [kg/s].
    outdoor_air_min
        Least flow of outdoor air while the fan runs [kg/s].
    economiser, economiser_limit
        ``differential`` (more outdoor air where it is cooler than the return air), ``fixed`` (where it is cooler than
        ``economiser_limit`` [degC]) or ``none``; heating has none.
    T_return, RH_return
        Return air [degC, 1]; the zones have its temperature.
    T_balance, T_design
        Outdoor temperatures [degC] at which the building's shell has no load and its full load.  ``T_design`` is by
        default the temperature that 0.4 % of the hours of the file exceed, in heating fall below.
    internal_load
        Load by people and devices as a share of the design load; in heating it is subtracted.
    zones, zone_spread
        Number of zones, and spread of their loads, as a share of their mean.
    set_point
        ``fixed`` (``T_set``), ``outdoor_reset`` (``T_set_max`` up to the outdoor temperature ``T_out_min``,
        ``T_set_min`` from ``T_out_max`` on, straight between) or ``trim_and_respond`` (the same, its ``T_set_max``
        lowered by requests of the zones; cooling only).  Temperatures [degC].
    water, T_w_in, T_w_min, T_w_max, T_out_w_min, T_out_w_max
        Entering water: ``fixed`` (``T_w_in``), ``load`` (from ``T_w_max`` without load to ``T_w_min`` at full load; in
        heating the other way round) or ``outdoor`` (``T_w_max`` up to the outdoor temperature ``T_out_w_min``,
        ``T_w_min`` from ``T_out_w_max`` on) [degC].
    disturbances, seed
        Noise faster than hours as a multiple of that of `paper_day` (0: none), and its seed, 0 to 2**32 - 1.

    Returns
    -------
    Boundary
        A stream along ``day``.

    Examples
    --------
    >>> import fastcoil as fc
    >>> rows = [f"{hour},{20 + hour % 24 / 2},12\n" for hour in range(1, 49)]
    >>> with open("site.csv", "w") as file:
    ...     file.writelines(["hour_of_year,T_drybulb_C,T_dewpoint_C\n", *rows])
    >>> fc.weather_year("site.csv", year=2023, T_design=32.0).extent
    '24 h x 2 days from 2023-01-01 00:00:00'
    """
    arguments = dict(locals())
    with argument_checks() as check:
        path = check(require_path, "path", path, "give the path of an EPW, TMY3 or CSV file")
        check(require_name_mappings, columns=columns, units=units)
        pressure = check.unless_none(require_condition, "pressure", pressure)
        cure = "give a year from 1970 to 2199"
        year = check(require_integer, "year", year, 1970, 2199, cure) or 2000  # refused below
        labels = check.unless_none(days_of_year, "days", days)
        first = check.unless_none(_parse_date, "first_date", first_date, year)
        last = check.unless_none(_parse_date, "last_date", last_date, year)
        weekday = check(_parse_hours, "fan_hours", fan_hours)
        weekend = check.unless_none(_parse_hours, "weekend_fan_hours", weekend_fan_hours)
        holiday_dates = check.unless_none(_parse_holidays, "holidays", holidays, year) or set()
        chosen = check(check_settings, arguments)
        if days is not None and not (first_date is None and last_date is None):
            sentence = "days and first_date, last_date are both given: give one of them"
            check.problems.append(Problem(sentence, "days", "conflict"))
    weather = read_weather(path, columns, units, pressure)
    outdoors = make_outdoors(weather, pressure, path.name)
    _require_leap_year(year, weather.is_leap, path.name)
    if labels is None:
        labels = _labels_between(first, last, outdoors.days, year) if first or last else list(outdoors.days)
    dates = _dates_of_labels(labels, year)
    if absent := [label for label in labels if label not in outdoors.days]:
        covered_text = f"{path.name} holds the whole days {outdoors.days[0]} to {outdoors.days[-1]} of the year"
        total_text = f" ({len(absent)} days in total)" if len(absent) > 1 else ""
        raise InputError(f"days: {covered_text}, not {absent[0]}{total_text}: choose among them", "days", "value")
    fan = {
        label: weekend if date.weekday() >= 5 or (date.month, date.day) in holiday_dates else weekday
        for label, date in zip(labels, dates, strict=True)
    }
    settings = make_settings(chosen, outdoors, fan, path.name)
    if settings.disturbances == 0.0:
        warn_of_interpolation()
    make, start = partial(make_day_series, settings, outdoors), [day.isoformat() for day in dates]
    return Boundary.from_days(make, day=labels, hours=24, start=start, time_zone=weather.time_zone)


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
