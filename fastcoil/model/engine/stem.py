"""Motor, gearbox and stem over a block of lanes: from the command to the opening, Eq (1)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from fastcoil.model.engine.metrics import account_travel
from fastcoil.model.engine.rows import LANES, R
from fastcoil.model.numerics.jit import section
from fastcoil.model.numerics.stages import BUILT_IN, FLAG, ROWS, WHOLE, Kind
from fastcoil.model.physics.actuator import accepted, driven, motor
from fastcoil.model.physics.valve import backlash, gap, opening, slipped, worn

STEM = Kind(ROWS, FLAG, returns=WHOLE)
"""Stages that move motor and stem, see ``stem_stage``."""
call_stem = STEM.call
MOVED, RUNNING = 1, 2
"""What a stage returns, summed: a valve moved; something happens next second whatever the command."""


@section
def actuate(S, counted, has_resolution, has_zones, slips, wears):
    """Move motor and gearbox, Eq (1).  Returns MOVED if any valve moved, plus RUNNING if any motor still runs.

    has_resolution, has_zones, slips, wears: whether any lane's motor rounds its commands, has a neutral zone or a slip
    jump, or wears, see ``Stem``.
    """
    moved, running = False, False
    for j in range(LANES):
        target = accepted(S[R.command + j], S[R.command_resolution + j] if has_resolution else 0.0)
        previous, x_bl = S[R.position + j], S[R.gap + j]
        if has_zones:
            runs = S[R.motor_runs + j] != 0.0
            position, runs = driven(previous, target, S[R.max_travel + j], S[R.neutral_zone + j], runs)
            S[R.motor_runs + j] = 1.0 if runs else 0.0
            running |= runs
        else:
            position = motor(previous, target, S[R.max_travel + j])
            running |= position != target
        if slips:
            direction = S[R.stem_direction + j]
            q, direction = slipped(S[R.q + j], direction, position, previous, x_bl, S[R.slip_jump + j])
            S[R.stem_direction + j] = direction
            running |= direction != 0.0  # it sticks in the second in which the motor has stopped
            open_ = opening(q, x_bl - S[R.slip_jump + j])
        else:
            q = backlash(S[R.q + j], position, x_bl)
            open_ = opening(q, x_bl)
        d_opening, d_position = open_ - S[R.opening + j], position - previous
        if counted:
            account_travel(S, j, d_opening, d_position)
        S[R.position + j] = position
        S[R.q + j] = q
        S[R.opening + j] = open_
        if wears:
            S[R.worn + j] = worn(S[R.worn + j], S[R.wear_rate + j], abs(d_opening))
            S[R.gap + j] = gap(S[R.worn + j], S[R.backlash_scale + j])
            running |= S[R.gap + j] != x_bl
        moved |= d_opening != 0.0
    return (MOVED if moved else 0) + (RUNNING if running else 0)


@section
def scale_gap(S, scale):
    """Let the boundary multiply every backlash by ``scale``; the stem is taken into the new gap when next actuated."""
    for j in range(LANES):
        S[R.backlash_scale + j] = scale
        S[R.gap + j] = gap(S[R.worn + j], scale)


class Stem(NamedTuple):
    """What the motors and valves of a block have in common: which parts of ``actuate`` are compiled for it."""

    has_resolution: bool = False
    has_zones: bool = False
    slips: bool = False
    wears: bool = False

    @classmethod
    def of(cls, row: Mapping[str, np.ndarray]) -> Stem:
        """For a block with these parameters, each (LANES,)."""
        return cls(
            has_resolution=bool(np.any(row["command_resolution"] > 0.0)),
            has_zones=bool(np.any(row["neutral_zone"] > 0.0)),
            slips=bool(np.any(row["slip_jump"] > 0.0)),
            wears=bool(np.any(row["wear_rate"] > 0.0)),
        )


@cache
def stem_stage(parts: Stem) -> Any:
    """Where ``actuate`` is, compiled for these parts: (S, counted) → MOVED and RUNNING."""
    if parts == Stem():
        return BUILT_IN

    has_resolution, has_zones, slips, wears = parts

    def stem(S, counted):
        return actuate(S, counted, has_resolution, has_zones, slips, wears)

    return STEM.compiled(stem, repr(parts))
