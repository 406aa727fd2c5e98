"""The estimator of a block of lanes: any rule of ``fastcoil.model.estimators``, in the same loop over lanes.

A rule sees one lane: a Sample, its parameters and its memory.  Its parameters and memory are rows of its own, so that
no row of the loop depends on which rules there are.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from fastcoil.model.control.pi import clipped, sample_number
from fastcoil.model.engine.rows import LANES, R
from fastcoil.model.estimators.interface import Estimator, Sample, defaults_of
from fastcoil.model.numerics.jit import exact, section
from fastcoil.model.numerics.stages import FLAG, NUMBER, ROWS, Kind, array_at, keep, values_at

ESTIMATE = Kind(ROWS, ROWS, NUMBER, NUMBER, NUMBER, FLAG, FLAG)
"""Stages that find the estimate, see ``estimator_stage``."""
call_estimator = ESTIMATE.call


@exact
def within(x_hat, x_bl):
    """Whether an estimate is right to 20 % of the true backlash x_bl or 1 % of stroke."""
    tolerance = 0.2 * x_bl if 0.2 * x_bl > 0.01 else 0.01
    return abs(x_hat - x_bl) <= tolerance


@section
def adopt(S, j, t, x_hat):
    """Take over lane j's new estimate, and note since when the estimate has been right."""
    # once no number, always none, so that the status says so at the end
    x_hat = S[R.estimate + j] if np.isnan(S[R.estimate + j]) else clipped(x_hat)
    right = within(x_hat, S[R.gap + j])
    since = S[R.time_identified + j]
    since = since if since <= t else t
    S[R.time_identified + j] = since if right else np.nan
    S[R.estimate + j] = x_hat
    S[R.assumed + j] = S[R.estimate_share + j] * x_hat


@cache
def estimator_stage(estimator: Estimator) -> Any:
    """Where the estimator is, compiled: (S, own, t, T_set, m_a, enabled, begins) → nothing.

    own: its parameters, then its memory, (n_parameters + n_memory) * LANES, then an array for each lane, if it has one.
    With ``begins`` it only fills the memory.
    """
    step, start, confirms = _compiled(estimator.step), _compiled(estimator.start), _compiled(estimator.confirms)
    Parameters, Memory, defaults = estimator.Parameters, estimator.Memory, defaults_of(estimator.Memory)
    memory_at, every_call = len(Parameters._fields) * LANES, estimator.periods is not None
    has_start, has_confirms = start is not None, confirms is not None
    words, arrays_at = estimator.words, memory_at + len(Memory._fields) * LANES
    has_array = words > 0

    def estimate(S, own, t, T_set, m_a, enabled, begins):
        if begins:
            for j in range(LANES):
                p = values_at(Parameters, own, j, LANES)
                memory = values_at(Memory, own, memory_at + j, LANES)
                keep(True, start(p) if has_start else Memory(*defaults), memory, own, memory_at + j, LANES)
                adopt(S, j, t, S[R.estimate + j])
            return
        for j in range(LANES):
            p = values_at(Parameters, own, j, LANES)
            memory = values_at(Memory, own, memory_at + j, LANES)
            now = Sample(
                t, T_set, m_a, S[R.T_seen + j], S[R.e_seen + j], S[R.u + j], S[R.command + j], S[R.mode + j],
                S[R.switches + j], S[R.estimate + j],
            )  # fmt: skip
            samples = sample_number(t, S[R.sample_time + j]) * S[R.sample_time + j] == t
            due = (samples & enabled) | every_call
            if has_array:
                if not due:
                    continue
                x_hat, after = step(now, p, memory, array_at(own, arrays_at + j * words, words))
            else:
                x_hat, after = step(now, p, memory)  # no branch: every lane runs the same
            keep(due, after, memory, own, memory_at + j, LANES)
            adopt(S, j, t, x_hat if due else S[R.estimate + j])
            if has_confirms:
                reached, confirmed = confirms(t, p, after, S[R.gap + j], S[R.time_reached + j], S[R.time_confirmed + j])
                S[R.time_reached + j] = reached
                S[R.time_confirmed + j] = confirmed

    return ESTIMATE.compiled(estimate, estimator.identity or estimator.name)


def _compiled(function: Any) -> Any:
    return function if function is None or hasattr(function, "py_func") else exact(function)
