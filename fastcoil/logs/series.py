"""Every column that a log or a boundary may have, once: name, meaning, units, bounds, how it runs between samples."""

import math
import re
import tomllib
import unicodedata
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from fastcoil.base import text as base_text
from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr

Units: TypeAlias = Mapping[str, tuple[float, float]]
"""Each unit's (scale, offset) into the first of its family, which is the unit used inside fastcoil."""

STANDARD_AIR_DENSITY = 1.2  # kg/m3, turns a volume flow of air into a mass flow (ASHRAE standard air)
WATER_DENSITY = 1000.0  # kg/m3, turns a volume flow of water into a mass flow


def _units_without_offset(scales: Mapping[str, float]) -> Units:
    return {unit: (scale, 0.0) for unit, scale in scales.items()}


TEMPERATURE: Units = {"degC": (1.0, 0.0), "degF": (5 / 9, -160 / 9), "K": (1.0, -273.15)}
TEMPERATURE_DIFFERENCE = _units_without_offset({"K": 1.0, "degC": 1.0, "degF": 5 / 9})
_MASS_FLOW = {"kg s-1": 1.0, "kg/s": 1.0, "kg/h": 1 / 3600, "lb/h": 0.45359237 / 3600}
AIR_FLOW = _units_without_offset({
    **_MASS_FLOW, "m3/s": STANDARD_AIR_DENSITY, "m3/h": STANDARD_AIR_DENSITY / 3600,
    "L/s": STANDARD_AIR_DENSITY / 1000, "cfm": STANDARD_AIR_DENSITY * 0.3048**3 / 60,
})  # fmt: skip
WATER_FLOW = _units_without_offset({
    **_MASS_FLOW, "m3/s": WATER_DENSITY, "m3/h": WATER_DENSITY / 3600, "L/s": WATER_DENSITY / 1000,
    "L/min": WATER_DENSITY / 60e3, "L/h": WATER_DENSITY / 3600e3, "gpm": WATER_DENSITY * 3.785411784e-3 / 60,
})  # fmt: skip
HUMIDITY_RATIO = _units_without_offset({"1": 1.0, "kg/kg": 1.0, "g/kg": 1e-3})
FRACTION = _units_without_offset({"1": 1.0, "percent": 0.01, "%": 0.01})
TRAVEL: Units = {
    **FRACTION, **_units_without_offset({"deg": 1 / 90, "V": 0.1, "V 0-10": 0.1}),
    "V 2-10": (1 / 8, -2 / 8), "mA 4-20": (1 / 16, -4 / 16), "mA 0-20": (1 / 20, 0.0),
}  # fmt: skip
"""Travel of a valve; degrees of a quarter turn, volts of 0–10, signals whose lowest value is the closed valve."""
POWER = _units_without_offset({"kW": 1.0, "W": 1e-3})
PRESSURE = _units_without_offset({"Pa": 1.0, "hPa": 100.0, "kPa": 1000.0})
TIME = _units_without_offset({"s": 1.0, "min": 60.0, "h": 3600.0})
DIMENSIONLESS = _units_without_offset({"1": 1.0})

VOCABULARY = tomllib.loads(Path(__file__).with_name("names.toml").read_text(encoding="utf-8"))
"""What building systems write, in headers, in cells, for units and for zones, and what it means."""
_ABBREVIATIONS: Mapping[str, str] = VOCABULARY["abbreviations"]
_UNIT_WORDS = {word: unit for unit, words in VOCABULARY["unit_words"].items() for word in words.split()}
_SUFFIXES: Sequence[str] = VOCABULARY["suffixes"]["any"]
_TIME_SUFFIXES: Sequence[str] = VOCABULARY["suffixes"]["time"]
MAX_UNIT_CHARACTERS = 40  # longest text that can be a unit: gramsOfWaterPerKilogramDryAir


def resolve_unit(name: str, unit: str, units: Units) -> str:
    """Return a unit as ``units`` spells it, from other spellings such as ``°C``, ``l/s`` and ``GPM``."""
    known_unit, full_unit = find_unit(unit, units), _ABBREVIATIONS.get(_fold_unit(unit))
    if known_unit is not None and known_unit != full_unit:
        return known_unit
    hint = f", did you mean {full_unit!r}?" if full_unit in units else did_you_mean(unit, units)
    raise InputError(f"{name} is in {short_repr(unit)}{hint} (known units: {', '.join(units)})", name, "unit")


def find_unit(text: str, units: Units) -> str | None:
    """Return the one of ``units`` that a text spells or abbreviates, None if it is none of them."""
    folded = _fold_unit(text)
    known_unit = {_fold_unit(unit): unit for unit in units}.get(folded)
    known_unit = known_unit or _expand_unit(folded) or _ABBREVIATIONS.get(folded)
    return known_unit if known_unit in units else None


def is_unit(text: str, *, of_time: bool = True) -> bool:
    """Whether a text is a unit, or an abbreviation of one; a bare number such as the unit 1 is not."""
    if len(text) > MAX_UNIT_CHARACTERS or text.isdigit():
        return False
    folded = _fold_unit(text)
    unit = _expand_unit(folded)
    return bool(unit) and (of_time or unit not in TIME) or folded in _ABBREVIATIONS


