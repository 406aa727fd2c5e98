"""The log of an air handler, with all its valves: which column is which point, in which units, read at once."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.logs.cells import parse_cells
from fastcoil.logs.columns import ColumnSpec, ReadingOptions, find_columns, interpret_header
from fastcoil.logs.join import find_value_columns, pivot_points
from fastcoil.logs.log import CheckedLog, Log, check_table
from fastcoil.logs.readings import detect_table_style, propose_unit
from fastcoil.logs.series import COLUMNS
from fastcoil.logs.table import Table

COILS = ("cooling", "heating", "preheat")
COMMANDS = tuple(f"{coil}_command" for coil in COILS)
_TEMPERATURES = ("T_sup", "T_mixed", "T_a_in", "T_return", "T_out", "T_set", "T_set_cooling", "T_set_heating")
AIR_HANDLER_SPEC = ColumnSpec(
    required=("T_sup",), optional=(*COMMANDS, *_TEMPERATURES[1:], "m_a", "fan_speed", "enabled", "occupied"),
    measured=(*_TEMPERATURES, "m_a", "fan_speed"), rules="air_handler_rules", asked=("T_set", *COMMANDS),
)  # fmt: skip


@dataclass(frozen=True)
class AirHandlerPoints:
    """Points of an air handler in a log: headers by our names, units proposed for columns without, notes on them."""

    headers: dict[str, str]
    units: dict[str, str]
    notes: list[str]

    @property
    def coils(self) -> list[str]:
        """The coils whose valves have a command in the log."""
        return [coil for coil in COILS if f"{coil}_command" in self.headers]


def count_valves(log: Log) -> int:
    """Count the kinds of valves that headers or the caller name beyond doubt; 0 of a log that is no table."""
    try:
        header = log.table().header
    except InputError:
        return 0
    meanings = [interpret_header(cell, AIR_HANDLER_SPEC.rules) for cell in header]
    named = {meaning.name for meaning in meanings if meaning and meaning.is_clear}
    return len({*COMMANDS} & (named | {*(log.options.columns or {})} | {*header}))


def find_points(log: Log) -> tuple[AirHandlerPoints, Table, ReadingOptions]:
    """Find the points of an air handler by the headers of its log, and propose units where they name none."""
    table, options = log.table(), replace(log.options, drop=True)
    if find_value_columns(table) is not None:
        table = pivot_points(table, options, AIR_HANDLER_SPEC)
        options = replace(options, columns=None, units={}, ignore=(), time_format=None, time_zone="")
    columns = find_columns(table, options, AIR_HANDLER_SPEC)
    points = {name: k for name, k in columns.items() if name in AIR_HANDLER_SPEC.names}
    table.raise_problems()
    units = _propose_units(table, points, options)
    unread = [name for name in points if name not in units and _lacks_unit(table, name, points[name], options)]
    headers = {name: table.header[k] for name, k in points.items() if name not in unread}
    options = replace(options, units={**units, **options.units}, ignore=[*options.ignore, *unread])
    if "degF" in units.values():  # numbers in °F come from where the month is written first
        options = replace(options, month_first=True)
    notes = []
    if units:
        texts = [f"{'a fraction' if unit == '1' else unit} for {', '.join(n for n in units if units[n] == unit)}"
                 for unit in dict.fromkeys(units.values())]  # fmt: skip
        cure = options.unit_cure(next(iter(units)), "UNIT")
        notes.append(f"units by the numbers, as the headers have none: {'; '.join(texts)}; if one is wrong: {cure}")
    if unread:
        notes.append(f"left out, as their headers have no unit: {', '.join(unread)}")
    return AirHandlerPoints(headers, units, notes), table, options


def read_air_handler(log: Log) -> tuple[CheckedLog, AirHandlerPoints]:
    """Read all points of an air handler as checked numbers in our units."""
    points, table, options = find_points(log)
    if not points.coils:
        cure = options.cure("columns={'cooling_command': 'its header'}", "--column cooling_command='its header'")
        commands = " or ".join(COMMANDS)
        raise InputError(f"{log.name}: {commands} is missing: say which it is: {cure}", "cooling_command", "missing")
    table.notes.clear()  # reading the columns writes them again
    data = check_table(table, AIR_HANDLER_SPEC, options)
    if not {"T_set", "T_set_cooling", "T_set_heating"} & data.values.keys():
        points.notes.append("without a set-point (T_set), nothing is said about control errors")
    return data, points


def valve_log(log: Log, points: AirHandlerPoints, coil: str) -> Log:
    """Return the log as that of one valve, with the headers and units that were found."""
    set_point = next((name for name in (f"T_set_{coil}", "T_set") if name in points.headers), "")
    entering = next((name for name in ("T_mixed", "T_a_in") if name in points.headers), "")
    names = {"command": f"{coil}_command", "T_sup": "T_sup", "T_set": set_point, "T_a_in": entering, "m_a": "m_a",
             "enabled": "enabled"}  # fmt: skip
    columns = {name: points.headers[point] for name, point in names.items() if point in points.headers}
    given_units = {**points.units, **log.options.units}
    units = {name: given_units[names[name]] for name in columns if names[name] in given_units}
    read = {*columns.values()}
    ignore = [header for header in points.headers.values() if header not in read]
    return log.with_options(
        columns=columns, units=units, ignore=ignore, drop=True, month_first="degF" in points.units.values()
    )


def _lacks_unit(table: Table, name: str, column: int, options: ReadingOptions) -> bool:
    is_plain = COLUMNS[name].is_switch or name in options.units
    return not is_plain and not table.declared_units(column)


def _propose_units(table: Table, points: Mapping[str, int], options: ReadingOptions) -> dict[str, str]:
    """Propose a unit by its numbers for each column whose header has none; one for all temperatures."""
    numbers: dict[str, Array] = {}
    style = detect_table_style(table, points)
    for name, column in points.items():
        if _lacks_unit(table, name, column, options):
            cells = parse_cells([row[column] for row in table.rows], style, is_switch=False)
            if not cells.units and np.isfinite(cells.values).any():
                numbers[name] = cells.values[np.isfinite(cells.values)]
    units = {name: propose_unit(COLUMNS[name], values) for name, values in numbers.items()}
    temperatures = [name for name in _TEMPERATURES if name in numbers]
    sensors = [name for name in temperatures if not name.startswith("T_set")] or temperatures
    is_fahrenheit = any(units[name] == "degF" for name in sensors)
    units |= dict.fromkeys(temperatures, "degF" if is_fahrenheit else "degC")
    return {name: unit for name, unit in units.items() if unit}


def require_answers(name: str, answers: Any) -> dict[str, dict[str, str]]:
    """Require headers and units of an air handler, as they stand in the file of another one."""
    parts = {part: answers.get(part, {}) for part in ("columns", "units")}
    if not {"columns", "units"} & answers.keys():
        cure = "give a file that `fastcoil diagnose -o` wrote for another air handler"
        raise InputError(f"{name}: it has no [columns] or [units]: {cure}", name, "data")
    for part, entries in parts.items():
        if not isinstance(entries, dict) or not all(isinstance(text, str) for text in entries.values()):
            sentence = f"{name}: [{part}] is not a table of texts: give a file that `fastcoil diagnose -o` wrote"
            raise InputError(sentence, name, "data")
    return parts
