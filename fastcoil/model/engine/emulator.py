"""The time loop: time × control volumes × lanes, the closed loop of Figs 6 and 8 of the paper.

``emulate`` keeps the state and the order of the steps; every formula is a scalar function of ``physics`` or
``control``.  Sections that would change nothing are skipped for the whole block, which changes no lane's bits.
"""

from typing import NamedTuple

import numpy as np

from fastcoil.model.engine import coil, metrics, valve
from fastcoil.model.engine.controller import call_control, draw_noise, plain_control
from fastcoil.model.engine.plant import call_plant, march_room
from fastcoil.model.engine.rows import LANES, T_A, T_W, VOLUME_STRIDE, R, begin_run, name_offsets
from fastcoil.model.engine.rules import call_estimator, call_law
from fastcoil.model.numerics.jit import kernel, section
from fastcoil.model.numerics.stages import BUILT_IN
from fastcoil.model.physics import scaled_backlash, sensor_reading, sensor_temperature

DAY_COLUMNS = (
    "m_a", "T_a_in", "W_a_in", "T_w_in", "T_set", "noise", "enabled", "backlash_scale", "T_out", "Q_room", "dp_ratio",
)  # fmt: skip
"""Columns of ``Day.series``."""
DAY_COLUMN = name_offsets(DAY_COLUMNS)


class Day(NamedTuple):
    """The day that all lanes of a block share; label and seed are the key of its noise."""

    series: np.ndarray  # (n_steps, 11), columns as in DAY_COLUMNS
    command: np.ndarray  # (n_steps,) for an open loop, or empty
    schedule: metrics.Schedule
    label: int
    seed: tuple[int, int]  # two 32-bit words
    start: int = 0  # seconds since the start of the first of consecutive days
    was_enabled: bool = True


@section
def record(S, V, rows, traces):
    """Copy rows into ``traces``, (n_rows, LANES); ``rows`` are offsets of S, or -1 - offset for those of V."""
    for k in range(rows.size):
        row = rows[k]
        values = S[row : row + LANES] if row >= 0 else V[-1 - row : -1 - row + LANES]
        for j in range(LANES):  # an assignment of arrays would check their shapes, and compile its messages for 2 s
            traces[k, j] = values[j]


