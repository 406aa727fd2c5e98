"""Cells as building systems write them: numbers, units, statuses, words."""

import numpy as np
import pytest
from helpers.exports import COMMAND, HEADER, ISO, ROWS, T_SUP, assert_same_log, cell_rows, table_text
from helpers.refusals import assert_mistakes, assert_refused

from fastcoil.logs import read_checked_log
from fastcoil.logs.cells import detect_number_style, parse_cells
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.series import AIR_FLOW, TEMPERATURE, WATER_FLOW, resolve_unit


def format_with_comma(values, decimals=2):
    return [f"{value:.{decimals}f}".replace(".", ",") for value in values]


# ----------------------------------------------------------------------------------------- decimals and thousands


QUOTED_ROWS = cell_rows(ISO, *([f'"{cell}"' for cell in format_with_comma(values)] for values in (COMMAND, T_SUP)))
COMMA_ROWS = cell_rows(ISO, format_with_comma(COMMAND, 1), format_with_comma(T_SUP))
COMMA_NOTE = "numbers are read with a decimal comma"


@pytest.mark.parametrize(
    ("cells", "separator", "notes"),
    [
        (QUOTED_ROWS, ",", [COMMA_NOTE]),
        (COMMA_ROWS, ";", ["columns are separated by semicolons", COMMA_NOTE]),
        (cell_rows(), ";", ["columns are separated by semicolons"]),
        (cell_rows(), "\t", ["columns are separated by tabs"]),
    ],
)
def test_separators_of_columns_and_of_decimals(read_export, cells, separator, notes):
    log = read_export(cells, separator=separator)
    assert_same_log(log)
    assert log.notes == notes


@pytest.mark.parametrize(
    ("cells", "values"),
    [
        (["1,234.5", "12.5", "1,234,567", "7"], [1234.5, 12.5, 1234567, 7]),
        (["1.234,5", "12,5", "1.234", "7"], [1234.5, 12.5, 1234, 7]),
        (["1 234,5", "12,25", "1\u202f234\u202f567", "7"], [1234.5, 12.25, 1234567, 7]),
        (["1'234.5", "12,345.5", "-1'234'567", "+7"], [1234.5, 12345.5, -1234567, 7]),
        (["1,234", "0.5", "12,345", "7"], [1234, 0.5, 12345, 7]),
    ],
)
def test_separators_of_thousands(cells, values):
    np.testing.assert_allclose(parse_cells(cells, detect_number_style([cells], ","), is_switch=False).values, values)


def test_separators_of_thousands_are_said_or_refused_if_they_may_be_decimals(write_log):
    path = write_log(["elapsed_time [s]", "m_w [L/h]"], [[0, "999.5"], [60, "7,200"], [120, "3,600"]])
    log = read_checked_log(path, ColumnSpec(("m_w",)))
    np.testing.assert_allclose(log.values["m_w"], [0.2776389, 2, 1], rtol=1e-6)
    assert log.notes == ["commas in numbers separate thousands"]
    path = write_log(["elapsed_time [s]", "T_sup [degC]"], [[0, "1,234"], [60, "1,235"]])
    assert_refused("log.csv", "format", read_checked_log, path, ColumnSpec(("T_sup",)))


# ----------------------------------------------------------------------------------------------- units in the cells


def test_numbers_with_their_unit(read_export):
    cells = cell_rows(ISO, [f"{c / 10:.2f} V" for c in COMMAND], [f"{1.8 * T + 32:.3f} °F" for T in T_SUP])
    log = read_export(cells, ("timestamp", "command", "T_sup"))
    np.testing.assert_allclose(log.values["command"], COMMAND / 100, atol=1e-9)
    np.testing.assert_allclose(log.values["T_sup"], T_SUP, atol=1e-3)
    assert log.notes == ["command is in 'V' by its cells", "T_sup is in '°F' by its cells"]


@pytest.mark.parametrize("form", ["{} %", "{}%", "{} percent"])
def test_percent_in_the_cells_beside_a_unit_in_the_header(read_export, form):
    cells = cell_rows(ISO, [form.format(c) for c in COMMAND])
    assert_same_log(read_export(cells))
    assert_same_log(read_export(cells, ("timestamp", "command", "T_sup [degC]")))
    assert_refused("command", "unit", read_export, cells, ("timestamp", "command [V]", "T_sup [degC]"))


def test_one_number_of_another_unit_is_a_bad_value_unless_the_cells_declare_it(read_export):
    cells = cell_rows(ISO, [f"{c} %" for c in COMMAND])
    for cells[7][1] in ("5.1 V", "5.1"):
        assert_refused("command", "unit", read_export, cells, ("timestamp", "command", "T_sup [degC]"))
    cells = cell_rows()
    cells[7][1] = "5.1 V"
    assert_refused("command", "value", read_export, cells)
    cells[7][1] = f"{COMMAND[7]} %"
    assert_same_log(read_export(cells))


# ------------------------------------------------------------------------------------------- words and statuses


@pytest.mark.parametrize("word", ["", "NaN", "---", "null", "#N/A", "n/a", "No Data"])
def test_words_for_a_missing_value(read_export, word):
    cells = cell_rows()
    cells[7][2] = word
    assert_refused("T_sup", "value", read_export, cells)
    assert np.flatnonzero(np.isnan(read_export(cells, drop=True).values["T_sup"])).tolist() == [7]


@pytest.mark.parametrize(("on", "off"), [("ON", "OFF"), ("true", "false"), ("Active", "Inactive"), ("Yes", "No")])
def test_switches_in_words(read_export, on, off):
    words = [on if k < 20 else off for k in range(ROWS)]
    log = read_export(cell_rows(ISO, COMMAND, T_SUP, words), (*HEADER, "enabled"))
    np.testing.assert_array_equal(log.values["enabled"], [1.0] * 20 + [0.0] * 40)
    assert not log.notes


def test_a_status_beside_the_number_in_its_cell(read_export):
    cells = cell_rows(ISO, [f"{c} {{ok}}" for c in COMMAND])
    assert_same_log(read_export(cells))
    for cells[7][1] in ('"0.0 {fault,stale}"', "{fault}"):
        assert_refused("command", "value", read_export, cells)
    log = read_export(cells, drop=True)
    assert log.values["command"][7] == log.values["command"][6]


def test_a_column_of_status_marks_the_values_of_its_row(read_export):
    status = ["{ok}"] * ROWS
    text = table_text(cell_rows(ISO, COMMAND, T_SUP, status), (*HEADER, "Status"))
    assert_same_log(read_export(text))
    status[7] = "{fault}"
    text = table_text(cell_rows(ISO, COMMAND, T_SUP, status), (*HEADER, "Status"))
    assert_mistakes([("command", "value"), ("T_sup", "value")], read_export, text)
    log = read_export(text, drop=True)
    assert log.notes[0] == "1 row marked as bad by the column 'Status' (first in row 9)"
    assert np.flatnonzero(np.isnan(log.values["T_sup"])).tolist() == [7]


@pytest.mark.parametrize(
    ("unit", "units"),
    [("lpm", WATER_FLOW), ("LPH", WATER_FLOW), ("cmh", AIR_FLOW), ("kg/min", AIR_FLOW), ("lpm", TEMPERATURE)],
)
def test_an_abbreviation_suggests_the_unit_it_means(unit, units):
    assert_refused("x", "unit", resolve_unit, "x", unit, units)
