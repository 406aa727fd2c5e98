"""The valve of Fig 6 over a block of lanes: motor, gearbox, stem, water flow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from fastcoil.model import physics
from fastcoil.model.engine.metrics import accumulate_travel
from fastcoil.model.engine.rows import LANES, LINEAR, R
from fastcoil.model.numerics.elementary import exp, log
from fastcoil.model.numerics.jit import section
from fastcoil.model.numerics.stages import BUILT_IN, FLAG, INTEGER, ROW_POINTER, StageSignature
from fastcoil.model.physics import LEAST_WATER_FLOW_KG_S


@section
def update_water_flow(S, leaks, is_linear):
    """Update the water flow of every lane, Eq (2): a short loop for each exponential and logarithm any lane needs."""
    for j in range(LANES):
        S[R.growth + j] = physics.flow_exponential(S[R.opening + j], S[R.valve_b + j], S[R.valve_c + j])
    for j in range(LANES):
        S[R.log_m_w + j] = physics.log_flow(S[R.log_m_max + j], S[R.valve_a + j], S[R.growth + j])
    for j in range(LANES):
        S[R.m_w + j] = exp(S[R.log_m_w + j])
        S[R.C_flow + j] = S[R.m_w + j] * S[R.cp_w + j]
    if is_linear:
        for j in range(LANES):
            m_w = S[R.m_max + j] * S[R.opening + j]
            S[R.m_w + j] = m_w if S[R.curve + j] == LINEAR else S[R.m_w + j]
            S[R.C_flow + j] = S[R.m_w + j] * S[R.cp_w + j]
    if leaks:  # the lanes without leakage keep their flow
        for j in range(LANES):
            m_w = physics.leaky_flow(S[R.m_w + j], S[R.m_0 + j], S[R.m_1 + j], S[R.leakage + j])
            S[R.m_w + j] = m_w if S[R.leakage + j] >= 0.0 else S[R.m_w + j]
            S[R.C_flow + j] = S[R.m_w + j] * S[R.cp_w + j]
    if leaks or is_linear:
        for j in range(LANES):
            log_m_w = log(S[R.m_w + j] if S[R.m_w + j] > LEAST_WATER_FLOW_KG_S else LEAST_WATER_FLOW_KG_S)
            is_changed = (S[R.leakage + j] >= 0.0) | (S[R.curve + j] == LINEAR)
            S[R.log_m_w + j] = log_m_w if is_changed else S[R.log_m_w + j]


@section
def scale_water_flow(S, j, dp_ratio):
    """Scale the design water flow of lane j to ``dp_ratio``; a pressure-independent one absorbs ratios above 1."""
    takes_rest = (S[R.pressure_independent + j] > 0.0) & (dp_ratio > 1.0)
    root = 1.0 if takes_rest else np.sqrt(dp_ratio)
    S[R.m_w + j] *= root
    S[R.log_m_w + j] += log(root)
    S[R.C_flow + j] = S[R.m_w + j] * S[R.cp_w + j]


ACTUATOR_SIGNATURE = StageSignature(S=ROW_POINTER, counted=FLAG, returns=INTEGER)
"""Stages that move motor and stem, see ``actuator_stage``."""
call_actuator = ACTUATOR_SIGNATURE.call
VALVE_MOVED = 1
"""Flag that ``actuate`` returns if any valve moved."""
ACTUATOR_BUSY = 2
"""Flag that ``actuate`` returns if any motor or stem has to be computed in the next second whatever the command."""


@dataclass(frozen=True, kw_only=True)
class ActuatorFeatures:
    """Parts of ``actuate`` that are compiled for a block, because one of its lanes needs them."""

    has_resolution: bool = False
    has_neutral_zone: bool = False
    has_positioner: bool = False
    has_stick_slip: bool = False
    has_wear: bool = False

    @classmethod
    def of_lanes(cls, row: Mapping[str, np.ndarray]) -> ActuatorFeatures:
        """Return the features of a block with these parameters, each (LANES,)."""
        return cls(
            has_resolution=bool(np.any(row["command_resolution"] > 0.0)),
            has_neutral_zone=bool(np.any(row["neutral_zone"] > 0.0)),
            has_positioner=bool(np.any(row["positioner_band"] > 0.0)),
            has_stick_slip=bool(np.any(row["slip_jump"] > 0.0)),
            has_wear=bool(np.any(row["wear_rate"] > 0.0)),
        )


def make_actuate(features: ActuatorFeatures) -> Any:
    """Return the section ``actuate`` with these features, see ``make_control``."""
    has_resolution, has_neutral_zone = features.has_resolution, features.has_neutral_zone
    has_positioner, has_stick_slip, has_wear = features.has_positioner, features.has_stick_slip, features.has_wear

    @section
    def actuate(S, counted):
        """Move motor and gearbox, Eq (1); return VALVE_MOVED and ACTUATOR_BUSY as they apply."""
        moved, running = False, False
        for j in range(LANES):
            target = physics.actuator_input(S[R.command + j], S[R.command_resolution + j] if has_resolution else 0.0)
            previous, max_travel = S[R.position + j], S[R.max_travel + j]
            x_bl, commissioned_gap = S[R.gap + j], S[R.backlash + j]
            if has_neutral_zone:
                runs = S[R.motor_runs + j] != 0.0
                position, runs = physics.move_with_dead_zone(previous, target, max_travel, S[R.neutral_zone + j], runs)
                S[R.motor_runs + j] = 1.0 if runs else 0.0
                running |= runs
            else:
                position = physics.motor_position(previous, target, max_travel)
                running |= position != target
            if has_positioner:
                stem, band = S[R.q + j] / (1.0 - commissioned_gap), S[R.positioner_band + j]
                positioned = physics.position_stem(previous, stem, target, max_travel, band)
                position = positioned if band > 0.0 else position
                running |= (band > 0.0) & (positioned != previous)
            if has_stick_slip:
                direction = S[R.stem_direction + j]
                q, direction = physics.stick_slip(S[R.q + j], direction, position, previous, x_bl, S[R.slip_jump + j])
                S[R.stem_direction + j] = direction
                running |= direction != 0.0  # it sticks in the second in which the motor has stopped
                open_ = physics.opening(q, commissioned_gap - S[R.slip_jump + j])
            else:
                q = physics.backlash(S[R.q + j], position, x_bl)
                open_ = physics.opening(q, commissioned_gap)
            d_opening, d_position = open_ - S[R.opening + j], position - previous
            if counted:
                accumulate_travel(S, j, d_opening, d_position)
            S[R.position + j] = position
            S[R.q + j] = q
            S[R.opening + j] = open_
            if has_wear:
                S[R.worn_backlash + j] += S[R.wear_rate + j] * abs(d_opening)
                S[R.gap + j] = physics.scaled_backlash(S[R.worn_backlash + j], S[R.backlash_scale + j])
                running |= S[R.gap + j] != x_bl
            moved |= d_opening != 0.0
        return (VALVE_MOVED if moved else 0) + (ACTUATOR_BUSY if running else 0)

    return actuate


actuate = make_actuate(ActuatorFeatures())


@cache
def actuator_stage(features: ActuatorFeatures) -> Any:
    """Return the address of ``actuate`` compiled with these features, see ACTUATOR_SIGNATURE."""
    if features == ActuatorFeatures():
        return BUILT_IN
    actuate_lanes = make_actuate(features)

    def actuator(S, counted):
        return actuate_lanes(S, counted)

    return ACTUATOR_SIGNATURE.compile(actuator, repr(features))
