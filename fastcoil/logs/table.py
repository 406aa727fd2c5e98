"""A CSV file as a table of text, with the mistakes found in it so far.

Read with the standard ``csv`` module.  Rows are numbered as a spreadsheet numbers them: a header at the top is row 1.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fastcoil.base.arrays import Mask
from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.logs.clock_columns import find_clock_columns, join_cells
from fastcoil.logs.layout import read_layout
from fastcoil.logs.notes import counted
from fastcoil.logs.units import is_unit

STATUS = ("status", "quality")
"""Headers of columns that say which values of a row count."""
_LONGEST_HEADER = 200
"""Letters of a header in which a unit without brackets is sought."""


def label_and_unit(header: str) -> tuple[str, str | None]:
    """``"T_a_in [degF]"`` as ``("T_a_in", "degF")``; the unit is None if there is none.

    Known units are found in round brackets and after a comma or slash, too.
    """
    text = header.strip()
    label, bracket, unit = text.partition("[")
    if bracket and text.endswith("]"):
        label, unit = label.rstrip(), unit[:-1].strip()
        return (header, None) if "\n" in label + unit else (label, unit)
    if "\n" in text:
        return header, None
    return _without_brackets(text) if len(text) <= _LONGEST_HEADER else (text, None)


def _without_brackets(text: str) -> tuple[str, str | None]:
    """``Cmd (%)``, ``Flow, L/s`` and ``T / °C`` as label and unit."""
    label, bracket, rest = text.rpartition("(")
    if bracket and rest.endswith(")") and label.strip() and is_unit(rest[:-1].strip()):
        return label.rstrip(), rest[:-1].strip()
    for mark in (",", "/"):
        label, found, rest = text.partition(mark)
        while found:
            if label.strip() and is_unit(rest.strip()):
                return label.rstrip(), rest.strip()
            more, found, rest = rest.partition(mark)
            label = f"{label}{mark}{more}"
    return text, None


@dataclass
class Table:
    """The cells of a log, and the mistakes found in it so far.

    name: of the file, for messages.  rows: without the header.  row_numbers: of each row in the file.  units: the cells
    of a row of units below the header; None if there is none.  separator: of the columns in the file.  notes: how it
    was read.  unit_cure: how to declare the ``unit`` of a column in the log itself, given its ``header``.  joined:
    index of the column that has the cells of these headers now, which the file has and the table has not.
    """

    name: str
    header: list[str]
    rows: list[list[str]]
    row_numbers: list[int]
    problems: list[str] = field(default_factory=list)
    unit_cure: str = "write '{header} [{unit}]' in the header"
    units: list[str] | None = None
    separator: str = ","
    notes: list[str] = field(default_factory=list)
    joined: dict[str, int] = field(default_factory=dict)

    @classmethod
    def read(cls, path: str | Path) -> Table:
        """Read a CSV file of at least two rows; blank lines are skipped.

        Raises
        ------
        InputError
            If the file cannot be read, or its rows and its header do not match.
        """
        path = Path(path)
        layout = read_layout(path)
        if layout is None:
            raise InputError(f"{path} is empty: give a header row and at least two rows of data")
        first, header, data = layout.header[0], [cell.strip() for cell in layout.header[1]], layout.rows
        if len(header) == 1 and re.search("[;\t]", header[0]):
            raise InputError(
                f"{path} separates its header by ';' or tabs, and its rows otherwise: use commas in both, and points "
                "for decimals"
            )
        if len(data) < 2:
            have = "one row of data" if data else "a header but no data"
            raise InputError(f"{path} has {have}: give at least two rows, so that the step is known")
        table = cls(
            path.name,
            header,
            [row for _, row in data],
            [i for i, _ in data],
            units=layout.units,
            separator=layout.separator,
            notes=layout.notes,
        )
        table._check_header(first)
        table._check_widths()
        table.stop_if_wrong()
        table._join_clock()
        return table

    def _check_header(self, row_number: int) -> None:
        """Every column needs a name of its own; one may be blank."""
        self.problems += [
            f"column {shown(cell)} appears twice in the header: rename or delete one"
            for cell, count in Counter(self.header).items()
            if count > 1 and cell and cell.lower() not in STATUS
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

    def _join_clock(self) -> None:
        """Make a column timestamp of a date and a time of day in columns of their own."""
        labels = [label_and_unit(cell)[0] for cell in self.header]
        found = find_clock_columns(self.header, self.rows)
        if found is None or "timestamp" in labels or "elapsed_time" in labels:
            return
        date, clock = (self.header[column] for column in found)
        for row in self.rows:
            row[found.date] = join_cells(row, found)
        self.header[found.date] = "timestamp"
        for row in filter(None, (self.header, self.units, *self.rows)):
            del row[found.clock]
        at = self.header.index("timestamp")
        self.joined = {date: at, clock: at}
        self.notes.append(f"{date} and {clock} are read as one timestamp")

    def stop_if_wrong(self) -> None:
        """Raise all problems found so far, if any, as one `InputError`."""
        if self.problems:
            raise InputError([f"{self.name}: {problem}" for problem in self.problems])

    def column(self, header: str) -> int | None:
        """Index of the column with this header, given with or without its unit; None if there is none."""
        if header in self.header:
            return self.header.index(header)
        labels = [label_and_unit(cell)[0] for cell in self.header]
        return labels.index(header) if header in labels else self.joined.get(header)

    def declared_unit(self, column: int) -> str | None:
        """Unit of a column by its header, or by a row of units below."""
        by_header = label_and_unit(self.header[column])[1]
        below = self.units[column] if self.units else ""
        return by_header if by_header is not None else below or None

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
