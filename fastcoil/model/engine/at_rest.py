"""The plant at rest, at its set-point or at given openings.

What a lane does never depends on the others in its block: each has its own end, and stands still behind it.
"""

from __future__ import annotations

import numpy as np

from fastcoil.model.engine.each_lane import air_side_each, enter_each, march_air_each
from fastcoil.model.engine.initial_state import derive, fill_coil, reset_sums, set_initial_state
from fastcoil.model.engine.plant import deliver, march_water
from fastcoil.model.engine.rows import LANES, T_A, VOLUME_STRIDE, R, positions
from fastcoil.model.numerics.jit import kernel, section

STEADY = ("opening", "T_sup", "m_w", "wet_volumes", "gain", "T_stepped", "nearest")
"""Rows of what is found of a plant at rest.

T_stepped: T_sup at rest after the first of ``small_steps``.  nearest: 1 if no opening holds the set-point.  gain: NaN
where T_sup jumps past it, as it may if a coil exchanges less when it is wet than when it is dry.
"""
F = positions(STEADY)
STEP = 1e-4
"""Of the opening, to each side, for a derivative."""
_SETTLED, _MOST_SWEEPS = 1e-11, 4000
"""A coil is at rest when no metal temperature moves further than this, K, in a sweep; it gets as many sweeps."""
_FOUND, _MOST_OPENINGS = 1e-9, 60
_JUMPED = 1e-4
"""Distance from the set-point, K, at an opening that ought to hold it."""
_LEAST_FLOW = 1e-12
"""kW/K; without water flow its temperature does not matter."""


@section
def small_steps(opening):
    """Two openings, one to each side of an opening but within 0–1, that differ by 2 STEP or, at an end, by STEP."""
    first = opening + STEP if opening + STEP <= 1.0 else opening - STEP
    return first, min(max(opening + opening - first, 0.0), 1.0)


@section
def settle(S, V, n_volumes, leaks, entering, openings, rests):
    """Bring every coil to rest at an opening, (LANES,).  The heat capacities do not matter for where that is.

    rests: (LANES,), coils that are left as they are.
    """
    for j in range(LANES):
        S[R.opening + j] = openings[j]
    deliver(S, leaks)
    for j in range(LANES):
        C_flow = S[R.C_flow + j] if S[R.C_flow + j] > _LEAST_FLOW else _LEAST_FLOW
        S[R.dt_C_w + j] = 0.0 if rests[j] else 1.0 / C_flow
    everywhere = np.ones(n_volumes + 1, np.bool_)
    for _ in range(_MOST_SWEEPS):
        enter_each(V, n_volumes, entering)
        march_water(S, V, n_volumes, False, everywhere)
        march_air_each(S, V, n_volumes, False, entering, True)
        # one sweep more after the last, so that the air is that of the coil as it stands
        all_rest = True
        for j in range(LANES):
            all_rest &= S[R.dt_C_w + j] == 0.0
            S[R.dt_C_w + j] = S[R.dt_C_w + j] if S[R.farthest_T_c + j] > _SETTLED else 0.0
        if all_rest:
            break


@kernel
def find_rest(rows, common, entering, T_set, S, V, found):
    """Find the opening at which each plant of a block rests at its set-point.

    rows, common: of a Block.  entering: (4, LANES), see CONDITIONS.  T_set: (LANES,), °C.  S, V: work space; V holds
    the coils at rest afterwards.  found: out, (6, LANES), see STEADY; gain in K per unit opening.
    """
    n_volumes = common.n_volumes
    derive(S, rows, n_volumes)
    set_initial_state(S, True)
    reset_sums(S, True)
    fill_coil(S, V, n_volumes, 0.0)
    air_side_each(S, entering)
    supply = V[VOLUME_STRIDE + T_A : VOLUME_STRIDE + T_A + LANES]

    low, high, openings = np.zeros(LANES), np.ones(LANES), np.zeros(LANES)
    e_low, e_high, direction = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    nowhere, is_found = np.zeros(LANES, np.bool_), np.zeros(LANES, np.bool_)
    settle(S, V, n_volumes, common.leaks, entering, low, nowhere)
    for j in range(LANES):
        e_low[j] = supply[j] - T_set[j]
    settle(S, V, n_volumes, common.leaks, entering, high, nowhere)
    for j in range(LANES):
        e_high[j] = supply[j] - T_set[j]
        e_low[j] = 0.0 if abs(e_low[j]) < _FOUND else e_low[j]
        e_high[j] = 0.0 if abs(e_high[j]) < _FOUND else e_high[j]
        direction[j] = 1.0 if e_high[j] > e_low[j] else -1.0
        e_low[j] *= direction[j]
        e_high[j] *= direction[j]
        found[F.nearest, j] = 0.0 if e_low[j] <= 0.0 <= e_high[j] and e_low[j] < e_high[j] else 1.0
        openings[j] = 1.0 if e_high[j] < 0.0 else 0.0
        is_found[j] = found[F.nearest, j] != 0.0

    for k in range(_MOST_OPENINGS):
        for j in range(LANES):
            if not is_found[j]:
                # the secant, and every third time the middle, so that the bracket shrinks whatever the curve
                share = 0.5 if k % 3 == 2 else -e_low[j] / (e_high[j] - e_low[j])
                openings[j] = low[j] + share * (high[j] - low[j])
        settle(S, V, n_volumes, common.leaks, entering, openings, is_found)
        for j in range(LANES):
            if not is_found[j]:
                e = direction[j] * (supply[j] - T_set[j])
                is_found[j] = abs(e) < _FOUND or high[j] - low[j] <= _FOUND * _FOUND
                if e <= 0.0:
                    low[j] = openings[j]
                    e_low[j] = e
                if e >= 0.0:
                    high[j] = openings[j]
                    e_high[j] = e
                if e == 0.0:
                    e_low[j] -= _FOUND * _FOUND
        if is_found.all():
            break
    for j in range(LANES):
        found[F.opening, j] = openings[j]
        low[j], high[j] = small_steps(openings[j])
    settle(S, V, n_volumes, common.leaks, entering, low, nowhere)
    for j in range(LANES):
        found[F.T_stepped, j] = supply[j]
    settle(S, V, n_volumes, common.leaks, entering, high, nowhere)
    for j in range(LANES):
        found[F.gain, j] = (supply[j] - found[F.T_stepped, j]) / (high[j] - low[j])
    settle(S, V, n_volumes, common.leaks, entering, openings, nowhere)
    for j in range(LANES):
        if found[F.nearest, j] == 0.0 and abs(supply[j] - T_set[j]) > _JUMPED:
            found[F.nearest, j] = 1.0
            found[F.gain, j] = np.nan
        found[F.T_sup, j] = supply[j]
        found[F.m_w, j] = S[R.m_w + j]
        found[F.wet_volumes, j] = S[R.wet_volumes + j]


@kernel
def rest_curve(rows, common, entering, openings, S, V, T_sup):
    """T_sup at rest at each of some openings, (n,): out, (n, LANES), °C."""
    n_volumes = common.n_volumes
    derive(S, rows, n_volumes)
    set_initial_state(S, True)
    reset_sums(S, True)
    fill_coil(S, V, n_volumes, 0.0)
    air_side_each(S, entering)
    everywhere, nowhere = np.empty(LANES), np.zeros(LANES, np.bool_)
    for k in range(openings.size):
        everywhere[:] = openings[k]
        settle(S, V, n_volumes, common.leaks, entering, everywhere, nowhere)
        for j in range(LANES):
            T_sup[k, j] = V[VOLUME_STRIDE + T_A + j]
