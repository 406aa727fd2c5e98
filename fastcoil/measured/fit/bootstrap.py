"""How much an estimate would change with other batches: a block bootstrap, one Gauss-Newton step for each draw.

What a meter gets wrong for hours or for a whole batch is no noise that averages out within it.  Batches, or blocks of
a long piece, are drawn with replacement, and the estimate moves to the minimum of the linearised problem of each draw.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.measured.fit.least_squares import CONFIDENCE, Estimate, Model, Uncertainty

_DRAWS = 400
_FEWEST, _MOST = 8, 30
"""Blocks that a log in fewer pieces is cut into, of at least so many independent samples each if it has them."""
_INDEPENDENT = 5.0
_RIDGE = 1e-10


def widened(model: Model, best: Estimate, spread: Uncertainty, fixed: list[int]) -> Uncertainty:
    """The uncertainty, no smaller than that of a bootstrap over blocks."""
    from scipy.stats import t

    block = blocks(model.segment, model.used, spread.n_effective)
    n_blocks = int(block.max()) + 1
    free = np.setdiff1d(np.flatnonzero(np.isfinite(np.diag(spread.covariance))), fixed)
    common = free[free < model.n_common]
    if n_blocks < 2 or not common.size:
        return spread
    moved = _moved(best, block, free)[:, : common.size]
    low, high = np.quantile(moved, [0.1587, 0.8413], axis=0)
    deviation = 0.5 * (high - low) * np.sqrt(n_blocks / (n_blocks - 1))
    ratio = deviation / np.sqrt(np.diag(spread.covariance)[common])
    ratio *= float(t.ppf(0.5 + CONFIDENCE / 2, n_blocks - 1)) / spread.quantile()
    factor = np.ones(best.x.size)
    factor[common] = np.maximum(ratio, 1.0)
    return replace(
        spread,
        covariance=spread.covariance * np.outer(factor, factor),
        inflation=spread.inflation * factor**2,
    )


def blocks(segment: Index, used: Mask, n_effective: float) -> Index:
    """Number of the block of each sample, (n,): the unbroken pieces, cut where they are too few."""
    pieces = np.unique(segment[used])
    if pieces.size >= _FEWEST:
        return np.asarray(np.clip(np.searchsorted(pieces, segment), 0, pieces.size - 1))
    wanted = int(np.clip(n_effective / _INDEPENDENT, _FEWEST, _MOST))
    number, n = np.zeros(segment.size, dtype=np.int64), 0
    for piece in pieces:
        here = np.flatnonzero((segment == piece) & used)
        cuts = max(round(wanted * here.size / used.sum()), 1)
        number[here] = n + np.arange(here.size) * cuts // here.size
        n += cuts
    return np.unique(number, return_inverse=True)[1]


def _moved(best: Estimate, block: Index, free: Index) -> Array:
    """Steps of the free parameters to the minimum of each draw, (draws, free)."""
    n_blocks = int(block.max()) + 1
    J = best.J[:, free]
    scale = np.linalg.norm(J, axis=0)
    J = J / scale
    ends = np.flatnonzero(np.diff(block)) + 1
    if (np.diff(block) < 0).any():
        order = np.argsort(block, kind="stable")
        J, r, ends = J[order], best.r[order], np.flatnonzero(np.diff(block[order])) + 1
    else:
        r = best.r
    starts = np.concatenate([[0], ends])
    gradient = np.add.reduceat(J * r[:, None], starts, axis=0)
    curvature = np.stack([part.T @ part for part in np.split(J, ends)])
    rng = np.random.default_rng(0)
    draws = rng.multinomial(n_blocks, np.full(n_blocks, 1.0 / n_blocks), size=_DRAWS).astype(float)
    H = np.einsum("db,bij->dij", draws, curvature) + _RIDGE * np.eye(free.size)
    return np.asarray(-np.linalg.solve(H, (draws @ gradient)[..., None])[..., 0] / scale)
