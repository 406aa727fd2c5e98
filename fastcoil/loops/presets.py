"""Named loops to start from: what each describes and how it differs from the defaults."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fastcoil.model.parameter_table import PARAMETERS, Parameter, Scalar

NOT_THE_FIT = "None of them is the fit of the paper, which was not published."
_POLYNOMIAL = ("m_max", "valve_a", "valve_b", "valve_c")  # the curve of a valve that has no rangeability


@dataclass(frozen=True, slots=True)
class Preset:
    """A named loop.

    ``values`` are the parameters in which it differs from the defaults, ``T_w_in`` the entering water that its coil is
    meant for, degC.
    """

    name: str
    text: str
    values: Mapping[str, Scalar]
    T_w_in: float = 7.0

    @property
    def heats(self) -> bool:
        """Whether it is a heating coil."""
        return self.values.get("action") == "heating"

    def value(self, parameter: Parameter) -> Scalar | None:
        """Its value of a parameter; None where others take the place of it."""
        if "rangeability" in self.values and parameter.name in _POLYNOMIAL:
            return None
        return self.values.get(parameter.name, parameter.default)

    def changed(self, values: Mapping[str, Any], table: Mapping[str, Parameter] = PARAMETERS) -> list[str]:
        """Names of the values that differ from the preset; ``table`` may include the parameters of rules."""
        return [name for name, value in values.items() if name not in table or value != self.value(table[name])]

    def __str__(self) -> str:
        """Description and, on a second line, differences from the defaults."""
        changed = [PARAMETERS[name].equation(value) for name, value in self.values.items()]
        return f"{self.text}\n{', '.join(changed) or 'the defaults'}"


class Presets(dict[str, Preset]):
    """Presets by name; printed as a table."""

    def __repr__(self) -> str:
        width = max(map(len, self), default=0) + 2
        rows = [f"{name:<{width}}" + str(preset).replace("\n", "\n" + " " * width) for name, preset in self.items()]
        return "\n".join([*rows, NOT_THE_FIT])


_LAGS = {"sensor_time_constant": 30.0, "stroke_time": 90.0}
_REAL_LOOP = {"C_c": 10.0, **_LAGS}
_HEATING_LOOP: Mapping[str, Scalar] = {
    # equal percentage, half of the pressure drop, and tight to class III of IEC 60534-4
    **{"rangeability": 50.0, "authority": 0.5, "m_full": 0.5, "leakage": 0.001},
    **_LAGS,
    **{"kp": 0.025, "ti": 80.0, "sample_time": 10.0, "action": "heating"},
}
"""Valve and tuning of a heating coil, with the gains that ``studies/heating/heating.py`` chooses for both coils."""
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
        # a quarter and a half of the cooling coil of the others, which has C_w 8.8, C_c 10, beta3 0.40, beta5 0.42: of
        # its water, metal and surface, and of its tubes, in which the water is as fast (or, in the half, half as fast):
        # beta1 is 0.32 times 0.25^0.2, and 0.32 times 0.5^0.2.
        Preset(
            "heating",
            "a heating coil of two rows for water of 60 °C, with the same lags and a tuning that does not ring",
            {"C_w": 2.2, "C_c": 2.5, "beta1": 0.24, "beta3": 0.10, "beta5": 0.105, **_HEATING_LOOP},
            60.0,
        ),
        Preset(
            "heating_45",
            "one of four rows for water of 45 °C, as heat pumps and condensing boilers supply it, with the same tuning",
            {"C_w": 4.4, "C_c": 5.0, "beta1": 0.28, "beta3": 0.20, "beta5": 0.21, **_HEATING_LOOP},
            45.0,
        ),
    )
)
COOLING = {name: preset for name, preset in PRESETS.items() if not preset.heats}
"""The presets of a cooling coil."""


def presets() -> Presets:
    """Every preset by name: what it stands for, and the ``values`` in which it differs from the defaults."""
    return Presets(PRESETS)
