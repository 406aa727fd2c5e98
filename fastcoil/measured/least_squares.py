"""Nonlinear least squares whose Jacobian comes from lanes: perturbed parameter sets in the same kernel call.

Trust-region reflective steps (``scipy.optimize.least_squares``, ``trf``), started from the best of many sets that are
screened as lanes; covariance by SVD, widened for the autocorrelation of the residuals.  The paper names
Levenberg-Marquardt, which knows no bounds, and these problems have some that matter: a backlash of 0, the least C_w
that is stable, an exponent that the data do not identify.  Where no bound is met both end in the same minimum.

A block bootstrap, one Gauss-Newton step for each draw, says how much an estimate would change with other batches: what
a meter gets wrong for hours or for a whole batch does not average out within it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask


class Listener(Protocol):
    """Receives the progress of a fit."""

    def part(self, what: str, done: int, of: int) -> None:
        """A part begins: ``done`` of ``of`` such parts are done."""

    def step(self) -> None:
        """The model was run once."""


_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def reported_to(listener: Listener) -> Iterator[None]:
    """Report the progress of the fits inside to ``listener``."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def report_part(what: str, done: int, of: int) -> None:
    """Report the start of a part."""
    if listener := _listener.get():
        listener.part(what, done, of)


def report_step() -> None:
    """Report one run of the model."""
    if listener := _listener.get():
        listener.step()


CONFIDENCE = 0.95
_RANK_TOLERANCE = 1e-8
_MAX_LAG_SHARE = 4
"""Autocorrelation is estimated up to lags of one segment divided by this."""
_REFINED = 4
_POLISH = 20.0
_SCREENED_AT_ONCE = 64
_TINY = 1e-300
FORBIDDEN = 1e6
"""Residual of a parameter set that cannot be run."""


@dataclass(frozen=True)
class Model:
    """A least-squares problem whose residuals are known for many parameter sets at once.

    residuals: (p, sets) → (n, sets), 0 at samples that are not compared.  lower, upper, step: (p,), the bounds and the
    steps of the central differences.  segment: (n,), number of the unbroken piece of each sample.  used: (n,), which
    samples are compared.  The last parameters may be ``nuisance``: one for each number in ``owner`` (n,), acting on the
    samples of that number only, so that all of them share one pair of lanes.
    """

    residuals: Callable[[Array], Array]
    lower: Array
    upper: Array
    step: Array
    segment: Index
    used: Mask
    n_nuisance: int = 0
    owner: Index | None = None

    @property
    def n_common(self) -> int:
        return self.lower.size - self.n_nuisance


@dataclass(frozen=True)
class Estimate:
    """A minimum: x (p,), residuals (n,), Jacobian (n, p), residual sum of squares."""

    x: Array
    r: Array
    J: Array
    rss: float


def evaluate(model: Model, x: Array) -> tuple[Array, Array]:
    """Residuals (n,) and their Jacobian (n, p) at x, from one call; differences are one-sided at a bound."""
    p, common = x.size, model.n_common
    pairs = common + (model.n_nuisance > 0)
    sets = np.repeat(x[:, None], 1 + 2 * pairs, axis=1)
    for k in range(pairs):
        which = slice(k, k + 1) if k < common else slice(common, p)
        step = model.step[which]
        sets[which, 1 + 2 * k] = np.minimum(x[which] + step, model.upper[which])
        sets[which, 2 + 2 * k] = np.maximum(x[which] - step, model.lower[which])
    found = model.residuals(sets)
    report_step()
    found = np.where(np.isfinite(found), found, FORBIDDEN)
    J = np.zeros((found.shape[0], p))
    forbidden = np.atleast_1d((np.abs(found) >= FORBIDDEN).any(axis=0))
    for k in range(pairs):
        for side in (1 + 2 * k, 2 + 2 * k):
            if forbidden[side]:  # the slope then comes from the other side alone
                sets[:, side], found[:, side] = sets[:, 0], found[:, 0]
        difference = found[:, 1 + 2 * k] - found[:, 2 + 2 * k]
        if k < common:
            J[:, k] = difference / max(sets[k, 1 + 2 * k] - sets[k, 2 + 2 * k], _TINY)
        else:
            assert model.owner is not None
            rows, column = np.arange(difference.size), common + model.owner
            J[rows, column] = difference / np.maximum(sets[column, 1 + 2 * k] - sets[column, 2 + 2 * k], _TINY)
    return found[:, 0], J


def screen(model: Model, starts: Array) -> Array:
    """Residual sum of squares of every start (p, sets)."""
    sums = []
    for first in range(0, starts.shape[1], _SCREENED_AT_ONCE):
        report_part("starts", first, starts.shape[1])
        r = model.residuals(starts[:, first : first + _SCREENED_AT_ONCE])
        r = np.where(np.isfinite(r), r, FORBIDDEN)
        sums.append(np.einsum("ij,ij->j", r, r))
    return np.concatenate(sums)


