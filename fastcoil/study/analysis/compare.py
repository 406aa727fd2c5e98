"""``compare``: paired differences against a baseline, as a Dataset and as a table for print.

All controllers of a study see the same days and the same noise (common random numbers), so the difference within a
pair says more than two means with their spread.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import (
    argument_checks,
    raise_problems,
    require_confidence_level,
    require_flag,
    require_mapping,
    require_names,
    require_number,
    to_builtin,
)
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.base.text import MISSING_VALUE, decimals_for_uncertainty, format_number, format_share
from fastcoil.loops.labels import Quantity, coordinate_quantity, quantity, values_quantity
from fastcoil.loops.scenarios import check_result
from fastcoil.model.metric_table import COSTS, METRICS, PREDICTIONS, STATUS_OK, YEARLY_PREFIX, metric_hint
from fastcoil.study.analysis.selected import list_first, mask_dataset, reduction_metrics

if TYPE_CHECKING:
    import pandas as pd


class Comparison(xr.Dataset):  # type: ignore[no-untyped-call]
    """Paired differences, as ``compare`` describes them; a selection from it still has ``to_table``."""

    __slots__ = ()

    def to_table(self) -> pd.DataFrame:
        """Write the comparison as a table for print, Markdown and LaTeX: a row per metric and label, texts in it.

        Returns
        -------
        pandas.DataFrame
            Index: the metric and the labels, with their units.  Columns: ``baseline`` and ``value``, the medians;
            ``difference``, the mean of the paired differences with its interval (a median, where some times never came
            and the mean is unknown); ``lower in``, the share of the pairs that are below their baseline; with
            ``threshold`` the shares that are below and above it by as much, with their intervals; ``pairs``, their
            number; and ``never``, the number of values that never came, if any.  The label of the baseline itself is
            left out, and so is a metric without any pair.

        Raises
        ------
        InputError
            For a selection of some statistics.
        """
        import pandas as pd

        needed = STATISTICS + (THRESHOLD_STATISTICS if "threshold" in self.attrs else ())
        if "statistic" not in self.dims or not set(needed) <= set(self["statistic"].values.tolist()):
            sentence = "to_table needs all statistics of the comparison: call it before .sel(statistic=...)"
            raise InputError(sentence, "statistic", "missing")
        if "level" not in self.attrs:
            sentence = "to_table needs the attributes of the comparison: call it on what compare returned"
            raise InputError(sentence, "attrs", "missing")
        compared = {str(name): variable for name, variable in self.data_vars.items() if "statistic" in variable.dims}
        dims = [str(d) for d in self.dims if d != "statistic" and any(d in v.dims for v in compared.values())]
        baseline = ast.literal_eval(self.attrs["baseline"])
        rows, index = [], []
        for name, variable in compared.items():
            if not (variable.sel(statistic="n_pairs") > 0).any():
                continue
            own_dims = [d for d in dims if d in variable.dims]
            values = variable.sel(statistic=list(needed)).transpose(*own_dims, "statistic").values
            for place in np.ndindex(values.shape[:-1]):
                at = {d: to_builtin(self[d].values[k]) for d, k in zip(own_dims, place, strict=True)}
                if all((at[d] if d in at else to_builtin(self[d].values)) == label for d, label in baseline.items()):
                    continue
                shown_as = _metric_quantity(variable)
                labels = (_format_label(self, d, at[d]) if d in at else MISSING_VALUE for d in dims)
                index.append((shown_as.axis, *labels))
                rows.append(self._format_row(name, shown_as, dict(zip(needed, values[place], strict=True))))
        names = ["metric", *(coordinate_quantity(self, d).axis for d in dims)]
        columns = list(rows[0]) if rows else []
        table = pd.DataFrame(rows, index=pd.MultiIndex.from_tuples(index, names=names), columns=columns)
        return table if (table.get("never", pd.Series()) != "0").any() else table.drop(columns="never", errors="ignore")

    def _format_row(self, metric: str, shown_as: Quantity, statistics: dict[str, float]) -> dict[str, str]:
        level = f"{self.attrs['level']:.3g}".removeprefix("0.").ljust(2, "0")
        relative, threshold = "relative" in self.attrs, self.attrs.get("threshold")
        factor, unit = (100.0, " %") if relative else (shown_as.factor, "")
        row = {
            "baseline": _format_value(shown_as, metric, statistics["baseline"]),
            "value": _format_value(shown_as, metric, statistics["value"]),
            f"difference ({level} %)": _format_difference(statistics, factor, unit),
            "lower in": format_share(statistics["share_lower"]),
        }
        if threshold is not None:
            size = f"{100 * threshold:.3g} %" if relative else shown_as.number(threshold)
            by = f" by {size}" if threshold else ""
            for side, word in (("below", "lower"), ("above", "higher")):
                edges = [statistics[f"share_{side}{edge}"] for edge in ("", "_low", "_high")]
                row[f"{word}{by} in ({level} %)"] = format_share(*edges)
        return row | {"pairs": f"{int(statistics['n_pairs']):,}", "never": str(int(statistics["n_censored"]))}


def _format_difference(statistics: dict[str, float], factor: float, unit: str) -> str:
    mean, low, high, median = (factor * statistics[s] for s in ("mean", "low", "high", "median"))
    if np.isnan(mean):
        return MISSING_VALUE if np.isnan(median) else f"median {format_number(median, sign=True)}{unit}"
    decimals = decimals_for_uncertainty((high - low) / 2)
    text = format_number(mean, decimals, sign=True) + unit
    edges = " to ".join(format_number(edge, decimals, sign=True) for edge in (low, high))
    return text if np.isnan(low) else f"{text} ({edges})"


def _metric_quantity(values: xr.DataArray) -> Quantity:
    """Return how the values of a metric are shown; the unit of shares is no longer that of their values."""
    name = str(values.name)
    known = name in METRICS or name in PREDICTIONS
    return quantity(name) if known or "relative_to" in values.attrs else values_quantity(values)


def _format_value(shown_as: Quantity, metric: str, value: float) -> str:
    if np.isinf(value) and metric in METRICS and METRICS[metric].censored:
        return "never"
    return format_number(shown_as.factor * value)


def _format_label(ds: xr.Dataset, dim: str, label: Any) -> str:
    return format_number(coordinate_quantity(ds, dim).factor * label) if isinstance(label, float) else str(label)


def compare(
    ds: xr.Dataset,
    *,
    baseline: Mapping[str, Any],
    over: str | Sequence[str],
    metrics: str | Sequence[str] | None = None,
    level: float = 0.95,
    relative: bool = False,
    threshold: float | None = None,
) -> Comparison:
    """Compare every scenario with its partner under a baseline, pair by pair.

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
    threshold
        Say in what share of the pairs the difference is at least so large, below the baseline and above it: 0.05 with
        ``relative`` is 5 %; without, it counts in the unit of the metrics, which must have the same one.  0 asks for
        any difference.

    Returns
    -------
    Comparison
        An ``xarray.Dataset`` with a method ``to_table``, which says the same to people: the metrics over the other
        dims and a dim ``statistic``: median of the ``baseline`` and of the ``value``; ``mean`` of the paired
        differences (value - baseline) with its interval ``low``–``high``; their quantiles ``q05`` to ``q95`` and
        ``median``; ``share_lower``, the share of pairs below their baseline (ties count half, also if both are
        censored); ``n_pairs``; ``n_censored``, the number of values that never came in this run.

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

        With ``threshold`` there are six more: ``share_below`` of the pairs has a difference of at most -threshold,
        ``share_above`` one of at least the threshold, each with the interval of its share, ``share_below_low`` to
        ``share_below_high`` and so on.  That one holds, as that of the mean, over other labels of every dim ``over``:
        other valves and other days, say.  It is Wilson's, for as many independent pairs as would scatter as the means
        of the days, and of the valves, do.

    Raises
    ------
    InputError
        For a dim, label or metric that ``ds`` does not have, or an argument of the wrong kind.

    See Also
    --------
    cost : what the energy of a result costs; costs are compared like metrics.
    sobol_indices : which parameters drive the spread of a result.

    Examples
    --------
    >>> import fastcoil as fc
    >>> day = fc.paper_day(hours=0.6, seed=[1, 2])
    >>> ds = fc.simulate(fc.Loop(backlash_estimate=[0.0, 0.07]), day, warm_up=600, n_jobs=1)
    >>> found = fc.compare(ds, baseline={"backlash_estimate": 0.0}, over="day", metrics="rmse")
    >>> int(found.rmse.sel(backlash_estimate=0.07, statistic="n_pairs"))
    2
    """
    with argument_checks() as check:
        check(check_result, ds)
        over = check(require_names, "over", over)
        metric_names = check.unless_none(require_names, "metrics", metrics)
        level = check(require_confidence_level, level)
        relative = check(require_flag, "relative", relative)
        threshold = check.unless_none(require_number, "threshold", threshold, "give a number of at least 0", least=0.0)
        cure = 'must be a dict of dimension and label, such as {"estimate_ratio": 0.0}'
        check(require_mapping, "baseline", baseline, cure)
    names = metric_names or [
        name for name in _comparable_names(ds) if name.removeprefix(YEARLY_PREFIX) not in PREDICTIONS
    ]
    _check_comparison(ds, baseline, over, names)
    units = sorted({str(ds[name].attrs.get("units", "1")) for name in names})
    if threshold is not None and not relative and len(units) > 1:
        raise InputError(
            f"threshold counts in the unit of the metrics, and these have {', '.join(units)}: name metrics of one "
            "unit, such as metrics='rmse', or compare with relative=True",
            "threshold",
            "unit",
        )
    ok = ds["status"] == STATUS_OK
    shape = [ds.sizes[d] for d in over]
    # noise is independent between days, but shared by everything else
    independent = [axis for axis, d in enumerate(over) if d != "replicate" or "day" not in over]
    words = str({dim: to_builtin(label) for dim, label in baseline.items()})
    results, statistic_names = {}, STATISTICS + (() if threshold is None else THRESHOLD_STATISTICS)
    for name in names:
        values = ds[name].where(ok)
        if name in METRICS and METRICS[name].censored:  # NaN means that it did not happen within the run
            values = values.where(values.notnull() | ~ok, np.inf)
        values, reference = xr.broadcast(values, values.sel(dict(baseline), drop=True))
        dims = [d for d in values.dims if d not in over]
        own_values, partner_values = (v.transpose(*dims, *over).values.reshape(-1, *shape) for v in (values, reference))
        statistics = paired_statistics(own_values, partner_values, independent, level, relative, threshold)
        attrs = ds[name].attrs
        if relative:
            comment = f"shares of the baseline; the statistics baseline and value in {attrs.get('units', '1')}"
            attrs = relative_attributes(attrs, words) | {"comment": comment}
        sizes = [values.sizes[d] for d in dims]
        results[name] = ((*dims, "statistic"), statistics.reshape(*sizes, len(statistic_names)), attrs)
    kept_dims = {*ds["status"].dims, *(d for dims, *_ in results.values() for d in dims)} - {*over, "statistic"}
    labels = {d: ds[d] for d in ds.dims if d in kept_dims}
    attrs = {"baseline": words, "over": ", ".join(over), "level": level} | ({"relative": 1} if relative else {})
    attrs |= {} if threshold is None else {"threshold": threshold}
    return Comparison(results, coords={**labels, "statistic": list(statistic_names)}, attrs=attrs)


def _comparable_names(ds: xr.Dataset) -> list[str]:
    """Return the metrics, costs, predictions and numbers of ``reduce`` in a result, without flags."""
    known = {n for n, each in METRICS.items() if not each.flags} | {*COSTS, *PREDICTIONS, *reduction_metrics(ds)}
    return [name for name in map(str, ds.data_vars) if name.removeprefix(YEARLY_PREFIX) in known]


def _check_comparison(ds: xr.Dataset, baseline: Mapping[str, Any], over: list[str], names: list[str]) -> None:
    dims = [str(d) for d in ds["status"].dims]
    if not dims:
        raise InputError(
            "ds is a single scenario without dimensions, so there is nothing to compare: give a sweep that holds the "
            "baseline, on several days or replicates",
            "ds",
            "shape",
        )
    problems: list[Problem] = []
    for argument, given in (("baseline", baseline), ("over", over)):
        for dim in (d for d in given if d not in dims):
            sentence = f"{argument}: {short_repr(dim)} is not a dimension of the result{did_you_mean(str(dim), dims)}"
            problems.append(Problem(f"{sentence}; it has {', '.join(dims)}", argument, "name"))
    for dim in (d for d in over if d in baseline):
        sentence = f"over: {dim} is a dimension of the baseline: choose one or the other"
        problems.append(Problem(sentence, "over", "conflict"))
    for dim in (d for d in baseline if d in dims):
        labels, single = ds[dim].values, to_builtin(baseline[dim])
        n = labels.tolist().count(single) if np.ndim(single) == 0 else 0
        if n != 1 or (isinstance(single, bool) and labels.dtype.kind != "b"):
            has = f"{n} labels" if n > 1 else "no label"
            cure = f"choose one of {list_first(labels)}"
            problems.append(
                Problem(f"baseline: {dim} has {has} {short_repr(baseline[dim])}; {cure}", "baseline", "choice")
            )
    for name in names:
        if name not in ds.data_vars:
            sentence = f"metrics: {short_repr(name)} is not in the result{metric_hint(name)}"
            problems.append(Problem(sentence, "metrics", "name"))
        elif name not in _comparable_names(ds):
            kind = "a flag" if name in METRICS else "not a number for each scenario"
            sentence = f"metrics: {name!r} is {kind}, which has no differences: leave it out"
            problems.append(Problem(sentence, "metrics", "unsupported"))
    if not baseline:
        sentence = "baseline is empty: give the dimension and label to compare with"
        problems.append(Problem(sentence, "baseline", "missing"))
    raise_problems(problems)


def wilson_interval(
    share: np.ndarray, variance: np.ndarray, cases: np.ndarray | int, labels: np.ndarray | int,
    quantile: np.ndarray | float,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return the ends of the interval of shares by Wilson's formula (1927, doi:10.1080/01621459.1927.10502953).

    Days of a valve are alike, and so are valves of a day: the number of cases is the one that would have the observed
    variance; where nothing varies, the number of labels.

    variance: of the means.  cases: how many each share is of.  labels: number of valves, or of days if they are more.
    quantile: of the standard normal or Student's distribution.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing varies, or there is no case at all
        n = np.where(variance > 0.0, np.minimum(cases, share * (1.0 - share) / variance), labels)
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


QUANTILES = {"q05": 0.05, "q25": 0.25, "median": 0.5, "q75": 0.75, "q95": 0.95}
STATISTICS = ("baseline", "value", "mean", "low", "high", *QUANTILES, "share_lower", "n_pairs", "n_censored")
THRESHOLD_STATISTICS = tuple(f"share_{side}{edge}" for side in ("below", "above") for edge in ("", "_low", "_high"))


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


def mask_off_days(ds: xr.Dataset) -> xr.Dataset:
    """Mask the metrics of days on which a loop was off all day, whose travel of 0 would shift medians."""
    if "rmse" not in ds or bool(ds["rmse"].notnull().all()):
        return ds
    is_on, dims = ds["rmse"].notnull(), set(ds["rmse"].dims)
    per_day = [n for n, v in ds.data_vars.items() if n != "status" and set(v.dims) == dims]
    return ds.assign(mask_dataset(ds[per_day], is_on).data_vars)


def relative_attributes(attrs: Mapping[str, Any], baseline: str) -> dict[str, Any]:
    """Return the attributes of a metric whose values are shares of those of a baseline."""
    kept = {name: value for name, value in attrs.items() if name != "units_metadata"}  # of kelvins
    return {**kept, "units": "1", "comment": "shares of the baseline", "relative_to": baseline}


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
        low, high = wilson_interval(share, variance, self.n, self.labels.max(axis=0), quantile)
        single = self.labels.min(axis=0) < 2
        return share, np.where(single, np.nan, low), np.where(single, np.nan, high)


def relative_to(ds: xr.Dataset, case: Mapping[str, int], words: str) -> xr.Dataset:
    """Express metrics as shares of their value in one case: -0.2 is a fifth lower.

    Where the value in the case is 0, or either failed, NaN, but 0 where both are 0.  Flags are left out, and so is the
    case.  The attribute ``relative_to`` of a metric names it.

    case: dimension → position along it.  words: the case, for people.
    """
    places = {d: np.delete(np.arange(ds.sizes[d]), k) for d, k in case.items()}
    if any(place.size == 0 for place in places.values()):
        sentence = f"--relative-to {words}: the study has no other case to compare with it"
        raise InputError(sentence, "--relative-to", "data")
    metrics = {"status": ds["status"].isel(places)}
    for name, variable in ds.data_vars.items():
        if name == "status" or variable.dims != ds["status"].dims or (name in METRICS and METRICS[name].flags):
            continue
        values = variable.where(ds["status"] == STATUS_OK)
        values, partners = xr.broadcast(values, values.isel(case, drop=True))
        change = values.copy(data=relative_change((values - partners).values, partners.values))
        change = change.transpose(*variable.dims).where(np.isfinite(change)).isel(places)
        metrics[str(name)] = change.drop_attrs().assign_attrs(relative_attributes(variable.attrs, words))
    return xr.Dataset(metrics, attrs=ds.attrs)
