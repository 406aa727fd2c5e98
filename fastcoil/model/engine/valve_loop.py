"""The valve alone, Eqs (1) and (2): recorded commands in, flows of many parameter sets out."""

from __future__ import annotations

import numpy as np

from fastcoil.model.engine.rows import positions
from fastcoil.model.numerics.elementary import exp, log
from fastcoil.model.numerics.jit import kernel
from fastcoil.model.physics.valve import backlash, growth, log_flow, opening, started

VALVE_ROWS = ("backlash", "m_max", "valve_a", "valve_b", "valve_c")
"""Rows of the parameter sets of ``valve_flows``."""
_VALVE = positions(VALVE_ROWS)


@kernel
def valve_flows(command, batch, sets, start, openings, flows):
    """Water flow of every parameter set at every recorded command.

    command: (n,), fraction of stroke.  batch: (n,), number of the unbroken piece a sample belongs to; what came before
    a piece is unknown.  sets: (5, n_sets), rows as in VALVE_ROWS.  start: (n_batches, n_sets), place in the gap where
    a piece starts, 0 falling to 1 rising.  openings, flows: out, (n, n_sets), fraction and kg/s.
    """
    n_sets = sets.shape[1]
    q = np.empty(n_sets)
    log_m_max = np.empty(n_sets)
    for j in range(n_sets):
        log_m_max[j] = log(sets[_VALVE.m_max, j])
    for t in range(command.size):
        if t == 0 or batch[t] != batch[t - 1]:
            for j in range(n_sets):
                q[j] = started(command[t], sets[_VALVE.backlash, j], start[batch[t], j])
        elif command[t] == command[t - 1]:
            for j in range(n_sets):
                openings[t, j] = openings[t - 1, j]
                flows[t, j] = flows[t - 1, j]
            continue
        for j in range(n_sets):
            q[j] = backlash(q[j], command[t], sets[_VALVE.backlash, j])
            openings[t, j] = opening(q[j], sets[_VALVE.backlash, j])
        for j in range(n_sets):
            grown = growth(openings[t, j], sets[_VALVE.valve_b, j], sets[_VALVE.valve_c, j])
            flows[t, j] = exp(log_flow(log_m_max[j], sets[_VALVE.valve_a, j], grown))
