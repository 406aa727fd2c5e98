"""The coil alone, Eqs (3) and (4): recorded flows and entering states in, leaving temperatures out.

The same march as in ``emulator``; only the water flow comes from a record instead of a valve.
"""

from __future__ import annotations

import numpy as np

from fastcoil.model.engine.initial_state import derive, fill_coil, reset_sums, set_initial_state
from fastcoil.model.engine.lanes import Block, run_sets, work_space
from fastcoil.model.engine.plant import air_side, count_wet, enter, march_air, march_water, water_side
from fastcoil.model.engine.rows import LANES, T_A, T_W, VOLUME_STRIDE, R, positions
from fastcoil.model.numerics.elementary import log
from fastcoil.model.numerics.jit import kernel
from fastcoil.model.physics.coil import NO_FLOW

COIL_COLUMNS = ("m_a", "T_a_in", "W_a_in", "T_w_in", "m_w")
"""Columns of what enters the coil."""
_COIL = positions(COIL_COLUMNS)


@kernel
def march_coil(rows, common, series, at, S, V, T_sup, T_w_out, wet):
    """March the coils of a block through a record.

    series: (n_steps, 5), columns as in COIL_COLUMNS, 1-s samples.  at: (n,), the seconds to record, ascending.
    S, V: work space as for ``emulate``.  T_sup, T_w_out, wet: out, (n, LANES): temperatures at those seconds, °C,
    and the number of wet volumes.
    """
    n_volumes, n_steps = common.n_volumes, series.shape[0]
    derive(S, rows, n_volumes)
    set_initial_state(S, True)
    reset_sums(S, True)
    fill_coil(S, V, n_volumes, series[0, _COIL.W_a_in])

    first, last = VOLUME_STRIDE, n_volumes * VOLUME_STRIDE
    m_a_known, m_w_known = np.nan, np.nan
    everywhere = np.ones(n_volumes + 1, np.bool_)
    k = 0
    for t in range(n_steps):
        m_a, T_a_in, W_a_in = series[t, _COIL.m_a], series[t, _COIL.T_a_in], series[t, _COIL.W_a_in]
        T_w_in, m_w = series[t, _COIL.T_w_in], series[t, _COIL.m_w]
        recorded = k < at.size and at[k] == t
        if recorded:
            for j in range(LANES):
                T_sup[k, j] = V[first + T_A + j]
                T_w_out[k, j] = V[last + T_W + j]
        if m_a != m_a_known:
            air_side(S, m_a)
            m_a_known = m_a
        if m_w != m_w_known:
            log_m_w = log(max(m_w, NO_FLOW))
            for j in range(LANES):
                S[R.log_m_w + j] = log_m_w
                S[R.C_flow + j] = m_w * S[R.cp_w + j]
            water_side(S)
            m_w_known = m_w
        enter(V, n_volumes, T_a_in, W_a_in, T_w_in)
        for part in range(common.substeps):
            march_water(S, V, n_volumes, False, everywhere)
            if recorded and part == 0 and common.lagged_air:
                count_wet(S, V, n_volumes)
            march_air(S, V, n_volumes, common.lagged_air, False, 0.0, 0.0, m_a, 0.0, np.inf, everywhere)
            if recorded and part == 0 and not common.lagged_air:
                count_wet(S, V, n_volumes)
        if recorded:
            for j in range(LANES):
                wet[k, j] = S[R.wet_volumes + j]
            k += 1


def run_coil(matrix: np.ndarray, series: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, ...]:
    """March many parameter sets, (len(PARAMETER_ROWS), n_sets), through a record.

    Returns T_sup, T_w_out, °C, and the number of wet volumes at the seconds ``at``, (n, n_sets).
    """

    def run(block: Block) -> list[np.ndarray]:
        T_sup, T_w_out, wet = (np.empty((at.size, LANES)) for _ in range(3))
        march_coil(block.rows, block.common, series, at, *work_space(block)[:2], T_sup, T_w_out, wet)
        return [T_sup, T_w_out, wet]

    return run_sets(matrix, run)
