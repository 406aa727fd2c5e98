"""Nonlinear least squares whose Jacobian comes from lanes: perturbed parameter sets in the same kernel call.

Trust-region reflective steps (``scipy.optimize.least_squares``, ``trf``), started from the best of many sets that are
screened as lanes; covariance by SVD, widened for the autocorrelation of the residuals.  The paper names
Levenberg-Marquardt, which knows no bounds, and these problems have some that matter: a backlash of 0, the least C_w
that is stable, an exponent that the data do not identify.  Where no bound is met both end in the same minimum.

What a meter gets wrong for hours or for a whole batch does not average out within it: the scatter of the gradient from
block to block says how much an estimate would change with other batches.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.measured.part import split_segments

CONFIDENCE_LEVEL = 0.95  # of all intervals of a fit
FORBIDDEN_RESIDUAL = 1e6  # in the unit of the samples, of a parameter set that cannot be run
_N_REFINED = 4  # number of best starts that are refined
_SETS_PER_CALL = 64  # parameter sets that are screened in one call
_LEAST_STEP = 1e-300  # so that nothing is divided by 0


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
        """Compute the residuals, (n, sets), of parameter sets, (p, sets); 0 at samples that are not compared."""
        r = self.residuals(sets)
        return np.where(self.used[:, None], np.where(np.isfinite(r), r, FORBIDDEN_RESIDUAL), 0.0)


@dataclass(frozen=True)
class Estimate:
    """A minimum: parameters x (p,), residuals (n,), Jacobian (n, p), residual sum of squares."""

    x: Array
    r: Array
    J: Array
    rss: float


def evaluate(model: Model, x: Array) -> tuple[Array, Array]:
    """Compute the residuals (n,) and their Jacobian (n, p) at x in one call, one-sided at a bound."""
    p, n_common = x.size, model.n_common
    n_pairs = n_common + (model.n_nuisance > 0)
    sets = np.repeat(x[:, None], 1 + 2 * n_pairs, axis=1)
    for k in range(n_pairs):
        parameters = slice(k, k + 1) if k < n_common else slice(n_common, p)
        step = model.step[parameters]
        sets[parameters, 1 + 2 * k] = np.minimum(x[parameters] + step, model.upper[parameters])
        sets[parameters, 2 + 2 * k] = np.maximum(x[parameters] - step, model.lower[parameters])
    residuals = model.compared_residuals(sets)
    J = np.zeros((residuals.shape[0], p))
    is_forbidden = np.atleast_1d((np.abs(residuals) >= FORBIDDEN_RESIDUAL).any(axis=0))
    # where one side is forbidden the slope comes from the other alone
    sets[:, is_forbidden], residuals[:, is_forbidden] = sets[:, :1], residuals[:, :1]
    for k in range(n_pairs):
        difference = residuals[:, 1 + 2 * k] - residuals[:, 2 + 2 * k]
        if k < n_common:
            J[:, k] = difference / max(sets[k, 1 + 2 * k] - sets[k, 2 + 2 * k], _LEAST_STEP)
        else:
            rows, column = np.arange(difference.size), n_common + model.segment
            J[rows, column] = difference / np.maximum(sets[column, 1 + 2 * k] - sets[column, 2 + 2 * k], _LEAST_STEP)
    return residuals[:, 0], J


def minimise(model: Model, starts: Array, fixed: Sequence[int] = (), max_steps: int = 80) -> Estimate:
    """Find the best minimum from the best of ``starts``, (p, sets); parameters in ``fixed`` keep their start."""
    if starts.shape[1] == 1:
        return _descend(model, starts[:, 0], fixed, max_steps)
    groups = (starts[:, k : k + _SETS_PER_CALL] for k in range(0, starts.shape[1], _SETS_PER_CALL))
    sums = np.concatenate([np.einsum("ij,ij->j", r, r) for r in map(model.compared_residuals, groups)])
    order = np.argsort(sums)[:_N_REFINED]
    best = min((_descend(model, starts[:, k], fixed, max_steps) for k in order), key=lambda estimate: estimate.rss)
    # long steps see past the kinks of Eq (1), short steps end nearer to the minimum
    polished_estimate = _descend(replace(model, step=model.step / 20.0), best.x, fixed, max_steps)
    best = min(best, polished_estimate, key=lambda estimate: estimate.rss)
    return _estimate_at(model, best.x)  # with short steps a kink looks like a slope


def _estimate_at(model: Model, x: Array) -> Estimate:
    """Return the parameters x with residuals and Jacobian there."""
    r, J = evaluate(model, x)
    return Estimate(x, r, J, float(r @ r))


def _descend(model: Model, x0: Array, fixed: Sequence[int], max_steps: int) -> Estimate:
    """Find the minimum below one start, x0, by trust-region steps; parameters in ``fixed`` keep their start."""
    from scipy.optimize import least_squares

    free = np.setdiff1d(np.arange(x0.size), np.asarray(fixed, dtype=int))
    x = x0.copy()

    @lru_cache(maxsize=1)
    def condensed_jacobian(x_free: bytes) -> Array:
        """Return Jacobian and, in the last column, residuals, condensed to a square matrix."""
        x[free] = np.frombuffer(x_free)
        r, J = evaluate(model, x)
        return _condense(np.column_stack([J[:, free], r]))

    if free.size:
        lower, upper = model.lower[free], model.upper[free]
        width = upper - lower
        solution = least_squares(
            lambda x_free: condensed_jacobian(x_free.tobytes())[:, -1],
            np.clip(x0[free], lower + 1e-9 * width, upper - 1e-9 * width),
            jac=lambda x_free: condensed_jacobian(x_free.tobytes())[:, :-1],
            bounds=(lower, upper), method="trf", x_scale="jac", ftol=1e-9, xtol=1e-9, gtol=1e-12, max_nfev=max_steps,
        )  # fmt: skip
        x[free] = solution.x
    return _estimate_at(model, x)


def _condense(A: Array) -> Array:
    """Return a square matrix R with RᵀR = AᵀA: enough for a descent, and much faster to decompose."""
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0.0] = 1.0
    rows = np.ascontiguousarray((A / norms).T)
    # not BLAS, whose threads get in each other's way where the machine is shared
    w, V = np.linalg.eigh(np.einsum("ij,kj->ik", rows, rows))
    return np.asarray(np.sqrt(np.maximum(w, 0.0))[:, None] * V.T * norms)


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of an estimate: covariance, and how many independent samples it rests on."""

    covariance: Array  # (p, p), NaN for parameters that are fixed or at a bound
    inflation: Array  # factor on the variance of white residuals, (p,)
    n_used: int
    n_effective: float
    freedom: float
    variance: float
    without_effect: tuple[int, ...]  # index of the parameters without any effect

    def quantile(self, freedom: float | None = None) -> float:
        """Return the half width of a 95 % interval in standard errors; freedom: degrees of freedom, its own if None."""
        from scipy.stats import t

        return float(t.ppf(0.5 + CONFIDENCE_LEVEL / 2, freedom or self.freedom))


