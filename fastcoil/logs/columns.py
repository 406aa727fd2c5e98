"""How a log is to be read, and which of its columns holds which series, in which unit, with which status.

A header of a building system, a Haystack name or a Brick class means a series only if that is beyond doubt.  It is
split into words, each of which stands for words of ``names.toml``.  It is read as a series if it has the words of one,
and no others but the unit of plant before them: ``AHU1 CHW VLV CMD``, ``discharge air temp sp``,
``Supply_Air_Temperature_Setpoint``.  What else it says, such as that it is a schedule or a limit, forbids it.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arguments import Checks, checking, choice_of, flag_of, is_number, mapping_of, number_of, path_of
from fastcoil.base.errors import nearest, shown
from fastcoil.logs.series import COLUMNS, NAMES, TIMES
from fastcoil.logs.table import TIME_HEADERS, Table, label_and_unit, letters_of
from fastcoil.logs.timestamps import is_time, time_format_of

_EXAMPLES = {"columns": "{'m_w': 'its header'}", "units": "{'m_w': 'kg/s'}", "constants": "{'m_a': 1.2}"}


class Wanted(NamedTuple):
    """The series that a caller reads."""

    needed: Sequence[str | tuple[str, ...]]  # must be in the log; of a tuple exactly one
    optional: Sequence[str] = ()
    measured: Sequence[str] = ()  # outputs of the model: a bad value becomes NaN, and its row stays

    @property
    def names(self) -> list[str]:
        return [name for one in (*self.needed, *self.optional) for name in ((one,) if isinstance(one, str) else one)]


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How a log is read: what the caller declares besides its header, and what becomes of its flaws.

    Parameters
    ----------
    columns, units, constants
        Our name → header (None if the log has our names), → unit for headers without one, → number for series that
        the log lacks.  ``constants`` is None where the caller does not offer it.
    drop
        Whether blank, NaN and impossible values are left out and counted instead of refused: those of measured series
        become NaN, an input that is missing in one row alone is bridged, other rows with one are left out.  None where
        the caller does not offer it.
    jumps
        ``refuse`` time that goes back or does not advance within a batch, or ``split`` the batch there; None where the
        caller does not offer it.
    max_gap
        Longest step that does not end a batch [s]; three times the median step if None, and more in a log whose rows
        were written when a value changed.
    time_format
        How ``timestamp`` is written: a pattern as of strftime, ``excel`` for serial days, ``epoch`` for seconds or
        milliseconds since 1970; recognised if None.
    unbroken
        Refuse gaps and changes of batch.
    has_command
        Whether a command offers the same as options, so that messages name these too.
    """

    columns: Mapping[str, str] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    constants: Mapping[str, float] | None = None
    drop: bool | None = None
    jumps: str | None = None
    max_gap: float | None = None
    time_format: str | None = None
    unbroken: bool = False
    has_command: bool = False

    def cure(self, argument: str, option: str) -> str:
        """An argument of the function, and the option of the command that does the same."""
        return f"{argument}, {option}" if self.has_command else argument

    def unit_cure(self, name: str, unit: str) -> str:
        """How to declare the unit of ``name``."""
        return self.cure(f"units={{{name!r}: {unit!r}}}", f"--unit {name}='{unit}'")

    def column_cure(self, name: str, header: str = "its header") -> str:
        """How to say which column holds ``name``."""
        return self.cure(f"columns={{{name!r}: {header!r}}}", f"--column {name}={header!r}")


def checked_reading(check: Checks, **given: Any) -> Reading:
    """The arguments of a public function that say how its log is read, checked; it passes those that it offers."""
    if "drop" in given:
        check(flag_of, "drop", given["drop"])
    if "jumps" in given:
        check(choice_of, "jumps", given["jumps"], ("refuse", "split"))
    given["max_gap"] = check(max_gap_of, given["max_gap"])
    check(require_mappings, **{name: given[name] for name in _EXAMPLES if name in given})
    given["time_format"] = check.unless_none(time_format_of, "time_format", given["time_format"])
    given |= {name: {} for name in ("units", "constants") if name in given and given[name] is None}
    return Reading(**given)


def require_mappings(**given: Any) -> None:
    """Raise one `InputError` for all of columns, units and constants that do not map names; None passes."""
    with checking() as check:
        for name, value in given.items():
            cure = f"give a mapping of names, such as {_EXAMPLES[name]}"
            check.unless_none(mapping_of, name, value, cure, to_text=name != "constants")


def max_gap_of(max_gap: Any) -> float | None:
    """The longest step to be bridged; None passes."""
    return None if max_gap is None else number_of("max_gap", max_gap, "give seconds, at least 1", least=1.0)