@kernel
def emulate(
    rows, config, day, S, V, estimator_state, law_state, plant_state, metric_rows, status, swings, traced_rows,
    interval, traces,
):  # fmt: skip
    """Run the lanes of a block through a day.

    S, V and the states of the rules: a WorkSpace, from which a day that does not start at 0 goes on.  metric_rows: out,
    (N_METRICS, LANES); status: out, (LANES,); swings: out, see ``hunting``, (n_swing_blocks + 1, N_SWING_ROWS, LANES),
    the last one scratch.  traced_rows: offsets.  traces: out, (n_points, n_rows, LANES), every ``interval`` seconds.
    """
    n_volumes, n_steps, lagged = config.n_volumes, day.series.shape[0], config.lagged_air
    open_loop = day.command.size > 0
    begin_run(S, V, rows, n_volumes, open_loop, day.start == 0, day.series[0, DAY_COLUMN.W_a_in])
    has_estimator = config.estimator != BUILT_IN and not open_loop
    has_law = config.law != BUILT_IN and not open_loop
    if day.start == 0 and has_estimator:
        call_estimator(config.estimator, (S, estimator_state, 0.0, 0.0, 0.0, True, True))
    if day.start == 0 and has_law:
        call_law(config.law, (S, law_state, 0.0, 0.0, 0.0, 0.0, True, True))
    has_plant, n_kept = config.plant != BUILT_IN, config.n_kept
    if day.start == 0 and has_plant:
        valve.update_water_flow(S, config.leaks, config.is_linear)
        call_plant(config.plant, (S, V, plant_state, n_kept, 0, 0.0, 0.0, 0.0, 0.0, True))
    controlled = S[R.T_room :] if config.controls_room else V[VOLUME_STRIDE + T_A :]

    shares_air_side = config.shares_air_side
    eps = np.empty((2, n_steps if shares_air_side else 0))
    coil.fill_air_effectiveness(S, day.series[:, DAY_COLUMN.m_a], eps)
    coldest, dampest = coil.coldest_and_dampest(S, V, n_volumes)
    highest_pressure = S[R.pressure]
    for j in range(1, LANES):  # the method of arrays would load numba's linear algebra with the kernel
        highest_pressure = max(highest_pressure, S[R.pressure + j])
    T_dry, dampest_known = 15.0, np.nan
    may_condense = np.ones(n_volumes + 1, np.bool_)
    m_a_known, scale_known, dp_known = np.nan, np.nan, 1.0
    was_enabled = day.was_enabled
    is_actuator_busy = False
    next_unwatched = 0
    inputs_before = (0.0, 0.0, 0.0, 0.0, 0.0)
    swing_block = 0
    dt = 1.0 / config.substeps
    for t in range(n_steps):
        clock = day.start + t
        now = day.series[t]
        m_a, T_a_in, W_a_in = now[DAY_COLUMN.m_a], now[DAY_COLUMN.T_a_in], now[DAY_COLUMN.W_a_in]
        T_w_in, T_set, noise = now[DAY_COLUMN.T_w_in], now[DAY_COLUMN.T_set], now[DAY_COLUMN.noise]
        enabled, scale = now[DAY_COLUMN.enabled] != 0.0, now[DAY_COLUMN.backlash_scale]
        dp_ratio = now[DAY_COLUMN.dp_ratio]
        flags = day.schedule.flags[t]
        counted = flags & metrics.IS_COUNTED != 0

        if scale != scale_known:
            for j in range(LANES):
                S[R.backlash_scale + j] = scale
                S[R.gap + j] = scaled_backlash(S[R.worn_backlash + j], scale)
            scale_known = scale
            is_actuator_busy = True  # the stem moves into the new gap
        coil.set_inlets(V, n_volumes, T_a_in, W_a_in, T_w_in)
        is_new_m_a = m_a != m_a_known
        if has_plant:
            call_plant(config.plant, (S, V, plant_state, n_kept, clock, m_a, T_a_in, W_a_in, T_w_in, False))
        elif is_new_m_a:
            m_a_known = m_a
            if not shares_air_side:
                coil.update_air_effectiveness(S, m_a)
            elif not lagged:
                coil.set_air_effectiveness(S, eps[0, t], eps[1, t])
        coldest = min(coldest, T_a_in, T_w_in)
        # may_condense is for the next march
        dampest = max(dampest, W_a_in, day.series[min(t + 1, n_steps - 1), DAY_COLUMN.W_a_in])
        if dampest != dampest_known:
            T_dry = coil.dew_point_bound(T_dry, dampest, highest_pressure)
            dampest_known = dampest
        is_mild = coldest > coil.MILD_T and dampest < coil.MILD_W
        dt_counted = dt if counted else 0.0
        if not (lagged or has_plant):
            coil.pass_air(S, V, n_volumes, m_a, dt_counted, is_mild, may_condense)

        if clock == 0:  # the sensor has the temperature of the air
            for j in range(LANES):
                S[R.y_s + j] = controlled[j]
        is_sample = clock % config.control_period == 0
        traced = traces.shape[0] > 0 and t % interval == 0
        if config.has_lag or is_sample or traced or was_enabled != enabled:
            for j in range(LANES):
                S[R.y_s + j] = sensor_temperature(S[R.y_s + j], controlled[j], S[R.sensor_decay + j])
        if is_sample and config.has_noise:
            draw_noise(S, clock, clock // config.control_period, config, day)
        if open_loop:
            for j in range(LANES):
                S[R.command + j] = day.command[t]
        else:
            if has_estimator and clock > 0 and clock % config.estimating_period == 0:
                call_estimator(config.estimator, (S, estimator_state, float(clock), T_set, m_a, enabled, False))
            if is_sample or was_enabled != enabled:
                if has_law:
                    call_law(config.law, (S, law_state, float(clock), T_set, noise, m_a, enabled, False))
                counts_switches = 1.0 if flags & metrics.IN_SWITCH_BLOCK else 0.0
                if config.control == BUILT_IN:
                    plain_control(S, clock, T_set, noise, enabled, counts_switches)
                else:
                    call_control(config.control, (S, clock, T_set, noise, m_a, enabled, counts_switches))
                is_actuator_busy = True
            was_enabled = enabled
        has_moved = False
        if open_loop or is_actuator_busy:
            is_built_in = config.actuator == BUILT_IN
            motion = valve.actuate(S, counted) if is_built_in else valve.call_actuator(config.actuator, (S, counted))
            is_actuator_busy = motion & valve.ACTUATOR_BUSY != 0
            has_moved = motion & valve.VALVE_MOVED != 0 or t == 0
        if has_moved or dp_ratio != dp_known:
            has_moved, dp_known = True, dp_ratio
            valve.update_water_flow(S, config.leaks, config.is_linear)
            if dp_ratio != 1.0:
                for j in range(LANES):
                    valve.scale_water_flow(S, j, dp_ratio)
            coil.update_water_conductance(S)
        if counted:
            metrics.accumulate_second(S, V, controlled, flags, T_set, T_w_in, m_a, n_volumes)
        if flags & metrics.IS_SWING_SAMPLE:
            inputs = (m_a, T_a_in, W_a_in, T_w_in, T_set)
            metrics.watch_swing(S, V, t, flags, inputs_before, inputs, swings[swing_block])
            inputs_before = inputs
            swing_block += 1 if flags & metrics.SWING_BLOCK_ENDS else 0

        if traced:
            for j in range(LANES):
                S[R.measured + j] = sensor_reading(S[R.y_s + j], S[R.noise + j] + noise, S[R.sensor_resolution + j])
                T_w_out = V[n_volumes * VOLUME_STRIDE + T_W + j]
                S[R.power + j] = S[R.sign + j] * (S[R.C_flow + j] * (T_w_out - T_w_in))
            coil.count_wet_volumes(S, V, n_volumes)
            record(S, V, traced_rows, traces[t // interval])
        if config.has_room:
            march_room(S, V, m_a, now[DAY_COLUMN.T_out], now[DAY_COLUMN.Q_room])
        if has_plant:
            pass
        elif lagged:
            for _ in range(config.substeps):
                coil.march_lagged_water(S, V, n_volumes, is_mild, may_condense)
                if shares_air_side:
                    coil.march_lagged_air(
                        S, V, n_volumes, True, eps[0, t], eps[1, t], m_a, dt_counted, T_dry, may_condense
                    )
                else:
                    coil.march_lagged_air(S, V, n_volumes, False, 0.0, 0.0, m_a, dt_counted, T_dry, may_condense)
        else:
            if has_moved:
                coil.update_half_step_of_water(S)
            if has_moved or is_new_m_a:
                coil.update_half_step_of_metal(S, m_a)
            coil.exchange_heat(S, V, n_volumes, T_dry, may_condense)
            for _ in range(1, config.substeps):
                coil.pass_air(S, V, n_volumes, m_a, dt_counted, is_mild, may_condense)
                coil.exchange_heat(S, V, n_volumes, T_dry, may_condense)

        if t % metrics.WATCH_INTERVAL_S == 0 or t == n_steps - 1:
            metrics.track_metal_extremes(S, V, n_volumes)
            if not (is_mild or has_plant):
                metrics.accumulate_frost(S, V, n_volumes, t + 1 - next_unwatched)
            next_unwatched = t + 1
            coldest, dampest = coil.coldest_and_dampest(S, V, n_volumes)

    metrics.summarise(S, V, n_volumes, day.schedule, metric_rows, status)
