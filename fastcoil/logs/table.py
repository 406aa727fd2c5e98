"""A CSV file as a table of text, with the mistakes found in it so far.

UTF-8, commas, a header row, decimal points; read with the standard ``csv`` module.  Rows are numbered as a spreadsheet
numbers them: the header is row 1.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fastcoil.arrays import Mask
from fastcoil.errors import InputError, nearest, shown
from fastcoil.files import read_text
from fastcoil.logs.notes import counted

_LARGEST = 2**30
"""Bytes."""
_MOST_CELLS, _MOST_COLUMNS = 100_000_000, 10_000
"""As a table of text, more cells would fill the memory; no building logs so many points in one file."""


def label_and_unit(header: str) -> tuple[str, str | None]:
    """``"T_a_in [degF]"`` as ``("T_a_in", "degF")``; the unit is None if there is none."""
    text = header.strip()
    label, bracket, unit = text.partition("[")
    if bracket and text.endswith("]"):
        label, unit = label.rstrip(), unit[:-1].strip()
        return (header, None) if "\n" in label + unit else (label, unit)
    return (header, None) if "\n" in text else (text, None)


@dataclass
class Table:
    """The cells of a log, and the mistakes found in it so far.

    name: of the file, for messages.  rows: without the header.  row_numbers: of each row in the file.
    unit_cure: how to declare the ``unit`` of a column in the log itself, given its ``header``.
    """

    name: str
    header: list[str]
    rows: list[list[str]]
    row_numbers: list[int]
    problems: list[str] = field(default_factory=list)
    unit_cure: str = "write '{header} [{unit}]' in the header"

    @classmethod
    def read(cls, path: str | Path) -> Table:
        """Read a CSV file of at least two rows; blank lines are skipped.

        Raises
        ------
        InputError
            If the file cannot be read, or its rows and its header do not match.
        """
        path = Path(path)
        try:
            numbered = _numbered_rows(path)
        except csv.Error as error:
            raise InputError(f"{path} is not a CSV file ({error}): save it as 'CSV UTF-8'") from None
        if not numbered:
            raise InputError(f"{path} is empty: give a header row and at least two rows of data")
        first, header, data = numbered[0][0], [cell.strip() for cell in numbered[0][1]], numbered[1:]
        if len(header) == 1 and re.search("[;\t]", header[0]):
            raise InputError(f"{path} separates its columns by ';' or tabs: use commas, and points for decimals")
        if len(data) < 2:
            have = "one row of data" if data else "a header but no data"
            raise InputError(f"{path} has {have}: give at least two rows, so that the step is known")
        table = cls(path.name, header, [row for _, row in data], [i for i, _ in data])
        table._check_header(first)
        table._check_widths()
        table.stop_if_wrong()
        return table

    def _check_header(self, row_number: int) -> None:
        """Every column needs a name of its own; one may be blank."""
        self.problems += [
            f"column {shown(cell)} appears twice in the header: rename or delete one"
            for cell, count in Counter(self.header).items()
            if cell and count > 1
        ]
        if (blank := self.header.count("")) > 1:
            self.problems.append(
                f"row {row_number} names {blank} columns '': begin the file with the header, name every column"
            )

    def _check_widths(self) -> None:
        """Every row needs as many cells as the header."""
        ragged = [i for i, row in enumerate(self.rows) if len(row) != len(self.header)]
        if ragged:
            row, number = self.rows[ragged[0]], self.row_numbers[ragged[0]]
            cure = "begin the file with the header" if len(ragged) == len(self.rows) else "mend it"
            more = f" ({len(ragged)} rows in total)" if len(ragged) > 1 else ""
            self.problems.append(
                f"row {number} has {counted(len(row), 'cell')} where the header has {len(self.header)}: {cure}{more}"
            )

    def stop_if_wrong(self) -> None:
        """Raise all problems found so far, if any, as one `InputError`."""
        if self.problems:
            raise InputError([f"{self.name}: {problem}" for problem in self.problems])

    def column(self, header: str) -> int | None:
        """Index of the column with this header, given with or without its unit; None if there is none."""
        if header in self.header:
            return self.header.index(header)
        labels = [label_and_unit(cell)[0] for cell in self.header]
        return labels.index(header) if header in labels else None

    def check_names(self, what: str, given: Iterable[str], known: Iterable[str]) -> None:
        """Every name ``given`` in the argument ``what`` that is not ``known`` is a problem."""
        known = list(known)
        self.problems += [
            f"{what} has unknown {shown(name)}{nearest(name, known)}: use {', '.join(known)}"
            for name in given
            if name not in known
        ]

    def keep(self, kept: Mask) -> None:
        """Cut the rows that are not ``kept``, (n_rows,)."""
        index = np.flatnonzero(kept).tolist()
        self.rows = [self.rows[i] for i in index]
        self.row_numbers = [self.row_numbers[i] for i in index]


def _numbered_rows(path: Path) -> list[tuple[int, list[str]]]:
    """The rows of a CSV file that are not blank, with their numbers."""
    numbered: list[tuple[int, list[str]]] = []
    n_cells = 0
    for i, row in enumerate(csv.reader(io.StringIO(read_text(path, "a CSV file", _LARGEST), newline="")), start=1):
        if len(row) > _MOST_COLUMNS:
            raise InputError(f"{path}: row {i} has {len(row):,} cells: give at most {_MOST_COLUMNS:,} columns")
        n_cells += len(row)
        if n_cells > _MOST_CELLS:
            raise InputError(f"{path} has more than {_MOST_CELLS:,} cells: leave out columns, or cut it into parts")
        if any(map(str.strip, row)):
            numbered.append((i, row))
    return numbered
