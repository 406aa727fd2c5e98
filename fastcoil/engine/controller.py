"""The controller of Fig 8 over a block of lanes: learner, noise on the sensor, PI, inverse."""

from __future__ import annotations

import numpy as np

from fastcoil.control.inverse import direction, extreme, inverse
from fastcoil.control.learner import ENOUGH, chatters, evidence, final_estimate, step_size, switch_frequency, updated
from fastcoil.control.pi import desired_opening, integrated, sample_number
from fastcoil.engine.metrics import account_learner_step
from fastcoil.engine.rows import LANES, R
from fastcoil.numerics.jit import section
from fastcoil.numerics.noise import MEASUREMENT, normal_pair
from fastcoil.physics.sensor import measured


@section
def learn(S, t):
    """Update the estimates, section 3.3, where an interval ends or, with an early trip, as soon as it chatters."""
    for j in range(LANES):
        if S[R.learning + j] > 0.0:
            interval, sample_time = S[R.learning_interval + j], S[R.sample_time + j]
            ends = S[R.next_update + j] == t
            f, f_ref = switch_frequency(S[R.switches + j], interval), S[R.reference + j]
            good = evidence(
                S[R.switches + j],
                f,
                f_ref,
                sample_time,
                S[R.learning_min_switches + j],
                S[R.learning_max_reference + j],
            )
            if ends and f_ref < 0.0 and good == ENOUGH:
                S[R.reference + j] = f
            down = chatters(f, S[R.reference + j], S[R.learning_ratio + j], S[R.learning_floor + j])
            # for the sake of other lanes this may run more often than this one samples
            samples = sample_number(t, sample_time) * sample_time == t
            trips = S[R.learning_early_trip + j] > 0.0 and S[R.reference + j] >= 0.0 and down and samples
            if ends or trips:
                S[R.evidence + j] = good
                S[R.switches + j] = 0.0
                S[R.next_update + j] = t + interval
                if good == ENOUGH:
                    step_estimate(S, j, t, down)


@section
def step_estimate(S, j, t, down):
    """One step of lane j's estimate."""
    lower, cap = S[R.backlash_estimate + j], S[R.learning_cap + j]
    step = step_size(S[R.step + j], down, S[R.climbing + j] > 0.0, S[R.learning_growth + j])
    x_hat = updated(S[R.estimate + j], step, down, lower, cap)
    account_learner_step(S, j, t, down, x_hat)
    if down and S[R.climbing + j] > 0.0:
        S[R.climbing + j] = 0.0
        if S[R.learning_stop + j] > 0.0:
            S[R.learning + j] = 0.0
            x_hat = final_estimate(x_hat, S[R.learning_final + j], lower)
    S[R.estimate + j] = x_hat
    S[R.step + j] = step * S[R.learning_shrink + j] if down else step


@section
def draw_noise(S, t, k, block, day):
    """Draw a normal number for the lanes that sample now.  k: number of the sample, where all lanes sample together."""
    if block.samples_together and k % 2 == 1:
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
def control(S, t, T_set, noise, enabled, counts_switches):
    """Run PI and inverse of the lanes that sample now; the others hold u, and so their command."""
    for j in range(LANES):
        y = measured(S[R.y_s + j], S[R.noise + j] + noise, S[R.sensor_resolution + j])
        e = S[R.sign + j] * (y - T_set)
        due = sample_number(t, S[R.sample_time + j]) * S[R.sample_time + j] == t
        integral = integrated(S[R.integral + j], e, S[R.ki + j])
        u = desired_opening(e, integral, S[R.kp + j])
        integral = integral if due else S[R.integral + j]
        u = u if due else S[R.u + j]
        integral = integral if enabled else 0.0
        u = u if enabled else 0.0
        S[R.integral + j] = integral
        S[R.u + j] = u

        mode = direction(u, S[R.mode + j], S[R.u_ext + j], S[R.buffer + j])
        turned = mode != S[R.mode + j]
        u_ext = extreme(u, mode, S[R.u_ext + j], turned)
        command = inverse(u_ext, mode, S[R.estimate + j])
        S[R.command + j] = command if u_ext != S[R.u_ext + j] else S[R.command + j]
        S[R.u_ext + j] = u_ext
        S[R.mode + j] = mode
        S[R.switches + j] += 1.0 if turned else 0.0
        S[R.sum_switches + j] += counts_switches if turned else 0.0
