"""The families of units in which a column may be logged, and how a unit is spelled."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

from fastcoil.base.errors import InputError, nearest, shown

Units: TypeAlias = Mapping[str, tuple[float, float]]
"""Each unit's (scale, offset) into the first of its family, which is the unit used inside fastcoil."""

STANDARD_AIR = 1.2
"""Density that turns a volume flow of air into a mass flow, kg/m3 (ASHRAE standard air)."""

WATER = 1000.0
"""Density that turns a volume flow of water into a mass flow, kg/m3."""

_POUND, _FOOT, _GALLON = 0.45359237, 0.3048, 3.785411784e-3

TEMPERATURE: Units = {"degC": (1.0, 0.0), "degF": (5 / 9, -160 / 9), "K": (1.0, -273.15)}
DIFFERENCE: Units = {"K": (1.0, 0.0), "degC": (1.0, 0.0), "degF": (5 / 9, 0.0)}
AIR_FLOW: Units = {
    "kg s-1": (1.0, 0.0),
    "kg/s": (1.0, 0.0),
    "kg/h": (1 / 3600, 0.0),
    "lb/h": (_POUND / 3600, 0.0),
    "m3/s": (STANDARD_AIR, 0.0),
    "m3/h": (STANDARD_AIR / 3600, 0.0),
    "L/s": (STANDARD_AIR / 1000, 0.0),
    "cfm": (STANDARD_AIR * _FOOT**3 / 60, 0.0),
}
WATER_FLOW: Units = {
    "kg s-1": (1.0, 0.0),
    "kg/s": (1.0, 0.0),
    "kg/h": (1 / 3600, 0.0),
    "lb/h": (_POUND / 3600, 0.0),
    "m3/s": (WATER, 0.0),
    "m3/h": (WATER / 3600, 0.0),
    "L/s": (WATER / 1000, 0.0),
    "L/min": (WATER / 60e3, 0.0),
    "L/h": (WATER / 3600e3, 0.0),
    "gpm": (WATER * _GALLON / 60, 0.0),
}
HUMIDITY_RATIO: Units = {"1": (1.0, 0.0), "kg/kg": (1.0, 0.0), "g/kg": (1e-3, 0.0)}
FRACTION: Units = {"1": (1.0, 0.0), "percent": (0.01, 0.0), "%": (0.01, 0.0)}
TRAVEL: Units = {
    **FRACTION,
    "deg": (1 / 90, 0.0),
    "V": (0.1, 0.0),
    "V 0-10": (0.1, 0.0),
    "V 2-10": (1 / 8, -2 / 8),
    "mA 4-20": (1 / 16, -4 / 16),
    "mA 0-20": (1 / 20, 0.0),
}
"""Travel of a valve; degrees of a quarter turn, volts of 0–10, signals whose lowest value is the closed valve."""
PRESSURE: Units = {"Pa": (1.0, 0.0), "hPa": (100.0, 0.0), "kPa": (1000.0, 0.0)}
TIME: Units = {"s": (1.0, 0.0), "min": (60.0, 0.0), "h": (3600.0, 0.0)}
NUMBER: Units = {"1": (1.0, 0.0)}

_ABBREVIATIONS = {
    "lpm": "L/min",
    "lps": "L/s",
    "lph": "L/h",
    "cms": "m3/s",
    "cmh": "m3/h",
    "ma": "mA 4-20",
}
"""Abbreviations that look more like another unit than like the one they mean."""
_SPELLINGS = {
    "c": "degC",
    "f": "degF",
    "pct": "percent",
    "% rh": "%",
    "%rh": "%",
    "% open": "%",
    "%open": "%",
    "vdc": "V",
    "v dc": "V",
    "2-10 v": "V 2-10",
    "0-10 v": "V 0-10",
    "4-20 ma": "mA 4-20",
    "0-20 ma": "mA 0-20",
    "usgpm": "gpm",
    "us gpm": "gpm",
}
"""Other spellings of a unit; of those of a family they mean one only."""
_FAMILIES = (TEMPERATURE, AIR_FLOW, WATER_FLOW, HUMIDITY_RATIO, TRAVEL, PRESSURE, TIME)
_LONGEST_UNIT = 16
"""Letters."""


def known_units(units: Units) -> str:
    """The end of a message: every unit of a family."""
    return f"known units: {', '.join(units)}"


def spelled(name: str, unit: str, units: Units) -> str:
    """``unit`` of the column ``name`` as ``units`` spells it; ``°C``, ``l/s`` and ``GPM`` are understood."""
    by_folded = {_folded(known): known for known in units}
    if _folded(unit) in by_folded:
        return by_folded[_folded(unit)]
    other = _SPELLINGS.get(_folded(unit))
    if other is not None and other in units:
        return other
    meant = _ABBREVIATIONS.get(_folded(unit))
    hint = f", did you mean {meant!r}?" if meant in units else nearest(unit, units)
    raise InputError(f"{name} is in {shown(unit)}{hint} ({known_units(units)})")


def is_unit(text: str) -> bool:
    """Whether a text is a unit, or an abbreviation of one; a bare number such as the unit 1 is not."""
    return len(text) <= _LONGEST_UNIT and not text.isdigit() and _folded(text) in _ALL


def _folded(unit: str) -> str:
    plain = unit.replace("\N{DEGREE CELSIUS}", "degC").replace("\N{DEGREE FAHRENHEIT}", "degF").replace("°", "deg")
    plain = plain.replace("³", "3").replace("\N{EN DASH}", "-").casefold()
    return plain if plain[:4] != "deg " else f"deg{plain[4:]}"


_ALL = frozenset(_folded(unit) for units in _FAMILIES for unit in units) | _ABBREVIATIONS.keys() | _SPELLINGS.keys()
