"""The control law of a block of lanes, where it is not the PI: a user's rule, in the same loop over lanes."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from fastcoil.model.control.interface import Law
from fastcoil.model.control.pi import clipped, sample_number
from fastcoil.model.engine.rows import LANES, R
from fastcoil.model.estimators.interface import Sample, defaults_of
from fastcoil.model.numerics.stages import FLAG, NUMBER, ROWS, Kind, keep, values_at
from fastcoil.model.physics.sensor import measured

LAW = Kind(ROWS, ROWS, NUMBER, NUMBER, NUMBER, NUMBER, FLAG, FLAG)
"""Stages that decide u, see ``law_stage``."""
call_law = LAW.call


@cache
def law_stage(law: Law) -> Any:
    """Where the law is, compiled: (S, own, t, T_set, noise, m_a, enabled, begins) → nothing.

    own: its parameters, then its memory.  With ``begins`` it only fills the memory.  Where the controller is off, the
    memory starts again.
    """
    step, Parameters, Memory, defaults = law.step, law.Parameters, law.Memory, defaults_of(law.Memory)
    memory_at = len(Parameters._fields) * LANES

    def decide(S, own, t, T_set, noise, m_a, enabled, begins):
        for j in range(LANES):
            p = values_at(Parameters, own, j, LANES)
            memory = values_at(Memory, own, memory_at + j, LANES)
            if begins or not enabled:
                keep(True, Memory(*defaults), memory, own, memory_at + j, LANES)
            else:
                y = measured(S[R.y_s + j], S[R.noise + j] + noise, S[R.sensor_resolution + j])
                e = S[R.sign + j] * (y - T_set)
                now = Sample(
                    t, T_set, m_a, y, e, S[R.u + j], S[R.command + j], S[R.mode + j], S[R.switches + j],
                    S[R.estimate + j],
                )  # fmt: skip
                u, after = step(now, p, memory)
                due = sample_number(t, S[R.sample_time + j]) * S[R.sample_time + j] == t
                keep(due, after, memory, own, memory_at + j, LANES)
                # once no number, always none, so that the status says so at the end
                u = S[R.decided + j] if np.isnan(S[R.decided + j]) else clipped(u)
                S[R.decided + j] = u if due else S[R.decided + j]

    return LAW.compiled(decide, law.identity)
