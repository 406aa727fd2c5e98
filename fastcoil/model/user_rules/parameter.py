"""The parameters of a rule: which of the loop it may read, and what it declares of its own."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from keyword import iskeyword
from typing import Any

from fastcoil.base.arguments import number_of, plain, text_of
from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.model.metric_table import METRICS, PREDICTIONS, TRACES
from fastcoil.model.parameter_table import ESTIMATOR_GROUPS, PARAMETERS, RESERVED_DIMS, Parameter

_TRUTH = ("coil", "valve", "actuator")
"""Groups of what a controller in the field cannot know."""
_TAKEN = {
    *METRICS, *PREDICTIONS, *TRACES, *RESERVED_DIMS, "status", "design", "scenario", "preset", "include", "size",
    "seed", "method", "tolerance", "drop", "indexers", "missing_dims",
}  # fmt: skip


class OwnParameter(float):
    """The default of a rule's own parameter, with what is known of it; a number like any other."""

    unit: str
    lower: float
    upper: float
    text: str


def parameter(
    default: float, *, unit: str = "1", lower: float = -math.inf, upper: float = math.inf, text: str = ""
) -> float:
    """Declare a parameter of a rule of your own, as the default of a field of its ``Parameters``.

    Parameters
    ----------
    default
        Its value where a loop does not give it.
    unit
        Such as ``"K-1 s-1"``; ``"1"`` for a fraction or a count.
    lower, upper
        Its bounds, inclusive.
    text
        What it is, for help and the attributes of results.

    Examples
    --------
    >>> import fastcoil as fc
    >>> from typing import NamedTuple
    >>> class Parameters(NamedTuple):
    ...     sample_time: float  # of the loop
    ...     gain: float = fc.parameter(3e-4, unit="K-1 s-1", lower=0.0, text="how fast the estimate moves")

    Raises
    ------
    InputError
        If the default is no finite number within the bounds, or a text is none.
    """
    lower, upper = _bound("lower", lower, -math.inf), _bound("upper", upper, math.inf)
    if math.isinf(lower) and math.isinf(upper):
        within = ""
    elif math.isinf(upper):
        within = f" of at least {lower:g}"
    else:
        within = f" of at most {upper:g}" if math.isinf(lower) else f" from {lower:g} to {upper:g}"
    number = number_of("default", default, f"give a number{within}", least=lower, most=min(upper, sys.float_info.max))
    declared = OwnParameter(number)
    declared.unit, declared.text = text_of("unit", unit), text_of("text", text)
    declared.lower, declared.upper = lower, upper
    return declared


def _bound(name: str, value: object, none: float) -> float:
    """A bound; ``none`` stands for the lack of one."""
    value = plain(value)
    return none if isinstance(value, float) and value == none else number_of(name, value, "give a number")


def text_without_one(rule: str) -> str:
    """The text of a parameter that is given none."""
    return f"parameter of {rule}"


def own_parameters(rule: str, fields: Mapping[str, object]) -> dict[str, Parameter]:
    """What a rule declares of its own; the other fields are parameters of the loop that it may read.

    fields: name → default, ``None`` for a field without one.

    Raises
    ------
    InputError
        For a name that is taken, is no parameter, or stands for what a rule must not know.
    """
    own, problems = {}, []
    for name, default in fields.items():
        if name in PARAMETERS:
            problems += _unreadable(rule, PARAMETERS[name], default)
        elif default is None:
            problems.append(
                f"{rule}: {name} is no parameter of the loop{nearest(name, PARAMETERS)}: give it a default to make it "
                f"one of the rule's own, {name}: float = fc.parameter(0.0, text=…)"
            )
        elif name in _TAKEN or iskeyword(name) or not name.isidentifier() or name.startswith("_"):
            problems.append(f"{rule}: the name {name} is taken: call the parameter something else")
        else:
            declared: Any = default if isinstance(default, OwnParameter) else parameter(default)  # type: ignore[arg-type]
            own[name] = Parameter(
                name, rule, declared.unit, float(declared), declared.text or text_without_one(rule), declared.lower,
                declared.upper, label=name.replace("_", " "),
            )  # fmt: skip
    if problems:
        raise InputError(problems)
    return own


def _unreadable(rule: str, of_loop: Parameter, default: object) -> list[str]:
    name = of_loop.name
    if of_loop.group in _TRUTH or name == "estimate_ratio":
        return [f"{rule} reads {name}, which is the plant itself: a rule must not know it, leave it out"]
    if of_loop.group in ESTIMATOR_GROUPS or of_loop.is_word:
        return [
            f"{rule} reads {name}, which is not for rules: leave it out, or give a parameter of your own a new name"
        ]
    if default is not None:
        return [f"{rule}: {name} = {shown(default)}: {name} is a parameter of the loop, which has its value; write "
                f"{name}: float"]  # fmt: skip
    return []
