"""Statistics of pairs: differences against a partner, their quantiles, shares, intervals and bootstrapped medians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

QUANTILES = {"q05": 0.05, "q25": 0.25, "median": 0.5, "q75": 0.75, "q95": 0.95}
STATISTICS = ("baseline", "value", "mean", "low", "high", *QUANTILES, "share_lower", "n_pairs", "n_censored")
THRESHOLD_STATISTICS = tuple(f"share_{side}{edge}" for side in ("below", "above") for edge in ("", "_low", "_high"))

# chosen on simulated shares, see tests/study/analysis/test_share_intervals.py
TYPICAL_CORRELATION = 0.5  # of cases with the same label
TYPICAL_WEIGHT = 0.1  # of it, in labels whose case is the rarer one


def paired_statistics(
    values: np.ndarray, reference: np.ndarray, units: Sequence[int], level: float, relative: bool,
    threshold: float | None = None,
) -> np.ndarray:  # fmt: skip
    """Return all statistics, (cells, len(STATISTICS)), with a threshold also THRESHOLD_STATISTICS.

    values, reference: (cells, *over), NaN if failed, inf if censored; units: the axes of ``over`` with independent
    labels.
    """
    shape = values.shape
    values, reference = values.reshape(shape[0], -1), reference.reshape(shape[0], -1)
    pair = ~np.isnan(values) & ~np.isnan(reference)
    values, reference = np.where(pair, values, np.nan), np.where(pair, reference, np.nan)
    pairs = _Pairs(pair.reshape(shape), units, level)
    n_pairs = pairs.n
    both_censored = np.isinf(values) & np.isinf(reference)
    difference = np.zeros(values.shape)
    np.subtract(values, reference, out=difference, where=~both_censored)
    if relative:
        difference = relative_change(difference, reference)
    known = ~(np.isinf(difference) | both_censored).any(axis=1) & (n_pairs > 0)
    finite = np.where(pair & known[:, None], difference, 0.0)
    lower = np.where(pair, (difference < 0.0) + 0.5 * (difference == 0.0), 0.0)
    statistics = {"baseline": _quantile(reference, n_pairs, 0.5), "value": _quantile(values, n_pairs, 0.5)}
    statistics |= {name: _quantile(difference, n_pairs, q) for name, q in QUANTILES.items()}
    statistics |= {"n_pairs": n_pairs, "n_censored": np.isinf(values).sum(axis=1)}
    with np.errstate(invalid="ignore"):  # a cell without pairs has no share and no mean
        statistics["share_lower"] = lower.sum(axis=1) / n_pairs
        statistics["mean"] = mean = np.where(known, finite.sum(axis=1) / n_pairs, np.nan)
    half = pairs.half_width(np.where(pair, finite - mean[:, None], 0.0).reshape(shape))
    statistics |= {"low": mean - half, "high": mean + half}
    if threshold is not None:
        # at a threshold of 0 an equal value is neither
        for side, sign in (("below", -1), ("above", 1)):
            is_beyond = pair & (sign * difference > 0.0) & (sign * difference >= threshold)
            names = [f"share_{side}{edge}" for edge in ("", "_low", "_high")]
            statistics |= zip(names, pairs.share(is_beyond.reshape(shape)), strict=True)
    return np.stack([statistics[s] for s in STATISTICS + (() if threshold is None else THRESHOLD_STATISTICS)], axis=-1)


def relative_change(difference: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return differences as shares of the size of the reference.

    Where the reference is 0, an equal value differs by 0, and any other by ±inf; where it never came, by -1 from it.
    """
    size = abs(reference)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(np.isinf(size), np.sign(difference), difference / size)
    return np.where(difference == 0.0, 0.0, share)


def paired_change(values: xr.DataArray, partners: xr.DataArray) -> xr.DataArray:
    """Return changes within pairs as shares of the partner's value: -0.2 is a fifth lower; NaN where that is 0."""
    return values / partners.where(partners > 0.0) - 1.0


def _quantile(rows: np.ndarray, n: np.ndarray, q: float) -> np.ndarray:
    """Return the least of the first ``n`` sorted values of each row that a share q does not exceed.

    It needs no arithmetic, so values may be infinite.
    """
    place = np.clip(np.ceil(q * n - 1e-9).astype(int) - 1, 0, None)
    return np.take_along_axis(np.sort(rows, axis=1), place[:, None], axis=1)[:, 0]


