"""A CSV file or a Dataset as a table of text, rows numbered as in a spreadsheet, with its mistakes so far."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fastcoil.base.arguments import carried_unit, collect_problems, raise_problems, require_choice
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.base.files import read_text
from fastcoil.logs.cells import GOOD_STATUS_WORDS, is_missing_word, is_number_cell, is_number_or_switch_word
from fastcoil.logs.series import MAX_UNIT_CHARACTERS, TIME, find_unit, format_count, is_unit, split_unit_suffix
from fastcoil.logs.timestamps import is_date_beside_clock, is_time

if TYPE_CHECKING:
    import xarray as xr


_MAX_CELLS = 100_000_000  # as a table of text, more would fill the memory; no building logs so many points in a file
_SEPARATOR_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs"}
_HEADER_SEARCH_ROWS = 200  # from the start of a file, among which the header is
_MAX_CHECKED_CELLS = 50  # of a row, by which its kind is judged
TIME_HEADERS = ("timestamp", "ts", "time", "date", "datetime", "zeit", "zeitstempel", "datum")
"""Headers of a column of times, as ``normalise_header`` gives them."""
_STATUS_HEADERS = ("status", "quality")  # headers of columns that say which values of a row count
REVERSED_ROWS_NOTE = "the newest row is first: turned round"
NumberedRows = list[tuple[int, list[str]]]  # rows that are not blank, with their numbers in the file


def _split_rows(text: str, separator: str) -> Iterator[list[str]]:
    return csv.reader(io.StringIO(text, newline=""), delimiter=separator)


def _detect_separator(text: str) -> str:
    """Detect the separator of columns: a comma, unless another one makes more cells below the header data."""
    start_text = text[: _HEADER_SEARCH_ROWS * 1000]
    shares = {",": 0.0}
    for separator in _SEPARATOR_NAMES:
        if separator not in start_text:
            continue
        try:
            first_rows = islice(_split_rows(start_text, separator), _HEADER_SEARCH_ROWS)
            rows = [row for row in first_rows if any(map(str.strip, row))]
        except csv.Error:
            continue
        k = _header_index(rows)
        width = len(rows[k])
        data_rows = [row for row in rows[k + 1 : -1] or rows[k + 1 :] if not _is_unit_row(row)]
        if data_rows and width > 1:
            cells = [cell for row in data_rows if len(row) == width for cell in row[:_MAX_CHECKED_CELLS]]
            n_data = sum(_is_data_cell(cell) or is_missing_word(cell) for cell in cells)
            shares[separator] = n_data / (len(data_rows) * min(width, _MAX_CHECKED_CELLS))
    best_separator = max(shares, key=lambda separator: shares[separator])
    return best_separator if shares[best_separator] > shares[","] else ","


def _header_index(rows: Sequence[list[str]]) -> int:
    """Return the index of the header: the row of names with most data below it before the next; 0 without one."""
    name_rows = [k for k, row in enumerate(rows) if _is_possible_header(row) and _has_data_below(rows, k)]
    for row in rows[: name_rows[0]] if name_rows else ():  # rows of data in another order are no remarks
        if len(row) > 1 and all(_is_data_cell(cell) or is_missing_word(cell) for cell in row[:_MAX_CHECKED_CELLS]):
            return 0
    if not name_rows:
        return 0
    section_ends = [*name_rows[1:], len(rows)]
    best_row = max(zip(name_rows, section_ends, strict=True), key=lambda section: section[1] - section[0])[0]
    return next(k for k in name_rows if {*filter(None, rows[k])} & {*rows[best_row]})  # the same header may come again


def _is_possible_header(row: Sequence[str]) -> bool:
    """Whether a row may be the header: names that are all different, no numbers, no times, no units alone."""
    cells = [cell.strip() for cell in _trim_blank_end(row)]
    return (
        cells.count("") <= 1
        and len(set(cells)) == len(cells)
        and (len(cells) > 1 or len(row) == 1)
        and not any(_is_data_cell(cell) or (cell and is_missing_word(cell)) for cell in cells[:_MAX_CHECKED_CELLS])
        and not _is_unit_row(row)
    )


def _has_data_below(rows: Sequence[list[str]], k: int) -> bool:
    """Whether rows of data, as wide as row ``k``, follow below it or below a row of units."""
    width, rows_below = len(_trim_blank_end(rows[k])), rows[k + 1 : k + 4]
    if rows_below and _is_unit_row(rows_below[0]):
        rows_below = rows_below[1:]
    return bool(rows_below) and all(
        len(row) >= width
        and len(_trim_blank_end(row)) <= len(rows[k])
        and any(map(_is_data_cell, row[:_MAX_CHECKED_CELLS]))
        for row in rows_below[:2]
    )


def _is_data_cell(cell: str) -> bool:
    return is_number_cell(cell) or is_time(cell)


def _is_unit_row(row: Sequence[str]) -> bool:
    """Whether a row holds units: one at least is known, and nothing is long, a number or a time."""
    cells = [_strip_brackets(cell) for cell in row]
    return (
        all(len(cell) <= MAX_UNIT_CHARACTERS for cell in cells)
        and any(is_unit(cell, of_time=False) for cell in cells)  # hour and min may be names
        and not any(cell != "1" and _is_data_cell(cell) for cell in cells[:_MAX_CHECKED_CELLS])
    )


def _strip_brackets(cell: str) -> str:
    return cell.strip().strip("[]()").strip()


def _drop_repeated_headers(path: Path, header: list[str], data: NumberedRows, notes: list[str]) -> NumberedRows:
    """Drop the rows that repeat the header; refuse another header, with some of its names."""
    names, kept_rows = {*header} - {""}, []
    for number, row in data:
        if names.isdisjoint(row) or any(map(_is_data_cell, row)):
            kept_rows.append((number, row))
        elif [cell.strip() for cell in _trim_blank_end(row)] != header:
            sentence = f"{path}: row {number} is another header, {short_repr(','.join(row))}: cut the file there"
            raise InputError(sentence, str(path), "format")
    if len(kept_rows) < len(data):
        notes.append(f"{format_count(len(data) - len(kept_rows), 'row')} left out: the header again")
    return kept_rows


def _footer_length(data: NumberedRows, width: int) -> int:
    """Count the rows at the end that are no data: sums, remarks, "End of report".

    They are text in fewer columns than there are, or have a word in the column of times (``Average,35.5,15``); without
    times, in the first column if it has numbers.
    """
    first_rows = [row for _, row in data[:9] if len(row) >= width]
    time_columns = [k for k in range(width) if 2 * sum(is_time(row[k]) for row in first_rows) > len(first_rows)]
    if not time_columns and all(_is_data_cell(row[0]) for row in first_rows):
        time_columns = [0]
    n = 0
    while n < min(20, len(data) - 1):
        cells = [cell.strip() for cell in _trim_blank_end(data[-1 - n][1])]
        time_cell = cells[time_columns[0]] if time_columns and time_columns[0] < len(cells) else ""
        words = [cell for cell in ([time_cell] if time_cell else cells) if any(map(str.isalpha, cell[:8]))]
        is_label = bool(time_columns) and any(
            not cell[:1].isdigit() and not _is_data_cell(cell) and not is_missing_word(cell) for cell in words
        )
        is_data = any(cell[:1].isdigit() or _is_data_cell(cell) or is_missing_word(cell) for cell in cells[:1])
        is_data |= sum(map(bool, cells)) >= width or (bool(time_cell) and _is_data_cell(time_cell))
        if is_data and not is_label:
            break
        n += 1
    return n


def _trim_blank_end(row: Sequence[str]) -> Sequence[str]:
    """Return the row up to its last cell that is not blank."""
    n_cells = len(row)
    while n_cells and not row[n_cells - 1].strip():
        n_cells -= 1
    return row[:n_cells]


def normalise_header(header: str) -> str:
    """Return the label of a header in small letters, its words together: ``datetime`` of ``Date / Time``."""
    return "".join(filter(str.isalnum, split_label_and_unit(header)[0].lower()))


def split_label_and_unit(header: str) -> tuple[str, str | None]:
    """Split ``"T_a_in [degF]"`` into label and unit, or None; ``Cmd (%)``, ``T / °C``, ``SAT_C`` if it is known."""
    text = header.strip()
    label, bracket, unit = text.partition("[")
    if bracket and text.endswith("]"):
        label, unit = label.rstrip(), unit[:-1].strip()
        return (header, None) if "\n" in label + unit else (label, unit)
    if "\n" in text or len(text) > 200:
        return header if "\n" in text else text, None
    if suffix := split_unit_suffix(text):
        return suffix
    label, bracket, rest = text.rpartition("(")
    if bracket and rest.endswith(")") and label.strip() and is_unit(rest[:-1].strip()):
        return label.rstrip(), rest[:-1].strip()
    for mark in (",", "/"):
        label, separator, rest = text.partition(mark)
        while separator:
            if label.strip() and is_unit(rest.strip()):
                return label.rstrip(), rest.strip()
            label_part, separator, rest = rest.partition(mark)
            label = f"{label}{mark}{label_part}"
    return text, None


def has_name(header: str, name: str) -> bool:
    """Whether a header is this name, with or without a unit."""
    return name in (header.strip(), split_label_and_unit(header)[0])


@dataclass
class Table:
    """The cells of a log as text, and the mistakes found in it so far."""

    name: str  # of the file, for messages
    header: list[str]
    rows: list[list[str]]  # without the header
    row_numbers: list[int]  # of each row in the file
    problems: list[str] = field(default_factory=list)
    unit_cure: str = "write '{header} [{unit}]' in the header"  # how to declare a unit in the log itself
    units: list[str] | None = None  # cells of a row of units below the header
    separator: str = ","  # of the columns in the file
    notes: list[str] = field(default_factory=list)  # how it was read
    column_of_joined_header: dict[str, int] = field(default_factory=dict)  # where cells of other headers went

    @classmethod
    def read(cls, path: str | Path, *, column: str = "", least_rows: int = 2) -> Table:
        """Read a CSV file; blank lines are skipped; ``column``: a name that is in its header, if that is known."""
        path = Path(path)
        text = read_text(path, "a CSV file", 2**30, utf_16=True)
        try:
            separator = _detect_separator(text)
            if text.count(separator) + text.count("\n") > _MAX_CELLS:
                sentence = f"{path} has more than {_MAX_CELLS:,} cells: leave out columns, or cut it into parts"
                raise InputError(sentence, str(path), "size")
            rows = [(i, row) for i, row in enumerate(_split_rows(text, separator), start=1) if any(map(str.strip, row))]
        except csv.Error as error:
            sentence = f"{path} is not a CSV file ({error}): save it as 'CSV UTF-8'"
            raise InputError(sentence, str(path), "format") from None
        if not rows:
            raise InputError(f"{path} is empty: give a header row and at least two rows of data", str(path), "data")
        notes = [] if separator == "," else [f"columns are separated by {_SEPARATOR_NAMES[separator]}"]
        first_rows = [row for _, row in rows[:_HEADER_SEARCH_ROWS]]
        named_rows = (k for k, row in enumerate(first_rows) for cell in row if column and has_name(cell, column))
        header_index = next(named_rows, _header_index(first_rows))
        (header_row, header), data = rows[header_index], rows[header_index + 1 :]
        if header_index:
            first_text = short_repr(" ".join(rows[0][1]))
            notes.append(f"what is above row {header_row} is not part of the table, from {first_text} on")
        units = None
        if data and _is_unit_row(data[0][1]) and any(map(_is_data_cell, chain(*(row for _, row in data[1:3])))):
            number, cells = data.pop(0)
            units = [_strip_brackets(cell) for cell in cells]
            notes.append(f"row {number} has the units: {', '.join(filter(None, units))[:80]}")
        header = [cell.strip() for cell in _trim_blank_end(header)]
        width = len(header)
        data = _drop_repeated_headers(path, header, data, notes)
        for _, row in data:
            if not any(map(str.strip, row[width:])):  # a separator at the end of the line
                del row[width:]
        if n_footer := _footer_length(data, width):
            (footer_row, footer), data = data[-n_footer], data[:-n_footer]
            notes.append(f"row {footer_row} and what follows is not part of the table: {short_repr(' '.join(footer))}")
        if len(data) < least_rows:
            cure = f"give at least {'two' if least_rows > 1 else 'one'}"
            sentence = f"{path} has {format_count(len(data), 'row')} of data below its header: {cure}"
            raise InputError(sentence, str(path), "data")
        table = cls(path.name, header, [row for _, row in data], [i for i, _ in data], separator=separator, notes=notes)
        table.units = None if units is None else (units + [""] * width)[:width]
        table._check_header()
        if ragged_rows := [i for i, row in enumerate(table.rows) if len(row) != width]:
            row, number = table.rows[ragged_rows[0]], table.row_numbers[ragged_rows[0]]
            count_text = f" ({len(ragged_rows)} rows in total)" if len(ragged_rows) > 1 else ""
            problem = f"row {number} has {format_count(len(row), 'cell')} where the header has {width}{count_text}"
            cure = "begin the file with the header, separate its cells as those of the rows, complete the row"
            table.add_problem(f"{problem}: {cure}", str(path), "format")
        table.raise_problems()
        table._join_clock()
        table._merge_status()
        return table

    def _check_header(self) -> None:
        """Add a problem for each name that appears more than once."""
        cure = "begin the file with the header, name every column once"
        for cell, count in Counter(self.header).items():
            if count > 1 and cell.lower() not in _STATUS_HEADERS:
                self.add_problem(f"column {short_repr(cell)} appears {count} times: {cure}", cell, "duplicate")

    def _join_clock(self) -> None:
        """Join a date and a time of day in separate columns to a column ``timestamp``."""
        headers = ("date", "datum"), ("time", "time of day", "zeit", "uhrzeit")
        columns = [[k for k, cell in enumerate(self.header) if cell.strip().lower() in names] for names in headers]
        labels = {split_label_and_unit(cell)[0] for cell in self.header}
        if [len(matching_columns) for matching_columns in columns] != [1, 1] or labels & {"timestamp", "elapsed_time"}:
            return
        (date,), (clock,) = columns
        if not all(is_date_beside_clock(row[date], row[clock]) for row in self.rows[:3]):
            return
        names = self.header[date], self.header[clock]
        for row in self.rows:
            date_and_clock = row[date].strip(), row[clock].strip()
            row[date] = " ".join(date_and_clock) if all(date_and_clock) else ""
        self.header[date] = "timestamp"
        for row in filter(None, (self.header, self.units, *self.rows)):
            del row[clock]
        self.column_of_joined_header = dict.fromkeys(names, self.header.index("timestamp"))
        self.notes.append(f"{names[0]} and {names[1]} are read as one timestamp")

    def _merge_status(self) -> None:
        """Append what columns of status say to the values that they are about, in braces, and drop these columns."""
        labels = [normalise_header(header) for header in self.header]
        candidates, sample = [k for k, label in enumerate(labels) if label in _STATUS_HEADERS], self.rows[:1000]
        status_columns = [k for k in candidates if any(row[k].strip().lower() in GOOD_STATUS_WORDS for row in sample)]
        other_columns = [k for k in range(len(labels)) if k not in status_columns]
        value_columns = [k for k in other_columns if labels[k] not in (*TIME_HEADERS, "elapsedtime")]
        for k in status_columns:
            bad_rows = [i for i, row in enumerate(self.rows) if row[k].strip().lower() not in (*GOOD_STATUS_WORDS, "")]
            for i, column in product(bad_rows, value_columns if len(status_columns) == 1 else [k - 1]):
                if is_number_or_switch_word(self.rows[i][column]):
                    self.rows[i][column] += f" {{{self.rows[i][k].strip(' {}')}}}"
            if bad_rows:
                subject, number = f"{format_count(len(bad_rows), 'row')} marked as bad", self.row_numbers[bad_rows[0]]
                self.notes.append(f"{subject} by the column {self.header[k]!r} (first in row {number})")
        for row in filter(None, (self.header, self.units, *self.rows) if status_columns else ()):
            row[:] = [row[k] for k in other_columns]

    def copy(self) -> Table:
        """Return a table with lists of its own, of the same rows."""
        lists: Any = {name: [*getattr(self, name)] for name in ("header", "rows", "row_numbers", "problems", "notes")}
        return replace(self, **lists)

    def add_problem(self, sentence: str, field: str, code: str) -> None:
        """Add a mistake in the log about ``field``, with a code of ``fastcoil.base.errors.CODES``."""
        self.problems.append(Problem(sentence, field, code))

    def raise_problems(self) -> None:
        """Raise all problems found so far, if any, as one `InputError`."""
        if self.problems:
            prefix = f"{self.name}: " if self.name else ""
            raise InputError([p.with_prefix(prefix) for p in InputError(self.problems).problems])

    def find_column(self, header: str) -> int | None:
        """Find the column with this header, given with or without its unit; None if there is none."""
        if header in self.header:
            return self.header.index(header)
        labels = [split_label_and_unit(cell)[0] for cell in self.header]
        return labels.index(header) if header in labels else self.column_of_joined_header.get(header)

    def find_time_column(self) -> int | None:
        """Find the column of times: by its header, or the first one if it has times; None if there is none."""
        first = 0 if is_time(self.rows[0][0]) and not is_time(self.header[0]) else None
        return next((k for k, header in enumerate(self.header) if normalise_header(header) in TIME_HEADERS), first)

    def declared_units(self, column: int) -> dict[str, str]:
        """Return the units of a column by where they are declared: ``by its header`` and ``by the row of units``."""
        by_header = split_label_and_unit(self.header[column])[1]
        below = self.units[column] if self.units else ""
        units = {} if by_header is None else {"by its header": by_header}
        return units | ({"by the row of units": below} if below and (not units or is_unit(below)) else {})

    def unit_declaration_cure(self, column: int, unit: str) -> str:
        """Return the advice how to declare the unit of a column in the log itself."""
        label = split_label_and_unit(self.header[column])[0]
        return self.unit_cure.format(header=label if len(label) <= 100 else "…", unit=unit)

    def check_names(self, argument: str, names: Iterable[str], known_names: Iterable[str]) -> None:
        """Add a problem for each of the ``names`` in an argument that is none of the ``known_names``."""
        for name in names:
            with collect_problems(self.problems):
                require_choice(argument, name, [*known_names])

    def keep_rows(self, rows: Iterable[int]) -> None:
        """Keep only the rows with these indices, in this order."""
        indices = list(rows)
        self.rows, self.row_numbers = [self.rows[i] for i in indices], [self.row_numbers[i] for i in indices]


def table_from_data(source: Any, columns: Mapping[str, str] | None, names: Collection[str]) -> Table:
    """Convert a Dataset or DataFrame to a table whose rows count from 0, as in ``isel`` and ``iloc``.

    Of a Dataset the variables with one of our ``names``, and those that ``columns`` (our name: its name) asks for,
    along one coordinate of time; of a DataFrame every column, and an index that is named or of times.
    """
    if hasattr(source, "iloc"):
        kind, cure = "DataFrame", "name the column '{header} [{unit}]'"
        header = [_header_with_unit(str(name).strip(), values) for name, values in source.items()]
        series, index = [values for _, values in source.items()], source.index
        if index.dtype.kind == "m":
            header, series = [f"{index.name or 'elapsed_time'} [s]", *header], [index.total_seconds(), *series]
        elif index.name is not None or is_time_like(index):
            time_header = "timestamp" if index.name is None or index.dtype.kind == "M" else str(index.name)
            header, series = [time_header, *header], [index, *series]
    else:
        kind, cure = "Dataset", "give it attrs['units'] = '{unit}'"
        header, series = _dataset_columns(source, dict(columns or {}), names)
    rows = [list(row) for row in zip(*map(_format_cells, series), strict=True)]
    if len(rows) < 2:
        raise InputError(f"the {kind} has fewer than two samples: give a longer log", kind, "data")
    table = Table(kind, header, rows, list(range(len(rows))), unit_cure=cure)
    table._check_header()
    table.raise_problems()
    table._merge_status()
    return table


def _dataset_columns(ds: xr.Dataset, columns: Mapping[str, str], names: Collection[str]) -> tuple[list[str], list[Any]]:
    """Return headers and values of the variables of a Dataset as columns of a log, the time first."""
    coordinates = ("elapsed_time", "timestamp", "time")
    times = (*(columns.get(name, name) for name in coordinates), *coordinates)
    dims = [name for name in times if name in ds.coords and ds[name].dims == (name,)]
    if not dims:
        cure = "give every variable one of them as dimension"
        sentence = f"the Dataset has no coordinate elapsed_time, nor timestamp: {cure}"
        raise InputError(sentence, "elapsed_time", "missing")
    time = dims[0]
    read_names = [str(n) for n in ds.data_vars if n in names or n in columns.values()]
    cure = f"choose one loop, so that only {time} is left"
    wrong_dims = [name for name in read_names if ds[name].dims != (time,)]
    raise_problems([Problem(f"{name} has dims {ds[name].dims}: {cure}", name, "shape") for name in wrong_dims])
    require_one_clock(ds, time)
    values, label = ds[time].values, time if time in columns.values() else "elapsed_time"
    if values.dtype.kind == "M" and columns.get("elapsed_time") != time:
        time_header = time if columns.get("timestamp") == time else "timestamp"
        values = values.astype("datetime64[us]")
    elif values.dtype.kind in "mM":
        time_header, values = f"{label} [s]", (values - values[:1]) / np.timedelta64(1, "s")
    else:
        time_header = _header_with_unit(label, ds[time])
    headers = [time_header, *(_header_with_unit(name, ds[name]) for name in read_names)]
    return headers, [values, *(ds[name].values for name in read_names)]


def require_one_clock(ds: xr.Dataset, time: str) -> None:
    """Refuse times along the dimension ``time``, such as dates beside the seconds, whose steps are not its own."""
    steps_by_name = {name: _steps_in_seconds(ds[name]) for name in (time, *ds.coords) if ds[name].dims == (time,)}
    steps = steps_by_name.pop(time)
    for name, other_steps in steps_by_name.items():  # such as dates beside the seconds
        is_known = steps is not None and other_steps is not None
        if is_known and not np.allclose(steps, other_steps, rtol=0.0, atol=1.0):
            sentence = f"{name} and {time} of the Dataset differ in their steps: drop the one that is wrong"
            raise InputError(sentence, str(name), "conflict")


def is_time_like(labels: Any) -> bool:
    """Whether the labels are times, by their type, or texts that say when."""
    if labels.dtype.kind not in "OUT":
        return bool(labels.dtype.kind in "mM")
    first = next(iter(np.ravel(labels.values)), None)
    return hasattr(first, "isoformat") or is_time(str(first))


def _steps_in_seconds(coord: xr.DataArray) -> Any:
    """Return the steps of a coordinate that has times; NaN if they cannot be read; None if it has something else."""
    if coord.dtype.kind in "mM":
        return np.diff(coord.values) / np.timedelta64(1, "s")
    if coord.dtype.kind not in "iuf":
        return np.array(np.nan) if is_time_like(coord) else None
    steps, unit = np.diff(coord.values), carried_unit(str(coord.name), coord)
    if unit is None:  # numbers that count
        return steps if abs(np.sign(steps).sum()) == steps.size else None
    known_unit = find_unit(unit.partition(" since ")[0], TIME)
    return None if known_unit is None else TIME[known_unit][0] * steps


def _header_with_unit(name: str, series: Any) -> str:
    """Add the unit that is beside the numbers of a column to its header, unless that has one."""
    unit, unit_of_header = carried_unit(name, series), split_label_and_unit(name)[1]
    if unit is not None and unit_of_header not in (None, unit):
        sentence = f"{name} has the unit {short_repr(unit)} beside its numbers: give one of the two"
        raise InputError(sentence, name, "unit")
    return name if unit in (None, unit_of_header) else f"{name} [{unit}]"


def _format_cells(values: Any) -> list[str]:
    """Convert numbers to text that reads back to the bit, and times with the zone that they have."""
    is_number = values.dtype.kind in "iuf"
    return [repr(v) for v in np.asarray(values, float).tolist()] if is_number else [str(v) for v in values]
