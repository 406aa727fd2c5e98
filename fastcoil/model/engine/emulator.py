"""THE loop: time × control volumes × lanes, the closed loop of Figs 6 and 8 of the paper.

``emulate`` runs one block of lanes through one day.  It keeps the state and the order of the steps; every
formula is a scalar function of ``physics`` or ``control``.  In second t: measure, estimate, PI, inverse, actuator,
Eq (1), Eq (2), record states[t] and signals[t], then Eqs (3) and (4) give states[t + 1].

Sections that would change nothing are skipped for the whole block; a lane's bits are the same either way.
"""

from typing import NamedTuple

import numpy as np

from fastcoil.model.engine.controller import call_control, control, draw_noise
from fastcoil.model.engine.metrics import (
    IN_SWITCH_BLOCK,
    IS_COUNTED,
    WATCH_INTERVAL_S,
    Schedule,
    accumulate_frost,
    accumulate_second,
    summarise,
    track_metal_extremes,
)
from fastcoil.model.engine.plant import (
    ACTUATOR_BUSY,
    MILD_T,
    MILD_W,
    VALVE_MOVED,
    actuate,
    call_actuator,
    coldest_and_dampest,
    count_wet_volumes,
    dew_point_bound,
    fill_air_effectiveness,
    highest_pressure,
    march_air,
    march_water,
    scale_gap,
    set_inlets,
    update_air_effectiveness,
    update_water_flow,
)
from fastcoil.model.engine.rows import LANES, T_A, T_W, VOLUME_STRIDE, R, begin_run, name_offsets
from fastcoil.model.engine.rules import call_estimator, call_law
from fastcoil.model.numerics.jit import kernel, section
from fastcoil.model.numerics.stages import BUILT_IN
from fastcoil.model.physics import sensor_reading, sensor_temperature

DAY_COLUMNS = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set", "noise", "enabled", "backlash_scale")
"""Columns of ``Day.series``."""
DAY_COLUMN = name_offsets(DAY_COLUMNS)