def split_unit_suffix(header: str) -> tuple[str, str] | None:
    """Split a unit at the end of a name, such as ``SAT_C``, ``time_s`` and ``SAT - °C``; None without one."""
    label, _, last_word = header.rpartition(" ")
    if label.strip(" -:/,") and re.search("[°º%]|deg", last_word) and is_unit(last_word):
        return label.rstrip(" -:/,"), last_word
    label, mark, suffix = header.rpartition("_")
    suffixes = _TIME_SUFFIXES if label.lower().endswith("time") else _SUFFIXES
    return (label, suffix) if mark and label.strip("_ ") and suffix in suffixes else None


def _expand_unit(folded: str) -> str:
    """Return the unit that a folded text spells, such as ``degrees-fahrenheit``; blank if there is none."""
    text = folded.removeprefix("unit:")
    in_symbols = re.sub("[a-z]{2,}", lambda word: _UNIT_WORDS.get(word[0], word[0]), text)
    return str(_UNIT_BY_SPELLING.get(_join_words(text)) or _UNIT_BY_SPELLING.get(_join_words(in_symbols), ""))


def _join_words(folded: str) -> str:
    american = folded.replace("litre", "liter").replace("metre", "meter")
    return re.sub(r"[\s_.^*·-]|per(?=[\W_]|second|minute|hour|kilogram)", "", american)


def _fold_unit(unit: str) -> str:
    """Return a unit in small ASCII letters, for comparison."""
    text = re.sub("º|˚|Â°", "°", unit)  # what stands for a degree sign
    text = re.sub("[–−]", "-", unicodedata.normalize("NFKC", text)).replace("°", "deg").casefold()
    return text if text[:4] != "deg " else f"deg{text[4:]}"


_UNIT_FAMILIES = (TEMPERATURE, AIR_FLOW, WATER_FLOW, HUMIDITY_RATIO, TRAVEL, POWER, PRESSURE, TIME)
_UNIT_BY_SPELLING = {_join_words(_fold_unit(unit)): unit for units in _UNIT_FAMILIES for unit in units} | {
    _join_words(_fold_unit(text)): unit for unit, texts in VOCABULARY["spellings"].items() for text in texts.split(", ")
}


@dataclass(frozen=True, slots=True)
class Series:
    """A column that a log may have, or a series of a boundary: name, units, bounds."""

    name: str
    long_name: str
    units: Units
    lower: float = -math.inf  # inclusive bounds, in the first of ``units``
    upper: float = math.inf
    hold: bool = False  # whether it keeps its value until the next sample; others run straight
    whole: bool = False  # whether it takes whole numbers only
    default: float | None = None  # where it is not given; None if it must be given
    scatters: bool = False  # whether readings may lie a little outside the bounds, as of a closed valve

    @property
    def unit(self) -> str:
        return next(iter(self.units))

    @property
    def is_switch(self) -> bool:
        """Whether the series is a switch, 1 for on and 0 for off."""
        return self.whole and (self.lower, self.upper) == (0.0, 1.0)

    @property
    def known_units(self) -> str:
        return f"known units: {', '.join(self.units)}"

    def resolve_unit(self, unit: str) -> str:
        """Return ``unit`` as ``units`` spells it."""
        return resolve_unit(self.name, unit, self.units)

    def is_same_unit(self, unit: str, other_unit: str) -> bool:
        """Whether two texts are units of this series, of one size and zero."""
        try:
            return self.units[self.resolve_unit(unit)] == self.units[self.resolve_unit(other_unit)]
        except InputError:
            return False

    def convert(self, values: Array, unit: str) -> Array:
        """Convert ``values`` from a declared ``unit`` into ours."""
        scale, offset = self.units[self.resolve_unit(unit)]
        with np.errstate(over="ignore"):  # what overflows is out of bounds
            return values * scale + offset

    def is_bad(self, values: Array) -> Mask:
        """Return where values (in our unit) are not finite, out of bounds, or not whole though they must be."""
        with np.errstate(invalid="ignore"):
            is_good = np.isfinite(values) & (values >= self.lower) & (values <= self.upper)
            return ~(is_good & (values == np.rint(values))) if self.whole else ~is_good

    def describe_bad_value(self, value: float, where: str, n_bad: int, unit: str | None = None) -> Problem:
        """Describe a bad ``value`` (in ``unit``): where it is, the bounds, and the cure."""
        unit = unit or self.unit
        if not math.isfinite(value):
            sentence = f"{self.name} is {value:g}{where}: fill or cut the gap{count_suffix(n_bad)}"
            return Problem(sentence, self.name, "value")
        unit_text = "" if unit == "1" else f" {unit}"
        scale, offset = self.units[unit]
        low, high = (round((bound - offset) / scale, 6) for bound in (self.lower, self.upper))
        bounds = f"{'whole, ' if self.whole else ''}from {low:g} to {high:g}{unit_text}"
        text = f"{self.name} = {value:g}{unit_text}{where}: must be {bounds}"
        return Problem(f"{text}; check its unit, or fill or cut the gap{count_suffix(n_bad)}", self.name, "value")


