"""The plant from one second to the next, linearised: states[t + 1] = A states[t] + B opening[t]."""

from __future__ import annotations

import numpy as np

from fastcoil.model.engine.at_rest import F, small_steps
from fastcoil.model.engine.each_lane import air_side_each, second_each
from fastcoil.model.engine.initial_state import derive, reset_sums, set_initial_state
from fastcoil.model.engine.plant import deliver
from fastcoil.model.engine.rows import LANES, T_A, T_C, T_W, VOLUME_STRIDE, W_A, R
from fastcoil.model.numerics.jit import kernel, section

STATES = ("T_w", "T_c", "T_a", "W_a")
"""Each for volume 1 to N, in this order."""
_CHANGES = (1e-4, 1e-4, 1e-4, 1e-7)
"""Of each kind of state to either side, K and kg/kg: well inside the band around the dew point."""


@section
def state_row(k, n_volumes):
    """Offset in V of state k, 0 to 4 N - 1, see STATES."""
    kind, i = k // n_volumes, k % n_volumes + 1
    row = T_W if kind == 0 else (T_C if kind == 1 else (T_A if kind == 2 else W_A))
    return i * VOLUME_STRIDE + row


@section
def add_states(V, n_volumes, factors, total):
    """Add every state, times a factor for each lane, to ``total``, (4 N, LANES)."""
    for k in range(4 * n_volumes):
        row = state_row(k, n_volumes)
        for j in range(LANES):
            total[k, j] += factors[j] * V[row + j]


@kernel
def linearise_step(rows, common, entering, found, at_rest, S, V, A, B):
    """Differentiate one second of the march at rest, with all its substeps, by central differences.

    rows, common, entering, S, V: as for ``find_rest``; found, at_rest: what that found, its V.
    A: out, (4 N, 4 N, LANES); B: out, (4 N, LANES), per unit opening.  States as in STATES, in K and kg/kg.
    """
    n_volumes = common.n_volumes
    derive(S, rows, n_volumes)
    set_initial_state(S, True)
    reset_sums(S, True)
    air_side_each(S, entering)
    A[:] = 0.0
    B[:] = 0.0
    factors, first, second = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    for j in range(LANES):
        first[j], second[j] = small_steps(found[F.opening, j])

    for side in (1.0, -1.0):
        V[:] = at_rest
        for j in range(LANES):
            S[R.opening + j] = first[j] if side > 0.0 else second[j]
            factors[j] = side / (first[j] - second[j])
        deliver(S, common.leaks)
        second_each(S, V, common, entering)
        add_states(V, n_volumes, factors, B)

    for j in range(LANES):
        S[R.opening + j] = found[F.opening, j]
    deliver(S, common.leaks)
    for k in range(4 * n_volumes):
        change, row = _CHANGES[k // n_volumes], state_row(k, n_volumes)
        for side in (1.0, -1.0):
            V[:] = at_rest
            for j in range(LANES):
                V[row + j] += side * change
                factors[j] = side / (2.0 * change)
            second_each(S, V, common, entering)
            add_states(V, n_volumes, factors, A[:, k])
