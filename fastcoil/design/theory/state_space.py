"""The plant at rest as a linear system of 1-s steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.design.theory.plants import Columns, distinct_plants
from fastcoil.model.engine.at_rest import STATES, STEADY, find_rest, linearise_step
from fastcoil.model.engine.lanes import blocks, work_space
from fastcoil.model.engine.rows import LANES


class StateSpace(NamedTuple):
    """x[t+1] = A x[t] + B opening[t], T_sup[t] = C x[t] + D opening[t], as deviations from rest; t in seconds.

    A: (n, 4 N, 4 N), B: (n, 4 N), C: (4 N,), D: 0, since water takes a second at least to reach the air.
    states: T_w, T_c, T_a, K, and W_a, kg/kg, of volume 1 to N each.
    """

    A: Array
    B: Array
    C: Array
    D: float
    states: tuple[str, ...]


def state_names(n_volumes: int) -> tuple[str, ...]:
    """T_w_1 … T_w_N, and so on."""
    return tuple(f"{name}_{i}" for name in STATES for i in range(1, n_volumes + 1))


def state_space_of(columns: Columns, conditions: Mapping[str, Array]) -> StateSpace:
    """Linearise the one-step map of every plant where it rests at its set-point.

    columns, conditions: as for ``plants_of``; all with one number of volumes N.
    """
    matrix, entering, T_set, same = distinct_plants(columns, conditions)
    n, n_volumes = T_set.size, int(columns["n_volumes"][0])
    size = len(STATES) * n_volumes
    A, B = np.empty((n, size, size)), np.empty((n, size))
    for members, block in blocks(matrix):
        padded = np.concatenate([members, np.full(LANES - members.size, members[-1])])
        S, V, *_ = work_space(block)
        found, of_lanes = np.empty((len(STEADY), LANES)), np.ascontiguousarray(entering[:, padded])
        find_rest(block.rows, block.common, of_lanes, T_set[padded], S, V, found)
        of_A, of_B = np.empty((size, size, LANES)), np.empty((size, LANES))
        linearise_step(block.rows, block.common, of_lanes, found, V.copy(), S, V, of_A, of_B)
        A[members] = np.moveaxis(of_A, 2, 0)[: members.size]
        B[members] = of_B.T[: members.size]
    names = state_names(n_volumes)
    C = np.zeros(size)
    C[names.index("T_a_1")] = 1.0
    return StateSpace(A[same], B[same], C, 0.0, names)
