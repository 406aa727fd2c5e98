"""Every parameter once: name, unit, bounds, default, meaning.

Kernel rows, ``Loop``, study files, the command line and the attributes of a result derive from this
table, so a name never changes on its way from a TOML key to a NetCDF coordinate.  Defaults are the
preset ``paper_like``.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

from fastcoil.errors import InputError, nearest

Scalar = float | int | str
LARGEST = sys.float_info.max


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number (or word) of a control loop.

    ``default`` is ``None`` for parameters that replace others when given (``rangeability``, …).
    Bounds are inclusive unless ``open_lower``/``open_upper``.
    """

    name: str
    group: str
    unit: str
    default: Scalar | None
    text: str
    lower: float = -math.inf
    upper: float = math.inf
    open_lower: bool = False
    open_upper: bool = False
    whole: bool = False
    choices: tuple[str, ...] = ()

    @property
    def is_word(self) -> bool:
        return bool(self.choices)

    @property
    def bounds(self) -> str:
        """The admissible values in words, for tables and messages."""
        if self.is_word:
            return " or ".join(repr(c) for c in self.choices)
        low, high = f"{self.lower:g}", f"{self.upper:g}"
        if math.isinf(self.lower) and math.isinf(self.upper):
            text = "any finite number"
        elif math.isinf(self.upper):
            text = f"{'above' if self.open_lower else 'at least'} {low}"
        else:
            text = f"{'above' if self.open_lower else 'from'} {low} "
            text += f"and below {high}" if self.open_upper else f"to {high}"
        return f"whole, {text}" if self.whole else text

    def problem(self, value: object) -> str | None:
        """One sentence naming field, value and cure if ``value`` is not admissible, else ``None``."""
        if self.is_word:
            if isinstance(value, str) and value in self.choices:
                return None
            return f"{self.name} = {value!r}: choose {self.bounds}"
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return f"{self.name} = {value!r}: give a number ({self.bounds})"
        if not -LARGEST <= value <= LARGEST:
            shown = f"{value}" if isinstance(value, float) else "a number of too many digits"
            return f"{self.name} = {shown}: give a finite number ({self.bounds})"
        too_low = value <= self.lower if self.open_lower else value < self.lower
        too_high = value >= self.upper if self.open_upper else value > self.upper
        if too_low or too_high or (self.whole and value != math.floor(value)):
            unit = "" if self.unit == "1" else f" {self.unit}"
            return f"{self.name} = {value:g}{unit}: must be {self.bounds}"
        return None


def _positive(name: str, group: str, unit: str, default: float | None, text: str) -> Parameter:
    return Parameter(name, group, unit, default, text, lower=0.0, open_lower=True)


