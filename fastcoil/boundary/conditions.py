"""The numbers that describe a day, with units and bounds, and their checks."""

from __future__ import annotations

from typing import Any

from fastcoil.arguments import plain
from fastcoil.errors import InputError
from fastcoil.logs.arguments import MAX_GAP
from fastcoil.parameter_table import PARAMETERS, Parameter

_TABLE = (
    Parameter("hours", "boundary", "h", 8.0, "length of the day", 0.0, 8760.0, open_lower=True),
    Parameter("T_a_in", "boundary", "degC", 25.0, "entering air temperature", -40.0, 60.0),
    Parameter("relative_humidity", "boundary", "1", 0.56, "relative humidity of the entering air", 0.0, 1.0),
    Parameter("T_w_in", "boundary", "degC", None, "mean entering water temperature", 0.0, 95.0),
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
    PARAMETERS["pressure"],
)
CONDITIONS = {p.name: p for p in _TABLE}
"""The numbers that describe a day, each with its unit and bounds."""


def condition_of(name: str, value: Any) -> Any:
    """A number that describes a day, within its bounds."""
    number = plain(value)
    if problem := CONDITIONS[name].problem(number):
        raise InputError(problem)
    return number


def whole_seconds(hours: float) -> int:
    """``hours`` in seconds, or an `InputError` if they are not a whole number of them."""
    if hours is None:
        raise InputError("hours is missing: give the length of the day in hours")
    hours = condition_of("hours", hours)
    seconds = round(hours * 3600)
    if abs(hours * 3600 - seconds) > 1e-6 or seconds < 1:
        raise InputError(f"hours = {hours:g}: give a whole number of seconds (n / 3600)")
    return seconds
