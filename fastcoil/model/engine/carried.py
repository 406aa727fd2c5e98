"""What a lane carries from one day to the next, taken out of the work space of a block and put into that of another.

The state of a lane is one vector: the state rows of S, the rows of its volumes in V, what its estimator remembers with
its array, and what its law remembers.  So a day may be run in other blocks than the day before.
"""

from __future__ import annotations

import numpy as np

from fastcoil.model.engine.lanes import Block, WorkSpace, work_space
from fastcoil.model.engine.rows import LANES, STATE_AT, STATE_ROWS, SUMS_AT, VOLUME_ROWS, VOLUME_STRIDE


def state_of(block: Block, work: WorkSpace) -> np.ndarray:
    """The states of a block's lanes, (LANES, n)."""
    return np.concatenate(_views(block, work), axis=1)


def work_space_from(block: Block, states: np.ndarray) -> WorkSpace:
    """The work space of a block whose first lanes begin in ``states``, (n, at least as many as a state has), n ≤ LANES.

    The lanes behind them, copies of the last in their parameters, begin as the last does.
    """
    work = work_space(block)
    lanes = np.minimum(np.arange(LANES), len(states) - 1)
    first = 0
    for rows in _views(block, work):
        rows[:] = states[lanes, first : first + rows.shape[1]]
        first += rows.shape[1]
    return work


def _views(block: Block, work: WorkSpace) -> list[np.ndarray]:
    """What is carried over in a work space, as views (LANES, n)."""
    n_volumes, estimator, law = block.common.n_volumes, block.estimator, block.law
    views = [
        work.S[STATE_AT:SUMS_AT].reshape(len(STATE_ROWS), LANES).T,
        work.V[VOLUME_STRIDE : (n_volumes + 1) * VOLUME_STRIDE].reshape(n_volumes * len(VOLUME_ROWS), LANES).T,
    ]
    if estimator is not None:
        first = block.for_estimator.size
        end = first + len(estimator.Memory._fields) * LANES
        views += [work.own[first:end].reshape(-1, LANES).T, work.own[end:].reshape(LANES, estimator.words)]
    if law is not None:
        views.append(work.own_law[block.for_law.size :].reshape(-1, LANES).T)
    return views