def log_of(name: str, source: Any) -> Any:
    """A log as it can be read: the path of a CSV file, a Dataset, or a DataFrame."""
    if hasattr(type(source), "data_vars") or (hasattr(type(source), "iloc") and hasattr(type(source), "columns")):
        return source
    return path_of(name, source, "give the path of a CSV file, an xarray.Dataset or a pandas.DataFrame")


_WORDS = {word: known.split() for known, written in NAMES["words"].items() for word in written.split()}
_ADDRESS = re.compile(r"\b[ab][iov][-_ ]?[0-9]+\b|(?:^|[.:/\\])[a-z](?=[.:/\\])", re.IGNORECASE)
"""Of a BACnet object; a folder of one letter in a path."""
_SET_POINT = re.compile(r"set[-_ ]*point", re.IGNORECASE)
_WORD = re.compile(r"[A-Z]?[a-zà-ÿ]+|[A-ZÀ-Ý]+(?![a-z])|[A-Z]|[0-9]+")


class Meaning(NamedTuple):
    """The series that a header means, words that say of which plant, and whether nothing speaks against it."""

    name: str
    place: frozenset[str]
    is_clear: bool


def meaning_of(header: str) -> Meaning | None:
    """What a header means; None where it means no series, or nothing that is known."""
    label, unit = label_and_unit(header)
    written = [word.lower() for word in _WORD.findall(_SET_POINT.sub("setpoint", _ADDRESS.sub(" ", label)))]
    written += ["cfm"] * (unit is not None and unit.lower() == "cfm")
    known = [_WORDS.get(word) for word in written]
    words = {one for meant in known for one in meant or ()} - {"place"}
    place: list[str] = []
    for k, word in enumerate(written):
        if word.isdigit() and k and known[k - 1] in (None, ["place"]):
            place[-1] += f" {word}"  # AHU-1 is another place than AHU-2, even below NAE-1
        elif known[k] in (None, ["place"]):
            place.append(word)
    first = next((k for k, meant in enumerate(known) if meant not in (None, ["place"])), 0)
    is_clear = all(written[k].isdigit() or known[k] is not None for k in range(first, len(written)))
    for name, needed, allowed in NAMES["rules"]:
        rest = words - {*needed.split()}
        if len(words) - len(rest) == len(needed.split()) and rest <= {*allowed.split(), "position"}:
            is_clear &= rest <= {*allowed.split()}  # a position that is fed back is no command
            is_its_unit = unit is None or COLUMNS[name].is_same_unit(unit, unit)
            return Meaning(name, frozenset(place), is_clear) if is_its_unit else None
    return None


_OUTPUTS = ("command", "T_sup", "T_w_out")  # always measured: no message suggests a constant for them
_MOST_NAMED = 3  # A message names this many unknown columns and counts the rest
_MOST_HINTS = 200  # unknown columns that get a suggestion of the probable name, which takes a millisecond each


def find_columns(table: Table, how: Reading, wanted: Wanted) -> dict[str, int]:
    """Index of each column to read; unknown, missing or doubled ones, and bad constants, are problems."""
    names = [*dict.fromkeys([*COLUMNS, *TIMES])]
    asked, constants = how.columns or {}, how.constants or {}
    table.check_names("columns", asked, names)
    table.check_names("units", how.units, [name for name in names if name != "timestamp"])
    table.check_names("constants", constants, wanted.names)
    for name, series in COLUMNS.items():
        value = constants.get(name, 0.0)
        if name in constants and (not is_number(value) or series.is_bad(np.array([value], dtype=float))[0]):
            bounds = f"{series.lower:g} to {series.upper:g}{'' if series.unit == '1' else f' {series.unit}'}"
            table.problems.append(f"constants has {name} = {shown(value)}: give a number from {bounds}")
    found, may_be = _find_headers(table, how, names, wanted)
    for one in [*wanted.needed, *wanted.optional, TIMES]:
        choices = (one,) if isinstance(one, str) else one
        standing_in = [f"constant {n}" for n in choices if n in constants]
        given = [name for name in choices if name in found] + standing_in
        preferred = [name for name in choices if name in asked]
        if len(given) > 1 and len(preferred) == 1 and not standing_in:
            for name in set(choices) - set(preferred):
                found.pop(name, None)
        elif len(given) > 1:
            which = "" if standing_in else f", or say which to read: {how.column_cure(given[0])}"
            table.problems.append(f"{' and '.join(given)} are both given: leave one out{which}")
        elif not given and not preferred:
            fits = may_be.get(choices[0], [])
            if len(fits) > 1:
                which = f"{' or '.join(map(shown, fits[:_MOST_NAMED]))}: say which to read"
                table.problems.append(f"{choices[0]} may be {which}: {how.column_cure(choices[0], fits[0])}")
            elif one not in wanted.optional:
                table.problems.append(_missing(choices, how, *fits))
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


