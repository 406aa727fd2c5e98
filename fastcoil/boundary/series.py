"""Every boundary series once: name, meaning, units, bounds, hold or linear between samples.

Validation, the attributes of a Dataset and the reading of trend logs and weather derive from this table.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fastcoil.errors import InputError, nearest

if TYPE_CHECKING:
    import xarray as xr

Array: TypeAlias = NDArray[np.float64]
Units: TypeAlias = Mapping[str, tuple[float, float]]
Values: TypeAlias = Any
"""What a user may give for a series: a number, array-like or DataArray; examined at run time."""

STANDARD_AIR = 1.2
"""Density that turns a volume flow of air into a mass flow, kg/m3 (ASHRAE standard air)."""

WATER = 1000.0
"""Density that turns a volume flow of water into a mass flow, kg/m3."""

_POUND, _FOOT, _GALLON = 0.45359237, 0.3048, 3.785411784e-3

# Each unit's (scale, offset) into the first of its family, which is the unit used inside fastcoil.
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
TRAVEL: Units = {**FRACTION, "deg": (1 / 90, 0.0), "V": (0.1, 0.0)}
"""Travel of a valve; degrees of a quarter turn, volts of 0–10."""
PRESSURE: Units = {"Pa": (1.0, 0.0), "hPa": (100.0, 0.0), "kPa": (1000.0, 0.0)}
TIME: Units = {"s": (1.0, 0.0), "min": (60.0, 0.0), "h": (3600.0, 0.0)}
NUMBER: Units = {"1": (1.0, 0.0)}

_MISSING_MARKS = (-99.0, -999.0, -9999.0)


@dataclass(frozen=True, slots=True)
class Series:
    """One series: bounds are inclusive, in the first of ``units``; no ``default`` if it must be given."""

    name: str
    long_name: str
    units: Units
    lower: float = -math.inf
    upper: float = math.inf
    hold: bool = False
    whole: bool = False
    default: float | None = None

    @property
    def unit(self) -> str:
        return next(iter(self.units))

    @property
    def known_units(self) -> str:
        return f"known units: {', '.join(self.units)}"

    def spelled(self, unit: str) -> str:
        """``unit`` as ``units`` spells it; ``°C``, ``l/s`` and ``GPM`` are understood."""
        by_folded = {_folded(known): known for known in self.units}
        if _folded(unit) not in by_folded:
            raise InputError(f"{self.name} is in {unit!r}{nearest(unit, self.units)} ({self.known_units})")
        return by_folded[_folded(unit)]

    def convert(self, values: Array, unit: str) -> Array:
        """``values`` from a declared ``unit`` into ours."""
        scale, offset = self.units[self.spelled(unit)]
        return values * scale + offset

    def is_bad(self, values: Array) -> NDArray[np.bool_]:
        """Where ``values`` (in our unit) are not finite, out of bounds, or not whole where they must be."""
        with np.errstate(invalid="ignore"):
            good = np.isfinite(values) & (values >= self.lower) & (values <= self.upper)
            return ~(good & (values == np.rint(values))) if self.whole else ~good

    def sentence(self, value: float, where: str, n_bad: int, unit: str | None = None) -> str:
        """What is wrong with ``value`` (in ``unit``), ``where``, and the cure."""
        unit = unit or self.unit
        more = f" ({n_bad} samples are so)" if n_bad > 1 else ""
        if not math.isfinite(value):
            return f"{self.name} is {value:g}{where}: fill or cut the gap{more}"
        shown = "" if unit == "1" else f" {unit}"
        scale, offset = self.units[unit]
        low, high = (round((bound - offset) / scale, 6) for bound in (self.lower, self.upper))
        text = f"{self.name} = {value:g}{shown}{where}: must be {'whole, ' if self.whole else ''}"
        text += f"from {low:g} to {high:g}{shown}"
        missing = value in _MISSING_MARKS
        cure = "it marks a missing value, fill or cut the gap" if missing else "check its unit"
        return f"{text}; {cure}{more}"


def _folded(unit: str) -> str:
    return unit.replace("°", "deg").casefold()


SERIES: dict[str, Series] = {
    s.name: s
    for s in (
        Series("m_a", "air flow", AIR_FLOW, 0.0, 200.0),
        Series("T_a_in", "entering air temperature", TEMPERATURE, -40.0, 60.0),
        Series("W_a_in", "humidity ratio of the entering air", HUMIDITY_RATIO, 0.0, 0.1),
        Series("T_w_in", "entering water temperature", TEMPERATURE, 0.5, 120.0),
        Series("T_set", "set-point of the supply air temperature", TEMPERATURE, -20.0, 80.0, hold=True),
        Series("noise", "recorded noise of the measured temperature", DIFFERENCE, -50.0, 50.0, default=0.0),
        Series("enabled", "whether the loop is in operation", NUMBER, 0.0, 1.0, hold=True, whole=True, default=1.0),
    )
}
"""Every series of a `Boundary` by name."""


class Given(NamedTuple):
    """One series as read: dims (of ``day``, ``elapsed_time``), values, and day labels if it has them."""

    dims: tuple[str, ...]
    values: Array
    day: NDArray[Any] | None = None

    def spread(self, n_days: int, n_steps: int) -> Array:
        shape = (n_days if "day" in self.dims else 1, n_steps if "elapsed_time" in self.dims else 1)
        # Adding 0.0 makes -0.0 a 0.0: equal series have equal bytes, hence equal digests.
        return np.broadcast_to(self.values.reshape(shape), (n_days, n_steps)) + 0.0


def read(series: Series, value: Values) -> Given:
    """``value`` as numbers in our unit, with its dims; values are not yet checked against the bounds."""
    if value is None:
        if series.default is None:
            raise InputError(f"{series.name} is missing: give the {series.long_name} ({series.known_units})")
        value = series.default
    if hasattr(value, "dims"):
        return _read_labelled(series, value)
    values = _numbers(series, value)
    if values.ndim > 2:
        raise InputError(f"{series.name} has {values.ndim} dimensions: give (seconds) or (days, seconds)")
    return Given(("day", "elapsed_time")[2 - values.ndim :], values)


def _read_labelled(series: Series, value: xr.DataArray) -> Given:
    dims = tuple(dim for dim in ("day", "elapsed_time") if dim in value.dims)
    if len(dims) != value.ndim:
        raise InputError(f"{series.name} has dims {value.dims}: name them elapsed_time and, for several days, day")
    if "elapsed_time" in dims and "elapsed_time" in value.coords:
        seconds = value.coords["elapsed_time"].values
        steps = np.diff(seconds) / (np.timedelta64(1, "s") if seconds.dtype.kind == "m" else 1.0)
        wrong = np.flatnonzero(~(np.abs(steps - 1.0) < 1e-6))
        if wrong.size:
            raise InputError(
                f"elapsed_time has a step of {steps[wrong[0]]:g} s after sample {wrong[0]}: "
                "give 1-s steps (interpolate first)"
            )
    values = _numbers(series, value.transpose(*dims).values)
    values = series.convert(values, value.attrs.get("units", series.unit))
    return Given(dims, values, value.coords["day"].values if "day" in value.coords else None)


def _numbers(series: Series, value: Values) -> Array:
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(np.float64), np.nan)
    try:
        values = np.asarray(value)
    except ValueError:
        raise InputError(f"{series.name} has rows of different length: give one length") from None
    if values.dtype.kind not in ("iufb" if series.whole else "iuf"):
        raise InputError(f"{series.name} = {value!r:.40} is of type {values.dtype.name}: give numbers")
    if values.size == 0:
        raise InputError(f"{series.name} is empty: give at least one 1-s sample")
    return values.astype(np.float64)