def uncertainty(model: Model, best: Estimate, fixed: Sequence[int] = (), profiled: Sequence[int] = ()) -> Uncertainty:
    """Estimate the covariance by SVD of the Jacobian; correlated residuals count as fewer samples.

    The variance of each estimate is that of residuals with their estimated autocorrelation ρ,
    aᵀ Jᵀ Ω J a with Ω = ρ(t - s), never less than that of white ones.  ``profiled`` parameters have one at their bound
    too: the limit of the profile depends on it.
    """
    r, n, p = best.r, int(model.used.sum()), best.x.size
    width = model.upper - model.lower
    is_inside = (best.x > model.lower + 1e-6 * width) & (best.x < model.upper - 1e-6 * width)
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
    white_variances = np.diag(inverse).copy()
    coloured_variances = white_variances + 2.0 * _lagged_products(best.J[:, free] @ inverse, model.segment, rho)
    inflation = np.maximum(coloured_variances / white_variances, 1.0)
    covariance, factors = np.full((p, p), np.nan), np.ones(p)
    covariance[np.ix_(free, free)] = variance * inverse * np.sqrt(np.outer(inflation, inflation))
    for v in Vt[~is_resolved]:  # directions that the data do not identify
        unidentified_columns = free[np.abs(v) > 0.1]
        covariance[unidentified_columns, :] = covariance[:, unidentified_columns] = np.inf
    factors[free] = inflation
    without_effect = tuple(np.flatnonzero(~has_effect).tolist())
    return Uncertainty(covariance, factors, n, n_effective, freedom, variance, without_effect)


