"""The answer of the plant at rest to a small step of the opening.

Each lane has its own end, and goes on behind it as a geometric series, whatever the others in its block do.
"""

from __future__ import annotations

import numpy as np

from fastcoil.model.engine.at_rest import F, small_steps
from fastcoil.model.engine.each_lane import air_side_each, second_each
from fastcoil.model.engine.initial_state import derive, reset_sums, set_initial_state
from fastcoil.model.engine.plant import deliver
from fastcoil.model.engine.rows import LANES, T_A, VOLUME_STRIDE, R
from fastcoil.model.numerics.jit import kernel

_AT_REST = 1e-9
"""Distance, K, from where a response ends, that is none."""
FEW = 60
"""Steps over which the ratio of successive changes is taken, behind the end of a response."""
SLOWEST = 0.99999
"""Largest such ratio: a time constant of a day."""


@kernel
def respond(rows, common, entering, found, at_rest, S, V, tolerance, response, ends):
    """Answer of T_sup to a small step of the opening, K per unit opening.

    found, at_rest: of ``find_rest``, its V.  response: out, (n_steps, LANES), seconds 1 to n_steps after the step.
    ends: out, (LANES,), the second from which a lane stays within ``tolerance`` (fraction of its gain) of where it
    ends.  From there on its changes are a geometric series.  n_steps, if fewer than FEW + 1 seconds are left for that.
    """
    n_steps = response.shape[0]
    derive(S, rows, common.n_volumes)
    set_initial_state(S, True)
    reset_sums(S, True)
    air_side_each(S, entering)
    supply = V[VOLUME_STRIDE + T_A : VOLUME_STRIDE + T_A + LANES]
    first, second = np.empty(LANES), np.empty(LANES)
    for j in range(LANES):
        first[j], second[j] = small_steps(found[F.opening, j])

    V[:] = at_rest
    for j in range(LANES):
        S[R.opening + j] = first[j]
    deliver(S, common.leaks)
    ends[:] = 2
    for t in range(n_steps):
        second_each(S, V, common, entering)
        for j in range(LANES):
            response[t, j] = supply[j]
            change = found[F.T_stepped, j] - found[F.T_sup, j]
            left = abs(found[F.T_stepped, j] - supply[j])
            ends[j] = t + 2 if left > tolerance * abs(change) + _AT_REST else ends[j]

    V[:] = at_rest
    for j in range(LANES):
        S[R.opening + j] = second[j]
    deliver(S, common.leaks)
    for t in range(n_steps):
        second_each(S, V, common, entering)
        for j in range(LANES):
            response[t, j] = (response[t, j] - supply[j]) / (first[j] - second[j])
            response[t, j] = response[t, j] if found[F.gain, j] == found[F.gain, j] else np.nan
    for j in range(LANES):
        ends[j] = ends[j] if found[F.gain, j] == found[F.gain, j] else 2
        ends[j] = ends[j] if ends[j] + FEW + 1 <= n_steps else n_steps
        end = ends[j]
        few = FEW if FEW < end - 1 else end - 1
        before = response[end - few - 1, j] - (response[end - few - 2, j] if end - few > 1 else 0.0)
        change, ratio = response[end - 1, j] - response[end - 2, j], 0.0
        if end < n_steps and change * before > 0.0:
            ratio = min((change / before) ** (1.0 / few), SLOWEST)
        for t in range(end, n_steps):
            change *= ratio
            response[t, j] = response[t - 1, j] + change