def count_suffix(n_bad: int) -> str:
    """Return the end of a message that names the first of several bad samples."""
    return f" ({n_bad} samples in total)" if n_bad > 1 else ""


COLUMNS: dict[str, Series] = {
    s.name: s
    for s in (
        Series("m_a", "air flow", AIR_FLOW, 0.0, 200.0, scatters=True),
        Series("T_a_in", "entering air temperature", TEMPERATURE, -70.0, 60.0),
        Series("W_a_in", "humidity ratio of the entering air", HUMIDITY_RATIO, 0.0, 0.1),
        Series("T_w_in", "entering water temperature", TEMPERATURE, 0.5, 120.0),
        Series("T_set", "set-point of the supply air temperature", TEMPERATURE, -20.0, 80.0, hold=True),
        Series("noise", "recorded noise of the measured temperature", TEMPERATURE_DIFFERENCE, -50.0, 50.0, default=0.0),
        Series("enabled", "whether the loop is in operation", DIMENSIONLESS, 0.0, 1.0, True, True, default=1.0),
        Series("backlash_scale", "what the backlash is multiplied by", DIMENSIONLESS, 0.0, 100.0, True, default=1.0),
        Series("T_out", "outdoor temperature", TEMPERATURE, -70.0, 60.0, default=0.0),
        Series("Q_room", "heat gain of the room", POWER, -1e4, 1e4, default=0.0),
        Series("dp_ratio", "pressure difference over its design value", DIMENSIONLESS, 0.0, 100.0, default=1.0),
        Series("elapsed_time", "time", TIME, -1e10, 1e10),  # three centuries
        Series("RH_a_in", "relative humidity of the entering air", FRACTION, 0.0, 1.0, scatters=True),
        Series("T_dp_in", "dew point of the entering air", TEMPERATURE, -70.0, 70.0),
        Series("command", "command to the valve", TRAVEL, 0.0, 1.0, hold=True, scatters=True),
        Series("m_w", "water flow", WATER_FLOW, 0.0, 1000.0, scatters=True),
        Series("T_sup", "supply air temperature", TEMPERATURE, -40.0, 100.0),
        Series("T_w_out", "leaving water temperature", TEMPERATURE, 0.1, 150.0),
        Series("test", "whether the valve test runs", DIMENSIONLESS, 0.0, 1.0, hold=True, whole=True),
        Series("batch", "number of the experiment", DIMENSIONLESS, 0.0, 1e9, hold=True, whole=True),
        Series("cooling_command", "command to the cooling valve", TRAVEL, 0.0, 1.0, hold=True, scatters=True),
        Series("heating_command", "command to the heating valve", TRAVEL, 0.0, 1.0, hold=True, scatters=True),
        Series("preheat_command", "command to the preheat valve", TRAVEL, 0.0, 1.0, hold=True, scatters=True),
        Series("T_set_cooling", "set-point for cooling", TEMPERATURE, -20.0, 80.0, hold=True),
        Series("T_set_heating", "set-point for heating", TEMPERATURE, -20.0, 80.0, hold=True),
        Series("T_mixed", "mixed air temperature", TEMPERATURE, -70.0, 60.0),
        Series("T_return", "return air temperature", TEMPERATURE, -70.0, 60.0),
        Series("fan_speed", "speed of the supply fan", FRACTION, 0.0, 1.0, scatters=True),
        Series("occupied", "whether the rooms are occupied", DIMENSIONLESS, 0.0, 1.0, hold=True, whole=True),
    )
}
"""Every column that a log may have, except ``timestamp``."""

AIR_HANDLER_COLUMNS = (
    "cooling_command", "heating_command", "preheat_command", "T_set_cooling", "T_set_heating", "T_mixed", "T_return",
    "fan_speed", "occupied",
)  # fmt: skip
"""Columns that are read of an air handler as a whole only; of one valve, the first three are its ``command``."""
TIME_COLUMNS = ("elapsed_time", "timestamp")  # in one of which a log gives its time
HUMIDITY_COLUMNS = ("W_a_in", "RH_a_in", "T_dp_in")  # in one of which it gives the humidity of the entering air


def format_count(mask_or_count: Mask | int, noun: str) -> str:
    """Format a number with its noun, ``1 row``, ``2 rows``; of a mask, how many it marks."""
    return base_text.format_count(int(np.sum(mask_or_count)), noun)


def describe_first_row(row_numbers: Sequence[int], mask: Mask) -> str:
    """Return ``first in row 7``: the row number of the first sample that ``mask`` marks."""
    return f"first in row {row_numbers[int(np.argmax(mask))]}"


def warn_of_reading_notes(name: str, notes: Sequence[str]) -> None:
    """Warn of the notes on how a log was read, for results that have no place for them."""
    if notes:
        warnings.warn(f"{name}: {'; '.join(notes)}", UserWarning, stacklevel=3)
