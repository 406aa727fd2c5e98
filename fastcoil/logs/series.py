"""Every column that a log may have, once: name, meaning, units, bounds, and how it runs between samples.

The checks of logs and of boundaries, and the attributes of a boundary's Dataset, derive from this table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs.units import (
    AIR_FLOW,
    DIFFERENCE,
    FRACTION,
    HUMIDITY_RATIO,
    NUMBER,
    TEMPERATURE,
    TIME,
    TRAVEL,
    WATER_FLOW,
    Units,
    known_units,
    spelled,
)

_MISSING_MARKS = (-99.0, -999.0, -9999.0)


@dataclass(frozen=True, slots=True)
class Series:
    """One series.

    lower, upper: inclusive bounds, in the first of ``units``.  hold: it keeps its value until the next sample; others
    run straight between samples.  whole: it takes whole numbers only.  default: used where it is not given; None if it
    must be given.  needs_no_unit: its column may leave the unit out.  scatters: its readings may lie a little outside
    the bounds, as those of a closed valve or a resting flow meter do.
    """

    name: str
    long_name: str
    units: Units
    lower: float = -math.inf
    upper: float = math.inf
    hold: bool = False
    whole: bool = False
    default: float | None = None
    needs_no_unit: bool = False
    scatters: bool = False

    @property
    def unit(self) -> str:
        return next(iter(self.units))

    @property
    def is_switch(self) -> bool:
        """Whether it is on or off."""
        return self.whole and (self.lower, self.upper) == (0.0, 1.0)

    @property
    def known_units(self) -> str:
        return known_units(self.units)

    def spelled(self, unit: str) -> str:
        """``unit`` as ``units`` spells it."""
        return spelled(self.name, unit, self.units)

    def is_same_unit(self, one: str, other: str) -> bool:
        """Whether two texts are units of this series, of one size and zero."""
        try:
            return self.units[self.spelled(one)] == self.units[self.spelled(other)]
        except InputError:
            return False

    def convert(self, values: Array, unit: str) -> Array:
        """``values`` from a declared ``unit`` into ours."""
        scale, offset = self.units[self.spelled(unit)]
        with np.errstate(over="ignore"):  # what overflows is out of bounds
            return values * scale + offset

    def is_bad(self, values: Array) -> Mask:
        """Where ``values`` (in our unit) are not finite, out of bounds, or not whole where they must be."""
        with np.errstate(invalid="ignore"):
            good = np.isfinite(values) & (values >= self.lower) & (values <= self.upper)
            return ~(good & (values == np.rint(values))) if self.whole else ~good

    def is_missing_mark(self, values: Array) -> Mask:
        """Where ``values``, as they are logged, mark a missing value."""
        return np.isin(values, _MISSING_MARKS)

    def sentence(self, value: float, where: str, n_bad: int, unit: str | None = None) -> str:
        """A sentence on a bad ``value`` (in ``unit``): where it is, the bounds, and the cure."""
        unit = unit or self.unit
        if not math.isfinite(value):
            return f"{self.name} is {value:g}{where}: fill or cut the gap{in_total(n_bad)}"
        shown = "" if unit == "1" else f" {unit}"
        scale, offset = self.units[unit]
        low, high = (round((bound - offset) / scale, 6) for bound in (self.lower, self.upper))
        text = f"{self.name} = {value:g}{shown}{where}: must be {'whole, ' if self.whole else ''}"
        text += f"from {low:g} to {high:g}{shown}"
        missing = value in _MISSING_MARKS
        cure = "it marks a missing value, fill or cut the gap" if missing else "check its unit"
        return f"{text}; {cure}{in_total(n_bad)}"


def in_total(n_bad: int) -> str:
    """The end of a message that names the first of several bad samples."""
    return f" ({n_bad} samples in total)" if n_bad > 1 else ""


COLUMNS: dict[str, Series] = {
    s.name: s
    for s in (
        Series("m_a", "air flow", AIR_FLOW, 0.0, 200.0, scatters=True),
        Series("T_a_in", "entering air temperature", TEMPERATURE, -40.0, 60.0),
        Series("W_a_in", "humidity ratio of the entering air", HUMIDITY_RATIO, 0.0, 0.1),
        Series("T_w_in", "entering water temperature", TEMPERATURE, 0.5, 120.0),
        Series("T_set", "set-point of the supply air temperature", TEMPERATURE, -20.0, 80.0, hold=True),
        Series("noise", "recorded noise of the measured temperature", DIFFERENCE, -50.0, 50.0, default=0.0),
        Series(
            "enabled",
            "whether the loop is in operation",
            NUMBER,
            0.0,
            1.0,
            hold=True,
            whole=True,
            default=1.0,
            needs_no_unit=True,
        ),  # fmt: skip
        Series(
            "backlash_scale",
            "what the backlash is multiplied by",
            NUMBER,
            0.0,
            100.0,
            hold=True,
            default=1.0,
            needs_no_unit=True,
        ),
        Series("elapsed_time", "time", TIME, -1e10, 1e10),  # three centuries
        Series("RH_a_in", "relative humidity of the entering air", FRACTION, 0.0, 1.0, scatters=True),
        Series("T_dp_in", "dew point of the entering air", TEMPERATURE, -60.0, 50.0),
        Series("command", "command to the valve", TRAVEL, 0.0, 1.0, hold=True, scatters=True),
        Series("m_w", "water flow", WATER_FLOW, 0.0, 1000.0, scatters=True),
        Series("T_sup", "supply air temperature", TEMPERATURE, -40.0, 100.0),
        Series("T_w_out", "leaving water temperature", TEMPERATURE, 0.1, 150.0),
        Series("batch", "number of the experiment", NUMBER, 0.0, 1e9, hold=True, whole=True, needs_no_unit=True),
    )
}
"""Every column that a log may have, except ``timestamp``."""

TIMES = ("elapsed_time", "timestamp")
"""A log gives its time in one of these columns."""
HUMIDITIES = ("W_a_in", "RH_a_in", "T_dp_in")
"""A log gives the humidity of the entering air in one of these columns."""
