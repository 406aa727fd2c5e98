"""Blocks of lanes, seen from the host: scenarios cut into blocks, and the work space of one block."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fastcoil.engine.controller import Control, control_stage
from fastcoil.engine.estimation import estimator_stage
from fastcoil.engine.rows import LANES, PARAMETER_ROWS, T_A, T_C, T_W, VOLUME_STRIDE, W_A, R
from fastcoil.engine.stem import Stem, stem_stage
from fastcoil.estimators.family import Estimator
from fastcoil.estimators.shipped import ESTIMATORS
from fastcoil.numerics.stages import BUILT_IN
from fastcoil.parameter_table import PARAMETERS

Columns = Mapping[str, np.ndarray]
"""Parameter name → one value per scenario; words as words, NaN where a stand-in is not given."""
KIND = ("estimator", "air_march", "n_volumes")
"""Parameters of which a block has one value.  Lanes of different estimators never share a block."""
_CACHE_LINE = 8
"""Doubles in a cache line of 64 bytes."""


class Common(NamedTuple):
    """What the lanes of a block have in common, for the kernel.

    Periods are common divisors of the lanes' own, s (0 = nothing is estimated).  Flags say what the whole block may
    skip or share; they change no lane's bits.  The last three are stages.
    """

    n_volumes: int
    lagged_air: bool
    control_period: int
    samples_together: bool
    estimating_period: int
    has_noise: bool
    shares_air_side: bool
    leaks: bool
    estimate: Any
    control: Any
    stem: Any


class Block(NamedTuple):
    """LANES scenarios that share a day and all of KIND; ``rows`` is (len(PARAMETER_ROWS), LANES)."""

    rows: np.ndarray
    common: Common
    estimator: Estimator | None


def blocks(matrix: np.ndarray) -> list[tuple[np.ndarray, Block]]:
    """Cut scenarios of one day into blocks: (index of the scenario in each used lane, block).

    matrix: (len(PARAMETER_ROWS), n), see ``parameter_matrix``.  Scenarios that share all of KIND are sorted by
    sample time, so that most blocks sample in step; the last block of each kind is padded with copies of its last
    scenario.
    """
    row = _by_name(matrix)
    order = np.lexsort([row[name] for name in ("learning_interval", "sample_time", *KIND)])
    kind = np.stack([row[name] for name in KIND])[:, order]
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
    matrix = np.stack([_numbers(name, columns[name]) for name in PARAMETER_ROWS])
    row = _by_name(matrix)
    given = row["estimate_ratio"] >= 0.0
    np.copyto(row["backlash_estimate"], row["estimate_ratio"] * row["backlash"], where=given)
    return matrix


def _numbers(name: str, values: np.ndarray) -> np.ndarray:
    if name in PARAMETERS and PARAMETERS[name].is_word:
        choices = np.array(PARAMETERS[name].choices)
        return np.asarray((values[:, None] == choices) @ np.arange(choices.size), dtype=float)
    return np.asarray(values, dtype=float)


def _by_name(matrix: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(PARAMETER_ROWS, matrix, strict=True))


def _block(rows: np.ndarray) -> Block:
    row = _by_name(rows)
    estimator = ESTIMATORS[int(row["estimator"][0])]
    common = Common(
        n_volumes=int(row["n_volumes"][0]),
        lagged_air=bool(row["air_march"][0] == 0.0),
        control_period=int(np.gcd.reduce(row["sample_time"].astype(np.int64))),
        samples_together=bool(np.ptp(row["sample_time"]) == 0.0),
        estimating_period=_estimating_period(row, estimator),
        has_noise=bool(np.any(row["noise_std"] > 0.0)),
        shares_air_side=all(np.ptp(row[name]) == 0.0 for name in ("beta3", "beta4", "beta5", "beta6")),
        leaks=bool(np.any(row["leakage"] >= 0.0)),
        estimate=BUILT_IN if estimator is None else estimator_stage(estimator),
        control=control_stage(Control.of(estimator, row)),
        stem=stem_stage(Stem.of(row)),
    )
    return Block(rows, common, estimator)


def _estimating_period(row: Mapping[str, np.ndarray], estimator: Estimator | None) -> int:
    """Seconds between calls of the estimator: a common divisor of when the lanes' own act."""
    if estimator is None:
        return 0
    seconds = row["sample_time"] if estimator.periods is None else estimator.periods(row)
    return int(np.gcd.reduce(seconds.astype(np.int64)))


def work_space(block: Block) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The flat states S, V and own of one block: uninitialised, but for the parameters of the estimator in own."""
    estimator = block.estimator
    names = () if estimator is None else estimator.Parameters._fields
    own = _aligned(LANES * (0 if estimator is None else len(names) + len(estimator.Memory._fields)))
    row = _by_name(block.rows)
    for k, name in enumerate(names):
        own[k * LANES : (k + 1) * LANES] = row[name]
    own[len(names) * LANES :] = 0.0
    return _aligned(len(R) * LANES), _aligned((block.common.n_volumes + 2) * VOLUME_STRIDE), own


def memory_of(block: Block, own: np.ndarray) -> Any:
    """What the estimator of a block remembers, as its named tuple of arrays (LANES,)."""
    estimator = block.estimator
    assert estimator is not None
    remembered = own.reshape(-1, LANES)[len(estimator.Parameters._fields) :]
    return estimator.Memory(*remembered)


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
