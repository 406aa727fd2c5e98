"""Nonlinear least squares whose Jacobian comes from lanes: perturbed parameter sets in the same kernel call.

Trust-region reflective steps (``scipy.optimize.least_squares``, ``trf``), started from the best of many sets that are
screened as lanes; covariance by SVD, widened for the autocorrelation of the residuals.  The paper names
Levenberg-Marquardt, which knows no bounds, and these problems have some that matter: a backlash of 0, the least C_w
that is stable, an exponent that the data do not identify.  Where no bound is met both end in the same minimum.

A block bootstrap, one Gauss-Newton step for each draw, says how much an estimate would change with other batches: what
a meter gets wrong for hours or for a whole batch does not average out within it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.measured.part import split_segments

CONFIDENCE = 0.95  # of intervals
FORBIDDEN_RESIDUAL = 1e6  # of a parameter set that cannot be run
_N_REFINED = 4  # best starts that are refined
_SCREENED_AT_ONCE = 64
_TINY = 1e-300


@dataclass(frozen=True)
class Model:
    """A least-squares problem whose residuals are computed for many parameter sets at once."""

    residuals: Callable[[Array], Array]  # (p, sets) → (n, sets)
    lower: Array  # bounds, (p,)
    upper: Array
    step: Array  # of the central differences, (p,)
    segment: Index  # number of the unbroken piece of each sample, (n,)
    used: Mask  # which samples are compared, (n,)
    n_nuisance: int = 0  # last parameters, each of one segment: all of them share one pair of lanes

    @property
    def n_common(self) -> int:
        return self.lower.size - self.n_nuisance

    def compared_residuals(self, sets: Array) -> Array:
        """Residuals, (n, sets), of parameter sets, (p, sets); 0 at samples that are not compared."""
        r = self.residuals(sets)
        return np.where(self.used[:, None], np.where(np.isfinite(r), r, FORBIDDEN_RESIDUAL), 0.0)


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
        parameters = slice(k, k + 1) if k < common else slice(common, p)
        step = model.step[parameters]
        sets[parameters, 1 + 2 * k] = np.minimum(x[parameters] + step, model.upper[parameters])
        sets[parameters, 2 + 2 * k] = np.maximum(x[parameters] - step, model.lower[parameters])
    residuals = model.compared_residuals(sets)
    J = np.zeros((residuals.shape[0], p))
    forbidden = np.atleast_1d((np.abs(residuals) >= FORBIDDEN_RESIDUAL).any(axis=0))
    # where one side is forbidden the slope comes from the other alone
    sets[:, forbidden], residuals[:, forbidden] = sets[:, :1], residuals[:, :1]
    for k in range(pairs):
        difference = residuals[:, 1 + 2 * k] - residuals[:, 2 + 2 * k]
        if k < common:
            J[:, k] = difference / max(sets[k, 1 + 2 * k] - sets[k, 2 + 2 * k], _TINY)
        else:
            rows, column = np.arange(difference.size), common + model.segment
            J[rows, column] = difference / np.maximum(sets[column, 1 + 2 * k] - sets[column, 2 + 2 * k], _TINY)
    return residuals[:, 0], J


def minimise(model: Model, starts: Array, fixed: Sequence[int] = (), max_steps: int = 80) -> Estimate:
    """Find the best minimum from the best of ``starts``, (p, sets); parameters in ``fixed`` keep their start."""
    if starts.shape[1] == 1:
        return _descend(model, starts[:, 0], fixed, max_steps)
    groups = (starts[:, k : k + _SCREENED_AT_ONCE] for k in range(0, starts.shape[1], _SCREENED_AT_ONCE))
    sums = np.concatenate([np.einsum("ij,ij->j", r, r) for r in map(model.compared_residuals, groups)])
    order = np.argsort(sums)[:_N_REFINED]
    best = min((_descend(model, starts[:, k], fixed, max_steps) for k in order), key=lambda estimate: estimate.rss)
    # long steps see past the kinks of Eq (1), short steps end nearer to the minimum
    polished = _descend(replace(model, step=model.step / 20.0), best.x, fixed, max_steps)
    best = min(best, polished, key=lambda estimate: estimate.rss)
    return _estimate_at(model, best.x)  # with short steps a kink looks like a slope


def _estimate_at(model: Model, x: Array) -> Estimate:
    r, J = evaluate(model, x)
    return Estimate(x, r, J, float(r @ r))


def _descend(model: Model, x0: Array, fixed: Sequence[int], max_steps: int) -> Estimate:
    from scipy.optimize import least_squares

    free = np.setdiff1d(np.arange(x0.size), np.asarray(fixed, dtype=int))
    x = x0.copy()
    last: tuple[bytes, Array] = (b"", np.empty(0))

    def condensed_jacobian(part: Array) -> Array:
        """Jacobian and, last, residuals."""
        nonlocal last
        if last[0] != part.tobytes():
            x[free] = part
            r, J = evaluate(model, x)
            last = (part.tobytes(), _condense(np.column_stack([J[:, free], r])))
        return last[1]

    if free.size:
        lower, upper = model.lower[free], model.upper[free]
        span = upper - lower
        solution = least_squares(
            lambda part: condensed_jacobian(part)[:, -1],
            np.clip(x0[free], lower + 1e-9 * span, upper - 1e-9 * span),
            jac=lambda part: condensed_jacobian(part)[:, :-1],
            bounds=(lower, upper), method="trf", x_scale="jac", ftol=1e-9, xtol=1e-9, gtol=1e-12, max_nfev=max_steps,
        )  # fmt: skip
        x[free] = solution.x
    return _estimate_at(model, x)


def _condense(A: Array) -> Array:
    """Square matrix R with RᵀR = AᵀA: enough for a descent, and much faster to decompose."""
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0.0] = 1.0
    rows = np.ascontiguousarray((A / norms).T)
    # not BLAS, whose threads get in each other's way where the machine is shared
    w, V = np.linalg.eigh(np.einsum("ij,kj->ik", rows, rows))
    return np.asarray(np.sqrt(np.maximum(w, 0.0))[:, None] * V.T * norms)


@dataclass(frozen=True)
class Uncertainty:
    """How well an estimate is known."""

    covariance: Array  # (p, p), NaN for parameters that are fixed or at a bound
    inflation: Array  # factor on the variance of white residuals, (p,)
    n_used: int
    n_effective: float
    freedom: float
    variance: float
    without_effect: tuple[int, ...]  # index of the parameters without any effect

    def quantile(self, freedom: float | None = None) -> float:
        """Half width of a 95 % interval in standard errors, for ``freedom`` degrees of freedom, its own if None."""
        from scipy.stats import t

        return float(t.ppf(0.5 + CONFIDENCE / 2, freedom or self.freedom))


def uncertainty(model: Model, best: Estimate, fixed: Sequence[int] = (), profiled: Sequence[int] = ()) -> Uncertainty:
    """Covariance by SVD of the Jacobian; correlated residuals count as fewer samples.

    The variance of each estimate is that of residuals with their estimated autocorrelation ρ,
    aᵀ Jᵀ Ω J a with Ω = ρ(t - s), never less than that of white ones.  ``profiled`` parameters have one at their bound
    too: the limit of the profile depends on it.
    """
    r, n, p = best.r, int(model.used.sum()), best.x.size
    span = model.upper - model.lower
    is_inside = (best.x > model.lower + 1e-6 * span) & (best.x < model.upper - 1e-6 * span)
    is_inside[list(profiled)] = True
    norms = np.linalg.norm(best.J, axis=0)
    has_effect = norms > 1e-12 * max(float(norms.max()), 1e-300)
    free = np.flatnonzero(is_inside & has_effect & ~np.isin(np.arange(p), np.asarray(fixed, dtype=int)))
    rho = autocorrelation(r, model.segment, model.used)
    n_effective = min(max(n / max(1.0 + 2.0 * float(rho.sum()), 1.0), 1.0), n)
    freedom = max(n_effective - free.size, 1.0)
    variance = best.rss / n * n_effective / freedom
    _, s, Vt = np.linalg.svd(best.J[:, free] / norms[free], full_matrices=False)
    is_resolved = s > 1e-8 * s[0] if s.size else np.zeros(0, dtype=bool)
    inverse = (Vt[is_resolved].T / s[is_resolved] ** 2) @ Vt[is_resolved] / np.outer(norms[free], norms[free])
    white = np.diag(inverse).copy()
    coloured = white + 2.0 * _lagged_products(best.J[:, free] @ inverse, model.segment, rho)
    inflation = np.maximum(coloured / white, 1.0)
    covariance, factors = np.full((p, p), np.nan), np.ones(p)
    covariance[np.ix_(free, free)] = variance * inverse * np.sqrt(np.outer(inflation, inflation))
    for v in Vt[~is_resolved]:  # directions that the data do not identify
        unknown = free[np.abs(v) > 0.1]
        covariance[unknown, :] = covariance[:, unknown] = np.inf
    factors[free] = inflation
    without_effect = tuple(np.flatnonzero(~has_effect).tolist())
    return Uncertainty(covariance, factors, n, n_effective, freedom, variance, without_effect)


def autocorrelation(r: Array, segment: Index, used: Mask) -> Array:
    """ρ(1), ρ(2), … of the residuals, up to where they are lost in noise (initial monotone sequence of Geyer)."""
    r, mark = np.where(used, r, 0.0), used.astype(float)
    pieces = split_segments(segment)
    most = max(piece.size for piece in pieces) // 4  # a longer lag has too few pairs
    sums, counts = np.zeros(most + 1), np.zeros(most + 1)
    for piece in pieces:
        lags = min(most + 1, piece.size)
        sums[:lags] += _autoproducts(r[piece])[:lags]
        counts[:lags] += _autoproducts(mark[piece])[:lags]
    if most < 1 or sums[0] <= 0.0:
        return np.zeros(0)
    rho = (sums / np.maximum(counts, 1.0)) / (sums[0] / counts[0])
    pairs = rho[: rho.size // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0.0)
    n_pairs = negative[0] if negative.size else pairs.size
    pairs = np.minimum.accumulate(pairs[:n_pairs])
    kept = rho[: 2 * n_pairs]
    scale = np.repeat(pairs / np.maximum(kept.reshape(-1, 2).sum(axis=1), 1e-300), 2)
    return np.asarray((kept * scale)[1:])


def _autoproducts(x: Array) -> Array:
    """Sum over t of x[t] x[t + k] for every lag k, (n,)."""
    size = 1 << (2 * x.size - 1).bit_length()
    f = np.fft.rfft(x, size)
    return np.fft.irfft(f * np.conj(f), size)[: x.size]


def _lagged_products(Z: Array, segment: Index, rho: Array) -> Array:
    """Sum over lags k of ρ(k) times the sum over t of z[t] z[t + k], for every column of Z."""
    total = np.zeros(Z.shape[1])
    for piece in split_segments(segment):
        lags = min(rho.size, piece.size - 1)
        if lags > 0:
            total += [rho[:lags] @ _autoproducts(z)[1 : lags + 1] for z in Z[piece].T]
    return total


def profile_parameter(model: Model, best: Estimate, k: int, grid: Array, fixed: Sequence[int] = ()) -> list[Estimate]:
    """Minima with parameter k held at each value of ``grid`` (ascending), outward from the free minimum."""
    middle = int(np.searchsorted(grid, best.x[k]))
    estimates: dict[int, Estimate] = {}
    for indices in (range(middle, grid.size), range(middle - 1, -1, -1)):
        x = best.x
        for i in indices:
            start = x.copy()
            start[k] = grid[i]
            estimates[i] = minimise(model, start[:, None], [*fixed, k], max_steps=30)
            x = estimates[i].x
    return [estimates[i] for i in range(grid.size)]


_FEWEST_BLOCKS = 8  # that a log in fewer pieces is cut into


def widen_by_bootstrap(model: Model, best: Estimate, spread: Uncertainty, fixed: list[int]) -> Uncertainty:
    """Widen an uncertainty to that of a bootstrap over blocks, if that is larger."""
    block = bootstrap_blocks(model.segment, model.used, spread.n_effective)
    n_blocks = int(block.max()) + 1
    free = np.setdiff1d(np.flatnonzero(np.isfinite(np.diag(spread.covariance))), fixed)
    common = free[free < model.n_common]
    if n_blocks < 2 or not common.size:
        return spread
    low, high = np.quantile(_bootstrap_steps(best, block, n_blocks, free)[:, : common.size], [0.1587, 0.8413], axis=0)
    deviation = 0.5 * (high - low) * np.sqrt(n_blocks / (n_blocks - 1))
    ratio = deviation / np.sqrt(np.diag(spread.covariance)[common])
    ratio *= spread.quantile(n_blocks - 1) / spread.quantile()
    factor = np.ones(best.x.size)
    factor[common] = np.maximum(ratio, 1.0)
    covariance = spread.covariance * np.outer(factor, factor)
    return replace(spread, covariance=covariance, inflation=spread.inflation * factor**2)


def bootstrap_blocks(segment: Index, used: Mask, n_effective: float) -> Index:
    """Block number of each sample, (n,): the unbroken pieces, cut if they are too few."""
    pieces = np.unique(segment[used])
    if pieces.size >= _FEWEST_BLOCKS:
        return np.asarray(np.clip(np.searchsorted(pieces, segment), 0, pieces.size - 1))
    n_wanted = int(np.clip(n_effective / 5.0, _FEWEST_BLOCKS, 30))
    number, n = np.zeros(segment.size, dtype=np.int64), 0
    for piece in pieces:
        samples = np.flatnonzero((segment == piece) & used)
        cuts = max(round(n_wanted * samples.size / used.sum()), 1)
        number[samples] = n + np.arange(samples.size) * cuts // samples.size
        n += cuts
    return np.unique(number, return_inverse=True)[1]


def _bootstrap_steps(best: Estimate, block: Index, n_blocks: int, free: Index) -> Array:
    """Steps of the free parameters to the minimum of each draw, (draws, free)."""
    J, r = best.J[:, free], best.r
    scale = np.linalg.norm(J, axis=0)
    order = np.argsort(block, kind="stable")
    J, r, ends = (J / scale)[order], r[order], np.flatnonzero(np.diff(block[order])) + 1
    gradient = np.add.reduceat(J * r[:, None], np.concatenate([[0], ends]), axis=0)
    curvature = np.stack([part.T @ part for part in np.split(J, ends)])
    draws = np.random.default_rng(0).multinomial(n_blocks, np.full(n_blocks, 1.0 / n_blocks), size=400).astype(float)
    H = np.einsum("db,bij->dij", draws, curvature) + 1e-10 * np.eye(free.size)
    return np.asarray(-np.linalg.solve(H, (draws @ gradient)[..., None])[..., 0] / scale)
