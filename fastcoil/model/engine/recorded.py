"""Parts of the loop on recorded signals, with the formulas of ``emulate``: coil, valve, gap of a stem, controller."""

import numpy as np

from fastcoil.model import physics
from fastcoil.model.engine import coil
from fastcoil.model.engine.controller import call_control, plain_control
from fastcoil.model.engine.emulator import record
from fastcoil.model.engine.lanes import NO_USER_RULES, Block, UserRules, run_sets, trace_rows, work_space
from fastcoil.model.engine.rows import LANES, T_A, T_W, VOLUME_STRIDE, R, begin_run, name_offsets
from fastcoil.model.engine.rules import call_estimator, call_law
from fastcoil.model.numerics.elementary import exp, log
from fastcoil.model.numerics.jit import kernel
from fastcoil.model.numerics.stages import BUILT_IN

COIL_COLUMNS = ("m_a", "T_a_in", "W_a_in", "T_w_in", "m_w")
"""Columns of the signals at the inlets of the coil."""
_COIL_COLUMN = name_offsets(COIL_COLUMNS)


@kernel
def march_coil(rows, config, series, seconds, S, V, T_sup, T_w_out, wet):
    """March the coils of a block through a record.

    series: (n_steps, 5), columns as in COIL_COLUMNS, 1-s samples.  seconds: (n,), to record, ascending.  S, V: as for
    ``emulate``.  T_sup, T_w_out, °C, wet (number of volumes): out, (n, LANES).
    """
    n_volumes, n_steps = config.n_volumes, series.shape[0]
    begin_run(S, V, rows, n_volumes, True, True, series[0, _COIL_COLUMN.W_a_in])
    first, last = VOLUME_STRIDE, n_volumes * VOLUME_STRIDE
    m_a_known, m_w_known = np.nan, np.nan
    all_volumes = np.ones(n_volumes + 1, np.bool_)
    k = 0
    for t in range(n_steps):
        now = series[t]
        m_a, T_a_in, W_a_in = now[_COIL_COLUMN.m_a], now[_COIL_COLUMN.T_a_in], now[_COIL_COLUMN.W_a_in]
        T_w_in, m_w = now[_COIL_COLUMN.T_w_in], now[_COIL_COLUMN.m_w]
        if m_a != m_a_known:
            coil.update_air_effectiveness(S, m_a)
        if m_w != m_w_known:
            log_m_w = log(max(m_w, physics.LEAST_WATER_FLOW_KG_S))
            for j in range(LANES):
                S[R.log_m_w + j] = log_m_w
                S[R.C_flow + j] = m_w * S[R.cp_w + j]
            coil.update_water_conductance(S)
        if m_a != m_a_known or m_w != m_w_known:
            coil.update_half_step_of_water(S)
            coil.update_half_step_of_metal(S, m_a)
            m_a_known, m_w_known = m_a, m_w
        coil.set_inlets(V, n_volumes, T_a_in, W_a_in, T_w_in)
        if not config.lagged_air:
            coil.pass_air(S, V, n_volumes, m_a, 0.0, False, all_volumes)
        if k < seconds.size and seconds[k] == t:
            coil.count_wet_volumes(S, V, n_volumes)
            for j in range(LANES):
                T_sup[k, j] = V[first + T_A + j]
                T_w_out[k, j] = V[last + T_W + j]
                wet[k, j] = S[R.wet_volumes + j]
            k += 1
        for substep in range(config.substeps):
            if config.lagged_air:
                coil.march_lagged_water(S, V, n_volumes, False, all_volumes)
                coil.march_lagged_air(S, V, n_volumes, False, 0.0, 0.0, m_a, 0.0, np.inf, all_volumes)
            else:
                if substep > 0:
                    coil.pass_air(S, V, n_volumes, m_a, 0.0, False, all_volumes)
                coil.exchange_heat(S, V, n_volumes, np.inf, all_volumes)


def run_coil(matrix: np.ndarray, series: np.ndarray, seconds: np.ndarray) -> tuple[np.ndarray, ...]:
    """March sets, (rows, n_sets), through a record: T_sup, T_w_out, °C, number of wet volumes, (n, n_sets)."""

    def run_block(block: Block, _: np.ndarray) -> list[np.ndarray]:
        T_sup, T_w_out, wet = (np.empty((seconds.size, LANES)) for _ in range(3))
        march_coil(block.rows, block.config, series, seconds, *work_space(block)[:2], T_sup, T_w_out, wet)
        return [T_sup, T_w_out, wet]

    return run_sets(matrix, run_block)


VALVE_ROWS = ("backlash", "m_max", "valve_a", "valve_b", "valve_c")
"""Rows of the parameter sets of ``valve_flows``."""
_VALVE_ROW = name_offsets(VALVE_ROWS)


@kernel
def valve_flows(command, batch, sets, start, openings, flows):
    """Compute the water flow of every parameter set at every recorded command.

    command: (n,), fraction of stroke.  batch: (n,), number of the unbroken piece of a sample; nothing is known of the
    time before a piece.  sets: (5, n_sets), rows as in VALVE_ROWS.  start: (n_batches, n_sets), place in the gap where
    a piece starts, 0 falling to 1 rising.  openings, flows: out, (n, n_sets), fraction and kg/s.
    """
    n_sets = sets.shape[1]
    q = np.empty(n_sets)
    log_m_max = np.empty(n_sets)
    for j in range(n_sets):
        log_m_max[j] = log(sets[_VALVE_ROW.m_max, j])
    for t in range(command.size):
        if t == 0 or batch[t] != batch[t - 1]:
            for j in range(n_sets):
                q[j] = physics.initial_stem_position(command[t], sets[_VALVE_ROW.backlash, j], start[batch[t], j])
        elif command[t] == command[t - 1]:
            for j in range(n_sets):
                openings[t, j] = openings[t - 1, j]
                flows[t, j] = flows[t - 1, j]
            continue
        for j in range(n_sets):
            q[j] = physics.backlash(q[j], command[t], sets[_VALVE_ROW.backlash, j])
            openings[t, j] = physics.opening(q[j], sets[_VALVE_ROW.backlash, j])
        for j in range(n_sets):
            growth = physics.flow_exponential(openings[t, j], sets[_VALVE_ROW.valve_b, j], sets[_VALVE_ROW.valve_c, j])
            flows[t, j] = exp(physics.log_flow(log_m_max[j], sets[_VALVE_ROW.valve_a, j], growth))


