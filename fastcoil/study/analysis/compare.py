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

from fastcoil.base.arguments import checking, flag_of, level_of, mapping_of, names_of, number_of, plain, refuse
from fastcoil.base.errors import InputError, WrongType, nearest, shown
from fastcoil.base.text import NONE, decimals_of, percent, written
from fastcoil.loops.labels import Quantity, quantity, quantity_of, quantity_of_values
from fastcoil.loops.scenarios import check_result
from fastcoil.model.metric_table import COSTS, METRICS, PREDICTIONS, STATUS_OK, YEARLY, metric_meant
from fastcoil.study.analysis.paired import OF_THRESHOLD, STATISTICS, in_shares, statistics_of
from fastcoil.study.analysis.selected import own_metrics

if TYPE_CHECKING:
    import pandas as pd


class Comparison(xr.Dataset):  # type: ignore[no-untyped-call]
    """Paired differences, as ``compare`` describes them; whatever is selected from it still has ``to_table``."""

    __slots__ = ()

    def to_table(self) -> pd.DataFrame:
        """Write the comparison as a table for print, Markdown and LaTeX: a row per metric and label, texts in it.

        Returns
        -------
        pandas.DataFrame
            With the metric and the labels as index, with their units, and the columns ``baseline`` and ``value``, the
            medians; ``difference``, the mean of the paired differences with its interval (a median, where the mean is
            unknown for some times never came); ``lower in``, the share of the pairs that are below their baseline;
            with ``threshold`` the shares that are below and above it by as much, with their intervals; ``pairs``,
            their number; and ``never``, how many of them have a value that never came, if any has.  The label of the
            baseline itself is left out, and so is a metric without any pair.
        """
        import pandas as pd

        needed = STATISTICS + (OF_THRESHOLD if "threshold" in self.attrs else ())
        if "statistic" not in self.dims or not set(needed) <= set(self["statistic"].values.tolist()):
            raise InputError("to_table needs all statistics of the comparison: call it before .sel(statistic=...)")
        if "level" not in self.attrs:
            raise InputError("to_table needs the attributes of the comparison: call it on what compare returned")
        compared = {str(name): variable for name, variable in self.data_vars.items() if "statistic" in variable.dims}
        dims = [str(d) for d in self.dims if d != "statistic" and any(d in v.dims for v in compared.values())]
        baseline = ast.literal_eval(self.attrs["baseline"])
        rows, index = [], []
        for name, variable in compared.items():
            if not (variable.sel(statistic="n_pairs") > 0).any():
                continue
            own = [d for d in dims if d in variable.dims]
            values = variable.sel(statistic=list(needed)).transpose(*own, "statistic").values
            for place in np.ndindex(values.shape[:-1]):
                at = {d: plain(self[d].values[k]) for d, k in zip(own, place, strict=True)}
                if all((at[d] if d in at else plain(self[d].values)) == label for d, label in baseline.items()):
                    continue
                of = _quantity(variable)
                index.append((of.axis, *(_label(self, d, at[d]) if d in at else NONE for d in dims)))
                rows.append(self._row(name, of, dict(zip(needed, values[place], strict=True))))
        names = ["metric", *(quantity_of(self, d).axis for d in dims)]
        columns = list(rows[0]) if rows else []
        table = pd.DataFrame(rows, index=pd.MultiIndex.from_tuples(index, names=names), columns=columns)
        return table if (table.get("never", pd.Series()) != "0").any() else table.drop(columns="never", errors="ignore")

    def _row(self, metric: str, of: Quantity, found: dict[str, float]) -> dict[str, str]:
        """The cells of a row from all statistics."""
        level = f"{self.attrs['level']:.3g}".removeprefix("0.").ljust(2, "0")
        relative, threshold = "relative" in self.attrs, self.attrs.get("threshold")
        row = {
            "baseline": _value(of, metric, found["baseline"]),
            "value": _value(of, metric, found["value"]),
            f"difference ({level} %)": _difference(found, *((100.0, " %") if relative else (of.factor, ""))),
            "lower in": percent(found["share_lower"]),
        }
        if threshold is not None:
            size = f"{100 * threshold:.3g} %" if relative else of.number(threshold)
            by = f" by {size}" if threshold else ""
            for side, word in (("below", "lower"), ("above", "higher")):
                edges = [found[f"share_{side}{edge}"] for edge in ("", "_low", "_high")]
                row[f"{word}{by} in ({level} %)"] = percent(*edges)
        return row | {"pairs": f"{int(found['n_pairs']):,}", "never": str(int(found["n_censored"]))}


def _difference(found: dict[str, float], factor: float, unit: str) -> str:
    mean, low, high, median = (factor * found[s] for s in ("mean", "low", "high", "median"))
    if np.isnan(mean):
        return NONE if np.isnan(median) else f"median {written(median, sign=True)}{unit}"
    decimals = decimals_of((high - low) / 2)
    text = written(mean, decimals, sign=True) + unit
    edges = " to ".join(written(edge, decimals, sign=True) for edge in (low, high))
    return text if np.isnan(low) else f"{text} ({edges})"


def _quantity(values: xr.DataArray) -> Quantity:
    """How the values of a metric are shown; the unit of shares is no longer that of their values."""
    name = str(values.name)
    known = name in METRICS or name in PREDICTIONS
    return quantity(name) if known or "relative_to" in values.attrs else quantity_of_values(values)


