"""What a cell says: a number as written in some country, with a unit or a status, or that there is no value."""

import math
import re
from collections.abc import Iterable, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.logs.series import NAMES, is_unit
from fastcoil.logs.timestamps import MOST_LETTERS

MISSING, GOOD, _ON, _OFF = (frozenset(NAMES["cells"][name]) for name in ("missing", "good", "on", "off"))
_STATUS = re.compile(r"\{.*\}")  # A status instead of a number
_NUMBER = re.compile(
    r"(?P<number>[+-]?[\d.,’' \u00a0\u202f]*\d[.,]?(?:[eE][+-]?\d+)?)\s*(?P<rest>\D.*)?", re.DOTALL | re.ASCII
)
_GROUPED = {
    mark: re.compile(
        rf"[+-]?\d{{1,3}}([{re.escape(others)}’' \u00a0\u202f])\d{{3}}(?:\1\d{{3}})*(?:{re.escape(mark)}\d*)?", re.ASCII
    )
    for mark, others in ((".", ","), (",", "."))
}
"""A number with separators of thousands, by its decimal mark."""
_PLAIN = {
    mark: re.compile(rf"[+-]?(?:\d+{re.escape(mark)}?\d*|{re.escape(mark)}\d+)(?:[eE][+-]?\d+)?", re.ASCII)
    for mark in ".,"
}
_ONE_GROUP = {mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}{re.escape(mark)}\d{{3}}") for mark in ".,"}
"""One thousand or one and some thousandths: ambiguous without other numbers."""


class Writing(NamedTuple):
    """How the numbers of a table are written."""

    mark: str = "."  # of the decimals
    grouped: bool = False  # whether thousands may be separated by the other mark
    unclear: str = ""  # a number that may be a thousand times another one, where nothing shows which
    note: str = ""  # what is said of it


class Cells(NamedTuple):
    """A column of cells, (n,)."""

    values: Array  # NaN where there is no number
    units: dict[int, str]  # what stands behind a number, by the index of the cell
    missing: Mask  # where a cell says that there is no value
    marked: Mask  # where a status speaks against the value beside it


def is_datum(cell: str) -> bool:
    """Whether a cell holds a number, with or without a unit or a status."""
    found = _NUMBER.fullmatch(cell.strip()) if len(cell) <= MOST_LETTERS else None
    rest = (found["rest"] or "").strip() if found else ""
    return found is not None and (not rest or rest.startswith("{") or is_unit(rest))


def is_value(cell: str) -> bool:
    """Whether a cell holds a number, or a word of a switch."""
    return is_datum(cell) or cell.strip().lower() in _ON | _OFF


def is_missing(cell: str) -> bool:
    """Whether a cell says that there is no value."""
    return len(cell) <= MOST_LETTERS and cell.strip().lower() in MISSING


def writing_of(columns: Iterable[Sequence[str]], separator: str) -> Writing:
    """How the numbers in these columns are written; ``separator``: of the columns in the file."""
    points = commas = thousands = 0
    unclear = ""
    columns = list(columns)
    if not any("," in cell for cells in columns for cell in cells):
        return Writing(grouped=True)
    for cell in chain.from_iterable(columns):
        found = _NUMBER.match(cell.strip()) if len(cell) <= MOST_LETTERS else None
        number = found["number"] if found else ""
        if _ONE_GROUP[","].fullmatch(number):
            unclear = unclear or number
        elif "," in number and (number.rfind(",") < number.rfind(".") or number.count(",") > 1):
            points += 1
            thousands += 1
        elif "," in number:
            commas += 1
        elif "." in number and not _ONE_GROUP["."].fullmatch(number):
            points += 1
    if commas and points:
        return Writing()
    if commas or (unclear and not points and separator == ";"):
        return Writing(",", grouped=True, note="numbers are read with a decimal comma")
    if unclear and not points:
        return Writing(".", grouped=True, unclear=unclear)
    return Writing(".", grouped=True, note="commas in numbers separate thousands" if unclear or thousands else "")


def cells_of(cells: Sequence[str], writing: Writing, *, switch: bool) -> Cells:
    """The numbers of a column; with ``switch``, words for on and off are 1 and 0."""
    values = np.array([_plain_number(cell, writing) for cell in cells], dtype=np.float64)
    missing, marked = np.zeros(len(cells), dtype=bool), np.zeros(len(cells), dtype=bool)
    units: dict[int, str] = {}
    for k in np.flatnonzero(np.isnan(values)).tolist():
        cell = cells[k]
        if is_missing(cell) or _STATUS.fullmatch(cell[:MOST_LETTERS].strip()):
            missing[k] = True
        elif len(cell) <= MOST_LETTERS:
            text, brace, status = (part.strip() for part in cell.partition("{"))
            marked[k] = bool(brace) and brace + status.lower() not in GOOD
            if switch and text.lower() in _ON | _OFF:
                values[k] = float(text.lower() in _ON)
            elif (found := _NUMBER.fullmatch(text)) is not None:
                unit = (found["rest"] or "").strip()
                number = _written(found["number"].rstrip(), writing)
                if not math.isnan(number) and (not unit or is_unit(unit)):
                    values[k] = number
                    if unit:
                        units[k] = unit
    return Cells(values, units, missing, marked)


def _plain_number(cell: str, writing: Writing) -> float:
    """A number as Python writes it, unless the decimal mark of the table is a comma; else NaN."""
    if writing.mark == "," and ("," in cell or "." in cell):
        return _written(cell.strip(), writing) if len(cell) <= MOST_LETTERS else np.nan
    try:
        return float(cell) if cell.isascii() and "_" not in cell else np.nan
    except ValueError:
        return np.nan


def _written(number: str, writing: Writing) -> float:
    """A number in a writing; NaN if it is none."""
    mark = writing.mark
    if writing.grouped and _GROUPED[mark].fullmatch(number):
        digits = "".join(letter for letter in number if letter.isdigit() or letter in f"{mark}+-")
        return float(digits.replace(mark, "."))
    return float(number.replace(mark, ".")) if _PLAIN[mark].fullmatch(number) else np.nan
