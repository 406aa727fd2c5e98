"""The controller of Fig 8 over a block of lanes: noise on the sensor, PI, inverse."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from fastcoil.model import control, valve_test
from fastcoil.model.control import clip01
from fastcoil.model.engine.rows import LANES, R
from fastcoil.model.estimators.interface import Estimator, StepRule
from fastcoil.model.numerics import stages
from fastcoil.model.numerics.jit import exact, section
from fastcoil.model.numerics.noise import MEASUREMENT_CHANNEL, normal_pair
from fastcoil.model.numerics.stages import BUILT_IN, FLAG, INTEGER, NUMBER, ROW_POINTER, StageSignature
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.model.physics import sensor_reading

CONTROL_SIGNATURE = StageSignature(
    S=ROW_POINTER, t=INTEGER, T_set=NUMBER, noise=NUMBER, m_a=NUMBER, enabled=FLAG, counts_switches=NUMBER
)
"""Stages that decide u and the command, see ``control_stage``."""
call_control = CONTROL_SIGNATURE.call
ADDITIVE = float(PARAMETERS["compensation"].choices.index("additive"))
SMOOTH = float(PARAMETERS["compensation"].choices.index("smooth"))
MEASURED_NOISE = float(PARAMETERS["buffer_noise"].choices.index("measured"))


@dataclass(frozen=True, kw_only=True)
class ControllerFeatures:
    """Parts of the controller, compiled for a block if a lane needs them; they change no bits of one that does not."""

    keeps_reading: bool = False
    """An estimator reads T and e of the last sample."""
    has_resolution: bool = False
    """The reading of the sensor is rounded."""
    has_law: bool = False
    """A law in place of the PI decides u; it has no integral."""
    has_dead_band: bool = False
    is_additive: bool = False
    is_smooth: bool = False
    measures_noise: bool = False
    waives_buffer: bool = False
    """Lanes whose estimate is 0 have no buffer, so that a valve without backlash has the plain PI."""
    has_test: bool = False

    @classmethod
    def of_lanes(
        cls, estimator: Estimator | None, law: StepRule | None, row: Mapping[str, np.ndarray]
    ) -> ControllerFeatures:
        """Return the features of a block with this estimator, this law (``None``: the PI) and these parameters."""
        return cls(
            keeps_reading=estimator is not None and estimator.is_watching(row),
            has_resolution=bool(np.any(row["sensor_resolution"] > 0.0)),
            has_law=law is not None,
            has_dead_band=bool(np.any(row["error_dead_band"] > 0.0)),
            is_additive=bool(np.any(row["compensation"] == ADDITIVE)),
            is_smooth=bool(np.any(row["compensation"] == SMOOTH)),
            measures_noise=bool(np.any(row["buffer_noise"] == MEASURED_NOISE)),
            waives_buffer=estimator is not None and estimator.waives_buffer,
            has_test=bool(np.any(row["test_start"] >= 0.0)),
        )


@section
def draw_noise(S, t, k, config, day):
    """Draw a normal number for the lanes that sample now; k: number of the sample where all lanes sample together."""
    if config.samples_together and k % 2 == 1:
        for j in range(LANES):
            S[R.noise + j] = S[R.noise_next + j]
        return
    k0, k1, label = np.uint64(day.seed[0]), np.uint64(day.seed[1]), np.uint64(day.label)
    for j in range(LANES):
        last_sample = control.sample_number(t, S[R.sample_time + j])
        sample, replicate = np.int64(last_sample), np.uint64(S[R.replicate + j])
        even, odd = normal_pair(np.uint64(sample >> 1), np.uint64(MEASUREMENT_CHANNEL), replicate, label, k0, k1)
        due = last_sample * S[R.sample_time + j] == t
        z = odd if sample & 1 else even
        S[R.noise + j] = S[R.noise_std + j] * z if due else S[R.noise + j]
        S[R.noise_next + j] = S[R.noise_std + j] * odd


def make_control(features: ControllerFeatures) -> Any:
    """Return the section ``control_lanes`` with these features; closed over, they are constants to the compiler."""
    keeps_reading, has_resolution, has_law = features.keeps_reading, features.has_resolution, features.has_law
    has_dead_band, is_additive, is_smooth = features.has_dead_band, features.is_additive, features.is_smooth
    measures_noise, waives_buffer, has_test = features.measures_noise, features.waives_buffer, features.has_test

    @section
    def control_lanes(S, t, T_set, noise, enabled, counts_switches):
        """Run PI and inverse of the lanes that sample now; the others hold u, and so their command."""
        for j in range(LANES):
            resolution = S[R.sensor_resolution + j] if has_resolution else 0.0
            y = sensor_reading(S[R.y_s + j], S[R.noise + j] + noise, resolution)
            e = S[R.sign + j] * (y - T_set)
            due = control.sample_number(t, S[R.sample_time + j]) * S[R.sample_time + j] == t
            integral = control.integral_part(S[R.integral + j], e, S[R.ki + j])
            u = S[R.u_law + j] if has_law else control.desired_opening(e, integral, S[R.kp + j])
            integral = 0.0 if has_law else integral
            acts = due
            if has_dead_band:
                acts = due and not control.in_dead_band(e, S[R.error_dead_band + j])
            if has_test:
                acts = acts and S[R.test + j] == 0.0
            integral = integral if acts else S[R.integral + j]
            u = u if acts else S[R.u + j]
            integral = integral if enabled else 0.0
            u = u if enabled else 0.0
            if keeps_reading:
                S[R.T_seen + j] = y if due else S[R.T_seen + j]
                S[R.e_seen + j] = e if due else S[R.e_seen + j]
            buffer = S[R.buffer + j]
            if measures_noise:
                buffer = update_noise_buffer(S, j, e, due)
            if waives_buffer:
                buffer = buffer if S[R.assumed_backlash + j] > 0.0 else 0.0

            mode = control.next_mode(u, S[R.mode + j], S[R.u_ext + j], buffer)
            turned = mode != S[R.mode + j]
            u_ext = control.next_extreme(u, mode, S[R.u_ext + j], turned)
            command = control.inverse_command(u_ext, mode, S[R.assumed_backlash + j])
            moves = u_ext != S[R.u_ext + j]
            if is_additive:
                adds = S[R.compensation + j] == ADDITIVE
                command = control.additive_command(u_ext, mode, S[R.assumed_backlash + j]) if adds else command
            if is_smooth:
                smooths = S[R.compensation + j] == SMOOTH
                smooth = control.smooth_command(u, S[R.u + j], S[R.assumed_backlash + j], S[R.steepness + j])
                command = smooth if smooths else command
                moves = (due or u != S[R.u + j]) if smooths else moves
            if has_test:
                moves = moves and S[R.test + j] == 0.0
            S[R.integral + j] = integral
            S[R.u + j] = u
            S[R.command + j] = command if moves else S[R.command + j]
            S[R.u_ext + j] = u_ext
            S[R.mode + j] = mode
            S[R.switches + j] += 1.0 if turned else 0.0
            S[R.sum_switches + j] += counts_switches if turned else 0.0

    return control_lanes


plain_control = make_control(ControllerFeatures())
"""The controller without any feature, which the kernel has built in."""


@section
def run_test(S, t, T_set, noise, m_a, enabled):
    """Run the valve test of the lanes that sample now: it sets the command, and the PI tracks it without a bump."""
    for j in range(LANES):
        y = sensor_reading(S[R.y_s + j], S[R.noise + j] + noise, S[R.sensor_resolution + j])
        due = control.sample_number(t, S[R.sample_time + j]) * S[R.sample_time + j] == t
        p = valve_test.Parameters(
            S[R.sample_time + j], S[R.test_minutes + j], S[R.test_rate + j], S[R.test_threshold + j],
            S[R.test_settle + j], S[R.test_hold + j], S[R.test_excursion + j],
        )  # fmt: skip
        before = stages.values_at(valve_test.Memory, S, R.test_phase + j, LANES)
        elapsed = t - S[R.test_start + j]
        repeat_period = 86400.0 * S[R.test_every + j]  # s from days
        elapsed = elapsed % repeat_period if elapsed > 0.0 and repeat_period > 0.0 else elapsed
        is_requested = elapsed >= 0.0 and elapsed < S[R.sample_time + j]
        begins, watched = valve_test.watch_loop(S[R.command + j], m_a, enabled, is_requested, p, before)
        is_start = due and begins
        held_command = valve_test.held_command(S[R.command + j], before) if is_start else S[R.command + j]
        memory = valve_test.begin_test(T_set, p, watched) if is_start else before
        runs = memory.phase != valve_test.PHASE_OFF
        acts = due or (runs and not enabled)
        sign = S[R.sign + j]
        command, after = valve_test.step_test(sign * (y - memory.reference), held_command, m_a, enabled, p, memory)
        after = after if runs else watched
        stages.store_if_due(acts and (runs or enabled), after, before, S, R.test_phase + j, LANES)
        runs = S[R.test_phase + j] != valve_test.PHASE_OFF
        S[R.test + j] = 1.0 if runs else 0.0
        mode = after.direction if after.direction != 0.0 else S[R.mode + j]
        u = opening_behind(command, mode, S[R.assumed_backlash + j], S[R.compensation + j])
        follows_test = runs and acts
        S[R.command + j] = command if follows_test else S[R.command + j]
        S[R.mode + j] = mode if follows_test else S[R.mode + j]
        S[R.u + j] = u if follows_test else S[R.u + j]
        S[R.u_ext + j] = u if follows_test else S[R.u_ext + j]
        integral = clip01(u - S[R.kp + j] * sign * (y - T_set))
        S[R.integral + j] = integral if follows_test else S[R.integral + j]


@exact
def opening_behind(command, mode, x_hat, compensation):
    """Return the u for which the compensation of an estimate x_hat gives a command: a bumpless start of the PI."""
    rising_share = 1.0 if mode > 0.0 else 0.0
    if compensation == ADDITIVE:
        return clip01(command - (rising_share - 0.5) * x_hat)
    rising_share = 0.5 if compensation == SMOOTH else rising_share
    return clip01((command - rising_share * x_hat) / (1.0 - x_hat))


@section
def update_noise_buffer(S, j, e, due):
    """Update the measured noise of lane j with its reading e; return the buffer, from that noise where it counts."""
    readings = S[R.readings + j] + (1.0 if due else 0.0)
    median = control.median_difference(S[R.difference + j], readings, e, S[R.e_1 + j], S[R.e_2 + j])
    median = median if due else S[R.difference + j]
    S[R.readings + j] = readings
    S[R.difference + j] = median
    S[R.e_2 + j] = S[R.e_1 + j] if due else S[R.e_2 + j]
    S[R.e_1 + j] = e if due else S[R.e_1 + j]
    sigma = control.noise_level(median)
    buffer = control.noise_buffer(S[R.buffer + j], S[R.buffer_ratio + j], S[R.kp + j], sigma, S[R.largest_buffer + j])
    return buffer if S[R.buffer_noise + j] == MEASURED_NOISE else S[R.buffer + j]


@cache
def control_stage(features: ControllerFeatures) -> Any:
    """Return the address of ``control_lanes`` compiled with these features, see CONTROL_SIGNATURE."""
    if features == ControllerFeatures():
        return BUILT_IN
    has_test, control_lanes = features.has_test, make_control(features)

    def controller(S, t, T_set, noise, m_a, enabled, counts_switches):
        if has_test:
            run_test(S, t, T_set, noise, m_a, enabled)
        control_lanes(S, t, T_set, noise, enabled, counts_switches)

    return CONTROL_SIGNATURE.compile(controller, repr(features))
