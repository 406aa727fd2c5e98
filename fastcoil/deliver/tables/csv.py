"""CSV with what the table is of in comment lines, and units in the header."""

from __future__ import annotations

import csv
from pathlib import Path

from fastcoil.base.files import commit_written
from fastcoil.deliver.tables.tidy import Tidy, facts_of

COMMENT = "#"


def write_csv(table: Tidy, path: Path) -> None:
    """Write a table as CSV: UTF-8, decimal points, an empty cell where there is no value.

    Comment lines begin with ``#``.  Should a label have one, all texts are quoted, so that readers do not cut it off.

    Raises
    ------
    StorageError
        If it cannot be written; nothing half-written is left behind.
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
