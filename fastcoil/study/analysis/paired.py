"""Statistics of differences within pairs: their mean with its interval, quantiles, and shares with theirs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fastcoil.study.analysis.shares import interval

QUANTILES = {"q05": 0.05, "q25": 0.25, "median": 0.5, "q75": 0.75, "q95": 0.95}
STATISTICS = ("baseline", "value", "mean", "low", "high", *QUANTILES, "share_lower", "n_pairs", "n_censored")
OF_THRESHOLD = tuple(f"share_{side}{edge}" for side in ("below", "above") for edge in ("", "_low", "_high"))
"""Further statistics where a threshold is given."""


def relative_change(difference: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Differences as shares of the size of the reference.

    Where the reference is 0, an equal value differs by 0, and any other by ±inf; where it never came, by -1 from it.
    """
    size = abs(reference)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(np.isinf(size), np.sign(difference), difference / size)
    return np.where(difference == 0.0, 0.0, share)


def in_shares(attrs: Mapping[str, Any], baseline: str) -> dict[str, Any]:
    """The attributes of a metric whose values are shares of those of a baseline."""
    kept = {name: value for name, value in attrs.items() if name != "units_metadata"}  # of kelvins
    return {**kept, "units": "1", "comment": "shares of the baseline", "relative_to": baseline}


def statistics_of(
    values: np.ndarray,
    reference: np.ndarray,
    units: Sequence[int],
    level: float,
    relative: bool,
    threshold: float | None = None,
) -> np.ndarray:
    """Return all statistics, (cells, len(STATISTICS)), with a threshold (cells, len(STATISTICS + OF_THRESHOLD)).

    values, reference: (cells, *over), NaN if failed, inf if censored; units: the axes of ``over`` with independent
    labels.
    """
    shape = values.shape
    values, reference = values.reshape(shape[0], -1), reference.reshape(shape[0], -1)
    pair = ~np.isnan(values) & ~np.isnan(reference)
    values, reference = np.where(pair, values, np.nan), np.where(pair, reference, np.nan)
    n_pairs = pair.sum(axis=1)
    both_censored = np.isinf(values) & np.isinf(reference)
    difference = np.zeros(values.shape)
    np.subtract(values, reference, out=difference, where=~both_censored)
    if relative:
        difference = relative_change(difference, reference)
    found = {
        "baseline": _quantile(reference, n_pairs, 0.5),
        "value": _quantile(values, n_pairs, 0.5),
        "n_pairs": n_pairs,
        "n_censored": np.isinf(values).sum(axis=1),
    }
    found |= {name: _quantile(difference, n_pairs, q) for name, q in QUANTILES.items()}
    lower = np.where(pair, (difference < 0.0) + 0.5 * (difference == 0.0), 0.0)
    with np.errstate(invalid="ignore"):  # a cell without pairs has no share and no mean
        found["share_lower"] = lower.sum(axis=1) / n_pairs
        known = ~(np.isinf(difference) | both_censored).any(axis=1) & (n_pairs > 0)
        finite = np.where(pair & known[:, None], difference, 0.0)
        found["mean"] = np.where(known, finite.sum(axis=1) / n_pairs, np.nan)
    half = _half_width(
        np.where(pair, finite - found["mean"][:, None], 0.0).reshape(shape), pair.reshape(shape), units, level
    )
    found |= {"low": found["mean"] - half, "high": found["mean"] + half}
    names = STATISTICS
    if threshold is not None:
        names += OF_THRESHOLD
        # at a threshold of 0 an equal value is neither
        below, above = ((sign * difference > 0.0) & (sign * difference >= threshold) for sign in (-1, 1))
        for side, holds in (("below", below), ("above", above)):
            edges = _share(np.where(pair, holds, False).reshape(shape), pair.reshape(shape), units, level)
            found |= zip((f"share_{side}", f"share_{side}_low", f"share_{side}_high"), edges, strict=True)
    return np.stack([found[s] for s in names], axis=-1)


def _quantile(rows: np.ndarray, n: np.ndarray, q: float) -> np.ndarray:
    """Quantile of the first ``n`` sorted values of each row: the least value that a share q does not exceed.

    It needs no arithmetic, so values may be infinite.
    """
    place = np.clip(np.ceil(q * n - 1e-9).astype(int) - 1, 0, None)
    return np.take_along_axis(np.sort(rows, axis=1), place[:, None], axis=1)[:, 0]


def _scatter(deviation: np.ndarray, pair: np.ndarray, units: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Of each unit the variance that it adds to the mean of each cell, and how many labels it has: (units, cells).

    deviation: (cells, *over), 0 where there is no pair.
    """
    n_pairs = pair.reshape(pair.shape[0], -1).sum(axis=1)
    variances, labels = [], []
    for unit in units:
        within = tuple(axis + 1 for axis in range(pair.ndim - 1) if axis != unit)
        n = pair.any(axis=within).sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):  # a single label has no scatter
            variances.append(n / (n - 1) * (deviation.sum(axis=within) ** 2).sum(axis=1) / n_pairs**2)
        labels.append(n)
    return np.array(variances), np.array(labels)


def _half_width(deviation: np.ndarray, pair: np.ndarray, units: Sequence[int], level: float) -> np.ndarray:
    """Half the interval of the mean of each cell, from deviations (cells, *over) that are 0 where there is no pair."""
    from scipy.stats import t

    variances, labels = _scatter(deviation, pair, units)
    fewest = labels.min(axis=0)
    quantile: np.ndarray = t.ppf(0.5 + 0.5 * level, np.where(fewest > 1, fewest - 1, np.nan))
    return quantile * np.sqrt(sum(variances, np.zeros(pair.shape[0])))


def _share(
    holds: np.ndarray, pair: np.ndarray, units: Sequence[int], level: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The share of the pairs in which something holds, with its interval; (cells, *over).

    Wilson's formula with the quantile of Student's distribution, whose degrees of freedom are Satterthwaite's (1946,
    doi:10.2307/3002019): few days that hardly differ widen the interval little.
    """
    from scipy.stats import norm, t

    n_pairs = pair.reshape(pair.shape[0], -1).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):  # a cell without pairs has no share
        share = holds.reshape(pair.shape[0], -1).sum(axis=1) / n_pairs
        mean = share.reshape(-1, *(1,) * (pair.ndim - 1))
        variances, labels = _scatter(np.where(pair, holds - mean, 0.0), pair, units)
        variance = variances.sum(axis=0)
        freedom = variance**2 / (variances**2 / (labels - 1)).sum(axis=0)
    quantile = np.where(variance > 0.0, t.ppf(0.5 + 0.5 * level, freedom), norm.ppf(0.5 + 0.5 * level))
    low, high = interval(share, variance, n_pairs, labels.max(axis=0), quantile)
    single = labels.min(axis=0) < 2
    return share, np.where(single, np.nan, low), np.where(single, np.nan, high)
