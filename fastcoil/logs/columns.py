"""How a log is to be read, and which of its columns holds which series, in which unit, with which status.

The words of a header, a Haystack name or a Brick class are looked up in ``names.toml``.  They mean a series only if
they are those of one, and no others but the unit of plant before them: ``AHU1 CHW VLV CMD``.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, Literal, NamedTuple

import numpy as np

from fastcoil.base import arguments
from fastcoil.base.errors import Problem, did_you_mean, short_repr
from fastcoil.logs.series import AIR_HANDLER_COLUMNS, COLUMNS, TIME_COLUMNS, VOCABULARY, is_unit
from fastcoil.logs.table import TIME_HEADERS, Table, has_name, normalise_header, split_label_and_unit
from fastcoil.logs.timestamps import is_time, require_time_format, require_time_zone

MAX_GAP_CURE = "give seconds, at least 1"
_MAPPING_EXAMPLES = {"columns": "{'m_w': 'its header'}", "units": "{'m_w': 'kg/s'}", "constants": "{'m_a': 1.2}"}


class ColumnSpec(NamedTuple):
    """The columns that a caller reads from a log, by our names."""

    required: Sequence[str | tuple[str, ...]]  # must be in the log; of a tuple exactly one
    optional: Sequence[str] = ()
    measured: Sequence[str] = ()  # outputs of the model: a bad value becomes NaN, and its row stays
    rules: str = "rules"  # of ``names.toml``, by which headers are read
    asked: Sequence[str] = ("T_set",)  # optional ones that are asked for if two headers fit: they change every answer

    @property
    def choices(self) -> list[tuple[str, ...]]:
        """For each column to read, the names that it may have."""
        return [(each,) if isinstance(each, str) else tuple(each) for each in (*self.required, *self.optional)]

    @property
    def names(self) -> list[str]:
        return [name for choices in self.choices for name in choices]


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """Options of ``fc.read_log``, and how messages name them; None where the caller does not offer one."""

    columns: Mapping[str, str] | None = None  # None also if the log has our names
    units: Mapping[str, str] = field(default_factory=dict)
    constants: Mapping[str, float] | None = None
    ignore: Sequence[str] = ()  # columns that are not read, by our names or by their headers
    drop: bool | None = None
    jumps: str | None = None
    max_gap: float | None = None
    time_format: str | None = None
    time_zone: str = ""
    month_first: bool = False  # whether the month comes before the day where a table does not show it
    refuse_gaps: bool = False  # and changes of batch
    # what the user calls: ``read_log`` or a command built on it, ``join``, or a function with the arguments themselves
    reader: Literal["read_log", "join", "function"] = "function"

    def cure(self, argument: str, option: str) -> str:
        """Return the advice for the caller: the argument of a function, or the option of a command."""
        if self.reader == "function":
            return argument
        return option if self.reader == "join" else f"fc.read_log(..., {argument}), {option}"

    def set_back_cure(self) -> str:
        """Return the advice where clocks may have been set back: sorted, the rows of two hours are mixed."""
        zone = self.cure("time_zone='America/New_York'", "--time-zone America/New_York")
        return f"if clocks were set back there, log UTC or the UTC offset, or give the zone of unsorted rows: {zone}"

    def unit_cure(self, name: str, unit: str) -> str:
        """Return the advice how to declare the unit of the column ``name``."""
        return self.cure(f"units={{{name!r}: {unit!r}}}", f"--unit {name}='{unit}'")

    def column_cure(self, name: str, header: str = "its header") -> str:
        """Return the advice how to name the header of the column that holds ``name``."""
        return self.cure(f"columns={{{name!r}: {header!r}}}", f"--column {name}={header!r}")


def check_reading_options(check: arguments.Checks, **options: Any) -> ReadingOptions:
    """Check the arguments of a public function that say how its log is read; it passes those that it offers."""
    if "drop" in options:
        check(arguments.require_flag, "drop", options["drop"])
    if "jumps" in options:
        check(arguments.require_choice, "jumps", options["jumps"], ("refuse", "split"))
    options["max_gap"] = check.unless_none(
        arguments.require_number, "max_gap", options["max_gap"], MAX_GAP_CURE, least=1.0
    )
    check(require_name_mappings, **{name: options[name] for name in _MAPPING_EXAMPLES if name in options})
    options["time_format"] = check.unless_none(require_time_format, "time_format", options["time_format"])
    if "time_zone" in options:
        options["time_zone"] = check(require_time_zone, "time_zone", options["time_zone"])
    ignore = options.get("ignore")
    is_empty = ignore is None or (isinstance(ignore, Sequence) and not ignore)
    options["ignore"] = [] if is_empty else check(arguments.require_names, "ignore", ignore)
    options |= {name: {} for name in ("units", "constants") if name in options and options[name] is None}
    return ReadingOptions(**options)


def require_name_mappings(**mappings: Any) -> None:
    """Raise one `InputError` for all of columns, units and constants that do not map names; None passes."""
    with arguments.argument_checks() as check:
        for name, value in mappings.items():
            cure = f"give a mapping of names, such as {_MAPPING_EXAMPLES[name]}"
            check.unless_none(arguments.require_mapping, name, value, cure, to_text=name != "constants")


def require_log(name: str, source: Any) -> Any:
    """Require a log: the path of a CSV file, a Dataset, or a DataFrame."""
    if hasattr(type(source), "data_vars") or (hasattr(type(source), "iloc") and hasattr(type(source), "columns")):
        return source
    return arguments.require_path(name, source, "give the path of a CSV file, an xarray.Dataset or a pandas.DataFrame")


_WORD_MEANINGS = {word: known.split() for known, written in VOCABULARY["words"].items() for word in written.split()}
_BACNET_ADDRESS = re.compile(r"\b[ab][iov][-_ ]?[0-9]+\b|(?:^|[.:/\\])[a-z](?=[.:/\\])", re.IGNORECASE)
"""Matches the address of a BACnet object, and a folder of one letter in a path."""
_SET_POINT_PATTERN = re.compile(
    r"(?:(?<![A-Za-z])(?i:se?t)|(?<=[A-Za-z])Se?t|(?<=[A-Z])SE?T(?=P))[-_ ]*(?i:point|pnt|pt)(?![a-z])"
)
_OWN_SUPPLY_NAME = re.compile(r"^T_sup(?=[_ ])")  # as in T_sup_set, the set-point of our T_sup
_BESIDE_SET_POINT_WORDS = frozenset({"", "setpoint", "supply", "air", "temp", "cooling", "heating", "coil", "position"})
"""Meanings beside which an unclear header may still be that of the set-point of the supply air temperature."""
_WORD_PATTERN = re.compile(r"[A-Z]?[a-zà-ÿ]+|[A-ZÀ-Ý]+(?![a-z])|[A-Z]|[0-9]+")


class HeaderMeaning(NamedTuple):
    """What a header means: one of our names, the words for the plant that it belongs to, and whether that is clear."""

    name: str
    plant: frozenset[str]
    is_clear: bool


def interpret_header(header: str, rules: str = "rules") -> HeaderMeaning | None:
    """Interpret a header by its words; None if it means none of our columns, or has unknown words alone."""
    label, unit = split_label_and_unit(header)
    label = _OWN_SUPPLY_NAME.sub("supply air temp ", label)
    text = _SET_POINT_PATTERN.sub(" setpoint ", _BACNET_ADDRESS.sub(" ", label))
    header_words = [word.lower() for word in _WORD_PATTERN.findall(text)]
    header_words += ["cfm"] * (unit is not None and unit.lower() == "cfm")
    meanings = [_WORD_MEANINGS.get(word) for word in header_words]
    known_words = {meaning for word_meanings in meanings for meaning in word_meanings or ()} - {"place"}
    plant: list[str] = []
    for k, word in enumerate(header_words):
        if word.isdigit() and k and meanings[k - 1] in (None, ["place"]):
            plant[-1] += f" {word}"  # AHU-1 is another place than AHU-2, even below NAE-1
        elif meanings[k] in (None, ["place"]):
            plant.append(word)
    first_known = next((k for k, word_meanings in enumerate(meanings) if word_meanings not in (None, ["place"])), 0)
    is_clear = all(header_words[k].isdigit() or meanings[k] is not None for k in range(first_known, len(header_words)))
    for name, *rule_words in VOCABULARY[rules]:
        required_words, optional_words = ({*words.split()} for words in rule_words)
        other_words = known_words - required_words
        if required_words <= known_words and other_words <= optional_words | {"position"}:
            is_clear &= other_words <= optional_words  # a position that is fed back is no command
            return HeaderMeaning(name, frozenset(plant), is_clear) if _may_have_unit(name, unit) else None
    may_be_set_point = "setpoint" in known_words <= _BESIDE_SET_POINT_WORDS and _may_have_unit("T_set", unit)
    return HeaderMeaning("T_set", frozenset(plant[:first_known]), False) if may_be_set_point else None


def _may_have_unit(name: str, unit: str | None) -> bool:
    """Whether a header with this unit may be of our column ``name``; of an unknown unit it is asked later."""
    return unit is None or not is_unit(unit) or COLUMNS[name].is_same_unit(unit, unit)


def _interpret_in_plant(header: str, headers: Sequence[str], rules: str) -> HeaderMeaning | None:
    """Interpret a header behind a name of plant that others share: ``CLG-O`` of ``S-7_CLG-O``; None if unclear."""
    for match in re.finditer(r"[_ .:/\\]", header):
        prefix, meaning = header[: match.end()], interpret_header(header[match.end() :], rules)
        has_other_words = any("other" in _WORD_MEANINGS.get(word.lower(), ()) for word in _WORD_PATTERN.findall(prefix))
        is_shared = sum(each.startswith(prefix) for each in headers) > 1
        if meaning and meaning.is_clear and is_shared and not has_other_words:
            return meaning._replace(plant=frozenset({prefix}))
    return None


_MAX_LISTED_COLUMNS = 3  # of unknown columns in a message, which counts the rest


def find_columns(table: Table, options: ReadingOptions, spec: ColumnSpec) -> dict[str, int]:
    """Return the index of each column to read, by our name; unknown, missing or doubled ones become problems."""
    names = [name for name in COLUMNS if name in spec.names or name not in AIR_HANDLER_COLUMNS] + ["timestamp"]
    header_by_name, constants = options.columns or {}, options.constants or {}
    table.check_names("columns", header_by_name, names)
    table.check_names("units", options.units, COLUMNS)
    table.check_names("constants", constants, spec.names)
    for name, series in COLUMNS.items():
        value = constants.get(name, 0.0)
        if name in constants and (not arguments.is_number(value) or series.is_bad(np.array([value], dtype=float))[0]):
            bounds = f"{series.lower:g} to {series.upper:g}{'' if series.unit == '1' else f' {series.unit}'}"
            sentence = f"constants has {name} = {short_repr(value)}: give a number from {bounds}"
            table.add_problem(sentence, "constants", "value")
    for header in options.ignore:
        if header not in names and not any(has_name(cell, header) for cell in table.header):
            sentence = f"ignore: there is no column {short_repr(header)}{did_you_mean(header, table.header)}"
            table.add_problem(sentence, "ignore", "name")
    column_by_name, candidates = _match_headers(table, options, names, spec)
    for choices in [*spec.choices, TIME_COLUMNS]:
        substitutes = [f"constant {n}" for n in choices if n in constants]
        available = [name for name in choices if name in column_by_name] + substitutes
        preferred = [name for name in choices if name in header_by_name]
        if len(available) > 1 and len(preferred) == 1 and not substitutes:
            for name in set(choices) - set(preferred):
                column_by_name.pop(name, None)
        elif len(available) > 1:
            advice = "" if substitutes else f", or say which to read: {options.column_cure(available[0])}"
            sentence = f"{' and '.join(available)} are both given: leave one out{advice}"
            table.add_problem(sentence, choices[0] if len(choices) == 1 else available[0], "conflict")
        elif not available and not preferred:
            headers = candidates.get(choices[0], [])
            is_needed = choices[0] not in spec.optional or choices[0] in spec.asked or options.reader == "function"
            listing = " or ".join(map(short_repr, headers[:_MAX_LISTED_COLUMNS]))
            cure = options.column_cure(choices[0], *headers[:1])
            if len(headers) > 1 and not is_needed:
                table.notes.append(f"{choices[0]} is not read, it may be {listing}: {cure}")
            elif len(headers) > 1:
                table.add_problem(f"{choices[0]} may be {listing}: say which to read: {cure}", choices[0], "missing")
            elif headers and choices[0] == "T_set":  # without it, every answer is another one
                if options.reader != "function":
                    cure += f", or leave it out: {options.cure(f'ignore=[{headers[0]!r}]', f'--ignore {headers[0]!r}')}"
                table.add_problem(f"T_set may be {listing}: say so, {cure}", "T_set", "missing")
            elif choices[0] not in spec.optional:
                table.problems.append(_describe_missing_column(choices, options, spec, *headers))
    read_names = (*spec.names, *TIME_COLUMNS, "batch")
    column_by_name = {name: column for name, column in column_by_name.items() if name in read_names}
    for (name, column), (other_name, other_column) in combinations(column_by_name.items(), 2):
        if column == other_column:
            header = short_repr(table.header[column])
            sentence = f"{name} and {other_name} are both read from the column {header}: give each its own"
            table.add_problem(sentence, name, "duplicate")
    return column_by_name


def find_requested_columns(table: Table, columns: Mapping[str, str]) -> dict[str, int]:
    """Return the index of each column that ``columns`` (our name: header) names; an absent one becomes a problem."""
    column_by_name = {}
    for name, header in columns.items():
        column = table.find_column(header)
        if column is None:
            hint = did_you_mean(header, table.header)
            table.add_problem(f"{name}: there is no column {short_repr(header)}{hint}", "columns", "name")
        else:
            column_by_name[name] = column
    return column_by_name


def require_columns_with_units(table: Table, options: ReadingOptions) -> None:
    """Add a problem for each unit that the caller declares for a column that the log does not have."""
    spec = ColumnSpec((), [name for name in COLUMNS if name not in AIR_HANDLER_COLUMNS])
    column_by_name, candidates = _match_headers(table.copy(), options, [*spec.names, "timestamp"], spec)
    for name in sorted(options.units.keys() & {*spec.names} - column_by_name.keys()):
        if not candidates.get(name) or name in options.ignore:
            cure = f"leave it out, or say which column it is: {options.column_cure(name)}"
            sentence = f"units has {name} = {short_repr(options.units[name])}, and no column is read as {name}: {cure}"
            table.add_problem(sentence, "units", "name")


def _match_headers(
    table: Table, options: ReadingOptions, names: list[str], spec: ColumnSpec
) -> tuple[dict[str, int], dict[str, list[str]]]:
    """Match headers to our ``names``, as requested or meant; return indices by name, and headers in question."""
    unknown_columns = []
    column_by_name = find_requested_columns(table, options.columns or {})
    ignored = [
        k for k, cell in enumerate(table.header) for name in options.ignore
        if has_name(cell, name) or ((meaning := interpret_header(cell, spec.rules)) and meaning.name == name)
    ]  # fmt: skip
    labels, units = zip(*map(split_label_and_unit, table.header), strict=True)
    time_column = table.find_time_column() if not {*TIME_COLUMNS} & {*labels, *column_by_name} else None
    if time_column is not None and (labels[time_column].lower() == "timestamp" or is_time(table.rows[0][time_column])):
        column_by_name["timestamp"] = time_column
        if normalise_header(table.header[time_column]) not in TIME_HEADERS:
            table.notes.append(f"the times are in the column {short_repr(table.header[time_column])}")
    elif time_column is not None and units[time_column] and _may_have_unit("elapsed_time", units[time_column]):
        column_by_name["elapsed_time"] = time_column
    for column, cell in enumerate(table.header):
        label = labels[column]
        if column in ignored:
            continue
        is_read = label in (*spec.names, *TIME_COLUMNS) and label not in (options.columns or {})
        if is_read and label in column_by_name:
            two_headers = f"{short_repr(table.header[column_by_name[label]])} and {short_repr(cell)}"
            advice = f"delete one, or say which to read: {options.column_cure(label, cell)}"
            table.add_problem(f"{label} is in two columns, {two_headers}: {advice}", label, "duplicate")
        elif label in names:
            column_by_name.setdefault(label, column)
        elif column not in column_by_name.values():
            unknown_columns.append(column)
    guesses, candidates = _guess_columns(table, options, spec, column_by_name, unknown_columns)
    unread = list(dict.fromkeys(table.header[k] for k in unknown_columns if k not in guesses.values()))
    is_ambiguous = any(len(headers) > 1 or name == "T_set" for name, headers in candidates.items() if headers)
    if unread and options.columns is None and not guesses and not is_ambiguous:
        hints = {cell: did_you_mean(split_label_and_unit(cell)[0], names) for cell in unread[:200]}  # 1 ms each
        unread.sort(key=lambda cell: not hints.get(cell))  # those that are nearly ours first
        example = spec.names[0]
        cure = options.cure(f"columns={{{example!r}: 'its header', ...}}", f"--column {example}='its header'")
        listing = _list_headers([f"{short_repr(cell)}{hints.get(cell, '')}" for cell in unread])
        table.add_problem(f"unknown columns: {listing}: delete them, or say what to read: {cure}", unread[0], "name")
    elif unread and (guesses or not options.columns):
        table.notes.append(f"left alone: {_list_headers([*map(short_repr, unread)])}")
    return column_by_name | guesses, candidates


def _list_headers(headers: list[str]) -> str:
    """List the first headers in a message, and count the rest."""
    n_more = len(headers) - _MAX_LISTED_COLUMNS
    return "; ".join(headers[:_MAX_LISTED_COLUMNS]) + (f"; and {n_more} more" if n_more > 0 else "")


def _guess_columns(
    table: Table, options: ReadingOptions, spec: ColumnSpec, column_by_name: Mapping[str, int], unknown: Sequence[int]
) -> tuple[dict[str, int], dict[str, list[str]]]:
    """Guess the names of ``unknown`` columns, all of one plant; return indices by name, and headers in question."""
    columns = [*unknown, *column_by_name.values()]
    meanings = {k: meaning for k in columns if (meaning := interpret_header(table.header[k], spec.rules))}
    headers = [table.header[k] for k in columns]
    for k, header in zip(columns, headers, strict=True):
        if k not in meanings and (meaning := _interpret_in_plant(header, headers, spec.rules)):
            meanings[k] = meaning
    plant = next((meanings[k].plant for k in column_by_name.values() if k in meanings), frozenset[str]())
    guesses: dict[str, int] = {}
    candidates: dict[str, list[str]] = {}
    given = {*column_by_name, *(options.constants or {}), *options.ignore}
    for name in [name for name in spec.names if name not in given]:
        matches = [k for k in unknown if k in meanings and meanings[k].name == name]
        in_plant = [k for k in matches if meanings[k].plant <= plant or plant <= meanings[k].plant]
        clear_matches = [k for k in in_plant if meanings[k].is_clear]
        if len(clear_matches) == 1:
            guesses[name] = clear_matches[0]
            plant |= meanings[clear_matches[0]].plant
        else:
            unclear_matches = in_plant if name == "T_set" else matches
            candidates[name] = [table.header[k] for k in clear_matches or unclear_matches[:1]]
    if guesses:
        table.notes.append(", ".join(f"{short_repr(table.header[k])} is read as {name}" for name, k in guesses.items()))
    return guesses, candidates


def _describe_missing_column(
    choices: tuple[str, ...], options: ReadingOptions, spec: ColumnSpec, header: str = ""
) -> Problem:
    """Return the problem that none of these columns exists, with every way to give one."""
    name, unit = choices[0], COLUMNS[choices[0]].unit
    column_cure = options.column_cure(name, *filter(None, [header]))
    cure = f"add a column '{name} [{unit}]', or say which one it is: {column_cure}"
    # what a sensor shows is no constant
    if options.constants is not None and name not in (*TIME_COLUMNS, "command", "T_sup", "T_w_out", *spec.measured):
        constant = options.cure(f"constants={{{name!r}: NUMBER}}", f"--constant {name}=NUMBER")
        cure += f"; or give a constant: {constant}"
    unclear = f"{short_repr(header)} is not clearly it: " if header else ""
    label, bracket, rest = header.rpartition("(")
    if bracket and rest.endswith(")") and (meaning := interpret_header(label)) and meaning.is_clear:
        series, unit_text = COLUMNS[meaning.name], short_repr(rest[:-1])
        unclear = f"{short_repr(header)} has {unit_text}, which is no unit that is known ({series.known_units}): "
    return Problem(f"{' or '.join(choices)} is missing: {unclear}{cure}", name, "missing")
