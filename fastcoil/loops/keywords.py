"""The parameters of a loop as keywords, for editors and type checkers: they read no table.

What runs takes its names from ``fastcoil.model.parameter_table``; a test compares the two.

What completion and help show of a function that takes any parameter of a loop by name.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeAlias, TypedDict, TypeVar

import numpy as np
import xarray as xr

from fastcoil.loops.assignment import MEANING, WORD
from fastcoil.model.parameter_table import COUNTS, PARAMETERS
from fastcoil.model.user_rules import Rule

Numbers: TypeAlias = float | Sequence[float] | tuple[str, Any] | np.ndarray[Any, Any] | xr.DataArray
"""A number; a list, which is a dimension of its own; ``(dim, values)``; a DataArray."""
Words: TypeAlias = Sequence[str] | tuple[str, Any] | np.ndarray[Any, Any] | xr.DataArray
"""Several words, in the same ways."""
PresetName: TypeAlias = Literal["paper_like", "paper_like_fast", "lbnl", "g36", "heating", "heating_45"]


class Keywords(TypedDict, total=False):
    """Parameters by name."""

    converged: bool
    C_w: Numbers
    C_c: Numbers
    beta1: Numbers
    beta2: Numbers
    beta3: Numbers
    beta4: Numbers
    beta5: Numbers
    beta6: Numbers
    cp_w: Numbers
    cp_a: Numbers
    pressure: Numbers
    n_volumes: Numbers
    air_march: Literal["lagged", "quasistatic"] | Words
    substeps: Numbers
    T_initial: Numbers
    m_max: Numbers
    valve_a: Numbers
    valve_b: Numbers
    valve_c: Numbers
    rangeability: Numbers
    authority: Numbers
    m_full: Numbers
    leakage: Numbers
    backlash: Numbers
    stroke_time: Numbers
    command_resolution: Numbers
    neutral_zone: Numbers
    slip_jump: Numbers
    wear_rate: Numbers
    sensor_time_constant: Numbers
    noise_std: Numbers
    sensor_resolution: Numbers
    kp: Numbers
    ti: Numbers
    sample_time: Numbers
    error_dead_band: Numbers
    action: Literal["cooling", "heating"] | Words
    plant_gain: Numbers
    law: Literal["pi"] | Rule | Words
    backlash_estimate: Numbers
    estimate_ratio: Numbers
    buffer: Numbers
    buffer_ratio: Numbers
    buffer_noise: Literal["given", "measured"] | Words
    buffer_swing: Numbers
    compensation: Literal["inverse", "additive", "smooth"] | Words
    smooth_rate: Numbers
    estimator: Literal["none", "learner", "hagglund", "gradient", "identify"] | Rule | Words
    estimate_share: Numbers
    learning_step: Numbers
    learning_interval: Numbers
    learning_ratio: Numbers
    learning_floor: Numbers
    learning_cap: Numbers
    learning_min_switches: Numbers
    learning_max_reference: Numbers
    learning_early_trip: Numbers
    learning_growth: Numbers
    learning_shrink: Numbers
    learning_final: Numbers
    learning_reference: Numbers
    learning_error_ratio: Numbers
    learning_stop: Literal["never", "first_step_down"] | Words
    hagglund_filter_ratio: Numbers
    hagglund_least_half_periods: Numbers
    gradient_gain: Numbers
    gradient_filter_time: Numbers
    gradient_reference_time: Numbers
    gradient_dead_zone: Numbers
    gradient_pause: Numbers
    gradient_cap: Numbers
    identify_stroke_time: Numbers
    identify_memory: Numbers
    identify_interval: Numbers
    identify_certainty: Numbers


Function = TypeVar("Function", bound=Callable[..., Any])
Class = TypeVar("Class", bound=type)


class _Unchanged:
    def __repr__(self) -> str:
        return "unchanged"


UNCHANGED = _Unchanged()
"""Stands in a signature for the value that a parameter has already."""


def take_parameters(defaults: Mapping[str, object]) -> Callable[[Function], Function]:
    """Show ``**values`` of a method as one keyword for each parameter, with these defaults."""

    def decorate(method: Function) -> Function:
        plain = inspect.signature(method)
        positional = [p for p in plain.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        keywords = [inspect.Parameter(n, inspect.Parameter.KEYWORD_ONLY, default=v) for n, v in defaults.items()]
        method.__signature__ = plain.replace(parameters=[*positional, *keywords])  # type: ignore[attr-defined]
        return method

    return decorate


def describe_parameters(cls: Class) -> Class:
    """Put the list of parameters into the docstring of a class, before its examples."""
    if cls.__doc__ is None:  # python -OO
        return cls
    text, heading, examples = inspect.cleandoc(cls.__doc__).partition("Examples\n")
    lines = ["Parameters", "----------"]
    for p in PARAMETERS.values():
        kind = "str" if p.is_word else "int" if p.name in COUNTS else "float"
        default = "optional" if p.default is None else f"default {p.default!r}"
        unit = "" if p.unit in ("", "1") else f" {p.unit}"
        lines += [f"{p.name} : {kind}, {default}{unit}", f"    {p.text} ({p.bounds})."]
    lines += [f"{WORD} : bool, default False", f"    True stands for {MEANING}."]
    cls.__doc__ = "\n".join([text.rstrip(), "", *lines, "", heading + examples])
    return cls
