"""Motor, gearbox and stem over a block of lanes: from the command to the opening, Eq (1)."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from fastcoil.engine.metrics import account_travel
from fastcoil.engine.rows import LANES, R
from fastcoil.numerics.jit import section
from fastcoil.numerics.stages import BUILT_IN, FLAG, ROWS, WHOLE, Kind
from fastcoil.physics.actuator import accepted, motor
from fastcoil.physics.valve import backlash, opening

STEM = Kind(ROWS, FLAG, returns=WHOLE)
"""Stages that move motor and stem, see ``stem_stage``."""
call_stem = STEM.call
MOVED, RUNNING = 1, 2
"""What a stage returns, summed: a valve moved; a motor still runs."""


@section
def actuate(S, counted):
    """Move motor and gearbox, Eq (1).  Returns MOVED if any valve moved, plus RUNNING if any motor still runs."""
    moved, running = False, False
    for j in range(LANES):
        target = accepted(S[R.command + j], S[R.command_resolution + j])
        position = motor(S[R.position + j], target, S[R.max_travel + j])
        q = backlash(S[R.q + j], position, S[R.backlash + j])
        open_ = opening(q, S[R.backlash + j])
        d_opening, d_position = open_ - S[R.opening + j], position - S[R.position + j]
        if counted:
            account_travel(S, j, d_opening, d_position)
        S[R.position + j] = position
        S[R.q + j] = q
        S[R.opening + j] = open_
        moved |= d_opening != 0.0
        running |= position != target
    return (MOVED if moved else 0) + (RUNNING if running else 0)


class Stem(NamedTuple):
    """What the motors and valves of a block have in common: which parts of ``actuate`` are compiled for it."""


@cache
def stem_stage(parts: Stem) -> Any:
    """Where ``actuate`` is, compiled for these parts: (S, counted) → MOVED and RUNNING."""
    if parts == Stem():
        return BUILT_IN

    def stem(S, counted):
        return actuate(S, counted)

    return STEM.compiled(stem, repr(parts))
