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

from fastcoil.boundary.series import Array, Series
from fastcoil.errors import InputError, nearest

_HEADER = re.compile(r"\s*(?P<label>.*?)\s*(?:\[\s*(?P<unit>.*?)\s*\])?\s*")


def label_and_unit(header: str) -> tuple[str, str | None]:
    """``"T_a_in [degF]"`` as ``("T_a_in", "degF")``; the unit is None if there is none."""
    match = _HEADER.fullmatch(header)
    return (match["label"], match["unit"]) if match else (header, None)


@dataclass
class Table:
    """The cells of a CSV file, the row numbers in the file, and the mistakes found so far."""

    path: Path
    header: list[str]
    rows: list[list[str]]
    row_numbers: list[int]
    problems: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, path: str | Path) -> Table:
        """Read a file of at least two rows; empty lines are skipped."""
        path = Path(path)
        try:
            with path.open(encoding="utf-8-sig", newline="") as file:
                numbered = [(i, row) for i, row in enumerate(csv.reader(file), start=1) if row]
        except UnicodeDecodeError:
            raise InputError(f"{path} is not UTF-8 text: save it as 'CSV UTF-8'") from None
        except csv.Error as error:
            raise InputError(f"{path} is not a CSV file ({error}): save it as 'CSV UTF-8'") from None
        except OSError as error:
            raise InputError(f"{path} cannot be read ({error.strerror}): give a CSV file") from None
        if not numbered:
            raise InputError(f"{path} is empty: give a header row and at least two rows of data")
        header, data = [cell.strip() for cell in numbered[0][1]], numbered[1:]
        if len(header) == 1 and re.search("[;\t]", header[0]):
            raise InputError(f"{path} separates its columns by ';' or tabs: use commas")
        if len(data) < 2:
            have = "one row of data" if data else "a header but no data"
            raise InputError(f"{path} has {have}: give at least two rows, so that the step is known")
        problems = [
            f"column {cell!r} stands twice in the header: rename or delete one"
            for cell in dict.fromkeys(header)
            if header.count(cell) > 1
        ]
        ragged = [(i, row) for i, row in data if len(row) != len(header)]
        if ragged:
            i, row = ragged[0]
            more = f" ({len(ragged)} rows are so)" if len(ragged) > 1 else ""
            problems.append(f"row {i} has {len(row)} cells where the header has {len(header)}: mend it{more}")
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

    def numbers(self, series: Series, column: int, unit: str | None = None) -> Array:
        """A column as checked numbers in our unit, (n_rows,); ``unit`` is for a header that declares none.

        Where something is wrong it is added to the problems, and the numbers mean nothing.
        """
        nothing = np.arange(len(self.rows), dtype=np.float64)
        declared = label_and_unit(self.header[column])[1]
        if declared and unit and declared != unit:
            self.problems.append(f"{series.name} is in {declared!r} by its header, in {unit!r} by units: drop one")
            return nothing
        unit = declared or unit
        if not unit:
            self.problems.append(
                f"{series.name} has no unit: write '{self.header[column]} [{series.unit}]' in the header, or "
                f"pass units={{{series.name!r}: {series.unit!r}}} ({series.known_units})"
            )
            return nothing
        cells = [row[column] for row in self.rows]
        try:
            raw = np.array([float(cell) for cell in cells])
            values = series.convert(raw, unit)
        except InputError as error:
            self.problems += error.problems
            return nothing
        except ValueError:
            i = next(i for i, cell in enumerate(cells) if not _is_number(cell))
            what = f"= {cells[i]!r}" if cells[i].strip() else "is blank"
            cure = "give a number with a decimal point, or fill or cut the gap"
            self.problems.append(f"{series.name} {what} in row {self.row_numbers[i]}: {cure}")
            return nothing
        bad = series.is_bad(values)
        if bad.any():
            i = int(np.argmax(bad))
            where = f" in row {self.row_numbers[i]}"
            self.problems.append(series.sentence(float(raw[i]), where, int(bad.sum()), unit))
        return values


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