def _find_headers(
    table: Table, how: Reading, names: list[str], wanted: Wanted
) -> tuple[dict[str, int], dict[str, list[str]]]:
    """Index of our ``names``, as asked or as headers mean; others are problems; and headers that may mean a name."""
    unknown = []
    found = asked_columns(table, how.columns or {})
    labels = [label_and_unit(cell)[0] for cell in table.header]
    time = table.time_column() if not {*TIMES} & {*labels, *found} else None
    if time is not None and (labels[time].lower() == "timestamp" or is_time(table.rows[0][time])):
        found["timestamp"] = time
        if letters_of(table.header[time]) not in TIME_HEADERS:
            table.notes.append(f"the times are in the column {shown(table.header[time])}")
    for column, cell in enumerate(table.header):
        label = labels[column]
        if label in names and label in found and label not in (how.columns or {}) and label in (*wanted.names, *TIMES):
            both = f"{shown(table.header[found[label]])} and {shown(cell)}"
            which = f"delete one, or say which to read: {how.column_cure(label, cell)}"
            table.problems.append(f"{label} is in two columns, {both}: {which}")
        elif label in names:
            found.setdefault(label, column)
        elif column not in found.values():
            unknown.append(column)
    guessed, may_be = _guess(table, how, wanted, found, unknown)
    left = list(dict.fromkeys(table.header[k] for k in unknown if k not in guessed.values()))
    more = f"; and {len(left) - _MOST_NAMED} more" if len(left) > _MOST_NAMED else ""
    if left and how.columns is None and not guessed and not any(len(fits) > 1 for fits in may_be.values()):
        hints = {cell: nearest(label_and_unit(cell)[0], names) for cell in left[:_MOST_HINTS]}
        left.sort(key=lambda cell: not hints.get(cell))  # those that are nearly ours first
        listed = "; ".join(f"{shown(cell)}{hints.get(cell, '')}" for cell in left[:_MOST_NAMED])
        example = wanted.names[0]
        say_which = how.cure(f"columns={{{example!r}: 'its header', ...}}", f"--column {example}='its header'")
        table.problems.append(f"unknown columns: {listed}{more}: delete them, or say what to read: {say_which}")
    elif left and (guessed or not how.columns):
        table.notes.append(f"left alone: {'; '.join(map(shown, left[:_MOST_NAMED]))}{more}")
    return found | guessed, may_be


def _guess(
    table: Table, how: Reading, wanted: Wanted, found: Mapping[str, int], unknown: Sequence[int]
) -> tuple[dict[str, int], dict[str, list[str]]]:
    """The ``unknown`` columns that mean series not ``found``, of one plant, which is said; else what may mean them."""
    meanings = {k: meaning for k in [*unknown, *found.values()] if (meaning := meaning_of(table.header[k]))}
    place = next((meanings[k].place for k in found.values() if k in meanings), frozenset[str]())
    guessed: dict[str, int] = {}
    may_be: dict[str, list[str]] = {}
    for name in [name for name in wanted.names if name not in found and name not in (how.constants or {})]:
        fits = [k for k in unknown if k in meanings and meanings[k].name == name]
        clear = [k for k in fits if meanings[k].is_clear and (meanings[k].place <= place or place <= meanings[k].place)]
        if len(clear) == 1:
            guessed[name] = clear[0]
            place |= meanings[clear[0]].place
        else:
            may_be[name] = [table.header[k] for k in clear or fits[:1]]
    if guessed:
        table.notes.append(", ".join(f"{shown(table.header[k])} is read as {name}" for name, k in guessed.items()))
    return guessed, may_be


def _missing(choices: tuple[str, ...], how: Reading, header: str = "") -> str:
    """A sentence that none of these columns exists, with every way to give one."""
    name, unit = choices[0], COLUMNS[choices[0]].unit
    cure = f"add a column '{name} [{unit}]', or say which one it is: {how.column_cure(name, *filter(None, [header]))}"
    if how.constants is not None and name not in (*TIMES, *_OUTPUTS):
        constant = how.cure(f"constants={{{name!r}: NUMBER}}", f"--constant {name}=NUMBER")
        cure += f"; or give a constant: {constant}"
    unclear = f"{shown(header)} is not clearly it: " if header else ""
    return f"{' or '.join(choices)} is missing: {unclear}{cure}"
