"""THE loop: time × control volumes × lanes, the closed loop of Figs 6 and 8 of the paper.

``emulate`` runs one block of lanes through one day.  It keeps the state and the order of the steps; every
formula is a scalar function of ``physics`` or ``control``.  In second t: measure, estimate, PI, inverse, actuator,
Eq (1), Eq (2), record states[t] and signals[t], then Eqs (3) and (4) give states[t + 1].

Sections that would change nothing are skipped for the whole block; a lane's bits are the same either way.
"""

from typing import NamedTuple

import numpy as np

from fastcoil.model.engine.controller import PLAIN, call_control, control, draw_noise
from fastcoil.model.engine.metrics import (
    COUNTED,
    IN_SWITCH_BLOCK,
    WATCH_INTERVAL,
    Schedule,
    account_second,
    summarise,
    watch,
    watch_frost,
)
from fastcoil.model.engine.plant import (
    MILD_T,
    MILD_W,
    MOVED,
    RUNNING,
    actuate,
    air_side,
    call_stem,
    count_wet,
    deliver,
    dry_from,
    enter,
    extremes,
    highest_pressure,
    march_air,
    march_water,
    scale_gap,
    shared_air_side,
)
from fastcoil.model.engine.rows import LANES, T_A, T_W, VOLUME_STRIDE, R, begin, positions
from fastcoil.model.engine.rules import call_estimator, call_law
from fastcoil.model.numerics.jit import kernel, section
from fastcoil.model.numerics.stages import BUILT_IN
from fastcoil.model.physics import lagged, measured

DAY_COLUMNS = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set", "noise", "enabled", "backlash_scale")
"""Columns of ``Day.series``."""
C = positions(DAY_COLUMNS)


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
        held = S[row : row + LANES] if row >= 0 else V[-1 - row : -1 - row + LANES]
        for j in range(LANES):  # an assignment of arrays would check their shapes, and compile its messages for 2 s
            traces[k, j] = held[j]