def minimise(
    model: Model, starts: Array, fixed: Sequence[int] = (), refined: int = _REFINED, max_steps: int = 80
) -> Estimate:
    """The best minimum found from the best of ``starts`` (p, sets); parameters in ``fixed`` stay where they start."""
    order = np.argsort(screen(model, starts))[:refined] if starts.shape[1] > 1 else np.array([0])
    found = []
    for i, k in enumerate(order):
        if starts.shape[1] > 1:
            report_part("descents", i, order.size + 1)
        found.append(_descend(model, starts[:, k], fixed, max_steps))
    best = min(found, key=lambda one: one.rss)
    if starts.shape[1] == 1:
        return best
    report_part("descents", order.size, order.size + 1)
    # long steps see past the kinks of Eq (1), short steps end nearer to the minimum
    polished = _descend(replace(model, step=model.step / _POLISH), best.x, fixed, max_steps)
    x = min(best, polished, key=lambda one: one.rss).x
    r, J = evaluate(model, x)  # with short steps a kink looks like a slope
    return Estimate(x, r, J, float(r @ r))


def _descend(model: Model, x0: Array, fixed: Sequence[int], max_steps: int) -> Estimate:
    from scipy.optimize import least_squares

    free = np.setdiff1d(np.arange(x0.size), np.asarray(fixed, dtype=int))
    x = x0.copy()
    last: tuple[bytes, Array, Array] = (b"", np.empty(0), np.empty(0))

    def at(part: Array) -> tuple[Array, Array]:
        nonlocal last
        if last[0] != part.tobytes():
            x[free] = part
            r, J = evaluate(model, x)
            R = _condensed(np.column_stack([J[:, free], r]))
            last = (part.tobytes(), R[:, -1], R[:, :-1])
        return last[1], last[2]

    if free.size:
        span = model.upper[free] - model.lower[free]
        inside = np.clip(x0[free], model.lower[free] + 1e-9 * span, model.upper[free] - 1e-9 * span)
        solution = least_squares(
            lambda part: at(part)[0],
            inside,
            jac=lambda part: at(part)[1],
            bounds=(model.lower[free], model.upper[free]),
            method="trf",
            x_scale="jac",
            ftol=1e-9,
            xtol=1e-9,
            gtol=1e-12,
            max_nfev=max_steps,
        )
        x[free] = solution.x
    r, J = evaluate(model, x)
    return Estimate(x.copy(), r, J, float(r @ r))