def autocorrelation(r: Array, segment: Index, used: Mask) -> Array:
    """Estimate the autocorrelation ρ(1), ρ(2), … of residuals, until lost in noise (Geyer's monotone sequence)."""
    r, is_used = np.where(used, r, 0.0), used.astype(float)
    pieces = split_segments(segment)
    largest_lag = max(piece.size for piece in pieces) // 4  # a longer lag has too few pairs
    sums, counts = np.zeros(largest_lag + 1), np.zeros(largest_lag + 1)
    for piece in pieces:
        n_lags = min(largest_lag + 1, piece.size)
        sums[:n_lags] += _autoproducts(r[piece])[:n_lags]
        counts[:n_lags] += _autoproducts(is_used[piece])[:n_lags]
    if largest_lag < 1 or sums[0] <= 0.0:
        return np.zeros(0)
    rho = (sums / np.maximum(counts, 1.0)) / (sums[0] / counts[0])
    pair_sums = rho[: rho.size // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pair_sums <= 0.0)
    n_pairs = negative[0] if negative.size else pair_sums.size
    pair_sums = np.minimum.accumulate(pair_sums[:n_pairs])
    significant_rho = rho[: 2 * n_pairs]
    scale = np.repeat(pair_sums / np.maximum(significant_rho.reshape(-1, 2).sum(axis=1), 1e-300), 2)
    return np.asarray((significant_rho * scale)[1:])


def _autoproducts(x: Array) -> Array:
    """Return the sum over t of x[t] x[t + k] for every lag k, (n,)."""
    size = 1 << (2 * x.size - 1).bit_length()
    f = np.fft.rfft(x, size)
    return np.fft.irfft(f * np.conj(f), size)[: x.size]


def _lagged_products(Z: Array, segment: Index, rho: Array) -> Array:
    """Return the sum over lags k and times t of ρ(k) z[t] z[t + k], for every column z of Z."""
    total = np.zeros(Z.shape[1])
    for piece in split_segments(segment):
        n_lags = min(rho.size, piece.size - 1)
        if n_lags > 0:
            total += [rho[:n_lags] @ _autoproducts(z)[1 : n_lags + 1] for z in Z[piece].T]
    return total


def profile_parameter(model: Model, best: Estimate, k: int, grid: Array, fixed: Sequence[int] = ()) -> list[Estimate]:
    """Find the minimum with parameter k held at each value of ``grid`` (ascending), outward from the free minimum."""
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


_FEWEST_BLOCKS = 8  # that the errors of a meter are taken from; a log of fewer segments is cut


def widen_by_blocks(model: Model, best: Estimate, spread: Uncertainty) -> Uncertainty:
    """Widen an uncertainty to what the blocks of a log show, if that is larger: the sandwich estimator by block."""
    block = number_blocks(model.segment, model.used, spread.n_effective)
    n_blocks = int(block.max()) + 1
    free = np.flatnonzero(np.isfinite(np.diag(spread.covariance)))
    if n_blocks < 2 or not free.size:
        return spread
    J = best.J[:, free]
    gradient = np.zeros((n_blocks, free.size))
    np.add.at(gradient, block, J * best.r[:, None])
    scatter = gradient @ np.linalg.pinv(J.T @ J, hermitian=True)  # of the estimate, by block
    deviation = np.sqrt(np.sum(scatter**2, axis=0) * n_blocks / (n_blocks - 1))
    deviation *= spread.quantile(n_blocks - 1) / spread.quantile()
    factor = np.ones(best.x.size)
    factor[free] = np.maximum(deviation / np.sqrt(np.diag(spread.covariance)[free]), 1.0)
    factor[model.n_common :] = 1.0
    covariance = spread.covariance * np.outer(factor, factor)
    return replace(spread, covariance=covariance, inflation=spread.inflation * factor**2)


def number_blocks(segment: Index, used: Mask, n_effective: float) -> Index:
    """Return the number of the block of each sample, (n,): the segments, cut if they are too few."""
    n_wanted = int(np.clip(n_effective / 5.0, _FEWEST_BLOCKS, 30))
    share = np.maximum(np.cumsum(used) - 1, 0) * n_wanted // max(int(used.sum()), 1)
    is_cut = np.unique(segment[used]).size < _FEWEST_BLOCKS
    block = np.zeros(segment.size, dtype=np.int64)
    block[used] = np.unique((segment * n_wanted + is_cut * share)[used], return_inverse=True)[1]
    return block
