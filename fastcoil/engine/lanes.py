"""Blocks of lanes, seen from the host: scenarios cut into blocks, and the work space of one block."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fastcoil.engine.rows import LANES, PARAMETER_ROWS, T_A, T_C, T_W, VOLUME_STRIDE, W_A, R
from fastcoil.parameter_table import PARAMETERS

Columns = Mapping[str, np.ndarray]
"""Parameter name → one value per scenario; words as words, NaN where a stand-in is not given."""
_CACHE_LINE = 8
"""Doubles in a cache line of 64 bytes."""


class Block(NamedTuple):
    """LANES scenarios that share a day, a number of volumes and an air march, ready for the kernel.

    ``rows`` is (len(PARAMETER_ROWS), LANES).  Periods are common divisors of the lanes' own, s (0 = no lane
    learns).  Flags say what the whole block may skip or share; they change no lane's bits.
    """

    rows: np.ndarray
    n_volumes: int
    lagged_air: bool
    control_period: int
    samples_together: bool
    learning_period: int
    has_noise: bool
    shares_air_side: bool


def blocks(matrix: np.ndarray) -> list[tuple[np.ndarray, Block]]:
    """Cut scenarios of one day into blocks: (index of the scenario in each used lane, block).

    matrix: (len(PARAMETER_ROWS), n), see ``parameter_matrix``.  Scenarios that share N and air march are sorted by
    sample time, so that most blocks sample in step; the last block of each kind is padded with copies of its last
    scenario.
    """
    row = _by_name(matrix)
    order = np.lexsort([row[name] for name in ("learning_interval", "sample_time", "air_march", "n_volumes")])
    kind = np.stack([row["n_volumes"], row["air_march"]])[:, order]
    starts = np.flatnonzero(np.any(np.diff(kind, axis=1, prepend=-1.0) != 0.0, axis=0))
    cut = []
    for group in np.split(order, starts[1:]):
        for start in range(0, group.size, LANES):
            members = group[start : start + LANES]
            padded = np.concatenate([members, np.full(LANES - members.size, members[-1])])
            cut.append((members, _block(np.ascontiguousarray(matrix[:, padded]))))
    return cut


def run_sets(matrix: np.ndarray, run: Callable[[Block], Sequence[np.ndarray]]) -> tuple[np.ndarray, ...]:
    """Run many parameter sets over one record, block by block.

    matrix: (len(PARAMETER_ROWS), n_sets).  run: takes a block, returns arrays (…, LANES).  Returns the same arrays for
    all sets, (…, n_sets), in their order.
    """
    found: tuple[np.ndarray, ...] = ()
    for members, block in blocks(matrix):
        parts = run(block)
        found = found or tuple(np.empty((*part.shape[:-1], matrix.shape[1])) for part in parts)
        for whole, part in zip(found, parts, strict=True):
            whole[..., members] = part[..., : members.size]
    return found


def parameter_matrix(columns: Columns) -> np.ndarray:
    """The columns as numbers, (len(PARAMETER_ROWS), n): a word becomes the index of its choice."""
    return np.stack([_numbers(name, columns[name]) for name in PARAMETER_ROWS])


def _numbers(name: str, values: np.ndarray) -> np.ndarray:
    if name in PARAMETERS and PARAMETERS[name].is_word:
        choices = np.array(PARAMETERS[name].choices)
        return np.asarray((values[:, None] == choices) @ np.arange(choices.size), dtype=float)
    return np.asarray(values, dtype=float)


def _by_name(matrix: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(PARAMETER_ROWS, matrix, strict=True))


def _block(rows: np.ndarray) -> Block:
    row = _by_name(rows)
    learners = row["learning_step"] > 0.0
    return Block(
        rows=rows,
        n_volumes=int(row["n_volumes"][0]),
        lagged_air=bool(row["air_march"][0] == 0.0),
        control_period=int(np.gcd.reduce(row["sample_time"].astype(np.int64))),
        samples_together=bool(np.ptp(row["sample_time"]) == 0.0),
        learning_period=_learning_period(row, learners),
        has_noise=bool(np.any(row["noise_std"] > 0.0)),
        shares_air_side=all(np.ptp(row[name]) == 0.0 for name in ("beta3", "beta4", "beta5", "beta6")),
    )


def _learning_period(row: Mapping[str, np.ndarray], learners: np.ndarray) -> int:
    """Seconds between calls of the learners: intervals end at multiples of it, early trips come at samples."""
    early = learners & (row["learning_early_trip"] > 0.0)
    seconds = np.concatenate([row["learning_interval"][learners], row["sample_time"][early]])
    return int(np.gcd.reduce(seconds.astype(np.int64), initial=0))


def work_space(n_volumes: int) -> tuple[np.ndarray, np.ndarray]:
    """The flat states S and V of one block, uninitialised."""
    return _aligned(len(R) * LANES), _aligned((n_volumes + 2) * VOLUME_STRIDE)


def _aligned(size: int) -> np.ndarray:
    """Allocate from the edge of a cache line on: a vector across two lines costs twice."""
    space = np.empty(size + _CACHE_LINE)
    start = -space.ctypes.data // space.itemsize % _CACHE_LINE
    return space[start : start + size]


def trace_rows(names: Sequence[str], n_volumes: int) -> np.ndarray:
    """Offsets of the named traces, (n_rows,), volume by volume where they have volumes.

    Offsets of S are given as they are, offsets of V as -1 - offset.
    """
    volume = {"T_w": T_W, "T_c": T_C, "T_a": T_A, "W_a": W_A}
    ends = {"T_sup": T_A + VOLUME_STRIDE, "W_sup": W_A + VOLUME_STRIDE, "T_w_out": T_W + n_volumes * VOLUME_STRIDE}
    signal = R._asdict() | {"T_measured": R.measured}
    rows: list[int] = []
    for name in names:
        if name in volume:
            rows += [-1 - (volume[name] + i * VOLUME_STRIDE) for i in range(1, n_volumes + 1)]
        else:
            rows.append(-1 - ends[name] if name in ends else signal[name])
    return np.array(rows, dtype=np.int64)
