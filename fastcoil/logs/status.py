"""Columns of status beside the values, as building systems export them: which values they speak against."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fastcoil.base.arrays import Mask
from fastcoil.logs.notes import counted, first_row
from fastcoil.logs.table import STATUS, Table, label_and_unit

_GOOD = frozenset(("ok", "{ok}", "{}", "good", "normal", "valid"))
_BAD = frozenset(
    ("fault", "down", "stale", "bad", "uncertain", "invalid", "error", "failed", "null", "disabled", "offline", "alarm",
     "unreliable", "fail", "faulted")
)  # fmt: skip
_BLANK = ""
_ROWS = 1000
"""Rows in which some status is good, or the column is none of status."""


def status_columns(table: Table) -> list[int]:
    """Indices of the columns of status: by their name, and by what is in them."""
    return [
        k
        for k, header in enumerate(table.header)
        if label_and_unit(header)[0].strip().lower() in STATUS
        and any(row[k].strip().lower() in _GOOD for row in table.rows[:_ROWS])
        and all(_is_status(row[k]) for row in table.rows[:_ROWS])
    ]


def marked_by_status(table: Table, columns: Mapping[str, int]) -> dict[str, Mask]:
    """Where a column of status speaks against a value, (n,) by name.

    One column of status is for all values of its row; of several, each is for the column on its left.
    """
    found = [k for k in status_columns(table) if k not in columns.values()]
    marked: dict[str, Mask] = {}
    for k in found:
        bad = np.array([row[k].strip().lower() not in (*_GOOD, _BLANK) for row in table.rows])
        names = [
            name
            for name, column in columns.items()
            if name not in ("elapsed_time", "batch") and (len(found) == 1 or column == k - 1)
        ]
        marked |= dict.fromkeys(names, bad)
        if bad.any() and names:
            first = first_row(table.row_numbers, bad)
            table.notes.append(f"{counted(bad, 'row')} marked as bad by the column {table.header[k]!r} ({first})")
    return marked


def _is_status(cell: str) -> bool:
    word = cell.strip().lower()
    return word in _GOOD or word in _BAD or word == _BLANK or (word[:1] == "{" and word[-1:] == "}")
