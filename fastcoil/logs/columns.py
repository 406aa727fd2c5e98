"""Which column of a log holds which series, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import combinations

import numpy as np

from fastcoil.base.arguments import is_number
from fastcoil.base.errors import collecting, nearest, shown
from fastcoil.logs.arguments import Declared, Wanted
from fastcoil.logs.series import COLUMNS, TIMES, Series
from fastcoil.logs.status import status_columns
from fastcoil.logs.table import Table, label_and_unit
from fastcoil.logs.timestamps import is_time

_OUTPUTS = ("command", "T_sup", "T_w_out")
"""Always measured: no message suggests a constant for them."""
_LONGEST_HEADER = 100
"""Characters of a header that a message repeats."""
_MOST_NAMED = 3
"""A message names this many unknown columns and counts the rest."""
_PERCENT, _FAR_ABOVE_1, _ROWS_LOOKED_AT = "%", 11.0, 10_000
_FLOAT = re.compile(r"\d{1,3}(?:\.\d{0,20})?")
_MOST_HINTS = 200
"""Unknown columns for which the name that was probably meant is sought: it takes a millisecond each."""


def find_columns(table: Table, declared: Declared, wanted: Wanted, *, strict: bool) -> dict[str, int]:
    """Index of each column to read; unknown, missing and doubled ones, and bad constants, are problems.

    With ``strict``, columns that are not wanted are unknown, and a column comes before a constant of its name; else
    the two together are a problem.
    """
    series = wanted.names if strict else list(COLUMNS)
    names = [*dict.fromkeys([*series, *TIMES])]
    asked, constants = declared.columns or {}, declared.constants or {}
    table.check_names("columns", asked, names)
    table.check_names("units", declared.units, [name for name in names if name != "timestamp"])
    table.check_names("constants", constants, wanted.names)
    table.problems += _bad_constants(constants)
    found = _find_headers(table, declared, names, wanted)
    for one in [*wanted.needed, *wanted.optional, TIMES]:
        choices = (one,) if isinstance(one, str) else one
        standing_in = [f"constant {n}" for n in choices if n in constants and not (strict and n in found)]
        given = [name for name in choices if name in found] + standing_in
        preferred = [name for name in choices if name in asked]
        if len(given) > 1 and len(preferred) == 1 and not standing_in:
            for name in set(choices) - set(preferred):
                found.pop(name, None)
        elif len(given) > 1:
            which = "" if standing_in else f", or say which to read: {declared.column_cure(given[0])}"
            table.problems.append(f"{' and '.join(given)} are both given: leave one out{which}")
        elif not given and not preferred and one not in wanted.optional:
            table.problems.append(_missing(choices, declared, _times_in(table) if one is TIMES else ""))
    found = {name: column for name, column in found.items() if name in (*wanted.names, *TIMES, "batch")}
    table.problems += [
        f"{one} and {other} are both read from the column {shown(table.header[found[one]])}: give each its own"
        for one, other in combinations(found, 2)
        if found[one] == found[other]
    ]
    return found


def asked_columns(table: Table, columns: Mapping[str, str]) -> dict[str, int]:
    """Index by our name of the columns that ``columns`` (our name: header) names; an absent one is a problem."""
    found = {name: table.column(header) for name, header in columns.items()}
    table.problems += [
        f"{name}: there is no column {shown(columns[name])}{nearest(columns[name], table.header)}"
        for name, column in found.items()
        if column is None
    ]
    return {name: column for name, column in found.items() if column is not None}


def find_unit(table: Table, series: Series, column: int, given: str | None, has_command: bool = False) -> str | None:
    """Unit of a column: from its header or the row below, or as ``given``; None, and a problem, if none is known.

    has_command: whether a command has an option for the argument ``units``, for the message.
    """
    declared, header = table.declared_unit(column), table.header[column]
    if given and declared and not table.units and not header.endswith("]"):
        if not series.is_same_unit(given, declared):
            table.notes.append(
                f"{series.name} is read in {shown(given)}, not in {shown(declared)} as its header has it"
            )
        declared = None  # what stands in round brackets may be a remark
    unit = declared or given or ("1" if series.needs_no_unit else None)
    if declared and given and declared != given:
        both = f"{shown(declared)} by its header, in {shown(given)} by units"
        table.problems.append(f"{series.name} is in {both}: drop one")
    elif not unit:
        of_percent = _PERCENT in series.units and _reads_as_percent(table, column)
        meant = _PERCENT if of_percent else series.unit
        cure = table.unit_cure.format(header=header if len(header) <= _LONGEST_HEADER else "…", unit=meant)
        cure += f", or pass units={{{series.name!r}: {meant!r}}}" + f", --unit {series.name}='{meant}'" * has_command
        why = ", and its values look like percent" if of_percent else ""
        table.problems.append(f"{series.name} has no unit{why}: {cure} ({series.known_units})")
    else:
        with collecting(table.problems):
            return series.spelled(unit)
    return None


def _reads_as_percent(table: Table, column: int) -> bool:
    """Whether the numbers of a column are far above 1, and none above 100."""
    numbers = [float(row[column]) for row in table.rows[:_ROWS_LOOKED_AT] if _FLOAT.fullmatch(row[column].strip())]
    return bool(numbers) and _FAR_ABOVE_1 < max(numbers) <= 100.5


def _find_headers(table: Table, declared: Declared, names: list[str], wanted: Wanted) -> dict[str, int]:
    """Index of each of our ``names`` in the header, or where the caller says.

    Other columns are problems, unless the caller says what to read, and so are two columns of a wanted name.
    """
    unknown = []
    found = asked_columns(table, declared.columns or {})
    asked, of_status = set(declared.columns or {}), status_columns(table)
    for column, cell in enumerate(table.header):
        label = label_and_unit(cell)[0]
        if label in names and label in found and label not in asked and label in (*wanted.names, *TIMES):
            both = f"{shown(table.header[found[label]])} and {shown(cell)}"
            cure = declared.cure(f"columns={{{label!r}: {cell!r}}}", f"--column {label}={cell!r}")
            table.problems.append(f"{label} is in two columns, {both}: delete one, or say which to read: {cure}")
        elif label in names:
            found.setdefault(label, column)
        elif column not in of_status:
            unknown.append(cell)
    if declared.columns is None:
        example = wanted.names[0]
        say_which = declared.cure(f"columns={{{example!r}: 'its header', ...}}", f"--column {example}='its header'")
        table.problems += _unknown(unknown, names, f"or say what to read: {say_which}")
    return found


def _unknown(cells: list[str], names: list[str], say_which: str) -> list[str]:
    """A sentence for each column whose name is nearly ours, and one for all others together."""
    hints = dict.fromkeys(cells, "") | {cell: nearest(label_and_unit(cell)[0], names) for cell in cells[:_MOST_HINTS]}
    others = [cell for cell, hint in hints.items() if not hint]
    one_by_one = [cell for cell in cells if hints[cell] or len(others) == 1]
    cure = f"rename or delete it, {say_which}"
    sentences = [f"column {shown(cell)} is unknown{hints[cell]}: {cure}" for cell in one_by_one]
    if len(others) > 1:
        more = f" and {len(others) - _MOST_NAMED} more" if len(others) > _MOST_NAMED else ""
        first = ", ".join(map(shown, others[:_MOST_NAMED]))
        sentences.append(f"columns {first}{more} are unknown: rename or delete them, {say_which}")
    return sentences


def _times_in(table: Table) -> str:
    """Header of the first column that begins with a date; empty if there is none."""
    first = table.rows[0] if table.rows else []
    return next((head for head, cell in zip(table.header, first, strict=False) if is_time(cell)), "")


def _missing(choices: tuple[str, ...], declared: Declared, times_in: str) -> str:
    """A sentence that none of these columns exists, with every way to give one.

    times_in: header of a column that looks like the missing time, else empty.
    """
    if times_in and len(times_in) <= _LONGEST_HEADER:
        argument, option = f"columns={{'timestamp': {times_in!r}}}", f"--column timestamp={times_in!r}"
        return f"timestamp is missing, and {shown(times_in)} has times: say so: {declared.cure(argument, option)}"
    name, series = choices[0], COLUMNS[choices[0]]
    which = " or ".join((", ".join(choices[:-1]), choices[-1])) if len(choices) > 1 else name
    text = f"{which} is missing: add a column '{name} [{series.unit}]', or say which one it is: "
    text += declared.column_cure(name)
    if declared.constants is not None and name not in (*TIMES, *_OUTPUTS):
        constant = declared.cure(f"constants={{{name!r}: NUMBER}}", f"--constant {name}=NUMBER")
        text += f"; or give a constant: {constant}"
    return text


def _bad_constants(constants: Mapping[str, float]) -> list[str]:
    problems = []
    for name, series in COLUMNS.items():
        value = constants.get(name, 0.0)
        if name in constants and (not is_number(value) or series.is_bad(np.array([value], dtype=float))[0]):
            what = "whole number" if series.whole else "number"
            unit = "" if series.unit == "1" else f" {series.unit}"
            bounds = f"from {series.lower:g} to {series.upper:g}{unit}"
            problems.append(f"constants has {name} = {shown(value)}: give a {what} {bounds}")
    return problems
