"""Tables of a result: CSV and Parquet with a row for each scenario-day, LaTeX with medians and their scatter.

CSV says in comment lines of which study it is, and has units in the header; Parquet has them in its metadata.  Rows are
made in pieces, so that a million of them need little memory.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError, missing_extra, nearest, shown
from fastcoil.base.files import commit_written
from fastcoil.base.text import MINUS, NONE, no_formula, written
from fastcoil.deliver.figures.drawing import BAND, FEWEST_FOR_A_BAND
from fastcoil.loops.labels import quantity, quantity_of, quantity_of_values
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
    """A checked result as rows: labels, parameters that differ, metrics, status.

    metrics: the results to have; all that are one number per scenario-day by default.
    """

    def __init__(self, ds: xr.Dataset, metrics: tuple[str, ...] = ()) -> None:
        check_metrics(ds, metrics)
        dims = list(ds["status"].sizes)
        per_row = [str(n) for n in ds.variables if n not in (*dims, "status") and {*ds[n].dims} <= {*dims}]
        coordinates = [n for n in per_row if n in ds.coords]
        chosen = [*coordinates, *(metrics or (n for n in per_row if n in ds.data_vars)), "status"]
        self.ds, self.dims = ds, dims
        self.columns = [_column(ds, str(n)) for n in (*dims, *chosen)]
        self.n_rows = ds["status"].size
        labels = {d: ds[d].values for d in dims}  # also of dimensions without labels
        self._shown = ds.drop_vars([n for n in ds.variables if n not in (*dims, *chosen)]).assign_coords(labels)

    def pieces(self) -> Iterator[pd.DataFrame]:
        """The rows, with plain names; the last label changes fastest."""
        import pandas as pd

        ds = self._shown if self.dims else self._shown.expand_dims("row")
        first = next((d for d in self.dims if ds.sizes[d] > 1), None)
        n = ds.sizes[first] if first else 1
        step = max(1, _ROWS * n // self.n_rows)
        for k in range(0, n, step):
            part = ds.isel({first: slice(k, k + step)}) if first else ds
            frame = part.to_dataframe(dim_order=self.dims or ["row"]).reset_index()
            for name, words in ((column.name, column.words) for column in self.columns if column.words):
                codes = frame[name].to_numpy()
                known = np.isin(codes, np.arange(len(words)))
                frame[name] = pd.Categorical.from_codes(np.where(known, codes, -1).astype(np.int8), list(words))
            yield frame[[column.name for column in self.columns]]


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


def _column(ds: xr.Dataset, name: str) -> Column:
    variable = ds[name]
    words = tuple(str(variable.attrs.get("flag_meanings", "")).split())
    is_number = variable.dtype.kind in "iuf" and not words and name not in RESERVED_DIMS
    unit = str(variable.attrs.get("units", "")) if is_number else ""
    return Column(name, unit, str(variable.attrs.get("long_name", "")), words)


COMMENT = "#"


def write_csv(table: Tidy, path: Path) -> None:
    """Write a table as CSV: UTF-8, decimal points, an empty cell where there is no value.

    Comment lines begin with ``#``.  Should a label have one, all texts are quoted, so that readers do not cut it off.
    An apostrophe stands before a text that a spreadsheet would take as a formula.
    """
    quoting = csv.QUOTE_NONNUMERIC if _has_comment(table) else csv.QUOTE_MINIMAL
    header = [no_formula(column.header) for column in table.columns]

    def write(unfinished: Path) -> None:
        with unfinished.open("x", encoding="utf-8", newline="") as file:
            file.writelines(f"{COMMENT} {name}: {no_formula(text)}\n" for name, text in facts_of(table.ds).items())
            for k, piece in enumerate(table.pieces()):
                for name in piece.select_dtypes(["object", "string"]):
                    piece[name] = piece[name].map(no_formula, na_action="ignore")
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
        pieces = table.pieces()
        piece = next(pieces)
        schema = pa.Schema.from_pandas(piece, preserve_index=False)
        schema = schema.with_metadata({**(schema.metadata or {}), **facts_of(table.ds), **more})
        for k, column in enumerate(table.columns):
            known = {"units": column.unit, "long_name": column.meaning}
            schema = schema.set(k, schema.field(k).with_metadata({name: text for name, text in known.items() if text}))
        with parquet.ParquetWriter(unfinished, schema) as writer:
            for each in chain([piece], pieces):
                writer.write_table(pa.Table.from_pandas(each, schema, preserve_index=False))

    commit_written(path, write)


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


def latex_of(ds: xr.Dataset, metrics: Sequence[str] = ()) -> str:
    """A table with a row for each label, and a column for each metric: its median and its scatter.

    The scatter is that over samples, days and replicates: from the 10th to the 90th percentile, or, of fewer than five,
    from the lowest to the highest.  Shares are means.  Failed scenarios are left out.
    """
    chosen = list(metrics) or [name for name in STANDARD if name in ds]
    check_metrics(ds, tuple(chosen))
    shown = [str(d) for d in ds["status"].dims if d not in CHANCE_DIMS and ds.sizes[d] > 1]
    _check_size(ds, shown, chosen)
    pooled = [str(d) for d in ds["status"].dims if d not in shown]
    columns = [_cells(ds, name, shown, pooled) for name in chosen]
    labels = [_labels(ds, d) for d in shown]
    head = [*(quantity_of(ds, d).axis for d in shown), *(quantity_of_values(ds[name]).axis for name in chosen)]
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
    rows = math.prod(ds.sizes[d] for d in shown)
    if len(metrics) > _MOST_METRICS:
        problems.append(
            f"--metric: {len(metrics)} metrics are wider than a page, which takes {_MOST_METRICS}: give fewer, or --csv"
        )
    if rows > _MOST_ROWS:
        groups = ds["members"].dims if "members" in ds.coords else ()
        widest = max(shown, key=lambda d: (d not in groups, ds.sizes[d]))
        problems.append(
            f"--latex: {rows:,} rows are more than a page takes, {_MOST_ROWS}: fix labels, such as --at "
            f"{widest}={ds[widest].values[0]}, or write all of them with --csv"
        )
    problems += [
        f"--metric {name} is a word, which has no median: leave it out"
        for name in metrics
        if "flag_meanings" in ds[name].attrs
    ]
    if problems:
        raise InputError(problems)


def _cells(ds: xr.Dataset, name: str, shown: Sequence[str], pooled: Sequence[str]) -> list[str]:
    """The cells of a metric: median, and scatter where there is more than one value."""
    is_ok = ds["status"] == STATUS_OK
    values = (quantity_of_values(ds[name]).factor * ds[name]).where(is_ok)
    censored = name in METRICS and METRICS[name].censored
    if censored:  # a time that never came
        values = values.where(values.notnull() | ~is_ok, np.inf)
    rows = values.transpose(*shown, *pooled).values.reshape(math.prod(ds.sizes[d] for d in shown), -1)
    found = [_median_and_scatter(row[~np.isnan(row)], name in _SHARES, censored) for row in rows]
    sizes = sorted(abs(middle) for middle, *_ in found if np.isfinite(middle) and middle != 0.0)
    decimals = max(0, 2 - math.floor(math.log10(sizes[len(sizes) // 2]))) if sizes else 0
    cells = []
    for numbers in found:
        texts = ["never" if censored and np.isinf(v) else written(v, decimals) for v in numbers]
        alike = len(texts) == 1 or (np.isinf(numbers[1]) and numbers[1] == numbers[2])
        cells.append(escaped(texts[0] if alike else f"{texts[0]} ({texts[1]} to {texts[2]})"))
    return cells


def _median_and_scatter(values: np.ndarray, is_share: bool, censored: bool) -> Sequence[float]:
    """The median, and from where to where the values lie if there are several; the mean of shares."""
    if not values.size or is_share:
        return [float(values.mean())] if values.size else [np.nan]
    # a time that never came takes no part in arithmetic
    method: Literal["inverted_cdf", "linear"] = "inverted_cdf" if censored else "linear"
    middle = float(np.quantile(values, 0.5, method=method))
    if values.size == 1:
        return [middle]
    if values.size < FEWEST_FOR_A_BAND:
        return middle, float(values.min()), float(values.max())
    low, high = np.quantile(values, BAND, method=method)
    return middle, float(low), float(high)


def _labels(ds: xr.Dataset, dim: str) -> list[str]:
    values = ds[dim].values
    if values.dtype.kind != "f":
        return [str(value) for value in values]
    return [written(quantity_of(ds, dim).factor * float(value)) for value in values]


def _header(text: str) -> str:
    """A cell of the header in lines of their own, for a narrow column."""
    lines = [escaped(line) for line in fill(text, _HEADER, break_long_words=False).splitlines()]
    # after a line break a bracket would be its length
    lines = [line.replace("[", "{[}", 1) if line[0] == "[" else line for line in lines]
    return r"\shortstack{" + r"\\".join(lines) + "}" if len(lines) > 1 else lines[0]


def _note(ds: xr.Dataset, pooled: Sequence[str], metrics: Sequence[str]) -> str:
    """What the numbers are, for the caption."""
    spread = [d for d in pooled if ds.sizes[d] > 1]
    failed = int(((ds["status"] != STATUS_OK) & ds["status"].notnull()).sum())
    end = f"; without {failed:,} scenario{'s' * (failed > 1)}, which failed" if failed else ""
    if not spread:
        return f"Single scenarios{end}."
    over = " and ".join(str(ds[d].attrs.get("pooled_as", f"{ds.sizes[d]:,} {d}s")) for d in spread)
    is_band = math.prod(ds.sizes[d] for d in spread) >= FEWEST_FOR_A_BAND
    shares = [quantity(m).text for m in metrics if m in _SHARES]
    mean = f"; {' and '.join(shares)}: mean" if shares else ""
    return f"Median ({'10th to 90th percentile' if is_band else 'lowest to highest'}) over {over}{mean}{end}."
