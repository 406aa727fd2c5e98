"""Words for axes and legends: a short name, the unit a reader expects, the factor to it."""

from __future__ import annotations

from typing import NamedTuple

from fastcoil.outputs import METRICS, TRACES
from fastcoil.parameter_table import PARAMETERS

_UNITS = {"1": "", "K-1": "1/K", "kg s-1": "kg/s", "kJ K-1": "kJ/K", "kW h": "kWh", "degC": "°C", "m3": "m³"}
_PERCENT = frozenset(
    (
        "backlash", "backlash_estimate", "buffer", "command_resolution", "learning_step", "learning_cap",
        "estimate_final", "estimate_settled", "estimate_first_down",
        "u", "integral", "command", "position", "opening", "estimate",
    )
)  # fmt: skip
"""Shares that are read in per cent."""
_HOURS = frozenset(("learn_time_reached", "learn_time_confirmed", "learn_time_first_down", "elapsed_time"))
_MINUTES = frozenset(("learning_interval",))
_STROKES = frozenset(("stem_travel", "motor_travel"))
_NAMES = {"estimate_ratio": "estimate / backlash"}
"""Where neither the name nor the long name will do."""


class Quantity(NamedTuple):
    """``value × factor`` is in ``unit``."""

    text: str
    unit: str
    factor: float

    @property
    def axis(self) -> str:
        """Label of an axis."""
        return f"{self.text} [{self.unit}]" if self.unit else self.text

    def equals(self, value: float) -> str:
        """``backlash = 7 %``, for legends and headings."""
        return f"{self.text} = {self.number(value)}"

    def number(self, value: float) -> str:
        """``7 %``."""
        return f"{value * self.factor:.3g} {self.unit}".rstrip()


def quantity(name: str) -> Quantity:
    """How a parameter, metric or trace is shown; another name is its own label."""
    entry = METRICS.get(name) or TRACES.get(name) or PARAMETERS.get(name)
    if entry is None:
        return Quantity(name.replace("_", " "), "", 1.0)
    fallback = getattr(entry, "long_name", "") or name.replace("_", " ")
    text = getattr(entry, "label", "") or _NAMES.get(name, fallback)
    if name in _PERCENT or name == "estimate_ratio":
        return Quantity(text, "%", 100.0)
    if name in _HOURS:
        return Quantity(text, "h", 1 / 3600)
    if name in _MINUTES:
        return Quantity(text, "min", 1 / 60)
    if name in _STROKES:
        return Quantity(text, "strokes", 1.0)
    return Quantity(text, _UNITS.get(entry.unit, entry.unit), 1.0)