def _condensed(A: Array) -> Array:
    """A square matrix R with RᵀR = AᵀA: enough for a descent on n residuals, and far quicker to decompose."""
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0.0] = 1.0
    rows = np.ascontiguousarray((A / norms).T)
    # not BLAS, whose threads get in each other's way where the machine is shared
    w, V = np.linalg.eigh(np.einsum("ij,kj->ik", rows, rows))
    return np.asarray(np.sqrt(np.maximum(w, 0.0))[:, None] * V.T * norms)


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the estimate, (p, p), NaN for parameters that are fixed or at a bound; and its basis.

    inflation: (p,), factor on the variance of white residuals.  dead: index of the parameters without any effect.
    weak: directions that the data do not identify, each as {parameter: share}.
    """

    covariance: Array
    inflation: Array
    n_used: int
    n_effective: float
    freedom: float
    variance: float
    dead: tuple[int, ...]
    weak: tuple[dict[int, float], ...]

    def quantile(self) -> float:
        """Half width of a 95 % interval in standard errors."""
        from scipy.stats import t

        return float(t.ppf(0.5 + CONFIDENCE / 2, self.freedom))


def uncertainty(
    model: Model, estimate: Estimate, fixed: Sequence[int] = (), profiled: Sequence[int] = ()
) -> Uncertainty:
    """Covariance by SVD of the Jacobian; correlated residuals count as fewer samples.

    The variance of each estimate is that of residuals with their estimated autocorrelation ρ,
    aᵀ Jᵀ Ω J a with Ω = ρ(t - s), never less than that of white ones.  ``profiled`` parameters have one at their bound
    too: the limit of the profile depends on it.
    """
    r, n = estimate.r, int(model.used.sum())
    p = estimate.x.size
    span = model.upper - model.lower
    inner = (estimate.x > model.lower + 1e-6 * span) & (estimate.x < model.upper - 1e-6 * span)
    inner[list(profiled)] = True
    norms = np.linalg.norm(estimate.J, axis=0)
    live = norms > 1e-12 * max(float(norms.max()), 1e-300)
    free = np.flatnonzero(inner & live & ~np.isin(np.arange(p), np.asarray(fixed, dtype=int)))
    rho = autocorrelation(r, model.segment, model.used)
    n_effective = min(max(n / max(1.0 + 2.0 * float(rho.sum()), 1.0), 1.0), n)
    freedom = max(n_effective - free.size, 1.0)
    variance = estimate.rss / n * n_effective / freedom
    _, s, Vt = np.linalg.svd(estimate.J[:, free] / norms[free], full_matrices=False)
    kept = s > _RANK_TOLERANCE * s[0] if s.size else np.zeros(0, dtype=bool)
    weak = tuple({int(free[k]): float(v[k]) for k in np.argsort(-np.abs(v))[:3]} for v in Vt[~kept])
    inverse = (Vt[kept].T / s[kept] ** 2) @ Vt[kept] / np.outer(norms[free], norms[free])
    white = np.diag(inverse).copy()
    Z = estimate.J[:, free] @ inverse
    coloured = white + 2.0 * _lagged_products(Z, model.segment, rho)
    inflation = np.maximum(coloured / white, 1.0)
    covariance, factors = np.full((p, p), np.nan), np.ones(p)
    covariance[np.ix_(free, free)] = variance * inverse * np.sqrt(np.outer(inflation, inflation))
    for v in Vt[~kept]:
        open_ = free[np.abs(v) > 0.1]
        covariance[open_, :] = covariance[:, open_] = np.inf
    factors[free] = inflation
    dead = tuple(int(k) for k in np.flatnonzero(~live))
    return Uncertainty(covariance, factors, n, n_effective, freedom, variance, dead, weak)


def autocorrelation(r: Array, segment: Index, used: Mask) -> Array:
    """ρ(1), ρ(2), … of the residuals up to where they are lost in noise (Geyer's initial monotone sequence)."""
    r = np.where(used, r, 0.0)
    ends = np.flatnonzero(np.diff(segment)) + 1
    pieces, marks = np.split(r, ends), np.split(used.astype(float), ends)
    most = max(piece.size for piece in pieces) // _MAX_LAG_SHARE
    sums, counts = np.zeros(most + 1), np.zeros(most + 1)
    for piece, mark in zip(pieces, marks, strict=True):
        lags = min(most + 1, piece.size)
        sums[:lags] += _autoproducts(piece)[:lags]
        counts[:lags] += _autoproducts(mark)[:lags]
    if most < 1 or sums[0] <= 0.0:
        return np.zeros(0)
    rho = (sums / np.maximum(counts, 1.0)) / (sums[0] / counts[0])
    pairs = rho[: rho.size // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0.0)
    n_pairs = negative[0] if negative.size else pairs.size
    pairs = np.minimum.accumulate(pairs[:n_pairs])
    kept = rho[: 2 * n_pairs]
    scale = np.repeat(pairs / np.maximum(kept.reshape(-1, 2).sum(axis=1), 1e-300), 2) if n_pairs else np.zeros(0)
    return np.asarray((kept * scale)[1:])


def _autoproducts(x: Array) -> Array:
    """Sum over t of x[t] x[t + k], for every lag k, (n,)."""
    size = 1 << (2 * x.size - 1).bit_length()
    f = np.fft.rfft(x, size)
    return np.fft.irfft(f * np.conj(f), size)[: x.size]


def _lagged_products(Z: Array, segment: Index, rho: Array) -> Array:
    """Sum over lags of ρ(k) times the sum over t of z[t] z[t + k], for every column of Z."""
    total = np.zeros(Z.shape[1])
    for piece in np.split(Z, np.flatnonzero(np.diff(segment)) + 1):
        lags = min(rho.size, piece.shape[0] - 1)
        if lags > 0:
            total += [rho[:lags] @ _autoproducts(z)[1 : lags + 1] for z in piece.T]
    return total


def profile(
    model: Model, best: Estimate, k: int, grid: Array, fixed: Sequence[int] = (), max_steps: int = 30
) -> list[Estimate]:
    """The minimum with parameter k held at each value of ``grid`` (ascending).

    Walks outward from the free minimum, each value starting where its neighbour ended.
    """
    middle = int(np.searchsorted(grid, best.x[k]))
    found: dict[int, Estimate] = {}
    for way in (range(middle, grid.size), range(middle - 1, -1, -1)):
        x = best.x
        for i in way:
            report_part("values of the backlash", len(found), grid.size)
            start = x.copy()
            start[k] = grid[i]
            found[i] = minimise(model, start[:, None], fixed=[*fixed, k], max_steps=max_steps)
            x = found[i].x
    return [found[i] for i in range(grid.size)]


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
