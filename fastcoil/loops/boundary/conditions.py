"""The numbers that describe a day, with units and bounds, and their checks."""

from collections.abc import Iterable
from itertools import islice
from typing import Any

from fastcoil.base.arguments import plain, whole_of
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.logs.columns import MAX_GAP
from fastcoil.model.parameter_table import PARAMETERS, Parameter

_TABLE = (
    Parameter("hours", "boundary", "h", 8.0, "length of the day", 0.0, 8760.0, open_lower=True),
    Parameter("T_a_in", "boundary", "degC", 25.0, "entering air temperature", -40.0, 60.0),
    Parameter("relative_humidity", "boundary", "1", 0.56, "relative humidity of the entering air", 0.0, 1.0),
    Parameter("T_design", "boundary", "degC", None, "outdoor design temperature", -40.0, 60.0),
    Parameter("T_daily_range", "boundary", "K", None, "daily range of the outdoor temperature", 0.0, 40.0),
    Parameter("T_wet_bulb", "boundary", "degC", None, "wet bulb at the design temperature", -40.0, 40.0),
    Parameter("outdoor_fraction", "boundary", "1", 0.3, "share of outdoor air in the dry air", 0.0, 1.0),
    Parameter("T_return", "boundary", "degC", None, "return air temperature", -20.0, 60.0),
    Parameter("RH_return", "boundary", "1", None, "relative humidity of the return air", 0.0, 1.0),
    Parameter("W_return", "boundary", "1", None, "humidity ratio of the return air", 0.0, 0.1),
    Parameter("start_hour", "boundary", "h", 9.0, "hour of the day at the start", 0.0, 24.0),
    Parameter("start", "boundary", "h", 0.0, "hours from the first row of a log to the start", 0.0, 8784.0),
    MAX_GAP,
    Parameter("m_a_design", "boundary", "kg s-1", 1.3, "air flow at full load", 0.0, open_lower=True),
    Parameter("m_a_min", "boundary", "kg s-1", 0.5, "least air flow while the fan runs", 0.0, open_lower=True),
    Parameter("outdoor_air_min", "boundary", "kg s-1", 0.25, "least flow of outdoor air while the fan runs", 0.0),
    Parameter(
        "economiser_limit", "boundary", "degC", None, "outdoor temperature that locks the economiser out", -40, 60
    ),
    Parameter("T_balance", "boundary", "degC", None, "outdoor temperature without load of the shell", -40.0, 60.0),
    Parameter("internal_load", "boundary", "1", None, "load by people and devices over the design load", 0.0, 1.0),
    Parameter("zone_spread", "boundary", "1", 0.3, "how far loads of zones lie apart, over their mean", 0.0, 1.0),
    Parameter("T_set", "boundary", "degC", None, "set-point", 0.0, 60.0),
    Parameter("T_set_min", "boundary", "degC", None, "lowest set-point", 0.0, 60.0),
    Parameter("T_set_max", "boundary", "degC", None, "highest set-point", 0.0, 60.0),
    Parameter("T_out_min", "boundary", "degC", None, "outdoor temperature up to which T_set_max holds", -40.0, 60.0),
    Parameter("T_out_max", "boundary", "degC", None, "outdoor temperature from which T_set_min holds", -40.0, 60.0),
    Parameter("trim", "boundary", "K", 0.1, "step of the set-point each time", 0.0, 10.0),
    Parameter("respond", "boundary", "K", 0.2, "step of the set-point for each request that counts", 0.0, 10.0),
    Parameter("respond_max", "boundary", "K", 0.6, "largest step of the set-point by requests", 0.0, 10.0),
    Parameter("T_w_in", "boundary", "degC", None, "entering water temperature", 0.5, 95.0),
    Parameter("T_w_min", "boundary", "degC", None, "lowest entering water temperature", 0.5, 95.0),
    Parameter("T_w_max", "boundary", "degC", None, "highest entering water temperature", 0.5, 95.0),
    Parameter("T_out_w_min", "boundary", "degC", None, "outdoor temperature up to which T_w_max holds", -40.0, 60.0),
    Parameter("T_out_w_max", "boundary", "degC", None, "outdoor temperature from which T_w_min holds", -40.0, 60.0),
    Parameter("disturbances", "boundary", "1", 1.0, "noise faster than hours, over that of paper_day", 0.0, 10.0),
    PARAMETERS["pressure"],
)
_MOST_DAYS = 366
_MOST_ITEMS = 1_000_000
CONDITIONS = {p.name: p for p in _TABLE}
"""The numbers that describe a day, each with its unit and bounds."""


def condition_of(name: str, value: Any) -> Any:
    """A number that describes a day, within its bounds."""
    number = plain(value)
    if problem := CONDITIONS[name].problem(number):
        raise InputError(problem)
    return number


def whole_seconds(hours: float | None) -> int:
    """``hours`` in seconds, or an `InputError` if they are not a whole number of them."""
    if hours is None:
        raise InputError("hours is missing: give the length of the day in hours")
    hours = condition_of("hours", hours)
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
