"""Tables of a result: CSV with a row for each scenario-day.

Comment lines say of which study it is, and the header has the units.  Rows are made in pieces, so that a million of
them need little memory.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from fastcoil.base.arguments import raise_problems
from fastcoil.base.errors import Problem, did_you_mean, short_repr
from fastcoil.base.files import replace_atomically
from fastcoil.base.text import escape_formulas
from fastcoil.model.metric_table import metric_hint
from fastcoil.model.parameter_table import RESERVED_DIMS

if TYPE_CHECKING:
    import pandas as pd


_ROWS_PER_PIECE = 50_000  # rows in memory at once
_STUDY_FACTS = ("title", "question", "boundary", "fastcoil_version", "study_sha256", "content_sha256")  # in comments


class TidyTable:
    """A result as rows, one a scenario-day: labels, swept parameters, ``metrics`` (by default all), status."""

    def __init__(self, ds: xr.Dataset, metrics: tuple[str, ...] = ()) -> None:
        dims = [str(d) for d in ds["status"].dims]
        per_row = [str(n) for n in ds.variables if n not in (*dims, "status") and {*ds[n].dims} <= {*dims}]
        results = metrics or [n for n in per_row if n in ds.data_vars]
        self.columns = list(dict.fromkeys([*dims, *(n for n in per_row if n in ds.coords), *results, "status"]))
        self.ds, self.dims, self.n_rows = ds, dims, ds["status"].size
        labels = {d: ds[d].values for d in dims}  # also of dimensions without labels
        self._table_data = ds.drop_vars([n for n in ds.variables if n not in self.columns]).assign_coords(labels)

    def header(self, name: str) -> str:
        """Return the header of a column, such as ``rmse [K]``; labels, words and flags have no unit."""
        variable = self.ds[name]
        is_number = variable.dtype.kind in "iuf" and not _flag_words(variable) and name not in RESERVED_DIMS
        unit = str(variable.attrs.get("units", "")) if is_number else ""
        return escape_formulas(f"{name} [{unit}]" if unit else name)

    def pieces(self) -> Iterator[pd.DataFrame]:
        """Yield the rows as DataFrames of limited size; the last label changes fastest."""
        ds = self._table_data if self.dims else self._table_data.expand_dims("row")
        outer_dim = next((d for d in self.dims if ds.sizes[d] > 1), None)
        n_outer = ds.sizes[outer_dim] if outer_dim else 1
        n_per_piece = max(1, _ROWS_PER_PIECE * n_outer // self.n_rows)
        for k in range(0, n_outer, n_per_piece):
            part = ds.isel({outer_dim: slice(k, k + n_per_piece)}) if outer_dim else ds
            frame = part.to_dataframe(dim_order=self.dims or ["row"]).reset_index()[self.columns]
            for name in self.columns:
                if words := _flag_words(self.ds[name]):
                    frame[name] = frame[name].map(dict(enumerate(words)))
            yield frame


def check_metrics(ds: xr.Dataset, metrics: tuple[str, ...]) -> None:
    """Refuse metrics that a table of scenario-days cannot hold."""
    dims, problems = ds["status"].dims, []
    for name in metrics:
        if name not in ds.data_vars:
            hint = metric_hint(name) or did_you_mean(name, map(str, ds.data_vars))
            problems.append(Problem(f"--metric {short_repr(name)} is not in this result{hint}", "--metric", "name"))
        elif others := [str(d) for d in ds[name].dims if d not in dims]:
            sentence = f"--metric {name} has values along {' and '.join(others)}"
            cure = "name one that has a value for each scenario-day"
            problems.append(Problem(f"{sentence}: {cure}", "--metric", "shape"))
    raise_problems(problems)


def _flag_words(variable: xr.DataArray) -> list[str]:
    """Return the meanings of the values of a flag; empty for other variables."""
    return str(variable.attrs.get("flag_meanings", "")).split()


def write_csv(table: TidyTable, path: Path) -> None:
    """Write a table as CSV: UTF-8, decimal points, an empty cell where there is no value.

    Comment lines begin with ``#``.  Should a label have one, all texts are quoted, so that readers do not cut it off.
    An apostrophe stands before a text that a spreadsheet would take as a formula.
    """
    texts = (v.values for v in table.ds.coords.values() if v.dtype.kind in "OU")
    has_comment = any("#" in str(text) for values in texts for text in values.ravel())
    attrs = table.ds.attrs | {"question": table.ds.attrs.get("summary", "")}
    facts = {name: " ".join(str(attrs.get(name, "")).split()) for name in _STUDY_FACTS}

    def write(unfinished: Path) -> None:
        with unfinished.open("x", encoding="utf-8", newline="") as file:
            file.writelines(f"# {name}: {escape_formulas(text)}\n" for name, text in facts.items() if text)
            for k, piece in enumerate(table.pieces()):
                for name in piece.select_dtypes(["object", "string"]):
                    piece[name] = piece[name].map(escape_formulas, na_action="ignore")
                piece.to_csv(
                    file, index=False, header=[table.header(name) for name in piece] if k == 0 else False,
                    quoting=csv.QUOTE_NONNUMERIC if has_comment else csv.QUOTE_MINIMAL, lineterminator="\n",
                )  # fmt: skip

    replace_atomically(path, write)