class Day(NamedTuple):
    """The day that all lanes of a block share.

    series: (n_steps, 8), columns as in DAY_COLUMNS.  command: (n_steps,) for an open loop, or empty.  label: of the
    day; it and the seed, two 32-bit words, key the noise.  start: seconds from the first of several days that follow
    one another; from there on controllers, estimators and noise go on.  was_enabled: whether the loop was on before.
    """

    series: np.ndarray
    command: np.ndarray
    schedule: Schedule
    label: int
    seed: tuple[int, int]
    start: int = 0
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
    rows,
    config,
    day,
    S,
    V,
    estimator_state,
    law_state,
    metrics,
    status,
    traced_rows,
    traced_rows_after,
    trace_interval,
    traces,
):
    """Run the lanes of a block through a day.

    rows, common: of a Block; day: Day; S, V, own, own_law: work space, see ``work_space``.  A day that does not start
    at 0 goes on with what they hold.
    metrics: out, (N_METRICS, LANES); status: out, (LANES,).
    traced_rows, rows_after: offsets of the traced rows known before, and only after, the march of step t.
    traces: out, (n_points, n_rows + n_rows_after, LANES), the sample at every ``trace_interval`` seconds.
    """
    n_volumes, n_steps = config.n_volumes, day.series.shape[0]
    open_loop = day.command.size > 0
    begin_run(S, V, rows, n_volumes, open_loop, day.start == 0, day.series[0, DAY_COLUMN.W_a_in])
    has_estimator = config.estimate != BUILT_IN and not open_loop
    has_law = config.law != BUILT_IN and not open_loop
    if day.start == 0:
        if has_estimator:
            call_estimator(config.estimate, (S, estimator_state, 0.0, 0.0, 0.0, True, True))
        if has_law:
            call_law(config.law, (S, law_state, 0.0, 0.0, 0.0, 0.0, True, True))

    shares_air_side = config.shares_air_side
    eps = np.empty((2, n_steps if shares_air_side else 0))
    fill_air_effectiveness(S, day.series[:, DAY_COLUMN.m_a], eps)
    coldest, dampest = coldest_and_dampest(S, V, n_volumes)
    pressure = highest_pressure(S)
    T_dry, dampest_known = 15.0, np.nan
    may_condense = np.ones(n_volumes + 1, np.bool_)
    m_a_known, scale_known = np.nan, np.nan
    was_enabled = day.was_enabled
    is_actuator_busy = False
    next_unwatched = 0
    dt = 1.0 / config.substeps
    for t in range(n_steps):
        clock = day.start + t
        m_a, T_a_in, W_a_in = (
            day.series[t, DAY_COLUMN.m_a],
            day.series[t, DAY_COLUMN.T_a_in],
            day.series[t, DAY_COLUMN.W_a_in],
        )
        T_w_in, T_set, noise = (
            day.series[t, DAY_COLUMN.T_w_in],
            day.series[t, DAY_COLUMN.T_set],
            day.series[t, DAY_COLUMN.noise],
        )
        enabled = day.series[t, DAY_COLUMN.enabled] != 0.0
        flags = day.schedule.flags[t]
        counted = flags & IS_COUNTED != 0

        scale = day.series[t, DAY_COLUMN.backlash_scale]
        if scale != scale_known:
            scale_gap(S, scale)
            scale_known = scale
            is_actuator_busy = True
        is_sample = clock % config.control_period == 0
        traced = traces.shape[0] > 0 and t % trace_interval == 0
        if config.has_lag or is_sample or traced or was_enabled != enabled:
            for j in range(LANES):
                S[R.y_s + j] = sensor_temperature(S[R.y_s + j], V[VOLUME_STRIDE + T_A + j], S[R.sensor_decay + j])
        if is_sample and config.has_noise:
            draw_noise(S, clock, clock // config.control_period, config, day)
        if open_loop:
            for j in range(LANES):
                S[R.command + j] = day.command[t]
        else:
            if has_estimator and clock > 0 and clock % config.estimating_period == 0:
                call_estimator(config.estimate, (S, estimator_state, float(clock), T_set, m_a, enabled, False))
            if is_sample or was_enabled != enabled:
                if has_law:
                    call_law(config.law, (S, law_state, float(clock), T_set, noise, m_a, enabled, False))
                counts_switches = 1.0 if flags & IN_SWITCH_BLOCK else 0.0
                if config.control == BUILT_IN:
                    control(S, clock, T_set, noise, enabled, counts_switches)
                else:
                    call_control(config.control, (S, clock, T_set, noise, enabled, counts_switches))
                is_actuator_busy = True
            was_enabled = enabled
        if open_loop or is_actuator_busy:
            is_built_in = config.stem == BUILT_IN
            actuator_flags = actuate(S, counted) if is_built_in else call_actuator(config.stem, (S, counted))
            is_actuator_busy = actuator_flags & ACTUATOR_BUSY != 0
            if actuator_flags & VALVE_MOVED != 0 or t == 0:
                update_water_flow(S, config.leaks)
        if m_a != m_a_known and not shares_air_side:
            update_air_effectiveness(S, m_a)
            m_a_known = m_a
        if counted:
            accumulate_second(S, V, t, flags, T_set, T_w_in, m_a, n_volumes)

        if traced:
            for j in range(LANES):
                S[R.measured + j] = sensor_reading(S[R.y_s + j], S[R.noise + j] + noise, S[R.sensor_resolution + j])
                T_w_out = V[n_volumes * VOLUME_STRIDE + T_W + j]
                S[R.power + j] = S[R.sign + j] * (S[R.C_flow + j] * (T_w_out - T_w_in))
            record(S, V, traced_rows, traces[t // trace_interval])
        set_inlets(V, n_volumes, T_a_in, W_a_in, T_w_in)
        coldest = min(coldest, T_a_in, T_w_in)
        dampest = max(
            dampest, W_a_in, day.series[min(t + 1, n_steps - 1), DAY_COLUMN.W_a_in]
        )  # damp is for the next march
        if dampest != dampest_known:
            T_dry = dew_point_bound(T_dry, dampest, pressure)
            dampest_known = dampest
        if traced:
            may_condense[:] = True  # who counts wet volumes wants saturation everywhere
        is_mild = coldest > MILD_T and dampest < MILD_W
        dt_counted = dt if counted else 0.0
        for substep in range(config.substeps):
            march_water(S, V, n_volumes, is_mild, may_condense)
            if traced and substep == 0 and config.lagged_air:
                count_wet_volumes(S, V, n_volumes)
            if shares_air_side:
                march_air(
                    S, V, n_volumes, config.lagged_air, True, eps[0, t], eps[1, t], m_a, dt_counted, T_dry, may_condense
                )
            else:
                march_air(S, V, n_volumes, config.lagged_air, False, 0.0, 0.0, m_a, dt_counted, T_dry, may_condense)
            if traced and substep == 0 and not config.lagged_air:
                count_wet_volumes(S, V, n_volumes)
        if traced:
            record(S, V, traced_rows_after, traces[t // trace_interval, traced_rows.size :])

        if t % WATCH_INTERVAL_S == 0 or t == n_steps - 1:
            track_metal_extremes(S, V, n_volumes)
            if not is_mild:
                accumulate_frost(S, V, n_volumes, t + 1 - next_unwatched)
            next_unwatched = t + 1
            coldest, dampest = coldest_and_dampest(S, V, n_volumes)

    summarise(S, V, n_volumes, day.schedule, metrics, status)
