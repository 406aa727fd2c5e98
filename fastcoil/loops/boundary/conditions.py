"""The numbers that describe a day, with units and bounds, and their checks."""

import math
from collections.abc import Iterable
from itertools import islice
from typing import Any

from fastcoil.base.arguments import plain, whole_of
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.model.parameter_table import PARAMETERS, Parameter

_BOUNDS: tuple[tuple[str, str, float, float], ...] = (
    ("relative_humidity outdoor_fraction RH_return internal_load zone_spread", "1", 0.0, 1.0),
    ("W_return", "1", 0.0, 0.1),
    ("disturbances", "1", 0.0, 10.0),
    ("T_a_in T_design T_balance economiser_limit", "degC", -40.0, 60.0),
    ("T_out_min T_out_max T_out_w_min T_out_w_max", "degC", -40.0, 60.0),
    ("T_wet_bulb", "degC", -40.0, 40.0),
    ("T_return", "degC", -20.0, 60.0),
    ("T_set T_set_min T_set_max", "degC", 0.0, 60.0),
    ("T_w_in T_w_min T_w_max", "degC", 0.5, 95.0),
    ("T_daily_range", "K", 0.0, 40.0),
    ("trim respond respond_max", "K", 0.0, 10.0),
    ("start_hour", "h", 0.0, 24.0),
    ("start", "h", 0.0, 8784.0),
    ("hours", "h", 0.0, 8760.0),
    ("m_a_design m_a_min outdoor_air_min", "kg s-1", 0.0, math.inf),
)
_ABOVE_0 = ("hours", "m_a_design", "m_a_min")
CONDITIONS = {
    name: Parameter(name, "boundary", unit, None, "", least, most, open_lower=name in _ABOVE_0)
    for names, unit, least, most in _BOUNDS
    for name in names.split()
} | {"pressure": PARAMETERS["pressure"]}
"""The numbers that describe a day, each with its unit and bounds."""
_MOST_DAYS = 366
_MOST_ITEMS = 1_000_000


def condition_of(name: str, value: Any) -> Any:
    """A number that describes a day, within its bounds."""
    number = plain(value)
    if problem := CONDITIONS[name].problem(number):
        raise InputError(problem)
    return number


def whole_seconds(hours: float | None) -> int:
    """``hours`` in seconds, or an `InputError` if they are not a whole number of them."""
    hours = float(condition_of("hours", hours))
    seconds = round(hours * 3600)
    if abs(hours * 3600 - seconds) > 1e-6 or seconds < 1:
        raise InputError(f"hours = {hours:g}: give a whole number of seconds (n / 3600)")
    return seconds


def several_of(name: str, value: object, cure: str) -> list[object]:
    """The items of an iterable of at most ``_MOST_ITEMS``."""
    if isinstance(value, str | bytes) or not isinstance(value, Iterable) or getattr(value, "ndim", 1) == 0:
        raise InputError(WrongType(f"{name} = {shown(value)}: {cure}"))
    items = list(islice(value, _MOST_ITEMS + 1))
    if len(items) > _MOST_ITEMS:
        raise InputError(f"{name} has more than {_MOST_ITEMS:,} items: give fewer")
    return items


def days_of(name: str, value: object) -> list[int]:
    """Days of the year."""
    whole = f"give whole numbers from 1 to {_MOST_DAYS}"
    several = several_of(name, value, "give a list of days of the year")
    days = [whole_of(name, one, 1, _MOST_DAYS, whole) for one in several]
    if not days or len(set(days)) < len(days):
        raise InputError(f"{name} {'has a day twice' if days else 'is empty'}: give each day once")
    return days
