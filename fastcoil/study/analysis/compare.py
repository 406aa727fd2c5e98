"""``compare``: paired differences against a baseline, as a Dataset and as a table for print.

All controllers of a study see the same days and the same noise (common random numbers), so the difference within a
pair says more than two means with their spread.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base import arguments
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.base.text import MISSING_VALUE, decimals_for_uncertainty, format_number, format_share
from fastcoil.loops.labels import Quantity, coordinate_quantity, quantity, values_quantity
from fastcoil.loops.scenarios import check_counted_result
from fastcoil.model.metric_table import COSTS, METRICS, STATUS_OK, YEARLY_PREFIX, metric_hint
from fastcoil.study.analysis.paired import STATISTICS, THRESHOLD_STATISTICS, paired_statistics
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
                at = {d: arguments.to_builtin(self[d].values[k]) for d, k in zip(own_dims, place, strict=True)}
                if {d: at[d] if d in at else arguments.to_builtin(self[d].values) for d in baseline} == baseline:
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
    known = name in METRICS
    return quantity(name) if known or "relative_to" in values.attrs else values_quantity(values)


def _format_value(shown_as: Quantity, metric: str, value: float) -> str:
    if np.isinf(value) and metric in METRICS and METRICS[metric].censored:
        return "never"
    return format_number(shown_as.factor * value)


def _format_label(ds: xr.Dataset, dim: str, label: Any) -> str:
    return format_number(coordinate_quantity(ds, dim).factor * label) if isinstance(label, float) else str(label)


def compare(
    ds: xr.Dataset, *, baseline: Mapping[str, Any], over: str | Sequence[str],
    metrics: str | Sequence[str] | None = None, level: float = 0.95, relative: bool = False,
    threshold: float | None = None,
) -> Comparison:  # fmt: skip
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
        other valves and other days, say.  It is Wilson's, for as many independent pairs as would scatter alike.

    Raises
    ------
    InputError
        For a dim, label or metric that ``ds`` does not have, or an argument of the wrong kind.

    Examples
    --------
    >>> import fastcoil as fc
    >>> day = fc.paper_day(hours=0.6, seed=[1, 2])
    >>> ds = fc.simulate(fc.Loop(backlash_estimate=[0.0, 0.07]), day, warm_up=600, n_jobs=1)
    >>> found = fc.compare(ds, baseline={"backlash_estimate": 0.0}, over="day", metrics="rmse")
    >>> int(found.rmse.sel(backlash_estimate=0.07, statistic="n_pairs"))
    2
    """
    with arguments.argument_checks() as check:
        check(check_counted_result, ds)
        over = check(arguments.require_names, "over", over)
        metric_names = check.unless_none(arguments.require_names, "metrics", metrics)
        level = check(arguments.require_confidence_level, level)
        relative = check(arguments.require_flag, "relative", relative)
        cure = "give a number of at least 0"
        threshold = check.unless_none(arguments.require_number, "threshold", threshold, cure, least=0.0)
        cure = 'must be a dict of dimension and label, such as {"estimate_ratio": 0.0}'
        check(arguments.require_mapping, "baseline", baseline, cure)
    names = metric_names or _comparable_names(ds)
    _check_comparison(ds, baseline, over, names)
    units = sorted({str(ds[name].attrs.get("units", "1")) for name in names})
    if threshold is not None and not relative and len(units) > 1:
        sentence = f"threshold counts in the unit of the metrics, and these have {', '.join(units)}: name metrics of"
        sentence += " one unit, such as metrics='rmse', or compare with relative=True"
        raise InputError(sentence, "threshold", "unit")
    ok = ds["status"] == STATUS_OK
    shape = [ds.sizes[d] for d in over]
    # noise is independent between days, but shared by everything else
    independent = [axis for axis, d in enumerate(over) if d != "replicate" or "day" not in over]
    words = str({dim: arguments.to_builtin(label) for dim, label in baseline.items()})
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
            kept = {key: value for key, value in attrs.items() if key != "units_metadata"}  # of kelvins
            attrs = kept | {"units": "1", "comment": comment, "relative_to": words}
        sizes = [values.sizes[d] for d in dims]
        results[name] = ((*dims, "statistic"), statistics.reshape(*sizes, len(statistic_names)), attrs)
    kept_dims = {*ds["status"].dims, *(d for dims, *_ in results.values() for d in dims)} - {*over, "statistic"}
    labels = {d: ds[d] for d in ds.dims if d in kept_dims}
    attrs = {"baseline": words, "over": ", ".join(over), "level": level} | ({"relative": 1} if relative else {})
    attrs |= {} if threshold is None else {"threshold": threshold}
    return Comparison(results, coords={**labels, "statistic": list(statistic_names)}, attrs=attrs)


def _comparable_names(ds: xr.Dataset) -> list[str]:
    """Return the metrics, costs, predictions and numbers of ``reduce`` in a result, without flags."""
    known = {n for n, each in METRICS.items() if not each.flags} | {*COSTS, *reduction_metrics(ds)}
    return [name for name in map(str, ds.data_vars) if name.removeprefix(YEARLY_PREFIX) in known]


def _check_comparison(ds: xr.Dataset, baseline: Mapping[str, Any], over: list[str], names: list[str]) -> None:
    dims = [str(d) for d in ds["status"].dims]
    arguments.require_no_unit("baseline", list(baseline.values()), "give labels")
    if not dims:
        sentence = "ds is a single scenario without dimensions, so there is nothing to compare"
        cure = "give a sweep that holds the baseline, on several days or replicates"
        raise InputError(f"{sentence}: {cure}", "ds", "shape")
    problems: list[Problem] = []
    for argument, given in (("baseline", baseline), ("over", over)):
        for dim in (d for d in given if d not in dims):
            sentence = f"{argument}: {short_repr(dim)} is not a dimension of the result{did_you_mean(str(dim), dims)}"
            problems.append(Problem(f"{sentence}; it has {', '.join(dims)}", argument, "name"))
    for dim in (d for d in over if d in baseline):
        sentence = f"over: {dim} is a dimension of the baseline: choose one or the other"
        problems.append(Problem(sentence, "over", "conflict"))
    for dim in (d for d in baseline if d in dims):
        labels, single = ds[dim].values, arguments.to_builtin(baseline[dim])
        n = labels.tolist().count(single) if np.ndim(single) == 0 else 0
        if n != 1 or (isinstance(single, bool) and labels.dtype.kind != "b"):
            sentence = f"baseline: {dim} has {f'{n} labels' if n > 1 else 'no label'} {short_repr(baseline[dim])}"
            problems.append(Problem(f"{sentence}; choose one of {list_first(labels)}", "baseline", "choice"))
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
    arguments.raise_problems(problems)


def mask_off_days(ds: xr.Dataset) -> xr.Dataset:
    """Mask the metrics of days on which a loop was off all day, whose travel of 0 would shift medians."""
    if "rmse" not in ds or bool(ds["rmse"].notnull().all()):
        return ds
    is_on, dims = ds["rmse"].notnull(), set(ds["rmse"].dims)
    per_day = [n for n, v in ds.data_vars.items() if n != "status" and set(v.dims) == dims]
    return ds.assign(mask_dataset(ds[per_day], is_on).data_vars)
