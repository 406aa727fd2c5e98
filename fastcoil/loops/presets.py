"""Named loops of ``presets.toml``: a description of each, and its differences from the defaults."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fastcoil.model.parameter_table import PARAMETERS, STAND_INS, Parameter, Scalar

NOT_THE_PAPER_FIT = "None of them is the fit of the paper, which was not published."


@dataclass(frozen=True, slots=True)
class Preset:
    """A named loop: the ``values`` that differ from the defaults, ``day``, as in ``[boundary]``, of a day for it."""

    name: str
    text: str
    values: Mapping[str, Scalar]
    day: Mapping[str, Any] = field(default_factory=lambda: {"kind": "paper_day"})

    @property
    def heats(self) -> bool:
        """Whether it is a heating coil."""
        return self.values.get("action") == "heating"

    @property
    def has_room(self) -> bool:
        """Whether a room is behind the coil."""
        return "room_capacity" in self.values

    @property
    def day_text(self) -> str:
        """Return its day as a call, such as ``heating_day(T_w_in=60)``."""
        values = ", ".join(f"{name}={value:g}" for name, value in self.day.items() if name != "kind")
        return f"{self.day['kind']}({values})"

    def value(self, parameter: Parameter) -> Scalar | None:
        """Return its value of a parameter; None if others replace it."""
        if "rangeability" in self.values and parameter.name in STAND_INS["rangeability"]:
            return None
        return self.values.get(parameter.name, parameter.default)

    def changed_names(self, values: Mapping[str, Any], table: Mapping[str, Parameter] = PARAMETERS) -> list[str]:
        """Return the names of values that differ from the preset; ``table`` may include parameters of rules."""
        return [name for name, value in values.items() if name not in table or value != self.value(table[name])]

    def __str__(self) -> str:
        """Return the description and, on a second line, the differences from the defaults."""
        changed = [PARAMETERS[name].equation(value) for name, value in self.values.items()]
        return f"{self.text}\n{', '.join(changed) or 'the defaults'}"


class Presets(dict[str, Preset]):
    """Presets by name; printed as a table."""

    def __repr__(self) -> str:
        width = max(map(len, self), default=0) + 2
        rows = [f"{name:<{width}}" + str(preset).replace("\n", "\n" + " " * width) for name, preset in self.items()]
        return "\n".join([*rows, NOT_THE_PAPER_FIT])


_TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
PRESETS = Presets((name, Preset(name, **entry)) for name, entry in _TABLE.items())
COOLING_PRESETS = {name: preset for name, preset in PRESETS.items() if not preset.heats}  # of a cooling coil


def presets() -> Presets:
    """Return every preset by name: its text, and the ``values`` that differ from the defaults.

    Examples
    --------
    >>> import fastcoil as fc
    >>> fc.presets()["lbnl"].values["kp"]
    0.018
    """
    return Presets(PRESETS)