class _Pairs:
    """The pairs that exist, (cells, *over), and intervals of their means and shares over labels of the units."""

    def __init__(self, pair: np.ndarray, units: Sequence[int], level: float) -> None:
        self.pair, self.level = pair, level
        self.n = pair.reshape(pair.shape[0], -1).sum(axis=1)
        self.within = [tuple(axis + 1 for axis in range(pair.ndim - 1) if axis != unit) for unit in units]
        self.labels = np.array([pair.any(axis=within).sum(axis=1) for within in self.within])

    def variances(self, deviation: np.ndarray) -> np.ndarray:
        """Return the variance that each unit adds to the mean of each cell; deviation: 0 where there is no pair."""
        sums = [(deviation.sum(axis=within) ** 2).sum(axis=1) for within in self.within]
        with np.errstate(invalid="ignore", divide="ignore"):  # a single label has no scatter
            return np.array([n / (n - 1) * of_unit / self.n**2 for n, of_unit in zip(self.labels, sums, strict=True)])

    def half_width(self, deviation: np.ndarray) -> np.ndarray:
        """Return half the interval of the mean of each cell."""
        from scipy.stats import t

        fewest = self.labels.min(axis=0)
        quantile: np.ndarray = t.ppf(0.5 + 0.5 * self.level, np.where(fewest > 1, fewest - 1, np.nan))
        half: np.ndarray = quantile * np.sqrt(self.variances(deviation).sum(axis=0))
        return half

    def share(self, holds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the share of the pairs for which a condition holds, with its interval.

        Wilson's formula for the number of independent cases that scatter as much, since cases of a day are alike (Miao
        and Gastwirth 2004, doi:10.1198/0003130043303), with the quantile of Student's distribution and Satterthwaite's
        degrees of freedom (1946, doi:10.2307/3002019).
        """
        from scipy.stats import t

        with np.errstate(invalid="ignore", divide="ignore"):  # a cell without pairs has no share
            share = holds.reshape(holds.shape[0], -1).sum(axis=1) / self.n
            mean = share.reshape(-1, *(1,) * (holds.ndim - 1))
            # near 0 and 1 labels hardly tell how alike their cases are; what is assumed takes no degrees of freedom
            weight = self.labels * np.minimum(share, 1.0 - share)
            correlation = self.correlations(self.variances(np.where(self.pair, holds - mean, 0.0)), share, weight)
            independent = (1.0 - correlation.sum(axis=0)) / self.n
            parts = correlation / self.labels + independent / len(self.labels)
            unknown = weight / (weight + TYPICAL_WEIGHT) / (self.labels - 1)
            freedom = parts.sum(axis=0) ** 2 / (parts**2 * unknown).sum(axis=0)
            low, high = wilson_interval(share, 1.0 / parts.sum(axis=0), t.ppf(0.5 + 0.5 * self.level, freedom))
        single = self.labels.min(axis=0) < 2
        return share, np.where(single, np.nan, low), np.where(single, np.nan, high)

    def correlations(self, variances: np.ndarray, share: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Correlation of cases with the same label, (units, cells), from the variance of a share by units."""
        most = share * (1.0 - share) / self.labels  # where all cases of a label are equal
        alone = self.labels / self.n  # share of it that independent cases have
        found = np.where(alone < 1.0, (variances / most - alone) / (1.0 - alone), 0.0)
        typical = 1.0 if len(self.labels) == 1 else TYPICAL_CORRELATION
        found = np.where(weight > 0.0, np.clip(found, 0.0, 1.0), 0.0)
        correlation = (weight * found + TYPICAL_WEIGHT * typical) / (weight + TYPICAL_WEIGHT)
        return np.asarray(correlation / np.maximum(correlation.sum(axis=0), 1.0))


def wilson_interval(share: np.ndarray, n: Any, quantile: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the interval of shares by Wilson's formula (1927, doi:10.1080/01621459.1927.10502953).

    n: number of independent cases.  quantile: of the standard normal or Student's distribution.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # there is no case at all
        middle = share + quantile**2 / (2 * n)
        half = quantile * np.sqrt(share * (1.0 - share) / n + quantile**2 / (4 * n**2))
        low, high = ((middle + sign * half) / (1.0 + quantile**2 / n) for sign in (-1, 1))
    return abs(np.maximum(low, 0.0)), np.minimum(high, 1.0)


_N_RESAMPLES = 1000
_RESAMPLES_AT_ONCE = 20
_MANY_VALUES = 2**18  # of which resamples are drawn one by one
_RESAMPLING_SEED = 20261122  # fixed, so that a summary is the same every time
_MEDIAN_LEVEL = 0.95
_SPREAD_QUANTILES = 0.05, 0.95


class MedianSummary(NamedTuple):
    """Median of some values, its 95 % interval over the units, and what 5 and 95 % of the values stay below."""

    median: float
    low: float
    high: float
    q05: float
    q95: float


def summarise_median(values: xr.DataArray, unit: str = "sample") -> MedianSummary:
    """Return the median of the values of pairs and its bootstrap interval; NaN is left out.

    unit: dim whose labels are resampled, each with all that belongs to it; without this dim, every value alone.
    All is NaN without a value; the interval is NaN with a single unit.
    """
    if unit in values.dims:
        rows = values.transpose(unit, ...).values.reshape(values.sizes[unit], -1)
    else:
        rows = values.values.reshape(-1, 1)
    rows = rows[np.isfinite(rows).any(axis=1)]
    if not rows.size:
        return MedianSummary(np.nan, np.nan, np.nan, np.nan, np.nan)
    low = high = np.nan
    if len(rows) > 1:
        rng, n = np.random.default_rng(_RESAMPLING_SEED), len(rows)
        median = np.nanmedian if np.isnan(rows).any() else np.median
        n_at_once = _RESAMPLES_AT_ONCE if rows.size < _MANY_VALUES else 1
        resamples = (rows[rng.integers(n, size=(n_at_once, n))] for _ in range(_N_RESAMPLES // n_at_once))
        medians = np.concatenate([median(part.reshape(n_at_once, -1), axis=1) for part in resamples])
        low, high = np.quantile(medians, [0.5 - 0.5 * _MEDIAN_LEVEL, 0.5 + 0.5 * _MEDIAN_LEVEL])
    q05, q95 = np.nanquantile(rows, _SPREAD_QUANTILES)
    return MedianSummary(float(np.nanmedian(rows)), float(low), float(high), float(q05), float(q95))
