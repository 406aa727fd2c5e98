"""Texts for axes and legends: a short name, the usual unit, the factor to it."""

import json
from collections.abc import Hashable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.text import format_count
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.parameter_table import PARAMETERS, RESERVED_DIMS

_UNIT_TEXTS = {
    "1": "", "K-1": "1/K", "s-1": "1/s", "kg s-1": "kg/s", "kJ K-1": "kJ/K", "kW h": "kWh", "degC": "°C", "m3": "m³",
    "kJ kg-1 K-1": "kJ/(kg K)",
}  # fmt: skip
_IN_PERCENT = (
    "backlash", "backlash_estimate", "estimate_ratio", "buffer", "command_resolution", "learning_step",
    "learning_cap", "learning_max_reference", "estimate_final", "estimate_largest", "estimate_settled", "size_error",
    "estimate_first_down", "share_off", "hunts", "swing_regularity",
    "u", "integral", "command", "position", "opening", "estimate",
)  # fmt: skip
"""Fractions that are shown in per cent."""
_DISPLAY_UNITS = {
    **dict.fromkeys(_IN_PERCENT, ("%", 100.0)),
    **dict.fromkeys(("learn_time_reached", "learn_time_confirmed", "learn_time_first_down"), ("h", 1 / 3600)),
    "learning_interval": ("min", 1 / 60),
}
"""Unit and factor of quantities that are shown in another unit than that of their table."""
_BUFFER: Any = PARAMETERS["buffer"]


class Quantity(NamedTuple):
    """A quantity as it is shown: ``value × factor`` in ``unit``.  meaning: of the parameter of a user's rule."""

    text: str
    unit: str
    factor: float
    meaning: str = ""

    @property
    def axis(self) -> str:
        """Label of an axis."""
        text_with_unit = f"{self.text} [{self.unit}]" if self.unit else self.text
        return f"{text_with_unit}: {self.meaning}" if self.meaning else text_with_unit

    def equals(self, value: float) -> str:
        """Format ``backlash = 7 %``, for legends and headings; ``no buffer`` where it only ignores round-off."""
        is_round_off = self.text == _BUFFER.label and value <= _BUFFER.default
        return f"no {self.text}" if is_round_off else f"{self.text} = {self.number(value)}"

    def number(self, value: float) -> str:
        """Format ``7 %``."""
        return f"{value * self.factor:.3g} {self.unit}".rstrip()


def quantity(name: str) -> Quantity:
    """Return how a parameter, metric or trace is shown; any other name is its own label."""
    entry = METRICS.get(name) or TRACES.get(name) or PARAMETERS.get(name)
    if entry is None:
        return Quantity(name.replace("_", " "), "", 1.0)
    return Quantity(entry.label, *_DISPLAY_UNITS.get(name, (unit_in_words(entry.unit), 1.0)))


def unit_in_words(unit: str) -> str:
    """Return a unit of the tables in its usual spelling; empty for a number."""
    return _UNIT_TEXTS.get(unit, unit)


def is_parameter(ds: xr.Dataset | xr.DataArray, dim: Hashable) -> bool:
    """Whether a coordinate of a result is a parameter, of the table or of a rule."""
    return dim in PARAMETERS or (dim in ds.coords and "comment" in ds[dim].attrs)


def plain_pi_label(ds: xr.Dataset | xr.DataArray) -> str:
    """Name the loop of a result without estimate: ``plain PI``, or ``PI with a buffer``, which suppresses reversals."""
    stored = json.loads(ds.attrs.get("parameters", "{}"))
    values = {
        name: np.asarray(ds.coords[name].values if name in ds.coords else stored.get(name, 0.0))
        for name in ("buffer", "buffer_ratio", "buffer_noise", "noise_std")
    }
    noise = (values["noise_std"] > 0.0).any() or (values["buffer_noise"] == "measured").any()
    follows_noise = (values["buffer_ratio"] > 0.0).any() and noise
    return "PI with a buffer" if follows_noise or (values["buffer"] > _BUFFER.default).all() else "plain PI"


def coordinate_quantity(ds: xr.Dataset | xr.DataArray, dim: str) -> Quantity:
    """Return how a coordinate of a result is shown; that of a rule with the unit and text that it declares."""
    if dim in PARAMETERS or not is_parameter(ds, dim):
        return quantity(dim)
    attrs = ds[dim].attrs
    unit = unit_in_words(str(attrs.get("units", "")))
    return Quantity(str(attrs.get("long_name", dim)), unit, 1.0, str(attrs["comment"]))


def sizes_in_words(sizes: Mapping[Any, int]) -> str:
    """Format the sizes of a result: ``2 days × 15 values of backlash``."""
    words = {d: format_count(n, str(d) if d in RESERVED_DIMS else "value") for d, n in sizes.items()}
    return " × ".join(text if d in RESERVED_DIMS else f"{text} of {d}" for d, text in words.items())


def label_in_words(ds: xr.Dataset | xr.DataArray, dim: str, k: int) -> str:
    """Format a label along a dimension: a text unchanged, a parameter as ``backlash = 7 %``, others as ``day 3``."""
    if dim not in ds.coords:
        return f"{dim} {k}"
    value = ds[dim].values[k]
    if isinstance(value, str):
        return str(value)
    return coordinate_quantity(ds, dim).equals(float(value)) if is_parameter(ds, dim) else f"{dim} {value}"


def values_quantity(values: xr.DataArray) -> Quantity:
    """Return how values are shown: by the tables, or by their attributes; shares of a baseline in per cent."""
    name, attrs = str(values.name or ""), values.attrs
    entry = METRICS.get(name) or TRACES.get(name)
    if entry is not None and "relative_to" in attrs:
        return Quantity(f"change of {entry.label}", "%", 100.0)
    if entry is not None and attrs.get("units", entry.unit) == entry.unit:
        return quantity(name)
    text = str(attrs.get("long_name", name.replace("_", " "))) or "value"
    return Quantity(text, unit_in_words(str(attrs.get("units", ""))), 1.0)
