"""Tables of a result: CSV and Parquet with a row for each scenario-day, LaTeX with medians and their scatter.

CSV says in comment lines of which study it is, and has units in the header; Parquet has them in its metadata.  Rows are
made in pieces, so that a million of them need little memory.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError, missing_extra, nearest, shown
from fastcoil.base.files import commit, commit_written
from fastcoil.base.text import MINUS, NONE, written
from fastcoil.deliver.figures.axes import BAND, FEWEST_FOR_A_BAND
from fastcoil.loops.labels import quantity, quantity_of
from fastcoil.model.metric_table import METRICS, STATUS_OK, metric_meant
from fastcoil.model.parameter_table import CHANCE_DIMS, RESERVED_DIMS

if TYPE_CHECKING:
    import pandas as pd


_ROWS = 50_000  # of a piece
_FACTS = {
    "title": "title",
    "question": "summary",
    "boundary": "boundary",
    "fastcoil_version": "fastcoil_version",
    "study_sha256": "study_sha256",
    "content_sha256": "content_sha256",
}
"""What a table says of its study, by the attributes of the result."""


class Column(NamedTuple):
    """unit: empty for labels and words.  words: the meanings of a flag, empty for all else."""

    name: str
    unit: str
    meaning: str
    words: tuple[str, ...]

    @property
    def header(self) -> str:
        """``rmse [K]``."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Tidy:
    """A result as rows: labels, parameters that differ, metrics, status.

    Parameters
    ----------
    ds
        A result, checked.
    metrics
        The results to have; all that are one number per scenario-day if there are none.

    Raises
    ------
    InputError
        For a metric that ``ds`` does not have, or that has several values per scenario-day.
    """

    def __init__(self, ds: xr.Dataset, metrics: tuple[str, ...] = ()) -> None:
        self.ds, self.sizes = ds, dict(ds["status"].sizes)
        check_metrics(ds, metrics)
        own = [n for n in ds.data_vars if n != "status" and set(ds[n].dims) <= set(self.sizes)]
        coordinates = [n for n in ds.coords if n not in self.sizes and set(ds[n].dims) <= set(self.sizes)]
        self.columns = [_column(ds, n) for n in (*self.sizes, *coordinates, *(metrics or own), "status")]
        self.n_rows = ds["status"].size

    def pieces(self) -> Iterator[pd.DataFrame]:
        """The rows, with plain names; that of the last label changes fastest."""
        import pandas as pd

        names = [column.name for column in self.columns]
        for first in range(0, self.n_rows, _ROWS):
            rows = np.arange(first, min(first + _ROWS, self.n_rows))
            place = np.unravel_index(rows, tuple(self.sizes.values())) if self.sizes else ()
            at: dict[Hashable, np.ndarray] = dict(zip(self.sizes, place, strict=True))
            values = [self._values(column, at, rows.size) for column in self.columns]
            yield pd.DataFrame(dict(zip(names, values, strict=True)))

    def _values(self, column: Column, at: Mapping[Hashable, np.ndarray], n: int) -> Any:
        import pandas as pd

        variable = self.ds.variables.get(column.name)
        if variable is None:  # a dimension without labels
            return at[column.name]
        values = variable.values[tuple(at[d] for d in variable.dims)] if variable.dims else variable.values
        values = np.broadcast_to(values, (n,))
        if not column.words:
            return values
        known = np.isin(values, np.arange(len(column.words)))
        return pd.Categorical.from_codes(np.where(known, values, -1).astype(np.int8), list(column.words))


def check_metrics(ds: xr.Dataset, metrics: tuple[str, ...]) -> None:
    """Refuse what a table of scenario-days cannot hold."""
    dims, problems = ds["status"].dims, []
    for name in metrics:
        if name == "status":
            problems.append("--metric status: every table has it, leave it out")
        elif name not in ds.data_vars:
            meant = metric_meant(name) or nearest(name, map(str, ds.data_vars))
            problems.append(f"--metric {shown(name)} is not in this result{meant}")
        elif not set(ds[name].dims) <= set(dims):
            others = " and ".join(str(d) for d in ds[name].dims if d not in dims)
            problems.append(
                f"--metric {name} has values along {others}, and a table has one for each scenario-day: name a "
                f"metric, or take fc.open_study(...)[{name!r}].to_dataframe() in Python"
            )
    problems += [
        f"--metric {n} is given twice: give it once" for n in sorted({n for n in metrics if metrics.count(n) > 1})
    ]
    if problems:
        raise InputError(problems)


def facts_of(ds: xr.Dataset) -> dict[str, str]:
    """What a table says of the study it was made from: names and texts on one line."""
    found = {name: " ".join(str(ds.attrs.get(attribute, "")).split()) for name, attribute in _FACTS.items()}
    return {name: text for name, text in found.items() if text}


