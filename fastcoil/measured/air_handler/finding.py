"""A finding on an air handler: one component, one kind, its times, its size, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from fastcoil.base.arrays import Mask
from fastcoil.measured.air_handler.series import AirHandlerSeries

KINDS = {
    "sensor_stuck": "a sensor stands still", "leak": "passes water when shut", "stuck_open": "stuck open",
    "stuck_shut": "without effect", "fight": "both coils at work", "not_met": "set-point not met", "hunt": "hunts",
    "set_point_swings": "the set-point swings", "sensor_offset": "a sensor is off", "swings": "swings from outside",
    "unoccupied": "runs while unoccupied",
}  # fmt: skip
"""Kinds of findings in a few words, in the order of their rank."""
_RANK_GROUPS = {"sensor_stuck": 0, "hunt": 2, "set_point_swings": 2, "swings": 3, "sensor_offset": 3, "unoccupied": 4}
_MAX_LISTED = 4  # times or days in a sentence


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with an air handler.

    Attributes
    ----------
    component
        ``cooling valve``, ``heating valve``, ``preheat valve``, ``set-point``, ``mixed air sensor``, …
    kind
        One of ``leak``, ``stuck_open``, ``stuck_shut``, ``not_met``, ``fight``, ``hunt``, ``set_point_swings``,
        ``swings``, ``sensor_stuck``, ``sensor_offset``, ``unoccupied``.
    windows
        Start and end of each time, datetime64, or s since the start of a log without a clock.
    size, unit
        How much: K, the amplitude of a swing among them; h of ``unoccupied``.
    hours
        How long in all.
    text, action
        What shows it, and what to do, a sentence each.
    cause
        Why a valve hunts: ``other_valve``, ``load``, ``integral`` (Ti too short), ``gain`` (kp too high) or ``unknown``; blank for other kinds.
    """

    component: str
    kind: str
    windows: list[tuple[Any, Any]]
    size: float
    unit: str
    hours: float
    text: str
    action: str
    cause: str = ""

    def __str__(self) -> str:
        return f"{self.component[0].upper()}{self.component[1:]}: {self.text}. Do this: {self.action}."

    @property
    def severity(self) -> tuple[float, float]:
        """Sort key: kinds that others rest on first, then by kelvin-hours."""
        return _RANK_GROUPS.get(self.kind, 1), -abs(self.size) * self.hours


def make_finding(
    unit: AirHandlerSeries, component: str, kind: str, mask: Mask, size: float, text: str, action: str, **more: Any
) -> Finding:
    """Make a finding of the samples that ``mask`` marks; ``{when}`` in the text becomes its times."""
    windows = unit.windows(mask)
    when = describe_times(unit, mask, windows)
    symbol = more.pop("symbol", "K")
    return Finding(component, kind, windows, size, symbol, unit.hours(mask), text.format(when=when), action, **more)


def describe_times(unit: AirHandlerSeries, mask: Mask, windows: Sequence[tuple[Any, Any]]) -> str:
    """Describe when: clock times within a day, else the days of all days."""
    days = np.unique(unit.day[mask])
    if days.size > 1 or unit.days.size > 1:
        return f"on {days.size} of {max(unit.days.size, days.size)} days ({describe_days(unit, days.tolist())})"
    listed = [f"{_clock(unit, first)}–{_clock(unit, last)}" for first, last in windows[:_MAX_LISTED]]
    more = f" and {len(windows) - _MAX_LISTED} more times" if len(windows) > _MAX_LISTED else ""
    return f"{', '.join(listed)}{more}"


def describe_days(unit: AirHandlerSeries, days: Sequence[int]) -> str:
    """Describe days as ``03-11, 23, 25; 04-01``, or by their number from the start of the log."""
    if unit.start is None:
        return ", ".join(f"day {day + 1}" for day in days)
    dates = [str(unit.start.astype("datetime64[D]") + np.timedelta64(day, "D"))[5:] for day in days]
    months = [list(group) for _, group in groupby(dates, key=lambda date: date[:2])]
    return "; ".join(", ".join([month[0], *(date[3:] for date in month[1:])]) for month in months)


def _clock(unit: AirHandlerSeries, moment: Any) -> str:
    """Format a time to the quarter of an hour, as a clock shows it, or as hours since the start."""
    if unit.start is None:
        return f"{round(moment / 900.0) / 4:g} h"
    quarters = round(float((moment - moment.astype("datetime64[D]")) / np.timedelta64(900, "s")))
    return f"{quarters // 4}:{15 * (quarters % 4):02d}"
