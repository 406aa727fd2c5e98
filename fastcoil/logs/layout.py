"""Where the table is in a file: what separates its columns, and the rows before the header and after the data."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from fastcoil.base.errors import InputError, shown
from fastcoil.base.files import read_text
from fastcoil.logs.cells import is_datum, is_missing
from fastcoil.logs.timestamps import is_time
from fastcoil.logs.units import is_unit

_LARGEST = 2**30
"""Bytes."""
_MOST_CELLS, _MOST_COLUMNS = 100_000_000, 10_000
"""As a table of text, more cells would fill the memory; no building logs so many points in one file."""
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
_SAMPLE = 200
"""Rows from the start of a file among which the header is."""
_MOST_LOOKED_AT = 50
"""Cells of a row."""
_LAST = 20
"""Rows at the end of a file among which a footer may be."""
_LONGEST_UNIT = 24
Numbered = list[tuple[int, list[str]]]
"""Rows that are not blank, with their numbers in the file."""


class Layout(NamedTuple):
    """The parts of a file.

    header: number and cells of the row.  units: cells of the row of units below it; None if there is none.  rows: of
    the data.  notes: what was left out.
    """

    separator: str
    header: tuple[int, list[str]]
    units: list[str] | None
    rows: Numbered
    notes: list[str]


def read_layout(path: Path) -> Layout | None:
    """The table in a file; None if the file is empty.

    Raises
    ------
    InputError
        If the file cannot be read, or is no table.
    """
    text = read_text(path, "a CSV file", _LARGEST, utf_16=True)
    try:
        separator = _separator_of(text)
        numbered = _numbered_rows(path, text, separator)
    except csv.Error as error:
        raise InputError(f"{path} is not a CSV file ({error}): save it as 'CSV UTF-8'") from None
    if not numbered:
        return None
    notes: list[str] = []
    if separator != ",":
        notes.append(f"columns are separated by {_SEPARATORS[separator]}")
    top = _header_index([row for _, row in numbered[:_SAMPLE]])
    if top:
        what = "row is" if top == 1 else "rows are"
        notes.append(f"the first {top if top > 1 else ''} {what} no part of the table: {_first_words(numbered[:top])}"
                     .replace("  ", " "))  # fmt: skip
    header, data = numbered[top], numbered[top + 1 :]
    units = None
    if data and _is_unit_row(data[0][1]) and any(map(_is_filled_with_data, (row for _, row in data[1:3]))):
        units = [cell.strip().strip("[]()").strip() for cell in data[0][1]]
        notes.append(f"row {data[0][0]} has the units: {', '.join(filter(None, units))[:80]}")
        data = data[1:]
    width = _cut_trailing_separators(header[1], data)
    n_footer = _footer_length(data, width)
    if n_footer:
        notes.append(f"row {data[-n_footer][0]} and what follows is no part of the table: "
                     f"{_first_words(data[-n_footer:])}")  # fmt: skip
        data = data[:-n_footer]
    units = None if units is None else (units + [""] * width)[:width]
    return Layout(separator, (header[0], header[1][:width]), units, data, notes)


def _rows(text: str, separator: str) -> Iterator[list[str]]:
    return csv.reader(io.StringIO(text, newline=""), delimiter=separator)


def _separator_of(text: str) -> str:
    """What separates the columns: commas, unless the header and the data are of one width with something else only."""
    head = text[: _SAMPLE * 1000]
    shares = {",": 0.0}
    for separator in _SEPARATORS:
        if separator not in head:
            continue
        try:
            rows = [row for row in islice(_rows(head, separator), _SAMPLE) if any(map(str.strip, row))]
        except csv.Error:
            continue
        top = _header_index(rows)
        below = [row for row in rows[top + 1 : -1] or rows[top + 1 :] if not _is_unit_row(row)]
        if below and len(rows[top]) > 1:
            cells = [cell for row in below if len(row) == len(rows[top]) for cell in row[:_MOST_LOOKED_AT]]
            whole = len(below) * len(rows[top][:_MOST_LOOKED_AT])
            shares[separator] = sum(is_datum(cell) or is_missing(cell) or is_time(cell) for cell in cells) / whole
    best = max(shares, key=lambda separator: shares[separator])
    return best if shares[best] > shares[","] else ","


def _numbered_rows(path: Path, text: str, separator: str) -> Numbered:
    """The rows of a file that are not blank, with their numbers."""
    numbered: Numbered = []
    n_cells = 0
    for i, row in enumerate(_rows(text, separator), start=1):
        if len(row) > _MOST_COLUMNS:
            raise InputError(f"{path}: row {i} has {len(row):,} cells: give at most {_MOST_COLUMNS:,} columns")
        n_cells += len(row)
        if n_cells > _MOST_CELLS:
            raise InputError(f"{path} has more than {_MOST_CELLS:,} cells: leave out columns, or cut it into parts")
        if any(map(str.strip, row)):
            numbered.append((i, row))
    return numbered


def _header_index(rows: Sequence[list[str]]) -> int:
    """Index of the header: the row of names with most data below it before the next such row; 0 if there is none."""
    named = [k for k, row in enumerate(rows) if _may_be_header(row) and _has_data_below(rows, k)]
    if not named:
        return 0
    if any(_is_data(row) for row in rows[: named[0]]):
        return 0  # rows of data in another order are no remarks
    lengths = [end - k for k, end in zip(named, [*named[1:], len(rows)], strict=True)]
    return max(zip(lengths, named, strict=True), key=lambda pair: pair[0])[1]


def _may_be_header(row: Sequence[str]) -> bool:
    """Whether a row has names: all different, no numbers, no times, no units alone."""
    cells = [cell.strip() for cell in _trimmed(row)]
    return (
        cells.count("") <= 1
        and len(set(cells)) == len(cells)
        and (len(cells) > 1 or len(row) == 1)
        and not any(is_datum(cell) or is_time(cell) for cell in cells[:_MOST_LOOKED_AT])
        and not _is_unit_row(row)
    )


def _has_data_below(rows: Sequence[list[str]], k: int) -> bool:
    width, below = len(_trimmed(rows[k])), rows[k + 1 : k + 4]
    if below and _is_unit_row(below[0]):
        below = below[1:]
    return bool(below) and all(
        len(row) >= width and len(_trimmed(row)) <= len(rows[k]) and _is_filled_with_data(row) for row in below[:2]
    )


def _is_filled_with_data(row: Sequence[str]) -> bool:
    """Whether some cell holds a number or a time."""
    return any(is_datum(cell) or is_time(cell) for cell in row[:_MOST_LOOKED_AT])


def _is_data(row: Sequence[str]) -> bool:
    """Whether every cell, of two at least, holds a number or a time, or says that it has none."""
    cells = row[:_MOST_LOOKED_AT]
    return len(cells) > 1 and all(is_datum(cell) or is_time(cell) or is_missing(cell) for cell in cells)


def _is_unit_row(row: Sequence[str]) -> bool:
    """Whether a row has units: one at least that is known, and nothing long, no number and no time."""
    cells = [cell.strip().strip("[]()").strip() for cell in row]
    return (
        all(len(cell) <= _LONGEST_UNIT for cell in cells)
        and any(map(is_unit, cells))
        and not any(cell != "1" and (is_datum(cell) or is_time(cell)) for cell in cells[:_MOST_LOOKED_AT])
    )


def _cut_trailing_separators(header: list[str], data: Numbered) -> int:
    """Cut the blank cells that a separator at the end of each line makes; the number of columns that are left."""
    width = len(_trimmed(header))
    longer = [row for _, row in data if len(row) > width]
    if width == 0 or any(any(map(str.strip, row[width:])) for row in longer):
        width = len(header)
    for row in longer:
        if not any(map(str.strip, row[width:])):
            del row[width:]
    return width


def _footer_length(data: Numbered, width: int) -> int:
    """How many rows at the end are text, and fill fewer columns than there are: sums, remarks, "End of report"."""
    n = 0
    while n < min(_LAST, len(data) - 2):
        cells = _trimmed(data[-1 - n][1])
        filled = [cell for cell in cells if cell.strip()]
        first = cells[0].strip()
        if len(filled) >= width or first[:1].isdigit() or is_datum(first) or is_time(first) or is_missing(first):
            break
        n += 1
    return n


def _trimmed(row: Sequence[str]) -> Sequence[str]:
    """The row up to its last cell that is not blank."""
    end = len(row)
    while end and not row[end - 1].strip():
        end -= 1
    return row[:end]


def _first_words(rows: Numbered) -> str:
    return shown(next((cell.strip() for _, row in rows for cell in row if cell.strip()), ""))
