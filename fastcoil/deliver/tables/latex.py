"""LaTeX: a booktabs table of medians, with the scatter over valves, days and noise, ready to be input."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Literal

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.base.files import commit
from fastcoil.base.text import written
from fastcoil.deliver.tables.tex import escaped
from fastcoil.deliver.tables.tidy import check_metrics, facts_of
from fastcoil.loops.labels import quantity, quantity_of
from fastcoil.model.metric_table import METRICS, STATUS_OK
from fastcoil.model.parameter_table import CHANCE_DIMS
from fastcoil.study.analysis.spread import BAND, FEWEST_FOR_A_BAND

STANDARD = ("rmse", "rmse_settled", "switch_frequency", "motor_travel")
_MOST_ROWS, _MOST_METRICS = 60, 6
"""Of a page."""
_HEADER = 18
"""Letters of a line in the header."""
_SHARES = ("hunts", "predicted_hunts")
"""0 or 1, so that the mean is a share."""


def write_latex(ds: xr.Dataset, path: Path, metrics: Sequence[str] = ()) -> None:
    """Write a table with a row for each label, and a column for each metric: its median and its scatter.

    The scatter is that over samples, days and replicates: from the 10th to the 90th percentile, or, of fewer than five,
    from the lowest to the highest.  Shares are means.  Failed scenarios are left out.

    Raises
    ------
    InputError
        For a metric that has no median, and for more metrics or rows than a page takes.
    StorageError
        If it cannot be written; nothing half-written is left behind.
    """
    commit(path, latex_of(ds, metrics).encode())


def latex_of(ds: xr.Dataset, metrics: Sequence[str] = ()) -> str:
    """The table as text; raises as ``write_latex``."""
    chosen = list(metrics) or [name for name in STANDARD if name in ds]
    check_metrics(ds, tuple(chosen))
    shown = [str(d) for d in ds["status"].dims if d not in CHANCE_DIMS and ds.sizes[d] > 1]
    _check_size(ds, shown, chosen)
    pooled = [d for d in ds["status"].dims if d not in shown]
    columns = [_column(ds, name, shown, pooled) for name in chosen]
    labels = [_labels(ds, d) for d in shown]
    head = [*(quantity_of(ds, d).axis for d in shown), *(quantity(name).axis for name in chosen)]
    lines = [f"% {name}: {text}" for name, text in facts_of(ds).items()]
    lines += [f"% {_note(ds, pooled, chosen)}", r"% In the preamble: \usepackage{booktabs}"]
    lines += [rf"\begin{{tabular}}{{{'l' * len(shown)}{'r' * len(chosen)}}}", r"\toprule"]
    lines += [" & ".join(map(_header, head)) + r" \\", r"\midrule"]
    before: list[str] = []
    for k, place in enumerate(np.ndindex(*(ds.sizes[d] for d in shown))):
        row = [labels[axis][at] for axis, at in enumerate(place)]
        changed = next((axis for axis, label in enumerate(row) if not before or label != before[axis]), 0)
        if before and len(row) > 1 and changed == 0:
            lines.append(r"\addlinespace")
        cells = ["" if axis < changed else escaped(label) for axis, label in enumerate(row)]
        lines.append(" & ".join([*cells, *(column[k] for column in columns)]) + r" \\")
        before = row
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _check_size(ds: xr.Dataset, shown: Sequence[str], metrics: Sequence[str]) -> None:
    problems = []
    rows = int(np.prod([ds.sizes[d] for d in shown], dtype=int))
    if len(metrics) > _MOST_METRICS:
        problems.append(
            f"--metric: {len(metrics)} metrics are wider than a page, which takes {_MOST_METRICS}: give fewer, or --csv"
        )
    if rows > _MOST_ROWS:
        groups = ds["members"].dims if "members" in ds.coords else ()
        widest = max(shown, key=lambda d: (d not in groups, ds.sizes[d]))
        problems.append(
            f"--latex: {rows:,} rows are more than a page takes, {_MOST_ROWS}: fix labels, such as --at "
            f"{widest}={ds[widest].values[0] if widest in ds.coords else 0}, or write all of them with --csv"
        )
    problems += [
        f"--metric {name} is a word, which has no median: leave it out"
        for name in metrics
        if "flag_meanings" in ds[name].attrs
    ]
    if problems:
        raise InputError(problems)


def _column(ds: xr.Dataset, name: str, shown: Sequence[str], pooled: Sequence[object]) -> list[str]:
    """The cells of a metric: median, and scatter where there is more than one value."""
    of = quantity(name)
    values = ds[name].where(ds["status"] == STATUS_OK).transpose(*shown, *pooled).values
    rows = of.factor * values.reshape(int(np.prod([ds.sizes[d] for d in shown], dtype=int)), -1)
    censored = name in METRICS and METRICS[name].censored
    if censored:
        ok = (ds["status"] == STATUS_OK).transpose(*shown, *pooled).values.reshape(rows.shape)
        rows = np.where(np.isnan(rows) & ok, np.inf, rows)
    found = [_median_and_scatter(row[~np.isnan(row)], name in _SHARES, censored) for row in rows]
    sizes = sorted(abs(middle) for middle, *_ in found if np.isfinite(middle) and middle != 0.0)
    decimals = max(0, 2 - math.floor(math.log10(sizes[len(sizes) // 2]))) if sizes else 0
    return [_cell(*each, decimals, "never" if censored else "∞") for each in found]


def _median_and_scatter(values: np.ndarray, is_share: bool, censored: bool) -> tuple[float, float, float]:
    if not values.size:
        return np.nan, np.nan, np.nan
    if is_share:
        return float(values.mean()), np.nan, np.nan
    # a time that never came takes no part in arithmetic
    method: Literal["inverted_cdf", "linear"] = "inverted_cdf" if censored else "linear"
    middle = float(np.quantile(values, 0.5, method=method))
    if values.size == 1:
        return middle, np.nan, np.nan
    if values.size < FEWEST_FOR_A_BAND:
        return middle, float(values.min()), float(values.max())
    low, high = np.quantile(values, BAND, method=method)
    return middle, float(low), float(high)


def _cell(middle: float, low: float, high: float, decimals: int, infinite: str) -> str:
    texts = [infinite if np.isinf(v) else written(v, decimals) for v in (middle, low, high)]
    alike = np.isnan(low) or (np.isinf(low) and low == high)
    return escaped(texts[0] if alike else f"{texts[0]} ({texts[1]} to {texts[2]})")


def _labels(ds: xr.Dataset, dim: str) -> list[str]:
    values = ds[dim].values
    if values.dtype.kind != "f":
        return [str(value) for value in values]
    return [written(quantity_of(ds, dim).factor * float(value)) for value in values]


def _header(text: str) -> str:
    """A cell of the header in lines of their own, for a narrow column."""
    # after a line break a bracket would be its length
    lines = [
        escaped(line).replace("[", "{[}", 1) if line[0] == "[" else escaped(line)
        for line in fill(text, _HEADER, break_long_words=False).splitlines()
    ]
    return r"\shortstack{" + r"\\".join(lines) + "}" if len(lines) > 1 else lines[0]


def _note(ds: xr.Dataset, pooled: Sequence[object], metrics: Sequence[str]) -> str:
    """What the numbers are, for the caption."""
    spread = [d for d in pooled if ds.sizes[d] > 1]
    failed = int(((ds["status"] != STATUS_OK) & ds["status"].notnull()).sum())
    end = f"; without {failed:,} scenario{'s' * (failed > 1)}, which failed" if failed else ""
    if not spread:
        return f"Single scenarios{end}."
    n = int(np.prod([ds.sizes[d] for d in spread], dtype=int))
    over = " and ".join(str(ds[d].attrs["pooled_as"]) if d in ds.coords and "pooled_as" in ds[d].attrs
                        else f"{ds.sizes[d]:,} {d}s" for d in spread)  # fmt: skip
    edges = "10th to 90th percentile" if n >= FEWEST_FOR_A_BAND else "lowest to highest"
    shares = [quantity(m).text for m in metrics if m in _SHARES]
    mean = f"; {' and '.join(shares)}: mean" if shares else ""
    return f"Median ({edges}) over {over}{mean}{end}."