_TABLE = (
    _positive("C_w", "coil", "kJ K-1", 8.8, "heat capacity of the water in one control volume (of 8), Eq (3)"),
    _positive("C_c", "coil", "kJ K-1", 30.0, "heat capacity of the metal of one control volume (of 8), Eq (3)"),
    _positive("beta1", "coil", "1", 0.32, "water-side effectiveness: factor, Eq (4)"),
    Parameter("beta2", "coil", "1", -0.20, "water-side effectiveness: exponent of m_w, Eq (4)", -5.0, 5.0),
    _positive("beta3", "coil", "1", 0.40, "air-side effectiveness (heat): factor, Eq (4)"),
    Parameter("beta4", "coil", "1", -0.45, "air-side effectiveness (heat): exponent of m_a, Eq (4)", -5.0, 5.0),
    _positive("beta5", "coil", "1", 0.42, "air-side effectiveness (heat and mass): factor, Eq (4)"),
    Parameter(
        "beta6", "coil", "1", -0.42, "air-side effectiveness (heat and mass): exponent of m_a, Eq (4)", -5.0, 5.0
    ),
    _positive("cp_w", "coil", "kJ kg-1 K-1", 4.186, "specific heat of water"),
    _positive("cp_a", "coil", "kJ kg-1 K-1", 1.02, "specific heat of moist air"),
    Parameter("pressure", "coil", "Pa", 101325.0, "barometric pressure", 50e3, 110e3),
    Parameter("n_volumes", "coil", "1", 8, "number of control volumes N along the water", 1, 64, whole=True),
    Parameter(
        "air_march",
        "coil",
        "",
        "lagged",
        "time level of the upstream air: as printed in Eq (3), or this step's",
        choices=("lagged", "quasistatic"),
    ),
    Parameter("T_initial", "coil", "degC", 20.0, "all temperatures at the start", 0.0, 50.0),
    _positive("m_max", "valve", "kg s-1", 2.0, "asymptotic water flow, Eq (2)"),
    _positive("valve_a", "valve", "1", 0.7, "asymmetry a of the flow curve, Eq (2)"),
    _positive("valve_b", "valve", "1", 9.0, "growth rate b of the flow curve per unit opening, Eq (2)"),
    Parameter("valve_c", "valve", "1", 0.38, "opening c of steepest growth, Eq (2)", -5.0, 5.0),
    Parameter(
        "rangeability",
        "valve",
        "1",
        None,
        "inherent rangeability R of an equal-percentage valve (with authority and m_full, for Eq (2))",
        1.0,
        1000.0,
        open_lower=True,
    ),
    Parameter(
        "authority",
        "valve",
        "1",
        None,
        "valve authority N: share of the total pressure drop, fully open",
        0.0,
        1.0,
        open_lower=True,
        open_upper=True,
    ),
    _positive("m_full", "valve", "kg s-1", None, "water flow at full opening"),
    Parameter("backlash", "actuator", "1", 0.07, "true backlash x_BL, fraction of stroke, Eq (1)", 0.0, 0.9),
    Parameter("stroke_time", "actuator", "s", 0.0, "time of a full stroke of the motor; 0 = instantaneous", 0.0),
    Parameter("command_resolution", "actuator", "1", 0.0, "step of the actuator's input; 0 = continuous", 0.0, 0.5),
    Parameter("sensor_time_constant", "sensor", "s", 0.0, "first-order lag of the supply air sensor; 0 = none", 0.0),
    Parameter(
        "noise_std", "sensor", "K", 0.0, "standard deviation of the measurement noise at controller samples", 0.0
    ),
    Parameter("sensor_resolution", "sensor", "K", 0.0, "step of the measured temperature; 0 = continuous", 0.0),
    Parameter("kp", "controller", "K-1", 0.03, "proportional gain K_p, stroke per kelvin"),
    _positive("ti", "controller", "s", 8.0, "integral time T_i"),
    Parameter("sample_time", "controller", "s", 30.0, "controller sample time", 1, 3600, whole=True),
    Parameter("action", "controller", "", "cooling", "sign of the loop", choices=("cooling", "heating")),
    Parameter(
        "backlash_estimate",
        "inverse",
        "1",
        0.0,
        "backlash size the inverse starts from; 0 = plain PI",
        0.0,
        1.0,
        open_upper=True,
    ),
    Parameter(
        "estimate_ratio", "inverse", "1", None, "backlash_estimate / backlash, in place of backlash_estimate", 0.0
    ),
    Parameter(
        "buffer", "inverse", "1", 1e-9, "reversal of u that the inverse ignores; 0 = none", 0.0, 1.0, open_upper=True
    ),
    Parameter("learning_step", "learner", "1", 0.0, "step of the learned estimate; 0 = no learning", 0.0, 0.25),
    Parameter(
        "learning_interval", "learner", "s", 1800.0, "time between updates of the estimate", 600, 86400, whole=True
    ),
    _positive(
        "learning_ratio",
        "learner",
        "1",
        2.0,
        "switch frequency, relative to the first interval's, that trips the learner",
    ),
    Parameter("learning_floor", "learner", "1", 0.0, "least reference switch frequency, switches per 10 min", 0.0),
    Parameter(
        "learning_cap", "learner", "1", 0.25, "largest estimate the learner may reach", 0.0, 0.9, open_lower=True
    ),
    Parameter(
        "learning_min_switches",
        "learner",
        "1",
        0.0,
        "mode switches below which an interval is no evidence: no step",
        0.0,
    ),
    Parameter(
        "learning_max_reference",
        "learner",
        "1",
        1.0,
        "share of samples with a switch above which the first interval is no reference: no step",
        0.0,
        1.0,
        open_lower=True,
    ),
    Parameter(
        "learning_early_trip",
        "learner",
        "1",
        0.0,
        "1 = step down as soon as the switches exceed those of a whole interval, 0 = at its end",
        0.0,
        1.0,
        whole=True,
    ),
    Parameter(
        "learning_growth", "learner", "1", 1.0, "factor of each step up over the last, until one goes down", 1.0, 10.0
    ),
    Parameter("learning_shrink", "learner", "1", 1.0, "factor of all steps after one down", 0.0, 1.0, open_lower=True),
    Parameter(
        "learning_final", "learner", "1", 1.0, "factor of the estimate where learning stops", 0.0, 1.0, open_lower=True
    ),
    Parameter(
        "learning_stop",
        "learner",
        "",
        "never",
        "whether the first step down ends the learning",
        choices=("never", "first_step_down"),
    ),
)

PARAMETERS: dict[str, Parameter] = {p.name: p for p in _TABLE}
"""Every parameter by name, in the order of the loop: coil, valve, actuator, sensor, controller, learner."""

STAND_INS = {
    "estimate_ratio": ("backlash_estimate",),
    "rangeability": ("m_max", "valve_a", "valve_b", "valve_c"),
    "authority": ("m_max", "valve_a", "valve_b", "valve_c"),
    "m_full": ("m_max", "valve_a", "valve_b", "valve_c"),
}
"""Parameters without a default, and those they replace."""

INSTALLED_VALVE = ("rangeability", "authority", "m_full")

RESERVED_DIMS = ("sample", "replicate", "day", "controller", "tuning", "volume", "elapsed_time")


def check_name(name: str) -> str:
    """Return ``name`` if it is a parameter, else raise ``InputError`` with the nearest known one."""
    if name not in PARAMETERS:
        raise InputError(f"{name} is not a parameter{nearest(name, PARAMETERS)} (see `fastcoil parameters`)")
    return name
