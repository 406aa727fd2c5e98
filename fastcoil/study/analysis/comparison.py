"""What ``compare`` returns: a Dataset, with a table of it for people."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import plain
from fastcoil.base.errors import InputError
from fastcoil.base.text import NONE, decimals_of, percent, written
from fastcoil.loops.labels import Quantity, quantity, quantity_of, quantity_of_values
from fastcoil.model.metric_table import METRICS, PREDICTIONS
from fastcoil.study.analysis.paired import OF_THRESHOLD, STATISTICS

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

        Raises
        ------
        InputError
            If the statistics were picked from: call it before ``.sel(statistic=…)``.
        """
        import pandas as pd

        needed = STATISTICS + (OF_THRESHOLD if "threshold" in self.attrs else ())
        if "statistic" not in self.dims or not set(needed) <= set(self["statistic"].values.tolist()):
            raise InputError("to_table needs all statistics of the comparison: call it before .sel(statistic=...)")
        if "level" not in self.attrs:
            raise InputError("to_table needs the attributes of the comparison: call it on what compare returned")
        metrics = [str(name) for name, variable in self.data_vars.items() if "statistic" in variable.dims]
        dims = [str(d) for d in self.dims if d != "statistic" and any(d in self[m].dims for m in metrics)]
        rows, index = [], []
        for metric in metrics:
            if not (self[metric].sel(statistic="n_pairs") > 0).any():
                continue
            for labels, found in self._cells(metric, dims, needed):
                index.append((_quantity(self[metric]).axis, *labels))
                rows.append(self._row(metric, found))
        names = ["metric", *(quantity_of(self, d).axis for d in dims)]
        columns = list(rows[0]) if rows else []
        table = pd.DataFrame(rows, index=pd.MultiIndex.from_tuples(index, names=names), columns=columns)
        return table if (table.get("never", pd.Series()) != "0").any() else table.drop(columns="never", errors="ignore")

    def _cells(
        self, metric: str, dims: list[str], statistics: tuple[str, ...]
    ) -> Iterator[tuple[list[str], dict[str, float]]]:
        """Labels in words, and the statistics, of every cell but the baseline's own."""
        own = [d for d in dims if d in self[metric].dims]
        values = self[metric].sel(statistic=list(statistics)).transpose(*own, "statistic").values
        labels = {d: [plain(label) for label in self[d].values] for d in own}
        reference = ast.literal_eval(self.attrs["baseline"])
        fixed = {d: plain(self[d].values) for d in reference if d not in own}
        for place in np.ndindex(values.shape[:-1]):
            at = {d: labels[d][k] for d, k in zip(own, place, strict=True)}
            if any((fixed | at)[d] != label for d, label in reference.items()):
                words = [_label(self, d, at[d]) if d in at else NONE for d in dims]
                yield words, dict(zip(statistics, values[place], strict=True))

    def _row(self, metric: str, found: dict[str, float]) -> dict[str, str]:
        """The cells of a row from all statistics."""
        of, n = _quantity(self[metric]), int(found["n_pairs"])
        level = f"{self.attrs['level']:.3g}".removeprefix("0.").ljust(2, "0")
        row = {
            "baseline": _value(of, metric, found["baseline"]),
            "value": _value(of, metric, found["value"]),
            f"difference ({level} %)": self._difference(of, found),
            "lower in": percent(found["share_lower"]),
        }
        if "threshold" in self.attrs:
            for side, word in (("below", "lower"), ("above", "higher")):
                edges = [found[f"share_{side}{edge}"] for edge in ("", "_low", "_high")]
                row[f"{word}{self._by(of)} in ({level} %)"] = percent(*edges)
        return row | {"pairs": f"{n:,}", "never": str(int(found["n_censored"]))}

    def _by(self, of: Quantity) -> str:
        threshold = self.attrs["threshold"]
        if not threshold:
            return ""
        return f" by {100 * threshold:.3g} %" if "relative" in self.attrs else f" by {of.number(threshold)}"

    def _difference(self, of: Quantity, found: dict[str, float]) -> str:
        factor, unit = (100.0, " %") if "relative" in self.attrs else (of.factor, "")
        mean, low, high = (factor * found[s] for s in ("mean", "low", "high"))
        if np.isnan(mean):
            median = factor * found["median"]
            return NONE if np.isnan(median) else f"median {written(median, sign=True)}{unit}"
        decimals = decimals_of((high - low) / 2)
        text = written(mean, decimals, sign=True) + unit
        edges = [written(edge, decimals, sign=True) for edge in (low, high)]
        return text if np.isnan(low) else f"{text} ({edges[0]} to {edges[1]})"


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