@kernel
def motor_positions(command, max_travel, positions):
    """Compute the motor position just before the command of each sample acts, and one sample after the last.

    command: (n,), fraction of stroke, held from sample to sample.  max_travel: fraction of stroke between two samples.
    positions: out, (n + 1,).  The motor starts at the first command.
    """
    positions[0] = command[0]
    for k in range(command.size):
        positions[k + 1] = physics.motor_position(positions[k], command[k], max_travel)


@kernel
def mean_openings(positions, sizes, width, openings, squares):
    """Average the opening behind each candidate backlash, and its square, over ``width`` intervals at a time.

    positions: (n + 1,), of the motor.  sizes: (c,), fractions of stroke.  openings, squares: out, (m, c).  Between two
    samples the motor runs one way: Eq (1) at the samples is exact, and the opening between them counts as the mean of
    both.  The stem starts in the middle of its play, which matters until a turn first closes the gap.
    """
    q = np.empty(sizes.size)
    before = np.empty(sizes.size)
    for j in range(sizes.size):
        q[j] = min(max(positions[0] - sizes[j] / 2.0, 0.0), 1.0 - sizes[j])
        q[j] = physics.backlash(q[j], positions[0], sizes[j])
        before[j] = physics.opening(q[j], sizes[j])
    for k in range(openings.shape[0]):
        for j in range(sizes.size):
            openings[k, j] = 0.0
            squares[k, j] = 0.0
        for i in range(k * width + 1, (k + 1) * width + 1):
            for j in range(sizes.size):
                q[j] = physics.backlash(q[j], positions[i], sizes[j])
                current = physics.opening(q[j], sizes[j])
                mean_opening = 0.5 * (before[j] + current)
                openings[k, j] += mean_opening / width
                squares[k, j] += mean_opening * mean_opening / width
                before[j] = current


REPLAY_COLUMNS = ("T_sup", "T_set", "enabled", "m_a")
"""Columns of the inputs of the controller."""
_REPLAY_COLUMN = name_offsets(REPLAY_COLUMNS)
REPLAY_TRACES = ("u", "integral", "command", "estimate", "mode")


@kernel
def replay_controllers(
    rows, config, series, S, V, estimator_state, law_state, plant_state, traced_rows, interval, traces
):
    """Run the controllers of a block on a record.

    series: (n_steps, 4), columns as in REPLAY_COLUMNS, 1-s samples; m_a is NaN where it is not known.  S, V
    and the states of the rules: a WorkSpace; V and plant_state are not read.  traced_rows: offsets.  traces: out,
    (n_points, n_rows, LANES), every ``interval`` seconds.
    """
    begin_run(S, V, rows, config.n_volumes, False, True, 0.0)
    has_estimator = config.estimator != BUILT_IN
    if has_estimator:
        call_estimator(config.estimator, (S, estimator_state, 0.0, 0.0, 0.0, True, True))
    has_law = config.law != BUILT_IN
    if has_law:
        call_law(config.law, (S, law_state, 0.0, 0.0, 0.0, 0.0, True, True))
    was_enabled = True
    for t in range(series.shape[0]):
        now = series[t]
        enabled, T_set, m_a = now[_REPLAY_COLUMN.enabled] != 0.0, now[_REPLAY_COLUMN.T_set], now[_REPLAY_COLUMN.m_a]
        for j in range(LANES):
            S[R.y_s + j] = now[_REPLAY_COLUMN.T_sup]
        if has_estimator and t > 0 and t % config.estimating_period == 0:
            call_estimator(config.estimator, (S, estimator_state, float(t), T_set, m_a, enabled, False))
        if t % config.control_period == 0 or was_enabled != enabled:
            if has_law:
                call_law(config.law, (S, law_state, float(t), T_set, 0.0, m_a, enabled, False))
            if config.control == BUILT_IN:
                plain_control(S, t, T_set, 0.0, enabled, 0.0)
            else:
                call_control(config.control, (S, t, T_set, 0.0, m_a, enabled, 0.0))
        was_enabled = enabled
        if t % interval == 0:
            record(S, V, traced_rows, traces[t // interval])


def run_replay(
    matrix: np.ndarray, series: np.ndarray, interval: int, rules: UserRules = NO_USER_RULES
) -> dict[str, np.ndarray]:
    """Replay many controllers, (len(PARAMETER_ROWS), n_sets); return each of REPLAY_TRACES, (n_points, n_sets)."""

    def run_block(block: Block, _: np.ndarray) -> list[np.ndarray]:
        rows = trace_rows(REPLAY_TRACES, block.config.n_volumes)
        traces = np.empty((-(-series.shape[0] // interval), rows.size, LANES))
        replay_controllers(block.rows, block.config, series, *work_space(block), rows, interval, traces)
        return [traces]

    (replays,) = run_sets(matrix, run_block, rules)
    return {name: replays[:, k] for k, name in enumerate(REPLAY_TRACES)}
