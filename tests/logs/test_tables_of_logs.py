"""Tables as programs export them: remarks around them, rows of units, units in headers, other encodings."""

import numpy as np
import pytest
from helpers.exports import COMMAND, HEADER, ISO, ROWS, T_SUP, assert_same_log, cell_rows, format_times, table_text
from helpers.refusals import assert_mistakes, assert_refused

from fastcoil.logs.table import split_label_and_unit


@pytest.mark.parametrize(
    "before",
    [
        "Trend report\n\n",
        "Trend report of AHU-1\nSite: Berkeley, CA\nFrom:,2024-07-11\nTo:,2024-07-12\n\n",
        "Trend report,,\n,,\nBuilding 33,,\nPoints:,2,\n",
    ],
)
def test_lines_before_the_header_are_left_out_and_said(read_export, before):
    log = read_export(cell_rows(), before=before)
    assert_same_log(log)
    header = before.count("\n") + 1  # as a spreadsheet numbers them
    assert log.rows[0] == header + 1
    assert any(f"above row {header} is not part of the table, from 'Trend report" in note for note in log.notes)


@pytest.mark.parametrize(
    "after",
    [
        "End of report\n",
        "\nTotal: 60 rows\nPrinted by,the system,\n",
        "Average,50.1,14.2\nMin,1,2\n",
        ",Avg: 5,Avg: 1\n# n,60,60\n",
    ],
)
def test_lines_after_the_data_are_left_out_and_said(read_export, after):
    log = read_export(cell_rows(), after=after)
    assert_same_log(log)
    assert any(f"row {ROWS + 2 + after.startswith(chr(10))} and what follows is not part" in n for n in log.notes)


@pytest.mark.parametrize("last", ["2024-07-12T00:3", "2024-07-12T00:30:00,50.0", "x,1"])
def test_a_last_row_that_is_cut_off_is_refused(read_export, tmp_path, last):
    text = table_text(cell_rows(), after=last)
    if last == "x,1":
        assert any("not part of the table: 'x 1'" in note for note in read_export(text).notes)
    else:
        assert_refused(str(tmp_path / "export.csv"), "format", read_export, text)


def test_rows_of_data_before_the_header_are_refused(read_export):
    header, *data = table_text(cell_rows()).splitlines()
    text = "\n".join([*data[:5], header, *data[5:]])
    missing = [(name, "missing") for name in ("command", "T_sup", "elapsed_time")]
    assert_mistakes([("2024-07-11T23:30:00", "name"), *missing], read_export, text)


@pytest.mark.parametrize(
    "units", ["yyyy-mm-dd hh:mm,%,°C", ",%,degC", "-,[%],[°C]", "local time,(%),(Deg C)", "TIMESTAMP,percent,C"]
)
def test_a_row_of_units_below_the_header(read_export, units):
    header = ("timestamp", "command", "T_sup")
    log = read_export([units.split(","), *cell_rows()], header)
    assert_same_log(log)
    assert log.rows[0] == 3
    assert log.notes[0].startswith("row 2 has the units: ")


def test_a_row_of_units_is_checked_as_a_header_is(read_export):
    header = ("timestamp", "command", "T_sup")
    assert_refused("T_sup", "unit", read_export, [["", "%", "bar"], *cell_rows()], header)
    assert_refused("T_sup", "unit", read_export, [["", "%", "K"], *cell_rows()], header, units={"T_sup": "degC"})


@pytest.mark.parametrize(
    "header",
    [
        ("timestamp", "command (%)", "T_sup (°C)"),
        ("timestamp", "command / %", "T_sup / °C"),
        ("timestamp", '"command, %"', '"T_sup, degC"'),
        ("timestamp", "command (% open)", "T_sup (C)"),
        ("timestamp", "command %", "T_sup - °C"),
        ("timestamp", "command_pct", "T_sup_C"),
    ],
)
def test_units_in_round_brackets_and_after_comma_or_slash(read_export, header):
    assert_same_log(read_export(cell_rows(), header))


def test_a_unit_that_contradicts_the_header_is_refused_and_another_spelling_is_not(read_export):
    text = table_text(cell_rows(), ("timestamp", "command (V)", HEADER[2]))
    assert_refused("command", "unit", read_export, text, units={"command": "%"})
    text = table_text(cell_rows(), ("timestamp", "command (%)", HEADER[2]))
    assert not read_export(text, units={"command": "percent"}).notes