@kernel
def emulate(rows, common, day, S, V, own, own_law, metrics, status, traced_rows, rows_after, trace_interval, traces):
    """Run the lanes of a block through a day.

    rows, common: of a Block; day: Day; S, V, own, own_law: work space, see ``work_space``.  A day that does not start
    at 0 goes on with what they hold.
    metrics: out, (N_METRICS, LANES); status: out, (LANES,).
    traced_rows, rows_after: offsets of the traced rows known before, and only after, the march of step t.
    traces: out, (n_points, n_rows + n_rows_after, LANES), the sample at every ``trace_interval`` seconds.
    """
    n_volumes, n_steps = common.n_volumes, day.series.shape[0]
    open_loop = day.command.size > 0
    begin(S, V, rows, n_volumes, open_loop, day.start == 0, day.series[0, C.W_a_in])
    estimates = common.estimate != BUILT_IN and not open_loop
    has_law = common.law != BUILT_IN and not open_loop
    if day.start == 0:
        if estimates:
            call_estimator(common.estimate, (S, own, 0.0, 0.0, 0.0, True, True))
        if has_law:
            call_law(common.law, (S, own_law, 0.0, 0.0, 0.0, 0.0, True, True))

    shared = common.shares_air_side
    eps = np.empty((2, n_steps if shared else 0))
    shared_air_side(S, day.series[:, C.m_a], eps)
    coldest, dampest = extremes(S, V, n_volumes)
    pressure = highest_pressure(S)
    T_dry, dampest_known = 15.0, np.nan
    damp = np.ones(n_volumes + 1, np.bool_)
    m_a_known, scale_known = np.nan, np.nan
    was_enabled = day.was_enabled
    running = False
    looked = 0
    dt = 1.0 / common.substeps
    for t in range(n_steps):
        clock = day.start + t
        m_a, T_a_in, W_a_in = day.series[t, C.m_a], day.series[t, C.T_a_in], day.series[t, C.W_a_in]
        T_w_in, T_set, noise = day.series[t, C.T_w_in], day.series[t, C.T_set], day.series[t, C.noise]
        enabled = day.series[t, C.enabled] != 0.0
        flags = day.schedule.flags[t]
        counted = flags & COUNTED != 0

        scale = day.series[t, C.backlash_scale]
        if scale != scale_known:
            scale_gap(S, scale)
            scale_known = scale
            running = True
        samples = clock % common.control_period == 0
        traced = traces.shape[0] > 0 and t % trace_interval == 0
        if common.has_lag or samples or traced or was_enabled != enabled:
            for j in range(LANES):
                S[R.y_s + j] = lagged(S[R.y_s + j], V[VOLUME_STRIDE + T_A + j], S[R.sensor_decay + j])
        if samples and common.has_noise:
            draw_noise(S, clock, clock // common.control_period, common, day)
        if open_loop:
            for j in range(LANES):
                S[R.command + j] = day.command[t]
        else:
            if estimates and clock > 0 and clock % common.estimating_period == 0:
                call_estimator(common.estimate, (S, own, float(clock), T_set, m_a, enabled, False))
            if samples or was_enabled != enabled:
                if has_law:
                    call_law(common.law, (S, own_law, float(clock), T_set, noise, m_a, enabled, False))
                counts = 1.0 if flags & IN_SWITCH_BLOCK else 0.0
                if common.control != BUILT_IN:
                    call_control(common.control, (S, clock, T_set, noise, enabled, counts))
                elif samples and common.samples_together:
                    control(S, clock, T_set, noise, enabled, counts, PLAIN, True)
                else:
                    control(S, clock, T_set, noise, enabled, counts, PLAIN, False)
                running = True
            was_enabled = enabled
        if open_loop or running:
            plain = common.stem == BUILT_IN
            found = actuate(S, counted, False, False, False, False) if plain else call_stem(common.stem, (S, counted))
            running = found & RUNNING != 0
            if found & MOVED != 0 or t == 0:
                deliver(S, common.leaks)
        if m_a != m_a_known and not shared:
            air_side(S, m_a)
            m_a_known = m_a
        if counted:
            account_second(S, V, t, flags, T_set, T_w_in, m_a, n_volumes)

        if traced:
            for j in range(LANES):
                S[R.measured + j] = measured(S[R.y_s + j], S[R.noise + j] + noise, S[R.sensor_resolution + j])
                T_w_out = V[n_volumes * VOLUME_STRIDE + T_W + j]
                S[R.power + j] = S[R.sign + j] * (S[R.C_flow + j] * (T_w_out - T_w_in))
            record(S, V, traced_rows, traces[t // trace_interval])
        enter(V, n_volumes, T_a_in, W_a_in, T_w_in)
        coldest = min(coldest, T_a_in, T_w_in)
        dampest = max(dampest, W_a_in, day.series[min(t + 1, n_steps - 1), C.W_a_in])  # damp is for the next march
        if dampest != dampest_known:
            T_dry = dry_from(T_dry, dampest, pressure)
            dampest_known = dampest
        if traced:
            damp[:] = True  # who counts wet volumes wants saturation everywhere
        is_mild = coldest > MILD_T and dampest < MILD_W
        dt_counted = dt if counted else 0.0
        for part in range(common.substeps):
            march_water(S, V, n_volumes, is_mild, damp)
            if traced and part == 0 and common.lagged_air:
                count_wet(S, V, n_volumes)
            if shared:
                march_air(S, V, n_volumes, common.lagged_air, True, eps[0, t], eps[1, t], m_a, dt_counted, T_dry, damp)
            else:
                march_air(S, V, n_volumes, common.lagged_air, False, 0.0, 0.0, m_a, dt_counted, T_dry, damp)
            if traced and part == 0 and not common.lagged_air:
                count_wet(S, V, n_volumes)
        if traced:
            record(S, V, rows_after, traces[t // trace_interval, traced_rows.size :])

        if t % WATCH_INTERVAL == 0 or t == n_steps - 1:
            watch(S, V, n_volumes)
            if not is_mild:
                watch_frost(S, V, n_volumes, t + 1 - looked)
            looked = t + 1
            coldest, dampest = extremes(S, V, n_volumes)

    summarise(S, V, n_volumes, day.schedule, metrics, status)
