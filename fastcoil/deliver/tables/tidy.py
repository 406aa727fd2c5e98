"""A result as a tidy table: a row for each scenario-day, in pieces, so that a million rows need little memory."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.model.metric_table import metric_meant
from fastcoil.model.parameter_table import RESERVED_DIMS

if TYPE_CHECKING:
    import pandas as pd

_ROWS = 50_000
"""Of a piece."""
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
