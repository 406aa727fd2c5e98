"""``compare``: paired differences against a baseline, over the days and noise realisations that both share.

All controllers of a study see the same days and the same noise (common random numbers), so the difference within a
pair says more than two means with their spread.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.arguments import checking, flag_of, level_of, mapping_of, names_of, plain
from fastcoil.errors import InputError, WrongType, nearest, shown
from fastcoil.outputs import COSTS, METRICS, PREDICTIONS, STATUS_OK, YEARLY, metric_meant
from fastcoil.result import check_result

CENSORED = tuple(m.name for m in METRICS.values() if m.censored)
"""Metrics in which NaN means that it did not happen within the run."""
QUANTILES = {"q05": 0.05, "q25": 0.25, "median": 0.5, "q75": 0.75, "q95": 0.95}
STATISTICS = ("baseline", "value", "mean", "low", "high", *QUANTILES, "share_lower", "n_pairs", "n_censored")


def compare(
    ds: xr.Dataset,
    *,
    baseline: Mapping[str, Any],
    over: str | Sequence[str],
    metrics: str | Sequence[str] | None = None,
    level: float = 0.95,
    relative: bool = False,
) -> xr.Dataset:
    """Compare every scenario with its partner under a baseline.

    Parameters
    ----------
    ds
        A result with ``status``, or the costs of one, as of ``cost``.
    baseline
        Dim → label of the baseline, such as ``{"estimate_ratio": 0.0}`` for the plain PI; every label of these dims
        is compared with it.
    over
        Dim or dims whose labels are the pairs, such as ``["day", "replicate"]``.
    metrics
        Name or names; all metrics of ``ds`` by default.
    level
        Level of the interval ``low``–``high``.
    relative
        Give the differences as shares of the partner's value under the baseline: -0.2 is a fifth lower.

    Returns
    -------
    xarray.Dataset
        The metrics over the other dims and a dim ``statistic``: median of the ``baseline`` and of the ``value``;
        ``mean`` of the paired differences (value - baseline) with its interval ``low``–``high``; their quantiles
        ``q05`` to ``q95`` and ``median``; ``share_lower``, the share of pairs below their baseline (ties count half,
        also if both are censored); ``n_pairs``; ``n_censored``, the number of values that never came in this run.

        The interval is Student's, from the scatter between the means of days (of each label of a dim ``over``):
        replicates that share a day do not count as independent.  With several such dims, their variances add up and
        the dim with the fewest labels gives the degrees of freedom; with ``day``, ``replicate`` does not count.  The
        interval is NaN if one of these dims has a single label.

        A time that never came counts as later than any that did: quantiles may then be ±inf (beyond the run), and the
        mean is NaN.  Pairs with a failed scenario are left out.

        With ``relative`` every difference is divided by the size of the baseline's value before anything else is done;
        only ``baseline`` and ``value`` keep their unit.  Where the baseline is 0, an equal value differs by 0, and any
        other by ±inf: quantiles may then be infinite, and the mean is NaN.  A time that came differs by -1 from a
        baseline that never did.

    Raises
    ------
    InputError
        For a dim, label or metric that ``ds`` does not have, or an argument of the wrong kind.
    """
    with checking() as check:
        check(check_result, ds)
        over = check(names_of, "over", over)
        given = check.unless_none(names_of, "metrics", metrics)
        level = check(level_of, level)
        relative = check(flag_of, "relative", relative)
        check(
            mapping_of, "baseline", baseline, 'must be a dict of dimension and label, such as {"estimate_ratio": 0.0}'
        )
    compared = METRICS | COSTS
    names = given or [n for n in map(str, ds.data_vars) if _base(n) in compared and not compared[_base(n)].flags]
    _check(ds, baseline, over, names)
    ok = ds["status"] == STATUS_OK
    shape = [ds.sizes[d] for d in over]
    # noise is independent between days, but shared by everything else
    units = [axis for axis, d in enumerate(over) if d != "replicate" or "day" not in over]
    results = {}
    for name in names:
        values = ds[name].where(ok)
        if name in CENSORED:
            values = values.where(values.notnull() | ~ok, np.inf)
        values, reference = xr.broadcast(values, values.sel(dict(baseline), drop=True))
        dims = [d for d in values.dims if d not in over]
        own, partner = (v.transpose(*dims, *over).values.reshape(-1, *shape) for v in (values, reference))
        statistics = _statistics(own, partner, units, level, relative).reshape(
            *(values.sizes[d] for d in dims), len(STATISTICS)
        )
        results[name] = ((*dims, "statistic"), statistics, _in_shares(ds[name].attrs) if relative else ds[name].attrs)
    kept = {*ds["status"].dims, *(d for dims, *_ in results.values() for d in dims)} - {*over, "statistic"}
    labels = {d: ds[d] for d in ds.dims if d in kept}
    found = xr.Dataset(results, coords={**labels, "statistic": list(STATISTICS)})
    found.attrs = {"baseline": str(dict(baseline)), "over": ", ".join(over), "level": level}
    found.attrs |= {"relative": 1} if relative else {}
    return found


def _base(name: str) -> str:
    """The name of a metric or cost without what makes it one of a year."""
    return name.removeprefix(YEARLY)


def _in_shares(attrs: Mapping[str, Any]) -> dict[str, Any]:
    """The attributes of a metric whose differences are shares of the baseline."""
    comment = f"shares of the baseline; the statistics baseline and value in {attrs.get('units', '1')}"
    return {**attrs, "units": "1", "comment": comment}


def _shares(difference: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Differences as shares of the size of the reference; what becomes of 0 and inf is told in ``compare``."""
    size = abs(reference)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(np.isinf(size), np.sign(difference), difference / size)
    return np.where(difference == 0.0, 0.0, share)


