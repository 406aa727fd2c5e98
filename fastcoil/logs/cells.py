"""What a cell says: a number as written in some country, with a unit or a status, or that there is no value."""

import math
import re
from collections.abc import Iterable, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.logs.series import VOCABULARY, is_unit
from fastcoil.logs.timestamps import MAX_CELL_CHARACTERS

MISSING_WORDS = frozenset(VOCABULARY["cells"]["missing"])
GOOD_STATUS_WORDS = frozenset(VOCABULARY["cells"]["good"])
_ON_WORDS = frozenset(VOCABULARY["cells"]["on"])
_SWITCH_WORDS = _ON_WORDS | frozenset(VOCABULARY["cells"]["off"])
_NUMBER_PATTERN = re.compile(
    r"(?P<number>[+-]?[\d.,’' \u00a0\u202f]*\d[.,]?(?:[eE][+-]?\d+)?)\s*(?P<rest>\D.*)?", re.DOTALL | re.ASCII
)
_GROUPED_NUMBER_PATTERN = {
    mark: re.compile(
        rf"[+-]?\d{{1,3}}([{re.escape(others)}’' \u00a0\u202f])\d{{3}}(?:\1\d{{3}})*(?:{re.escape(mark)}\d*)?", re.ASCII
    )
    for mark, others in ((".", ","), (",", "."))
}
"""A number with separators of thousands, by its decimal mark."""
_PLAIN_NUMBER_PATTERN = {
    mark: re.compile(rf"[+-]?(?:\d+{re.escape(mark)}?\d*|{re.escape(mark)}\d+)(?:[eE][+-]?\d+)?", re.ASCII)
    for mark in ".,"
}
_ONE_GROUP_PATTERN = {mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}{re.escape(mark)}\d{{3}}") for mark in ".,"}
"""One thousand or one and some thousandths: ambiguous without other numbers."""


class NumberStyle(NamedTuple):
    """How the numbers of a table are written."""

    mark: str = "."  # decimal mark
    may_be_grouped: bool = False  # whether thousands may be separated by the other mark
    ambiguous_number: str = ""  # a number that may be a thousand times another one, where nothing shows which
    note: str = ""  # what is said of it


class ParsedCells(NamedTuple):
    """A column of cells, (n,)."""

    values: Array  # NaN where there is no number
    units: dict[int, str]  # what stands behind a number, by the index of the cell
    missing: Mask  # where a cell says that there is no value
    has_bad_status: Mask  # where a status speaks against the value beside it


def is_number_cell(cell: str) -> bool:
    """Whether a cell holds a number, with or without a unit or a status."""
    match = _NUMBER_PATTERN.fullmatch(cell.strip()) if len(cell) <= MAX_CELL_CHARACTERS else None
    rest = (match["rest"] or "").strip() if match else ""
    return match is not None and (not rest or rest.startswith("{") or is_unit(rest))


def is_number_or_switch_word(cell: str) -> bool:
    """Whether a cell holds a number, or a word for on or off."""
    return is_number_cell(cell) or cell.strip().lower() in _SWITCH_WORDS


def is_missing_word(cell: str) -> bool:
    """Whether a cell says that there is no value."""
    return len(cell) <= MAX_CELL_CHARACTERS and cell.strip().lower() in MISSING_WORDS


def detect_number_style(columns: Iterable[Sequence[str]], separator: str) -> NumberStyle:
    """Detect how the numbers in these columns are written; ``separator``: of the columns in the file."""
    n_decimal_points = n_decimal_commas = n_grouped = 0
    ambiguous_number = ""
    columns = list(columns)
    if not any("," in cell for cells in columns for cell in cells):
        return NumberStyle(may_be_grouped=True)
    for cell in chain.from_iterable(columns):
        match = _NUMBER_PATTERN.match(cell.strip()) if len(cell) <= MAX_CELL_CHARACTERS else None
        number = match["number"] if match else ""
        if _ONE_GROUP_PATTERN[","].fullmatch(number):
            ambiguous_number = ambiguous_number or number
        elif "," in number and (number.rfind(",") < number.rfind(".") or number.count(",") > 1):
            n_decimal_points += 1
            n_grouped += 1
        elif "," in number:
            n_decimal_commas += 1
        elif "." in number and not _ONE_GROUP_PATTERN["."].fullmatch(number):
            n_decimal_points += 1
    if n_decimal_commas and n_decimal_points:
        return NumberStyle()
    if n_decimal_commas or (ambiguous_number and not n_decimal_points and separator == ";"):
        return NumberStyle(",", may_be_grouped=True, note="numbers are read with a decimal comma")
    if ambiguous_number and not n_decimal_points:
        return NumberStyle(".", may_be_grouped=True, ambiguous_number=ambiguous_number)
    note = "commas in numbers separate thousands" if ambiguous_number or n_grouped else ""
    return NumberStyle(".", may_be_grouped=True, note=note)


def parse_cells(cells: Sequence[str], style: NumberStyle, *, is_switch: bool) -> ParsedCells:
    """Parse the numbers of a column; with ``is_switch``, words for on and off are 1 and 0."""
    values = np.array([_parse_plain_number(cell, style) for cell in cells], dtype=np.float64)
    is_missing, has_bad_status = np.zeros(len(cells), dtype=bool), np.zeros(len(cells), dtype=bool)
    units: dict[int, str] = {}
    for k in np.flatnonzero(np.isnan(values)).tolist():
        cell = cells[k]
        if is_missing_word(cell) or re.fullmatch(r"\{.*\}", cell[:MAX_CELL_CHARACTERS].strip()):
            is_missing[k] = True
        elif len(cell) <= MAX_CELL_CHARACTERS:
            text, brace, status = (part.strip() for part in cell.partition("{"))
            has_bad_status[k] = bool(brace) and brace + status.lower() not in GOOD_STATUS_WORDS
            if is_switch and text.lower() in _SWITCH_WORDS:
                values[k] = float(text.lower() in _ON_WORDS)
            elif (match := _NUMBER_PATTERN.fullmatch(text)) is not None:
                unit = (match["rest"] or "").strip()
                number = _parse_styled_number(match["number"].rstrip(), style)
                if not math.isnan(number) and (not unit or is_unit(unit)):
                    values[k] = number
                    if unit:
                        units[k] = unit
    return ParsedCells(values, units, is_missing, has_bad_status)


def _parse_plain_number(cell: str, style: NumberStyle) -> float:
    """Parse a number as Python writes it, unless the decimal mark of the table is a comma; else NaN."""
    if style.mark == "," and ("," in cell or "." in cell):
        return _parse_styled_number(cell.strip(), style) if len(cell) <= MAX_CELL_CHARACTERS else np.nan
    try:
        return float(cell) if cell.isascii() and "_" not in cell else np.nan
    except ValueError:
        return np.nan


def _parse_styled_number(text: str, style: NumberStyle) -> float:
    """Parse a number in a style; NaN if it is none."""
    mark = style.mark
    if style.may_be_grouped and _GROUPED_NUMBER_PATTERN[mark].fullmatch(text):
        digits = "".join(letter for letter in text if letter.isdigit() or letter in f"{mark}+-")
        return float(digits.replace(mark, "."))
    return float(text.replace(mark, ".")) if _PLAIN_NUMBER_PATTERN[mark].fullmatch(text) else np.nan