@pytest.mark.parametrize(
    ("header", "label", "unit"),
    [
        ("  T_sup  [ degC ]  ", "T_sup", "degC"),
        ("T_sup", "T_sup", None),
        ("", "", None),
        ("[degC]", "", "degC"),
        ("T_sup []", "T_sup", ""),
        ("T [x] [degC]", "T", "x] [degC"),
        ("T_sup\n[degC]", "T_sup", "degC"),
        ("Supply\nair [degC]", "Supply\nair [degC]", None),
        ("SAT (AHU1)", "SAT (AHU1)", None),
        ("Flow/L/s", "Flow", "L/s"),
        ("(%)", "(%)", None),
        ("SAT (AHU1) [degF]", "SAT (AHU1)", "degF"),
        ("x" * 300 + " (%)", "x" * 300 + " (%)", None),
    ],
)
def test_label_and_unit_of_a_header(header, label, unit):
    assert split_label_and_unit(header) == (label, unit)


def test_a_header_that_comes_again_is_left_out_and_another_one_is_refused(read_export, tmp_path):
    lines = table_text(cell_rows()).splitlines()
    repeated = "\n".join([*lines[:9], lines[0], *lines[9:]])
    log = read_export(repeated)
    assert log.notes == ["1 row left out: the header again"]
    assert_same_log(log)
    for other_header in (lines[0].replace("T_sup [", "T_set ["), ",".join(reversed(lines[0].split(",")))):
        text = repeated.replace(f"\n{lines[0]}", f"\n{other_header}")
        assert_refused(str(tmp_path / "export.csv"), "format", read_export, text, drop=True)


@pytest.mark.parametrize("where", ["everywhere", "below the header"])
def test_a_separator_at_the_end_of_each_line(read_export, where):
    lines = table_text(cell_rows()).splitlines()
    text = "\n".join(f"{line}," if k or where == "everywhere" else line for k, line in enumerate(lines))
    log = read_export(text)
    assert_same_log(log)
    assert not log.notes


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le-bom", "utf-16-be-bom"])
def test_encodings_of_spreadsheets(read_export, encoding):
    text = table_text(cell_rows(), ("timestamp", "command [%]", "T_sup [°C]"), separator="\t").replace("\n", "\r\n")
    marked = "\ufeff" + text if encoding.endswith("-bom") else text
    assert_same_log(read_export(marked, encoding=encoding.removesuffix("-bom")))


def test_all_at_once(read_export):
    """As a German building system writes it."""
    stamps = [f"{stamp} MEZ" for stamp in format_times("%d.%m.%Y %H:%M:%S")]
    command, T_sup = ([f"{x}".replace(".", ",") for x in values] for values in (COMMAND, T_SUP))
    cells = [["", "%", "°C", ""], *cell_rows(stamps, command, T_sup, ["{ok}"] * ROWS)]
    text = table_text(cells, ("Zeit", "Stellung", "Zuluft", "Status"), ";", "Anlage;RLT 1\n\n", "\nEnde\n")
    log = read_export(text, encoding="utf-16", columns={"timestamp": "Zeit", "command": "Stellung", "T_sup": "Zuluft"})
    assert_same_log(log)
    assert len(log.notes) == 7


# ---------------------------------------------------------------------------------- signals of 2-10 V, percent


def test_signals_whose_lowest_value_is_the_closed_valve(read_export):
    stroke = COMMAND / 100
    for unit, closed, span in ("V", 0, 10), ("deg", 0, 90), ("V 2-10", 2, 8), ("2-10 V", 2, 8), ("mA 4-20", 4, 16):
        log = read_export(cell_rows(ISO, closed + span * stroke), ("timestamp", f"command [{unit}]", HEADER[2]))
        np.testing.assert_allclose(log.values["command"], stroke, atol=1e-12)
        assert not log.notes


def test_a_command_from_2_to_10_V_is_suspected_aloud(read_export):
    stroke = np.linspace(0, 1, ROWS)
    header = ("timestamp", "command [V]", HEADER[2])
    (note,) = read_export(cell_rows(ISO, 2 + 8 * stroke), header).notes
    assert "command is from 2 to 10, read in V: if it is a signal in V 2-10, write '[V 2-10]'" in note
    assert "--unit command='V 2-10'" in note
    for values in (10 * stroke, 4 + 6 * stroke, 2 + 5 * stroke):
        assert not read_export(cell_rows(ISO, values), header).notes
    for unit in ("V 0-10", "V 2-10"):
        assert not read_export(cell_rows(ISO, 2 + 8 * stroke), (header[0], f"command [{unit}]", header[2])).notes
