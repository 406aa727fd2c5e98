"""The parameters of a loop as keywords, for type checkers and editors, which read no table; a test compares them."""

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, TypedDict, TypeVar

import numpy as np
import xarray as xr

from fastcoil.model.user_rules import Rule

Value: TypeAlias = float | str | Rule | Sequence[Any] | np.ndarray[Any, Any] | xr.DataArray
"""A number, a word or a rule; a list, which is a dimension of its own; ``(dim, values)``; a DataArray."""
PresetName: TypeAlias = Literal["paper_like", "paper_like_fast", "lbnl", "g36", "heating", "heating_45", "reheat"]

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
    curve: Literal["richards", "linear"] | Value
    pressure_independent: Value
    leakage: Value
    backlash: Value
    stroke_time: Value
    command_resolution: Value
    neutral_zone: Value
    positioner_band: Value
    slip_jump: Value
    wear_rate: Value
    plant: Literal["coil"] | Value
    dead_time: Value
    room_capacity: Value
    room_ua: Value
    sensor_time_constant: Value
    noise_std: Value
    sensor_resolution: Value
    kp: Value
    ti: Value
    sample_time: Value
    error_dead_band: Value
    action: Literal["cooling", "heating"] | Value
    controlled: Literal["T_sup", "T_room"] | Value
    plant_gain: Value
    law: Literal["pi"] | Value
    test_start: Value
    test_every: Value
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

Class = TypeVar("Class", bound=type)

def describe_parameters(cls: Class) -> Class: ...
