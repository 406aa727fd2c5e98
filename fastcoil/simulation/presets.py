"""Named loops to start from: what each stands for and how it differs from the defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from fastcoil.parameter_table import PARAMETERS, Scalar

NOT_THE_FIT = "None of them is the fit of the paper, which was not published."


@dataclass(frozen=True, slots=True)
class Preset:
    """A named loop.  ``values`` are the parameters in which it differs from the defaults."""

    name: str
    text: str
    values: Mapping[str, Scalar]

    def __str__(self) -> str:
        """What it stands for and, on a second line, what differs."""
        changed = [PARAMETERS[name].equation(value) for name, value in self.values.items()]
        return f"{self.text}\n{', '.join(changed) or 'the defaults'}"


class Presets(dict[str, Preset]):
    """Presets by name; printed as a table."""

    def __repr__(self) -> str:
        width = max(map(len, self), default=0) + 2
        rows = [f"{name:<{width}}" + str(preset).replace("\n", "\n" + " " * width) for name, preset in self.items()]
        return "\n".join([*rows, NOT_THE_FIT])


_REAL_LOOP = {"C_c": 10.0, "sensor_time_constant": 30.0, "stroke_time": 90.0}
PRESETS = Presets(
    (preset.name, preset)
    for preset in (
        Preset("paper_like", "a generic coil and tuning that show what the paper describes", {}),
        Preset(
            "paper_like_fast",
            "the same with less metal and a faster controller",
            {"C_c": 10.0, "kp": 0.05, "ti": 5.0, "sample_time": 10.0},
        ),
        Preset(
            "lbnl",
            "the recorded tuning of LBNL building 33 AHU-2, with sensor lag and a slow motor",
            {**_REAL_LOOP, "kp": 0.018, "ti": 30.0, "sample_time": 15.0},
        ),
        Preset(
            "g36",
            "the default tuning of ASHRAE Guideline 36 in the Modelica Buildings library, with the same lags",
            {**_REAL_LOOP, "kp": 0.05, "ti": 600.0, "sample_time": 5.0},
        ),
    )
)


def presets() -> Presets:
    """Every preset by name: what it stands for, and the ``values`` in which it differs from the defaults."""
    return Presets(PRESETS)
