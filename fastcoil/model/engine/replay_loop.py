"""The controller alone, Fig 8 without its plant: recorded temperatures in, commands out.

The same estimator, PI and inverse, at the same seconds, as in ``emulator``; only the temperature comes from a record.
"""

from __future__ import annotations

import numpy as np

from fastcoil.model.engine.controller import PLAIN, call_control, control
from fastcoil.model.engine.emulator import record
from fastcoil.model.engine.estimator_stage import call_estimator
from fastcoil.model.engine.initial_state import derive, reset_sums, set_initial_state
from fastcoil.model.engine.lanes import Block, run_sets, trace_rows, work_space
from fastcoil.model.engine.rows import LANES, R, positions
from fastcoil.model.numerics.jit import kernel
from fastcoil.model.numerics.stages import BUILT_IN

REPLAY_COLUMNS = ("T_sup", "T_set", "enabled", "m_a")
"""Columns of what the controller sees."""
_SEEN = positions(REPLAY_COLUMNS)
REPLAY_TRACES = ("u", "integral", "command", "estimate", "mode")


@kernel
def command_of(rows, common, series, S, V, own, traced_rows, interval, traces):
    """What the controllers of a block command on a record.

    series: (n_steps, 4), columns as in REPLAY_COLUMNS, 1-s samples; m_a is NaN where it is not known.  S, V, own: work
    space as for ``emulate``; V is not read.  traced_rows: their offsets.  traces: out, (n_points, n_rows, LANES), every
    ``interval`` seconds.
    """
    derive(S, rows, common.n_volumes)
    set_initial_state(S, False)
    reset_sums(S, False)
    estimates = common.estimate != BUILT_IN
    if estimates:
        call_estimator(common.estimate, (S, own, 0.0, 0.0, 0.0, True, True))
    was_enabled = True
    for t in range(series.shape[0]):
        enabled = series[t, _SEEN.enabled] != 0.0
        for j in range(LANES):
            S[R.y_s + j] = series[t, _SEEN.T_sup]
        if estimates and t > 0 and t % common.estimating_period == 0:
            call_estimator(common.estimate, (S, own, float(t), series[t, _SEEN.T_set], series[t, _SEEN.m_a], enabled, False))
        if t % common.control_period == 0 or was_enabled != enabled:
            if common.control == BUILT_IN:
                control(S, t, series[t, _SEEN.T_set], 0.0, enabled, 0.0, PLAIN)
            else:
                call_control(common.control, (S, t, series[t, _SEEN.T_set], 0.0, enabled, 0.0))
        was_enabled = enabled
        if t % interval == 0:
            record(S, V, traced_rows, traces[t // interval])


def run_replay(matrix: np.ndarray, series: np.ndarray, interval: int) -> dict[str, np.ndarray]:
    """Replay many controllers, (len(PARAMETER_ROWS), n_sets).  Returns each of REPLAY_TRACES, (n_points, n_sets)."""

    def run(block: Block) -> list[np.ndarray]:
        rows = trace_rows(REPLAY_TRACES, block.common.n_volumes)
        traces = np.empty((-(-series.shape[0] // interval), rows.size, LANES))
        S, V, own, _ = work_space(block)
        command_of(block.rows, block.common, series, S, V, own, rows, interval, traces)
        return [traces]

    (found,) = run_sets(matrix, run)
    return {name: found[:, k] for k, name in enumerate(REPLAY_TRACES)}
