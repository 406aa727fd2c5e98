"""Statistics of differences within pairs and of medians, with their intervals."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.model.metric_table import METRICS, STATUS_OK


def interval(
    share: np.ndarray,
    variance: np.ndarray,
    cases: np.ndarray | int,
    labels: np.ndarray | int,
    quantile: np.ndarray | float,
) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper ends of shares by Wilson's formula (1927, doi:10.1080/01621459.1927.10502953).

    Days of a valve are alike, and so are valves of a day: the number of cases is taken as what would have the variance
    that is seen; where nothing varies, as that of the labels.

    variance: of the means.  cases: how many each share is of.  labels: how many valves, or days if they are more.
    quantile: of the standard normal or Student's distribution.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing varies, or there is no case at all
        n = np.where(variance > 0.0, np.minimum(cases, share * (1.0 - share) / variance), labels)
        middle = share + quantile**2 / (2 * n)
        half = quantile * np.sqrt(share * (1.0 - share) / n + quantile**2 / (4 * n**2))
        low, high = ((middle + sign * half) / (1.0 + quantile**2 / n) for sign in (-1, 1))
    return abs(np.maximum(low, 0.0)), np.minimum(high, 1.0)


_RESAMPLES, _AT_ONCE = 1000, 20
_SEED = 20261122  # of the resamples: a summary says the same twice
_LEVEL = 0.95
_SPREAD = 0.05, 0.95


class Middle(NamedTuple):
    """Median of some values, its 95 % interval over the units, and what 5 and 95 % of the values stay below."""

    median: float
    low: float
    high: float
    q05: float
    q95: float


def middle_of(values: xr.DataArray, unit: str = "sample") -> Middle:
    """The median of values of pairs and its bootstrap interval; NaN is left out.

    unit: dim whose labels are drawn anew, each with all that belongs to it; every value by itself if there is none.
    All is NaN without a value; the interval is NaN with a single unit.
    """
    if unit in values.dims:
        rows = values.transpose(unit, ...).values.reshape(values.sizes[unit], -1)
    else:
        rows = values.values.reshape(-1, 1)
    rows = rows[np.isfinite(rows).any(axis=1)]
    if not rows.size:
        return Middle(np.nan, np.nan, np.nan, np.nan, np.nan)
    low = high = np.nan
    if len(rows) > 1:
        draw, n = np.random.default_rng(_SEED), len(rows)
        median = np.nanmedian if np.isnan(rows).any() else np.median
        drawn = (rows[draw.integers(n, size=(_AT_ONCE, n))] for _ in range(_RESAMPLES // _AT_ONCE))
        medians = np.concatenate([median(part.reshape(_AT_ONCE, -1), axis=1) for part in drawn])
        low, high = np.quantile(medians, [0.5 - 0.5 * _LEVEL, 0.5 + 0.5 * _LEVEL])
    q05, q95 = np.nanquantile(rows, _SPREAD)
    return Middle(float(np.nanmedian(rows)), float(low), float(high), float(q05), float(q95))


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


def change_of(values: xr.DataArray, partners: xr.DataArray) -> xr.DataArray:
    """Changes within pairs as shares of the partner's value: -0.2 is a fifth lower; NaN where that is 0."""
    return values / partners.where(partners > 0.0) - 1.0


def without_off_days(ds: xr.Dataset) -> xr.Dataset:
    """A result without metrics on the days on which a loop was off all day, whose travel of 0 would shift medians."""
    if "rmse" not in ds:
        return ds
    on, dims = ds["rmse"].notnull(), set(ds["rmse"].dims)
    return ds.assign({n: v.where(on) for n, v in ds.data_vars.items() if n != "status" and set(v.dims) == dims})


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
    found = {"baseline": _quantile(reference, n_pairs, 0.5), "value": _quantile(values, n_pairs, 0.5)}
    found |= {name: _quantile(difference, n_pairs, q) for name, q in QUANTILES.items()}
    found |= {"n_pairs": n_pairs, "n_censored": np.isinf(values).sum(axis=1)}
    with np.errstate(invalid="ignore"):  # a cell without pairs has no share and no mean
        found["share_lower"] = lower.sum(axis=1) / n_pairs
        found["mean"] = mean = np.where(known, finite.sum(axis=1) / n_pairs, np.nan)
    half = pairs.half_width(np.where(pair, finite - mean[:, None], 0.0).reshape(shape))
    found |= {"low": mean - half, "high": mean + half}
    if threshold is not None:
        # at a threshold of 0 an equal value is neither
        for side, sign in (("below", -1), ("above", 1)):
            holds = pair & (sign * difference > 0.0) & (sign * difference >= threshold)
            names = [f"share_{side}{edge}" for edge in ("", "_low", "_high")]
            found |= zip(names, pairs.share(holds.reshape(shape)), strict=True)
    return np.stack([found[s] for s in STATISTICS + (() if threshold is None else OF_THRESHOLD)], axis=-1)


