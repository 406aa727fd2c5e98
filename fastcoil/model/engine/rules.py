"""The rules of a block of lanes: the estimator in front of the PI, and the law in place of it."""

from functools import cache
from typing import Any

import numpy as np

from fastcoil.model.control import clip01, sample_number
from fastcoil.model.engine.rows import LANES, R
from fastcoil.model.estimators.interface import Estimator, Sample, StepRule, memory_defaults
from fastcoil.model.numerics.jit import exact, section
from fastcoil.model.numerics.stages import FLAG, NUMBER, ROW_POINTER, StageSignature, array_at, store_if_due, values_at
from fastcoil.model.physics import sensor_reading

ESTIMATOR_SIGNATURE = StageSignature(
    S=ROW_POINTER, rule_state=ROW_POINTER, t=NUMBER, T_set=NUMBER, m_a=NUMBER, enabled=FLAG, is_start=FLAG
)
"""Stages that estimate the backlash, see ``estimator_stage``."""
call_estimator = ESTIMATOR_SIGNATURE.call


@exact
def is_estimate_right(x_hat, x_bl):
    """Whether an estimate is right to 20 % of the true backlash x_bl or 1 % of stroke."""
    tolerance = 0.2 * x_bl if 0.2 * x_bl > 0.01 else 0.01
    return abs(x_hat - x_bl) <= tolerance


@section
def adopt_estimate(S, j, t, x_hat):
    """Set the estimate of lane j, and update the largest one and the time since which it has been right."""
    # a NaN stays, so that the status reports it
    x_hat = S[R.estimate + j] if np.isnan(S[R.estimate + j]) else clip01(x_hat)
    since = S[R.time_identified + j]
    since = since if since <= t else t
    S[R.time_identified + j] = since if is_estimate_right(x_hat, S[R.gap + j]) else np.nan
    S[R.estimate + j] = x_hat
    S[R.largest_estimate + j] = x_hat if x_hat > S[R.largest_estimate + j] else S[R.largest_estimate + j]
    S[R.assumed_backlash + j] = S[R.estimate_share + j] * x_hat


@cache
def estimator_stage(estimator: Estimator) -> Any:
    """Return the address of a compiled estimator; rule_state: its parameters, memory, and an array for each lane."""
    step, start, confirms = map(compile_exact, (estimator.step, estimator.start, estimator.confirms))
    Parameters, Memory, defaults = estimator.Parameters, estimator.Memory, memory_defaults(estimator.Memory)
    memory_at, every_call = len(Parameters._fields) * LANES, estimator.periods is not None
    has_start, has_confirms = start is not None, confirms is not None
    n_array, arrays_at = estimator.n_floats, memory_at + len(Memory._fields) * LANES
    has_array, sees_test = n_array > 0, estimator.sees_test

    def estimate(S, rule_state, t, T_set, m_a, enabled, is_start):
        if is_start:
            for j in range(LANES):
                p = values_at(Parameters, rule_state, j, LANES)
                memory = values_at(Memory, rule_state, memory_at + j, LANES)
                initial = start(p) if has_start else Memory(*defaults)
                store_if_due(True, initial, memory, rule_state, memory_at + j, LANES)
                adopt_estimate(S, j, t, S[R.estimate + j])
            return
        for j in range(LANES):
            p = values_at(Parameters, rule_state, j, LANES)
            memory = values_at(Memory, rule_state, memory_at + j, LANES)
            now = Sample(
                t, T_set, m_a, S[R.T_seen + j], S[R.e_seen + j], S[R.u + j], S[R.command + j], S[R.mode + j],
                S[R.switches + j], S[R.estimate + j], S[R.test + j],
            )  # fmt: skip
            is_sample = sample_number(t, S[R.sample_time + j]) * S[R.sample_time + j] == t
            due = ((is_sample & enabled) | every_call) & (sees_test | (S[R.test + j] == 0.0))
            if has_array:
                if not due:
                    continue
                x_hat, after = step(now, p, memory, array_at(rule_state, arrays_at + j * n_array, n_array))
            else:
                x_hat, after = step(now, p, memory)  # no branch: every lane runs the same
            store_if_due(due, after, memory, rule_state, memory_at + j, LANES)
            adopt_estimate(S, j, t, x_hat if due else S[R.estimate + j])
            if has_confirms:
                reached, confirmed = confirms(t, p, after, S[R.gap + j], S[R.time_reached + j], S[R.time_confirmed + j])
                S[R.time_reached + j] = reached
                S[R.time_confirmed + j] = confirmed

    return ESTIMATOR_SIGNATURE.compile(estimate, estimator.fingerprint or estimator.name)


def compile_exact(function: Any) -> Any:
    """Compile a part of a rule with the flags of the kernel, unless it is compiled or there is none."""
    return function if function is None or hasattr(function, "py_func") else exact(function)


LAW_SIGNATURE = StageSignature(
    S=ROW_POINTER, rule_state=ROW_POINTER, t=NUMBER, T_set=NUMBER, noise=NUMBER, m_a=NUMBER, enabled=FLAG, is_start=FLAG
)
"""Stages that decide u, see ``law_stage``."""
call_law = LAW_SIGNATURE.call


@cache
def law_stage(law: StepRule) -> Any:
    """Return the address of a law compiled for a block, see LAW_SIGNATURE; rule_state: parameters, then memory."""
    step, Parameters, Memory, defaults = law.step, law.Parameters, law.Memory, memory_defaults(law.Memory)
    memory_at = len(Parameters._fields) * LANES

    def decide(S, rule_state, t, T_set, noise, m_a, enabled, is_start):
        for j in range(LANES):
            p = values_at(Parameters, rule_state, j, LANES)
            memory = values_at(Memory, rule_state, memory_at + j, LANES)
            if is_start or not enabled:
                store_if_due(True, Memory(*defaults), memory, rule_state, memory_at + j, LANES)
            else:
                y = sensor_reading(S[R.y_s + j], S[R.noise + j] + noise, S[R.sensor_resolution + j])
                e = S[R.sign + j] * (y - T_set)
                now = Sample(
                    t, T_set, m_a, y, e, S[R.u + j], S[R.command + j], S[R.mode + j], S[R.switches + j],
                    S[R.estimate + j], S[R.test + j],
                )  # fmt: skip
                u, after = step(now, p, memory)
                due = sample_number(t, S[R.sample_time + j]) * S[R.sample_time + j] == t
                store_if_due(due, after, memory, rule_state, memory_at + j, LANES)
                # a NaN stays, so that the status reports it
                u = S[R.u_law + j] if np.isnan(S[R.u_law + j]) else clip01(u)
                S[R.u_law + j] = u if due else S[R.u_law + j]

    return LAW_SIGNATURE.compile(decide, law.fingerprint)
