"""``compare``: paired differences against a baseline, over the days and noise realisations that both share.

All controllers of a study meet the same days and the same noise (common random numbers), so that the difference
within a pair says more than two means with their spread.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.errors import InputError, nearest
from fastcoil.outputs import METRICS, STATUS_OK

CENSORED = tuple(m.name for m in METRICS.values() if "censored" in m.comment)
"""Metrics in which NaN means: not within this run."""
QUANTILES = {"q05": 0.05, "q25": 0.25, "median": 0.5, "q75": 0.75, "q95": 0.95}
STATISTICS = ("baseline", "value", "mean", "low", "high", *QUANTILES, "share_lower", "n_pairs", "n_censored")
_RESAMPLES = 2000
_CELLS_AT_ONCE = 1000


def compare(
    ds: xr.Dataset,
    *,
    baseline: Mapping[str, Any],
    over: str | Sequence[str],
    metrics: Sequence[str] | None = None,
    level: float = 0.95,
) -> xr.Dataset:
    """Compare every scenario with its partner under a baseline.

    Parameters
    ----------
    ds
        A result with ``status``.
    baseline
        Dim → label of the baseline, such as ``{"estimate_ratio": 0.0}`` for the plain PI; the labels of these dims
        are compared with it.
    over
        Dim or dims along which pairs are gathered, such as ``["day", "replicate"]``.
    metrics
        Names; all metrics of ``ds`` by default.
    level
        Of the interval ``low``–``high``.

    Returns
    -------
    xarray.Dataset
        The metrics over the other dims and a dim ``statistic``: median of the ``baseline`` and of the ``value``;
        ``mean`` of the paired differences (value - baseline) with its interval ``low``–``high``; their quantiles
        ``q05`` to ``q95`` and ``median``; ``share_lower``, the share of pairs that lie below their baseline (ties,
        both censored among them, count half); ``n_pairs``; ``n_censored``, values that never came in this run.

        The interval is a bootstrap that resamples each of the dims ``over`` as a whole, so that replicates that share
        a day do not count as independent; NaN where there is one pair only.  Times
        that never came are later than all that did: quantiles then may be ±inf (beyond the run), the mean is NaN.
        Pairs with a failed scenario are left out.

    Raises
    ------
    InputError
        For a dim, label or metric that ``ds`` does not have.
    """
    over = [over] if isinstance(over, str) else list(over)
    names = (
        list(metrics)
        if metrics is not None
        else [str(n) for n in ds.data_vars if n in METRICS and not METRICS[str(n)].flags]
    )
    _check(ds, baseline, over, names, level)
    ok = ds["status"] == STATUS_OK
    weights = _weights([ds.sizes[d] for d in over])
    results = {}
    for name in names:
        values = ds[name].where(ok)
        if name in CENSORED:
            values = values.where(values.notnull() | ~ok, np.inf)
        values, reference = xr.broadcast(values, values.sel(dict(baseline), drop=True))
        dims = [d for d in values.dims if d not in over]
        own, partner = (v.transpose(*dims, *over).values.reshape(-1, weights.shape[1]) for v in (values, reference))
        found = _statistics(own, partner, weights, level).reshape(*(values.sizes[d] for d in dims), len(STATISTICS))
        results[name] = ((*dims, "statistic"), found, ds[name].attrs)
    labels = {d: ds[d] for d in ds["status"].dims if d not in over}
    compared = xr.Dataset(results, coords={**labels, "statistic": list(STATISTICS)})
    compared.attrs = {"baseline": str(dict(baseline)), "over": ", ".join(over), "level": level}
    return compared


def _statistics(values: np.ndarray, reference: np.ndarray, weights: np.ndarray, level: float) -> np.ndarray:
    """(cells, len(STATISTICS)).

    values, reference: (cells, pairs), NaN where failed, inf where censored; weights: (resamples, pairs).
    """
    pair = ~np.isnan(values) & ~np.isnan(reference)
    values, reference = np.where(pair, values, np.nan), np.where(pair, reference, np.nan)
    n_pairs = pair.sum(axis=1)
    both_censored = np.isinf(values) & np.isinf(reference)
    difference = np.zeros(values.shape)
    np.subtract(values, reference, out=difference, where=~both_censored)
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
        found["low"], found["high"] = _interval(finite, pair, weights, level)
    for edge in ("low", "high"):
        found[edge] = np.where(known & (weights.shape[0] > 1), found[edge], np.nan)
    return np.stack([found[s] for s in STATISTICS], axis=-1)


def _quantile(rows: np.ndarray, n: np.ndarray, q: float) -> np.ndarray:
    """Quantile of the first ``n`` sorted values of each row: the least value that a share q does not exceed.

    It needs no arithmetic, so that values may be infinite.
    """
    place = np.clip(np.ceil(q * n - 1e-9).astype(int) - 1, 0, None)
    return np.take_along_axis(np.sort(rows, axis=1), place[:, None], axis=1)[:, 0]


def _weights(shape: Sequence[int]) -> np.ndarray:
    """How often each pair is drawn in each resample, (resamples, pairs); every dim is resampled as a whole."""
    rng = np.random.default_rng(0)
    resamples = _RESAMPLES if max(shape) > 1 else 1
    weights = np.ones((resamples, 1))
    for n in shape:
        drawn = rng.multinomial(n, np.full(n, 1.0 / n), size=resamples)
        weights = (weights[:, :, None] * drawn[:, None, :]).reshape(resamples, -1)
    return weights


def _interval(
    difference: np.ndarray, pair: np.ndarray, weights: np.ndarray, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Bootstrap interval of the mean difference of each cell."""
    edges = np.empty((2, difference.shape[0]))
    for start in range(0, difference.shape[0], _CELLS_AT_ONCE):
        at = slice(start, start + _CELLS_AT_ONCE)
        count = weights @ pair[at].T.astype(float)
        means = (weights @ difference[at].T) / np.where(count > 0.0, count, np.nan)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # cells without pairs
            edges[:, at] = np.nanquantile(means, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)
    return edges[0], edges[1]


def _check(ds: xr.Dataset, baseline: Mapping[str, Any], over: list[str], names: list[str], level: float) -> None:
    if "status" not in ds:
        raise InputError("ds has no status: give a Dataset of fastcoil.simulate or open_study")
    dims = [str(d) for d in ds["status"].dims]
    problems = [
        f"{what}: {dim!r} is no dimension of the result{nearest(str(dim), dims)}; it has {', '.join(dims)}"
        for what, given in (("baseline", list(baseline)), ("over", over))
        for dim in given
        if dim not in dims
    ]
    problems += [
        f"over: {dim} is a dimension of the baseline: choose one or the other" for dim in over if dim in baseline
    ]
    for dim, label in baseline.items():
        if dim in dims and label not in ds[dim].values:
            shown = ", ".join(map(str, ds[dim].values[:10]))
            problems.append(f"baseline: {dim} has no label {label!r}; choose one of {shown}")
    problems += [
        f"metrics: {name!r} is not in the result{nearest(str(name), METRICS)}"
        for name in names
        if name not in ds.data_vars or name not in METRICS
    ]
    if not baseline:
        problems.append("baseline is empty: give the dimension and label to compare with")
    if not over:
        problems.append("over is empty: give the dimension along which pairs are gathered")
    if not 0.0 < level < 1.0:
        problems.append(f"level = {level}: must lie between 0 and 1")
    if problems:
        raise InputError(problems)
