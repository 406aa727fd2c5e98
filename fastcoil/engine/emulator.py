"""THE loop: time × control volumes × lanes, Figs 6 and 8 of the paper closed.

``emulate`` runs one block of lanes through one day.  It holds the order of things and the state; every
formula is a scalar function of ``physics`` or ``control``.  In step t: measure, learn, PI, inverse, actuator,
Eq (1), Eq (2), record states[t] and signals[t], then Eqs (3) and (4) give states[t + 1].

Sections that would change nothing are skipped for the whole block; a lane's bits are the same either way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.control.inverse import FALLING, direction, extreme, inverse
from fastcoil.control.learning import chatters, switch_frequency, updated
from fastcoil.control.pi import desired_opening, integrated
from fastcoil.engine.lanes import (
    LANES,
    PARAMETER_ROWS,
    T_A,
    T_C,
    T_W,
    VOLUME_ROWS,
    VOLUME_STRIDE,
    W_A,
    Block,
    R,
    trace_rows,
)
from fastcoil.engine.metrics import N_METRICS, T_CENTRE, account_second, account_travel, summarise
from fastcoil.engine.schedule import COUNTED, IN_SWITCH_BLOCK, Schedule
from fastcoil.numerics.elementary import exp
from fastcoil.numerics.jit import kernel, section
from fastcoil.numerics.noise import MEASUREMENT, normal_pair
from fastcoil.outputs import STATUS_OK
from fastcoil.physics.actuator import accepted, motor
from fastcoil.physics.coil import air_heat, effectiveness, metal, outlet, outlet_humidity, water
from fastcoil.physics.psychrometrics import enthalpy, saturation_humidity_ratio
from fastcoil.physics.sensor import lagged, measured
from fastcoil.physics.valve import backlash, installed_valve, opening, water_flow

KNOWN_AFTER_MARCH = ("wet_volumes",)
"""Traces of step t that only the march of step t finds out."""
SERIES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set", "noise", "enabled")
"""Columns of ``Day.series``."""


class Day(NamedTuple):
    """What all lanes of a block live through.

    series: (n_steps, 7), columns as in SERIES.  command: (n_steps,) for an open loop, or empty.  label: of the
    day, keys its noise.  seed: two 32-bit words.
    """

    series: np.ndarray
    command: np.ndarray
    schedule: Schedule
    label: int
    seed: tuple[int, int]


@section
def prepare(S, n_volumes, open_loop):
    """Initial state, and what the parameters amount to per step and per volume (they are given for 8)."""
    per_volume = 8.0 / n_volumes
    nothing = np.nan if open_loop else 0.0
    for j in range(LANES):
        S[R.dt_C_w + j] = 1.0 / (per_volume * S[R.C_w + j])
        S[R.dt_C_c + j] = 1.0 / (per_volume * S[R.C_c + j])
        S[R.eps_w_factor + j] = per_volume * S[R.beta1 + j]
        S[R.eps_a_factor + j] = per_volume * S[R.beta3 + j]
        S[R.eps_star_factor + j] = per_volume * S[R.beta5 + j]
        S[R.max_travel + j] = 1.0 / S[R.stroke_time + j]
        tau = S[R.sensor_time_constant + j]
        S[R.sensor_decay + j] = exp(-1.0 / tau) if tau > 0.0 else 0.0
        S[R.ki + j] = S[R.kp + j] * S[R.sample_time + j] / S[R.ti + j]
        S[R.sign + j] = 1.0 - 2.0 * S[R.action + j]
        if S[R.rangeability + j] > 0.0:
            m_max, a, b, c = installed_valve(S[R.rangeability + j], S[R.authority + j], S[R.m_full + j])
            S[R.m_max + j] = m_max
            S[R.valve_a + j] = a
            S[R.valve_b + j] = b
            S[R.valve_c + j] = c
        if S[R.estimate_ratio + j] >= 0.0:
            S[R.backlash_estimate + j] = S[R.estimate_ratio + j] * S[R.backlash + j]
        S[R.y_s + j] = S[R.T_initial + j]
        S[R.u + j] = nothing
        S[R.integral + j] = nothing
        S[R.sum_switches + j] = nothing
        S[R.estimate + j] = np.nan if open_loop else S[R.backlash_estimate + j]
        S[R.mode + j] = 0.0 if open_loop else FALLING
        S[R.next_update + j] = S[R.learning_interval + j]
        S[R.learning + j] = 1.0 if S[R.learning_step + j] > 0.0 else 0.0
        S[R.reference + j] = -1.0
        S[R.time_reached + j] = np.nan
        S[R.time_confirmed + j] = np.nan
        S[R.time_first_down + j] = np.nan
        S[R.estimate_first_down + j] = np.nan
        S[R.peak_power + j] = -np.inf


@section
def learn(S, t):
    """One update of the estimate where an interval ends, section 3.3."""
    for j in range(LANES):
        if S[R.learning + j] > 0.0 and S[R.next_update + j] == t:
            step, interval = S[R.learning_step + j], S[R.learning_interval + j]
            f = switch_frequency(S[R.switches + j], interval)
            if S[R.reference + j] < 0.0:
                S[R.reference + j] = f
            down = chatters(f, S[R.reference + j], S[R.learning_ratio + j], S[R.learning_floor + j])
            x_hat = updated(S[R.estimate + j], step, down, S[R.backlash_estimate + j], S[R.learning_cap + j])
            S[R.estimate + j] = x_hat
            S[R.switches + j] = 0.0
            S[R.next_update + j] = t + interval
            if np.isnan(S[R.time_reached + j]) and x_hat >= S[R.backlash + j] - 0.5 * step - 1e-12:
                S[R.time_reached + j] = t
            if down and np.isnan(S[R.time_confirmed + j]) and S[R.time_reached + j] <= t:
                S[R.time_confirmed + j] = t
            if down and np.isnan(S[R.time_first_down + j]):
                S[R.time_first_down + j] = t
                S[R.estimate_first_down + j] = x_hat
                if S[R.learning_stop + j] > 0.0:
                    S[R.learning + j] = 0.0


@section
def draw_noise(S, t, k, block, day):
    """Hold a new normal in the lanes that sample now; k: index of the sample where all lanes sample together."""
    if block.samples_together and k % 2 == 1:
        for j in range(LANES):
            S[R.noise + j] = S[R.noise_next + j]
        return
    k0, k1, label = np.uint64(day.seed[0]), np.uint64(day.seed[1]), np.uint64(day.label)
    for j in range(LANES):
        sample = np.int64(S[R.samples + j])
        pair, replicate = np.uint64(sample >> 1), np.uint64(S[R.replicate + j])
        even, odd = normal_pair(pair, np.uint64(MEASUREMENT), replicate, label, k0, k1)
        due = S[R.next_sample + j] == t
        z = odd if sample & 1 else even
        S[R.noise + j] = S[R.noise_std + j] * z if due else S[R.noise + j]
        S[R.noise_next + j] = S[R.noise_std + j] * odd


@section
def control(S, t, T_set, noise, enabled, counts_switches):
    """PI and inverse of the lanes that sample now; the others hold u, and so their command."""
    for j in range(LANES):
        y = measured(S[R.y_s + j], S[R.noise + j] + noise, S[R.sensor_resolution + j])
        e = S[R.sign + j] * (y - T_set)
        due = S[R.next_sample + j] == t
        integral = integrated(S[R.integral + j], e, S[R.ki + j])
        u = desired_opening(e, integral, S[R.kp + j])
        integral = integral if due else S[R.integral + j]
        u = u if due else S[R.u + j]
        integral = integral if enabled else 0.0
        u = u if enabled else 0.0
        S[R.integral + j] = integral
        S[R.u + j] = u
        S[R.next_sample + j] += S[R.sample_time + j] if due else 0.0
        S[R.samples + j] += 1.0 if due else 0.0

        mode = direction(u, S[R.mode + j], S[R.u_ext + j], S[R.buffer + j])
        turned = mode != S[R.mode + j]
        u_ext = extreme(u, mode, S[R.u_ext + j], turned)
        command = inverse(u_ext, mode, S[R.estimate + j])
        S[R.command + j] = command if u_ext != S[R.u_ext + j] else S[R.command + j]
        S[R.u_ext + j] = u_ext
        S[R.mode + j] = mode
        S[R.switches + j] += 1.0 if turned else 0.0
        S[R.sum_switches + j] += counts_switches if turned else 0.0


@section
def actuate(S, counted):
    """Motor and gearbox, Eq (1).  Returns whether a lane moved its valve, and whether a motor still runs."""
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
    return moved, running


@section
def deliver(S):
    """Water flow, Eq (2), and water-side conductance, Eq (4)."""
    for j in range(LANES):
        m_w = water_flow(S[R.opening + j], S[R.m_max + j], S[R.valve_a + j], S[R.valve_b + j], S[R.valve_c + j])
        C_flow = m_w * S[R.cp_w + j]
        S[R.m_w + j] = m_w
        S[R.C_flow + j] = C_flow
        S[R.G_w + j] = effectiveness(S[R.eps_w_factor + j], S[R.beta2 + j], m_w) * C_flow


@section
def air_side(S, m_a, shared):
    """Air-side effectiveness and conductances, Eq (4); ``shared``: β3…β6 are the same in all lanes."""
    if shared:
        eps_a = effectiveness(S[R.eps_a_factor], S[R.beta4], m_a)
        eps_star = effectiveness(S[R.eps_star_factor], S[R.beta6], m_a)
        for j in range(LANES):
            S[R.eps_a + j] = eps_a
            S[R.eps_star + j] = eps_star
    else:
        for j in range(LANES):
            S[R.eps_a + j] = effectiveness(S[R.eps_a_factor + j], S[R.beta4 + j], m_a)
            S[R.eps_star + j] = effectiveness(S[R.eps_star_factor + j], S[R.beta6 + j], m_a)
    for j in range(LANES):
        S[R.G_a + j] = S[R.eps_a + j] * m_a * S[R.cp_a + j]
        S[R.G_star + j] = S[R.eps_star + j] * m_a


@section
def march(S, V, n_volumes, lagged_air, T_a_in, W_a_in, T_w_in, m_a_counted):
    """Eq (3) for every volume, from the air's entrance to its exit: states[t] become states[t + 1].

    The air on its way, T_air and W_air, is what the next volume takes in: the state [t] of the volume passed
    (lagged, as printed), or its outlet of this step (quasistatic).
    """
    for j in range(LANES):
        S[R.T_air + j] = T_a_in
        S[R.W_air + j] = W_a_in
        V[T_W + j] = T_w_in
        S[R.wet_volumes + j] = 0.0
    for i in range(n_volumes, 0, -1):
        pair = V[(i - 1) * VOLUME_STRIDE : (i + 1) * VOLUME_STRIDE]
        for j in range(LANES):
            T_in, W_in = S[R.T_air + j], S[R.W_air + j]
            T_c, T_w, T_w_in_i = pair[VOLUME_STRIDE + T_C + j], pair[VOLUME_STRIDE + T_W + j], pair[T_W + j]

            W_s = saturation_humidity_ratio(T_c, S[R.pressure + j])
            wet = W_in > W_s
            h_in, h_s = enthalpy(T_in, W_in), enthalpy(T_c, W_s)
            Q_a = air_heat(wet, S[R.G_a + j], T_in, T_c, S[R.G_star + j], h_in, h_s)
            T_c_next = metal(T_c, Q_a, S[R.G_w + j], T_w_in_i, S[R.dt_C_c + j])
            T_w_next = water(T_w, T_w_in_i, T_c, S[R.C_flow + j], S[R.G_w + j], S[R.dt_C_w + j])
            T_out = outlet(T_in, T_c, S[R.eps_a + j])
            W_out = outlet_humidity(wet, W_in, outlet(h_in, h_s, S[R.eps_star + j]), T_out)

            S[R.T_air + j] = pair[VOLUME_STRIDE + T_A + j] if lagged_air else T_out
            S[R.W_air + j] = pair[VOLUME_STRIDE + W_A + j] if lagged_air else W_out
            pair[VOLUME_STRIDE + T_C + j] = T_c_next
            pair[VOLUME_STRIDE + T_W + j] = T_w_next
            pair[VOLUME_STRIDE + T_A + j] = T_out
            pair[VOLUME_STRIDE + W_A + j] = W_out
            S[R.wet_volumes + j] += 1.0 if wet else 0.0
            S[R.condensate + j] += m_a_counted * (W_in - W_out)
            far = abs(T_c_next - T_CENTRE)
            S[R.farthest_T_c + j] = far if far > S[R.farthest_T_c + j] else S[R.farthest_T_c + j]


@section
def record(S, V, rows, traces):
    """Copy rows into ``traces`` (n_rows, LANES).  An offset of S is given as it is, one of V below 0 as -1 - offset."""
    for k in range(rows.size):
        row = rows[k]
        traces[k] = S[row : row + LANES] if row >= 0 else V[-1 - row : -1 - row + LANES]


@kernel
def emulate(block, day, S, V, metrics, status, rows, rows_after, trace_interval, traces):
    """Run the lanes of a block through a day.

    block: Block; day: Day; S, V: work space, len(R) * LANES and (block.n_volumes + 1) * VOLUME_STRIDE.
    metrics: out, (N_METRICS, LANES); status: out, (LANES,).
    rows, rows_after: offsets of the traced rows known before, and only after, the march of step t.
    traces: out, (n_points, n_rows + n_rows_after, LANES), the sample at every ``trace_interval`` seconds.
    """
    n_volumes, n_steps = block.n_volumes, day.series.shape[0]
    open_loop = day.command.size > 0
    S[:] = 0.0
    for k in range(len(PARAMETER_ROWS)):
        for j in range(LANES):
            S[k * LANES + j] = block.rows[k, j]
    prepare(S, n_volumes, open_loop)
    for i in range(1, n_volumes + 1):
        v = i * VOLUME_STRIDE
        for j in range(LANES):
            V[v + T_W + j] = S[R.T_initial + j]
            V[v + T_C + j] = S[R.T_initial + j]
            V[v + T_A + j] = S[R.T_initial + j]
            V[v + W_A + j] = day.series[0, 2]

    m_a_known = np.nan
    was_enabled = True
    running = False
    for t in range(n_steps):
        m_a, T_a_in, W_a_in = day.series[t, 0], day.series[t, 1], day.series[t, 2]
        T_w_in, T_set, noise = day.series[t, 3], day.series[t, 4], day.series[t, 5]
        enabled = day.series[t, 6] != 0.0
        flags = day.schedule.flags[t]
        counted = flags & COUNTED != 0

        for j in range(LANES):
            S[R.y_s + j] = lagged(S[R.y_s + j], V[VOLUME_STRIDE + T_A + j], S[R.sensor_decay + j])
        if open_loop:
            for j in range(LANES):
                S[R.command + j] = day.command[t]
        else:
            if block.learning_period > 0 and t > 0 and t % block.learning_period == 0:
                learn(S, t)
            samples = t % block.control_period == 0
            if samples and block.has_noise:
                draw_noise(S, t, t // block.control_period, block, day)
            if samples or was_enabled != enabled:
                control(S, t, T_set, noise, enabled, 1.0 if flags & IN_SWITCH_BLOCK else 0.0)
                running = True
            was_enabled = enabled
        if open_loop or running:
            moved, running = actuate(S, counted)
            if moved or t == 0:
                deliver(S)
        if m_a != m_a_known:
            air_side(S, m_a, block.shares_air_side)
            m_a_known = m_a
        if counted:
            account_second(S, V, flags, T_set, T_w_in, n_volumes)

        traced = traces.shape[0] > 0 and t % trace_interval == 0
        if traced:
            for j in range(LANES):
                S[R.measured + j] = measured(S[R.y_s + j], S[R.noise + j] + noise, S[R.sensor_resolution + j])
                T_w_out = V[n_volumes * VOLUME_STRIDE + T_W + j]
                S[R.power + j] = S[R.sign + j] * (S[R.C_flow + j] * (T_w_out - T_w_in))
            record(S, V, rows, traces[t // trace_interval])
        march(S, V, n_volumes, block.lagged_air, T_a_in, W_a_in, T_w_in, m_a if counted else 0.0)
        if traced:
            record(S, V, rows_after, traces[t // trace_interval, rows.size :])

    summarise(S, V, n_volumes, day.schedule, metrics, status)


class Traces(NamedTuple):
    """Which traces to record, every how many seconds."""

    names: tuple[str, ...] = ()
    interval: int = 1

    def n_points(self, n_steps: int) -> int:
        """Samples of a run of ``n_steps``: seconds 0, interval, 2 interval, …"""
        return -(-n_steps // self.interval) if self.names else 0


def run_block(block: Block, day: Day, wanted: Traces) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Run one block.  Returns metrics (N_METRICS, LANES), status (LANES,) and traces by name.

    A trace is (n_points, LANES), or (n_points, N, LANES) if it has volumes; those of failed lanes are NaN.
    """
    before = [n for n in wanted.names if n not in KNOWN_AFTER_MARCH]
    after = [n for n in wanted.names if n in KNOWN_AFTER_MARCH]
    rows, rows_after = trace_rows(before, block.n_volumes), trace_rows(after, block.n_volumes)
    n_points = wanted.n_points(day.series.shape[0])
    traces = np.empty((n_points, rows.size + rows_after.size, LANES))
    metrics, status = np.empty((N_METRICS, LANES)), np.empty(LANES, dtype=np.int64)
    S, V = np.empty(len(R) * LANES), np.empty((block.n_volumes + 1) * VOLUME_STRIDE)
    emulate(block, day, S, V, metrics, status, rows, rows_after, wanted.interval, traces)

    traces[:, :, status != STATUS_OK] = np.nan
    named, k = {}, 0
    for name in before + after:
        if name in VOLUME_ROWS:
            named[name] = traces[:, k : k + block.n_volumes]
            k += block.n_volumes
        else:
            named[name] = traces[:, k]
            k += 1
    return metrics, status, named
