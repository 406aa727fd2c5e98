"""Tables of a result: CSV with a row for each scenario-day.

Comment lines say of which study it is, and the header has the units.  Rows are made in pieces, so that a million of
them need little memory.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.base.files import commit_written
from fastcoil.base.text import no_formula
from fastcoil.model.metric_table import metric_meant
from fastcoil.model.parameter_table import RESERVED_DIMS

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
