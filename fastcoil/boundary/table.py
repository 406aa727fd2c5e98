"""A CSV file as a table of text, and its columns as checked numbers with declared units.

UTF-8, commas, a header row, decimal points; read with the standard ``csv`` module.  Mistakes are collected,
with row numbers as a spreadsheet shows them (the header is row 1).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastcoil.boundary.series import Array, Series
from fastcoil.errors import InputError, collecting, nearest

_HEADER = re.compile(r"\s*(?P<label>.*?)\s*(?:\[\s*(?P<unit>.*?)\s*\])?\s*")


def label_and_unit(header: str) -> tuple[str, str | None]:
    """``"T_a_in [degF]"`` as ``("T_a_in", "degF")``; the unit is None if there is none."""
    match = _HEADER.fullmatch(header)
    return (match["label"], match["unit"]) if match else (header, None)


@dataclass
class Table:
    """The cells of a CSV file, the row numbers in the file, and the mistakes found so far.

    unit_cure: how to give the ``unit`` of the series ``name``, under a ``header`` that declares none.
    """

    path: Path
    header: list[str]
    rows: list[list[str]]
    row_numbers: list[int]
    problems: list[str] = field(default_factory=list)
    unit_cure: str = "write '{header} [{unit}]' in the header, or pass units={{'{name}': '{unit}'}}"

    @classmethod
    def read(cls, path: str | Path) -> Table:
        """Read a file of at least two rows; lines without content are skipped."""
        path = Path(path)
        try:
            with path.open(encoding="utf-8-sig", newline="") as file:
                numbered = [(i, row) for i, row in enumerate(csv.reader(file), start=1) if any(map(str.strip, row))]
        except UnicodeDecodeError:
            raise InputError(f"{path} is not UTF-8 text: save it as 'CSV UTF-8'") from None
        except csv.Error as error:
            raise InputError(f"{path} is not a CSV file ({error}): save it as 'CSV UTF-8'") from None
        except OSError as error:
            raise InputError(f"{path} cannot be read ({error.strerror}): give a CSV file") from None
        if not numbered:
            raise InputError(f"{path} is empty: give a header row and at least two rows of data")
        first, header, data = numbered[0][0], [cell.strip() for cell in numbered[0][1]], numbered[1:]
        if len(header) == 1 and re.search("[;\t]", header[0]):
            raise InputError(f"{path} separates its columns by ';' or tabs: use commas, and points for decimals")
        if len(data) < 2:
            have = "one row of data" if data else "a header but no data"
            raise InputError(f"{path} has {have}: give at least two rows, so that the step is known")
        problems = [
            f"column {cell!r} stands twice in the header: rename or delete one"
            for cell in dict.fromkeys(header)
            if cell and header.count(cell) > 1
        ]
        if (blank := header.count("")) > 1:
            problems.append(f"row {first} names {blank} columns '': begin the file with the header, name every column")
        ragged = [(i, row) for i, row in data if len(row) != len(header)]
        if ragged:
            i, row = ragged[0]
            cure = "begin the file with the header" if len(ragged) == len(data) else "mend it"
            more = f" ({len(ragged)} rows are so)" if len(ragged) > 1 else ""
            problems.append(f"row {i} has {len(row)} cells where the header has {len(header)}: {cure}{more}")
        table = cls(path, header, [row for _, row in data], [i for i, _ in data], problems)
        table.stop_if_wrong()
        return table

    def stop_if_wrong(self) -> None:
        """Raise what was found, if anything, as one `InputError`."""
        if self.problems:
            raise InputError([f"{self.path.name}: {problem}" for problem in self.problems])

    def column(self, header: str) -> int | None:
        """Index of the column with this header, given with or without its unit; None if there is none."""
        if header in self.header:
            return self.header.index(header)
        labels = [label_and_unit(cell)[0] for cell in self.header]
        return labels.index(header) if header in labels else None

    def check_names(self, what: str, given: Iterable[str], known: Iterable[str]) -> None:
        """Make every name ``given`` in the argument ``what`` that is not ``known`` a problem."""
        known = list(known)
        self.problems += [
            f"{what} has unknown {name!r}{nearest(name, known)}: use {', '.join(known)}"
            for name in given
            if name not in known
        ]

    def renamed(self, columns: Mapping[str, str]) -> dict[str, int]:
        """Index by our name of what ``columns`` (our name: header) asks for; an absent one is a problem."""
        found = {name: self.column(header) for name, header in columns.items()}
        self.problems += [
            f"{name}: there is no column {columns[name]!r}{nearest(columns[name], self.header)}"
            for name, column in found.items()
            if column is None
        ]
        return {name: column for name, column in found.items() if column is not None}

    def found(self, columns: Mapping[str, str] | None, names: Iterable[str], cure: str) -> dict[str, int]:
        """Index of each of our ``names`` in the header, or where ``columns`` (our name: header) says.

        Other columns are problems where no ``columns`` say what to read; ``cure`` tells how.
        """
        names = list(names)
        found = self.renamed(columns or {})
        for column, cell in enumerate(self.header):
            label = label_and_unit(cell)[0]
            if label in names:
                found.setdefault(label, column)
            elif columns is None:
                self.problems.append(f"column {cell!r} is unknown{nearest(label, names)}: rename or delete it, {cure}")
        return found

    def unit(self, series: Series, column: int, given: str | None = None) -> str | None:
        """Unit of a column: as its header declares, or as ``given``; None, and a problem, if there is no known one."""
        declared = label_and_unit(self.header[column])[1]
        unit = declared or given
        if declared and given and declared != given:
            self.problems.append(f"{series.name} is in {declared!r} by its header, in {given!r} by units: drop one")
        elif not unit:
            cure = self.unit_cure.format(name=series.name, header=self.header[column], unit=series.unit)
            self.problems.append(f"{series.name} has no unit: {cure} ({series.known_units})")
        else:
            with collecting(self.problems):
                return series.spelled(unit)
        return None

    def values(self, series: Series, column: int, unit: str) -> Array:
        """A column in our unit, (n_rows,), NaN where a cell is no number; values are not yet checked."""
        return series.convert(np.array([_number(row[column]) for row in self.rows]), unit)

    def complaint(self, series: Series, column: int, unit: str, bad: NDArray[np.bool_]) -> str:
        """What is wrong with the first ``bad`` cell of a column in ``unit``, how many there are, and the cure."""
        i = int(np.argmax(bad))
        cell, row = self.rows[i][column], self.row_numbers[i]
        if _is_number(cell):
            return series.sentence(float(cell), f" in row {row}", int(bad.sum()), unit)
        what = f"= {cell!r}" if cell.strip() else "is blank"
        more = f" ({bad.sum()} samples are so)" if bad.sum() > 1 else ""
        return f"{series.name} {what} in row {row}: give a number with a decimal point, or fill or cut the gap{more}"

    def numbers(self, series: Series, column: int, unit: str | None = None) -> Array:
        """A column as checked numbers in our unit, (n_rows,); ``unit`` is for a header that declares none.

        Where something is wrong it is added to the problems, and the numbers mean nothing.
        """
        nothing = np.arange(len(self.rows), dtype=np.float64)
        known = self.unit(series, column, unit)
        if known is None:
            return nothing
        values = self.values(series, column, known)
        bad = series.is_bad(values)
        if bad.any():
            self.problems.append(self.complaint(series, column, known, bad))
            return nothing
        return values


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