def _quantile(rows: np.ndarray, n: np.ndarray, q: float) -> np.ndarray:
    """Quantile of the first ``n`` sorted values of each row: the least value that a share q does not exceed.

    It needs no arithmetic, so values may be infinite.
    """
    place = np.clip(np.ceil(q * n - 1e-9).astype(int) - 1, 0, None)
    return np.take_along_axis(np.sort(rows, axis=1), place[:, None], axis=1)[:, 0]


class _Pairs:
    """Which pairs there are, (cells, *over), and the intervals of what is seen of them over labels of the units."""

    def __init__(self, pair: np.ndarray, units: Sequence[int], level: float) -> None:
        self.pair, self.level = pair, level
        self.n = pair.reshape(pair.shape[0], -1).sum(axis=1)
        self.within = [tuple(axis + 1 for axis in range(pair.ndim - 1) if axis != unit) for unit in units]
        self.labels = np.array([pair.any(axis=within).sum(axis=1) for within in self.within])

    def variances(self, deviation: np.ndarray) -> np.ndarray:
        """Of each unit the variance that it adds to the mean of each cell; deviation: 0 where there is no pair."""
        sums = [(deviation.sum(axis=within) ** 2).sum(axis=1) for within in self.within]
        with np.errstate(invalid="ignore", divide="ignore"):  # a single label has no scatter
            return np.array([n / (n - 1) * of_unit / self.n**2 for n, of_unit in zip(self.labels, sums, strict=True)])

    def half_width(self, deviation: np.ndarray) -> np.ndarray:
        """Half the interval of the mean of each cell."""
        from scipy.stats import t

        fewest = self.labels.min(axis=0)
        quantile: np.ndarray = t.ppf(0.5 + 0.5 * self.level, np.where(fewest > 1, fewest - 1, np.nan))
        half: np.ndarray = quantile * np.sqrt(self.variances(deviation).sum(axis=0))
        return half

    def share(self, holds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The share of the pairs in which something holds, with its interval.

        Wilson's formula with the quantile of Student's distribution, whose degrees of freedom are Satterthwaite's
        (1946, doi:10.2307/3002019): few days that hardly differ widen the interval little.
        """
        from scipy.stats import norm, t

        with np.errstate(invalid="ignore", divide="ignore"):  # a cell without pairs has no share
            share = holds.reshape(holds.shape[0], -1).sum(axis=1) / self.n
            mean = share.reshape(-1, *(1,) * (holds.ndim - 1))
            variances = self.variances(np.where(self.pair, holds - mean, 0.0))
            variance = variances.sum(axis=0)
            freedom = variance**2 / (variances**2 / (self.labels - 1)).sum(axis=0)
        upper = 0.5 + 0.5 * self.level
        quantile = np.where(variance > 0.0, t.ppf(upper, freedom), norm.ppf(upper))
        low, high = interval(share, variance, self.n, self.labels.max(axis=0), quantile)
        single = self.labels.min(axis=0) < 2
        return share, np.where(single, np.nan, low), np.where(single, np.nan, high)


def relative_to(ds: xr.Dataset, case: Mapping[str, int], words: str) -> xr.Dataset:
    """Metrics as shares of their value in one case: -0.2 is a fifth lower.

    Where the value in the case is 0, or either failed, NaN, but 0 where both are 0.  Flags are left out, and so is the
    case.  The attribute ``relative_to`` of a metric names it.

    case: dimension → position along it.  words: the case, for people.
    """
    rest = {d: np.delete(np.arange(ds.sizes[d]), k) for d, k in case.items()}
    if any(keep.size == 0 for keep in rest.values()):
        raise InputError(f"--relative-to {words}: the study has no other case to compare with it")
    found = {"status": ds["status"].isel(rest)}
    for name, variable in ds.data_vars.items():
        if name == "status" or variable.dims != ds["status"].dims or (name in METRICS and METRICS[name].flags):
            continue
        values = variable.where(ds["status"] == STATUS_OK)
        own, partner = xr.broadcast(values, values.isel(case, drop=True))
        change = own.copy(data=relative_change((own - partner).values, partner.values)).transpose(*variable.dims)
        change = change.where(np.isfinite(change)).isel(rest)
        found[str(name)] = change.drop_attrs().assign_attrs(in_shares(variable.attrs, words))
    return xr.Dataset(found, attrs=ds.attrs)
