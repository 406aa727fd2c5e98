"""The parameters of a loop as keywords: for type checkers and editors, and in signatures and help.

Type checkers read no table, so the names stand here too; a test compares them with ``parameter_table``.  Parameters
that a user's rule brings are passed as ``loop.assign(**{"gain": 0.5})``.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeAlias, TypedDict, TypeVar

import numpy as np
import xarray as xr

from fastcoil.loops.assignment import MEANING, WORD
from fastcoil.model.parameter_table import COUNTS, PARAMETERS
from fastcoil.model.user_rules import Rule

Value: TypeAlias = float | str | Rule | Sequence[Any] | np.ndarray[Any, Any] | xr.DataArray
"""A number, a word or a rule; a list, which is a dimension of its own; ``(dim, values)``; a DataArray."""
PresetName: TypeAlias = Literal["paper_like", "paper_like_fast", "lbnl", "g36", "heating", "heating_45"]


class Keywords(TypedDict, total=False):
    """Parameters by name."""

    converged: bool | Value
    C_w: Value
    C_c: Value
    beta1: Value
    beta2: Value
    beta3: Value
    beta4: Value
    beta5: Value
    beta6: Value
    cp_w: Value
    cp_a: Value
    pressure: Value
    n_volumes: Value
    air_march: Literal["lagged", "quasistatic"] | Value
    substeps: Value
    T_initial: Value
    m_max: Value
    valve_a: Value
    valve_b: Value
    valve_c: Value
    rangeability: Value
    authority: Value
    m_full: Value
    leakage: Value
    backlash: Value
    stroke_time: Value
    command_resolution: Value
    neutral_zone: Value
    slip_jump: Value
    wear_rate: Value
    sensor_time_constant: Value
    noise_std: Value
    sensor_resolution: Value
    kp: Value
    ti: Value
    sample_time: Value
    error_dead_band: Value
    action: Literal["cooling", "heating"] | Value
    plant_gain: Value
    law: Literal["pi"] | Value
    test_start: Value
    test_minutes: Value
    test_rate: Value
    test_threshold: Value
    test_settle: Value
    test_hold: Value
    test_excursion: Value
    backlash_estimate: Value
    estimate_ratio: Value
    buffer: Value
    buffer_ratio: Value
    buffer_noise: Literal["given", "measured"] | Value
    buffer_swing: Value
    compensation: Literal["inverse", "additive", "smooth"] | Value
    smooth_rate: Value
    estimator: Literal["none", "learner", "hagglund", "gradient", "identify"] | Value
    estimate_share: Value
    learning_step: Value
    learning_interval: Value
    learning_ratio: Value
    learning_floor: Value
    learning_cap: Value
    learning_min_switches: Value
    learning_max_reference: Value
    learning_early_trip: Value
    learning_growth: Value
    learning_shrink: Value
    learning_final: Value
    learning_reference: Value
    learning_error_ratio: Value
    learning_stop: Literal["never", "first_step_down"] | Value
    hagglund_filter_ratio: Value
    hagglund_least_half_periods: Value
    gradient_gain: Value
    gradient_filter_time: Value
    gradient_reference_time: Value
    gradient_dead_zone: Value
    gradient_pause: Value
    gradient_cap: Value
    identify_stroke_time: Value
    identify_memory: Value
    identify_interval: Value
    identify_certainty: Value


Function = TypeVar("Function", bound=Callable[..., Any])
Class = TypeVar("Class", bound=type)


class _Unchanged:
    """Stands in a signature for the value that a parameter has already."""

    def __repr__(self) -> str:
        return "unchanged"


UNCHANGED = _Unchanged()


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
