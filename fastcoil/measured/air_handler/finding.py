"""A finding on an air handler: one component, one kind, its times, its size, and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fastcoil.base.arrays import Mask
from fastcoil.measured.air_handler.series import AirHandlerSeries
from fastcoil.measured.clock import describe_times

KINDS = {
    "mismatch": "commands of other hours", "sensor_stuck": "a sensor stands still",
    "leak": "passes water when shut", "stuck_open": "stuck open",
    "stuck_shut": "without effect", "fight": "both coils at work", "not_met": "set-point not met", "hunt": "hunts",
    "set_point_swings": "swings", "sensor_offset": "a sensor is off", "swings": "swings from outside",
    "unoccupied": "runs while unoccupied",
}  # fmt: skip
"""Kinds of findings in a few words, in the order of their rank."""
_RANK_GROUPS = {
    "mismatch": 0, "sensor_stuck": 0, "hunt": 2, "set_point_swings": 2, "swings": 3, "sensor_offset": 3,
    "unoccupied": 4,
}  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with an air handler.

    Attributes
    ----------
    component
        ``cooling valve``, ``heating valve``, ``cooling coil``, ``controller``, ``set-point``,
        ``entering air``, ``supply air``, ``water``, ``fan``, …
    kind
        One of ``leak``, ``stuck_open``, ``stuck_shut``, ``not_met``, ``fight``, ``hunt``, ``set_point_swings``,
        ``swings``, ``sensor_stuck``, ``sensor_offset``, ``unoccupied``, ``mismatch``.
    windows
        Start and end of each time, datetime64, or s since the start of a log without a clock.
    size, unit
        How much: K, the amplitude of a swing among them; h of ``unoccupied``.
    hours
        How long in all.
    text, action
        What shows it, and what to do, a sentence each.
    cause
        Why a valve hunts: ``other_valve``, ``load``, ``integral`` (Ti too short), ``integral_or_gap``,
        ``gain`` (kp too high) or ``unknown``; blank for other kinds.
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

    @property
    def label(self) -> str:
        """A few words for a figure, such as ``cooling valve: hunts``."""
        named = self.text.partition(" itself")[0].removeprefix("the ") if self.kind == "set_point_swings" else ""
        return f"{named or self.component}: {KINDS[self.kind]}"

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
    spans = unit.spans(mask)
    when, symbol = describe_times(spans, unit.start, unit.days.size), more.pop("symbol", "K")
    windows = [(unit.moment(first), unit.moment(last)) for first, last in spans]
    return Finding(component, kind, windows, size, symbol, unit.hours(mask), text.format(when=when), action, **more)