def _statistics(
    values: np.ndarray, reference: np.ndarray, units: Sequence[int], level: float, relative: bool
) -> np.ndarray:
    """Return all statistics, (cells, len(STATISTICS)).

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
        difference = _shares(difference, reference)
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
    return np.stack([found[s] for s in STATISTICS], axis=-1)


def _quantile(rows: np.ndarray, n: np.ndarray, q: float) -> np.ndarray:
    """Quantile of the first ``n`` sorted values of each row: the least value that a share q does not exceed.

    It needs no arithmetic, so values may be infinite.
    """
    place = np.clip(np.ceil(q * n - 1e-9).astype(int) - 1, 0, None)
    return np.take_along_axis(np.sort(rows, axis=1), place[:, None], axis=1)[:, 0]


def _half_width(deviation: np.ndarray, pair: np.ndarray, units: Sequence[int], level: float) -> np.ndarray:
    """Half the interval of the mean of each cell, from deviations (cells, *over) that are 0 where there is no pair."""
    from scipy.stats import t

    variance, fewest = np.zeros(pair.shape[0]), np.full(pair.shape[0], np.inf)
    n_pairs = pair.reshape(pair.shape[0], -1).sum(axis=1)
    for unit in units:
        within = tuple(axis + 1 for axis in range(pair.ndim - 1) if axis != unit)
        n = pair.any(axis=within).sum(axis=1)
        fewest = np.minimum(fewest, n)
        with np.errstate(invalid="ignore", divide="ignore"):  # a single label has no scatter
            variance += n / (n - 1) * (deviation.sum(axis=within) ** 2).sum(axis=1) / n_pairs**2
    quantile: np.ndarray = t.ppf(0.5 + 0.5 * level, np.where(fewest > 1, fewest - 1, np.nan))
    return quantile * np.sqrt(variance)


def _check(ds: xr.Dataset, baseline: Mapping[str, Any], over: list[str], names: list[str]) -> None:
    dims = [str(d) for d in ds["status"].dims]
    if not dims:
        raise InputError(
            "ds is a single scenario without dimensions, so there is nothing to compare: give a sweep that holds the "
            "baseline, on several days or replicates"
        )
    problems = [
        f"{what}: {shown(dim)} is no dimension of the result{nearest(str(dim), dims)}; it has {', '.join(dims)}"
        for what, given in (("baseline", list(baseline)), ("over", over))
        for dim in given
        if dim not in dims
    ]
    problems += [
        f"over: {dim} is a dimension of the baseline: choose one or the other" for dim in over if dim in baseline
    ]
    for dim, label in baseline.items():
        if dim not in dims:
            continue
        labels, single = ds[dim].values, plain(label)
        if not isinstance(single, str | int | float | np.datetime64):
            sentence = f"baseline: {dim} = {shown(label)} is not a single label; give one, such as {labels[0]}"
            problems.append(WrongType(sentence))
        elif single not in labels or isinstance(single, bool) and labels.dtype.kind != "b":
            listed = ", ".join(map(str, labels[:10]))
            problems.append(f"baseline: {dim} has no label {shown(label)}; choose one of {listed}")
    for name in names:
        if name not in ds.data_vars or _base(name) not in METRICS | PREDICTIONS | COSTS:
            problems.append(f"metrics: {shown(name)} is not in the result{metric_meant(name)}")
        elif name in METRICS and METRICS[name].flags:
            problems.append(f"metrics: {name!r} is a flag, which has no differences: leave it out")
    if not baseline:
        problems.append("baseline is empty: give the dimension and label to compare with")
    if problems:
        raise InputError(problems)
