"""Table of all parameters, ``parameters.toml``: name, unit, bounds, default, meaning, and what theory makes of each."""

import math
import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr

Scalar = float | int | str
LARGEST_FLOAT = sys.float_info.max


class Theory(NamedTuple):
    """What the theory of a PI loop with a gap (``linearise``, ``limit_cycle``, ``explain``) makes of a parameter."""

    nearest: Scalar | None = None  # in the nearest loop that theory covers; None: as it is, or not affected by it
    clause: str = ""  # why it says nothing at other values and, behind a colon, what to do; empty: it covers them
    only_with: str = ""  # a parameter that must be above 0 for the clause to hold


COVERED = Theory()  # of a parameter at any value


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number (or word) of a control loop.

    ``text`` says what it is, in help and docs; ``label`` is a few words for the axis of a figure.  ``default`` is
    ``None`` for parameters that replace others when given (``rangeability``, …).  Bounds are inclusive unless
    ``open_lower``/``open_upper``.  ``theory`` has no default: each new parameter needs one.
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
    label: str = ""
    theory: Theory = field(kw_only=True)

    @property
    def is_word(self) -> bool:
        return bool(self.choices)

    @property
    def bounds(self) -> str:
        """Admissible values in words, for tables and messages."""
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

    def equation(self, value: object) -> str:
        """Format the parameter with a value as ``name = value unit``."""
        return f"{self.name} = {value}" + ("" if self.unit in ("", "1") else f" {self.unit}")

    def problem(self, value: object) -> Problem | None:
        """Return the mistake in a value that is not admissible, else ``None``."""
        if self.is_word:
            if isinstance(value, str) and value in self.choices:
                return None
            code = "choice" if isinstance(value, str) else "type"
            return Problem(f"{self.name} = {short_repr(value)}: choose {self.bounds}", self.name, code)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return Problem(f"{self.name} = {short_repr(value)}: give a number ({self.bounds})", self.name, "type")
        if not -LARGEST_FLOAT <= value <= LARGEST_FLOAT:
            text = f"{value}" if isinstance(value, float) else "a number of too many digits"
            return Problem(f"{self.name} = {text}: give a finite number ({self.bounds})", self.name, "value")
        too_low = value <= self.lower if self.open_lower else value < self.lower
        too_high = value >= self.upper if self.open_upper else value > self.upper
        if too_low or too_high or (self.whole and value != math.floor(value)):
            unit = "" if self.unit == "1" else f" {self.unit}"
            is_percent = self.unit == "1" and self.upper <= 1.0 < value <= 100.0
            hint = f"; {value:g} % is {value / 100.0:g}" * is_percent
            return Problem(f"{self.name} = {value:g}{unit}: must be {self.bounds}{hint}", self.name, "value")
        return None


def read_parameter(
    name: str, group: str, *, theory: Any, default: Scalar | None = None, choices: Sequence[str] = (), **fields: Any
) -> Parameter:
    """Return the parameter that a table of ``parameters.toml`` describes; ``theory`` is "covered" or a table."""
    what_theory_says = COVERED if theory == "covered" else Theory(**theory)
    return Parameter(name, group, default=default, choices=tuple(choices), theory=what_theory_says, **fields)


_GROUPS = tomllib.loads(Path(__file__).with_name("parameters.toml").read_text(encoding="utf-8"))
PARAMETERS: dict[str, Parameter] = {
    name: read_parameter(name, group, **fields) for group, tables in _GROUPS.items() for name, fields in tables.items()
}
"""Every parameter by name, in the order of the loop: coil, valve, actuator, sensor, controller, learner."""

ESTIMATOR_GROUPS = tuple(name for name in PARAMETERS["estimator"].choices if name != "none")
"""Groups of parameters that are read only by the estimator with the name of the group."""

INTEGER_PARAMETERS = ("n_volumes", "substeps")  # integers; all other numbers are floats
INSTALLED_VALVE_PARAMETERS = ("rangeability", "authority", "m_full")
_CURVE_PARAMETERS = ("m_max", "valve_a", "valve_b", "valve_c")
STAND_INS = {"estimate_ratio": ("backlash_estimate",), **dict.fromkeys(INSTALLED_VALVE_PARAMETERS, _CURVE_PARAMETERS)}
"""Parameters without a default, and the ones they replace."""

RESERVED_DIMS = ("sample", "replicate", "day", "controller", "tuning", "volume", "elapsed_time")
CHANCE_DIMS = ("sample", "design", "day", "replicate")
"""Dims of chance: which valve, day or noise; tables and figures pool over them."""


def require_parameter_name(name: str, table: Mapping[str, Parameter] = PARAMETERS) -> str:
    """Return ``name`` if ``table`` has it, else raise ``InputError`` with the most similar name."""
    if not isinstance(name, str):
        text = f"{short_repr(name)} is not the name of a parameter (see `fastcoil parameters`)"
        raise InputError(text, "name", "type")
    if name not in table:
        text = name if name.isidentifier() and len(name) < 60 else short_repr(name)
        sentence = f"{text} is not a parameter{did_you_mean(name, table)} (see `fastcoil parameters`)"
        raise InputError(sentence, name, "name")
    return name


class ParameterListing(dict[str, Parameter]):
    """Parameters by name; printed as a list, by the parts of the loop."""

    def __repr__(self) -> str:
        return "\n".join(parameter_lines(self.values()))


def parameter_lines(parameters: Iterable[Parameter]) -> list[str]:
    """Format parameters as lines: by part of the loop, each with default, unit, meaning and allowed values."""
    lines = []
    for group, group_parameters in groupby(parameters, attrgetter("group")):
        lines.append(group)
        for p in group_parameters:
            default = "-" if p.default is None else f"{p.default}"
            unit = "" if p.unit == "1" else p.unit
            lines.append(f"  {p.name:<22}{default:>10} {unit:<12} {p.text} ({p.bounds})")
    return lines
