"""The controller of Fig 8 over a block of lanes: noise on the sensor, PI, inverse."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from fastcoil.control.inverse import direction, extreme, inverse
from fastcoil.control.law import Law
from fastcoil.control.pi import desired_opening, integrated, sample_number
from fastcoil.engine.rows import LANES, R
from fastcoil.estimators.family import Estimator
from fastcoil.numerics.jit import section
from fastcoil.numerics.noise import MEASUREMENT, normal_pair
from fastcoil.numerics.stages import BUILT_IN, FLAG, NUMBER, ROWS, WHOLE, Kind
from fastcoil.physics.sensor import measured

CONTROL = Kind(ROWS, WHOLE, NUMBER, NUMBER, FLAG, NUMBER)
"""Stages that decide u and the command, see ``control_stage``."""
call_control = CONTROL.call


@section
def draw_noise(S, t, k, common, day):
    """Draw a normal number for the lanes that sample now.  k: number of the sample, where all lanes sample together."""
    if common.samples_together and k % 2 == 1:
        for j in range(LANES):
            S[R.noise + j] = S[R.noise_next + j]
        return
    k0, k1, label = np.uint64(day.seed[0]), np.uint64(day.seed[1]), np.uint64(day.label)
    for j in range(LANES):
        last = sample_number(t, S[R.sample_time + j])
        sample, replicate = np.int64(last), np.uint64(S[R.replicate + j])
        even, odd = normal_pair(np.uint64(sample >> 1), np.uint64(MEASUREMENT), replicate, label, k0, k1)
        due = last * S[R.sample_time + j] == t
        z = odd if sample & 1 else even
        S[R.noise + j] = S[R.noise_std + j] * z if due else S[R.noise + j]
        S[R.noise_next + j] = S[R.noise_std + j] * odd


@section
def control(S, t, T_set, noise, enabled, counts_switches, is_watched, has_law):
    """Run PI and inverse of the lanes that sample now; the others hold u, and so their command.

    is_watched: whether an estimator wants to know what was measured.  has_law: whether another law decided u; it has no
    integral.
    """
    for j in range(LANES):
        y = measured(S[R.y_s + j], S[R.noise + j] + noise, S[R.sensor_resolution + j])
        e = S[R.sign + j] * (y - T_set)
        due = sample_number(t, S[R.sample_time + j]) * S[R.sample_time + j] == t
        integral = integrated(S[R.integral + j], e, S[R.ki + j])
        u = S[R.decided + j] if has_law else desired_opening(e, integral, S[R.kp + j])
        integral = 0.0 if has_law else integral
        integral = integral if due else S[R.integral + j]
        u = u if due else S[R.u + j]
        integral = integral if enabled else 0.0
        u = u if enabled else 0.0
        S[R.integral + j] = integral
        S[R.u + j] = u
        if is_watched:
            S[R.T_seen + j] = y if due else S[R.T_seen + j]
            S[R.e_seen + j] = e if due else S[R.e_seen + j]

        mode = direction(u, S[R.mode + j], S[R.u_ext + j], S[R.buffer + j])
        turned = mode != S[R.mode + j]
        u_ext = extreme(u, mode, S[R.u_ext + j], turned)
        command = inverse(u_ext, mode, S[R.assumed + j])
        S[R.command + j] = command if u_ext != S[R.u_ext + j] else S[R.command + j]
        S[R.u_ext + j] = u_ext
        S[R.mode + j] = mode
        S[R.switches + j] += 1.0 if turned else 0.0
        S[R.sum_switches + j] += counts_switches if turned else 0.0


class Control(NamedTuple):
    """What the controllers of a block have in common: which parts of ``control`` are compiled for it."""

    is_watched: bool = False
    has_law: bool = False

    @classmethod
    def of(cls, estimator: Estimator | None, law: Law | None) -> Control:
        """For a block whose lanes have this estimator and, but for the PI, this law."""
        return cls(is_watched=estimator is not None and estimator.periods is None, has_law=law is not None)


@cache
def control_stage(parts: Control) -> Any:
    """Where ``control`` is, compiled for these parts: (S, t, T_set, noise, enabled, counts_switches) → nothing."""
    if parts == Control():
        return BUILT_IN
    is_watched, has_law = parts

    def controller(S, t, T_set, noise, enabled, counts_switches):
        control(S, t, T_set, noise, enabled, counts_switches, is_watched, has_law)

    return CONTROL.compiled(controller, repr(parts))