def _value(of: Quantity, metric: str, value: float) -> str:
    if np.isinf(value) and metric in METRICS and METRICS[metric].censored:
        return "never"
    return written(of.factor * value)


def _label(ds: xr.Dataset, dim: str, label: Any) -> str:
    return written(quantity_of(ds, dim).factor * label) if isinstance(label, float) else str(label)


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
    """
    with checking() as check:
        check(check_result, ds)
        over = check(names_of, "over", over)
        given = check.unless_none(names_of, "metrics", metrics)
        level = check(level_of, level)
        relative = check(flag_of, "relative", relative)
        threshold = check.unless_none(number_of, "threshold", threshold, "give a number of at least 0", least=0.0)
        check(
            mapping_of, "baseline", baseline, 'must be a dict of dimension and label, such as {"estimate_ratio": 0.0}'
        )
    names = given or [name for name in _comparable(ds) if _base(name) not in PREDICTIONS]
    _check(ds, baseline, over, names)
    units = sorted({str(ds[name].attrs.get("units", "1")) for name in names})
    if threshold is not None and not relative and len(units) > 1:
        raise InputError(
            f"threshold counts in the unit of the metrics, and these have {', '.join(units)}: name metrics of one "
            "unit, such as metrics='rmse', or compare with relative=True"
        )
    ok = ds["status"] == STATUS_OK
    shape = [ds.sizes[d] for d in over]
    # noise is independent between days, but shared by everything else
    independent = [axis for axis, d in enumerate(over) if d != "replicate" or "day" not in over]
    words = str({dim: plain(label) for dim, label in baseline.items()})
    results, asked = {}, STATISTICS + (() if threshold is None else OF_THRESHOLD)
    for name in names:
        values = ds[name].where(ok)
        if name in METRICS and METRICS[name].censored:  # NaN means that it did not happen within the run
            values = values.where(values.notnull() | ~ok, np.inf)
        values, reference = xr.broadcast(values, values.sel(dict(baseline), drop=True))
        dims = [d for d in values.dims if d not in over]
        own, partner = (v.transpose(*dims, *over).values.reshape(-1, *shape) for v in (values, reference))
        statistics = statistics_of(own, partner, independent, level, relative, threshold)
        attrs = ds[name].attrs
        if relative:
            comment = f"shares of the baseline; the statistics baseline and value in {attrs.get('units', '1')}"
            attrs = in_shares(attrs, words) | {"comment": comment}
        sizes = [values.sizes[d] for d in dims]
        results[name] = ((*dims, "statistic"), statistics.reshape(*sizes, len(asked)), attrs)
    kept = {*ds["status"].dims, *(d for dims, *_ in results.values() for d in dims)} - {*over, "statistic"}
    labels = {d: ds[d] for d in ds.dims if d in kept}
    attrs = {"baseline": words, "over": ", ".join(over), "level": level} | ({"relative": 1} if relative else {})
    attrs |= {} if threshold is None else {"threshold": threshold}
    return Comparison(results, coords={**labels, "statistic": list(asked)}, attrs=attrs)


def _base(name: str) -> str:
    """The name of a metric or cost without what makes it one of a year."""
    return name.removeprefix(YEARLY)


def _comparable(ds: xr.Dataset) -> list[str]:
    """Metrics, costs, predictions and the numbers of a study's own ``reduce``, without flags."""
    known = {n for n, each in METRICS.items() if not each.flags} | {*COSTS, *PREDICTIONS, *own_metrics(ds)}
    return [name for name in map(str, ds.data_vars) if _base(name) in known]


def _check(ds: xr.Dataset, baseline: Mapping[str, Any], over: list[str], names: list[str]) -> None:
    dims = [str(d) for d in ds["status"].dims]
    if not dims:
        raise InputError(
            "ds is a single scenario without dimensions, so there is nothing to compare: give a sweep that holds the "
            "baseline, on several days or replicates"
        )
    has = f"it has {', '.join(dims)}"
    unknown = [("baseline", d) for d in baseline if d not in dims] + [("over", d) for d in over if d not in dims]
    problems = [
        f"{what}: {shown(d)} is no dimension of the result{nearest(str(d), dims)}; {has}" for what, d in unknown
    ]
    both = [dim for dim in over if dim in baseline]
    problems += [f"over: {dim} is a dimension of the baseline: choose one or the other" for dim in both]
    for dim in (d for d in baseline if d in dims):
        labels, single, given = ds[dim].values, plain(baseline[dim]), shown(baseline[dim])
        if not isinstance(single, str | int | float | np.datetime64):
            sentence = f"baseline: {dim} = {given} is not a single label; give one, such as {labels[0]}"
            problems.append(WrongType(sentence))
        elif (n := labels.tolist().count(single)) != 1 or isinstance(single, bool) and labels.dtype.kind != "b":
            listed, has = ", ".join(map(str, labels[:10])), f"{n} labels" if n > 1 else "no label"
            problems.append(f"baseline: {dim} has {has} {given}; choose one of {listed}")
    for name in names:
        if name not in ds.data_vars:
            problems.append(f"metrics: {shown(name)} is not in the result{metric_meant(name)}")
        elif name not in _comparable(ds):
            kind = "a flag" if name in METRICS else "no number for each scenario"
            problems.append(f"metrics: {name!r} is {kind}, which has no differences: leave it out")
    if not baseline:
        problems.append("baseline is empty: give the dimension and label to compare with")
    refuse(problems)