def _column(ds: xr.Dataset, name: Hashable) -> Column:
    variable = ds.variables.get(name)
    attrs: Mapping[str, Any] = {} if variable is None else variable.attrs
    words = tuple(str(attrs.get("flag_meanings", "")).split())
    is_number = variable is not None and variable.dtype.kind in "iuf" and not words and name not in RESERVED_DIMS
    unit = str(attrs.get("units", "")) if is_number else ""
    return Column(str(name), unit, str(attrs.get("long_name", "")), words)


COMMENT = "#"


def write_csv(table: Tidy, path: Path) -> None:
    """Write a table as CSV: UTF-8, decimal points, an empty cell where there is no value.

    Comment lines begin with ``#``.  Should a label have one, all texts are quoted, so that readers do not cut it off.
    """
    quoting = csv.QUOTE_NONNUMERIC if _has_comment(table) else csv.QUOTE_MINIMAL
    header = [column.header for column in table.columns]

    def write(unfinished: Path) -> None:
        with unfinished.open("x", encoding="utf-8", newline="") as file:
            file.writelines(f"{COMMENT} {name}: {text}\n" for name, text in facts_of(table.ds).items())
            for k, piece in enumerate(table.pieces()):
                piece.to_csv(
                    file, index=False, header=header if k == 0 else False, quoting=quoting, lineterminator="\n"
                )

    commit_written(path, write)


def _has_comment(table: Tidy) -> bool:
    """Whether a label has the sign that begins a comment."""
    texts = (v.values for v in table.ds.coords.values() if v.dtype.kind in "OU")
    return any(COMMENT in str(text) for values in texts for text in values.ravel())


_MORE = ("parameters", "study_toml")  # attributes of a result, too long for other formats


def write_parquet(table: Tidy, path: Path) -> None:
    """Write a table as Parquet; words are categories."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise missing_extra("Parquet", "pyarrow", "parquet") from None

    more = {name: str(table.ds.attrs[name]) for name in _MORE if name in table.ds.attrs}

    def write(unfinished: Path) -> None:
        writer: Any = None
        try:
            for piece in table.pieces():
                if writer is None:
                    schema = _described(pa.Schema.from_pandas(piece, preserve_index=False), table)
                    schema = schema.with_metadata({**(schema.metadata or {}), **facts_of(table.ds), **more})
                    writer = parquet.ParquetWriter(unfinished, schema)
                writer.write_table(pa.Table.from_pandas(piece, schema, preserve_index=False))
        finally:
            if writer is not None:
                writer.close()

    commit_written(path, write)


def _described(schema: Any, table: Tidy) -> Any:
    """The schema with units and meanings of its fields."""
    for k, column in enumerate(table.columns):
        known = {"units": column.unit, "long_name": column.meaning}
        schema = schema.set(k, schema.field(k).with_metadata({name: text for name, text in known.items() if text}))
    return schema


_ESCAPED = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "_": r"\_", "%": r"\%",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"$<$", ">": r"$>$", "|": r"$|$",
    MINUS: "$-$", NONE: "--", "∞": r"$\infty$", "°": r"$^{\circ}$", "³": "$^3$", "²": "$^2$", "×": r"$\times$",
    "β": r"$\beta$", "\"": "''",
}  # fmt: skip


def escaped(text: str) -> str:
    """Text that TeX shows as it is."""
    return "".join(_ESCAPED.get(letter, letter) for letter in text)


STANDARD = ("rmse", "rmse_settled", "switch_frequency", "motor_travel")
_MOST_ROWS, _MOST_METRICS = 60, 6  # of a page
_HEADER = 18  # letters of a line in the header
_SHARES = ("hunts", "predicted_hunts")  # 0 or 1, so that the mean is a share


def write_latex(ds: xr.Dataset, path: Path, metrics: Sequence[str] = ()) -> None:
    """Write a table with a row for each label, and a column for each metric: its median and its scatter.

    The scatter is that over samples, days and replicates: from the 10th to the 90th percentile, or, of fewer than five,
    from the lowest to the highest.  Shares are means.  Failed scenarios are left out.
    """
    commit(path, latex_of(ds, metrics).encode())


def latex_of(ds: xr.Dataset, metrics: Sequence[str] = ()) -> str:
    """The table as text; raises as ``write_latex``."""
    chosen = list(metrics) or [name for name in STANDARD if name in ds]
    check_metrics(ds, tuple(chosen))
    shown = [str(d) for d in ds["status"].dims if d not in CHANCE_DIMS and ds.sizes[d] > 1]
    _check_size(ds, shown, chosen)
    pooled = [d for d in ds["status"].dims if d not in shown]
    columns = [_cells(ds, name, shown, pooled) for name in chosen]
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


def _cells(ds: xr.Dataset, name: str, shown: Sequence[str], pooled: Sequence[object]) -> list[str]:
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
