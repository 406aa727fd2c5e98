"""Logs as the fits read them: bad ones are refused with column, row and cure; what is left out is counted."""

import pytest
from helpers.log_files import COIL_HEADER, VALVE_HEADER, change_cell, coil_rows, valve_rows
from helpers.refusals import refusal

import fastcoil as fc

pytestmark = pytest.mark.kernel


def assert_has_words(text, words):
    for word in words:
        assert word in text, text


# ------------------------------------------------------------------------------------------------- columns and cells


@pytest.mark.parametrize(
    ("header", "change", "words"),
    [
        (
            ["elapsed_time [s]", "command", "m_w [kg/s]"],
            None,
            ["command has no unit", "'command [UNIT]'", "--unit", "deg"],
        ),
        (["elapsed_time [s]", "command [1]", "m_w [L/sec]"], None, ["m_w is in 'L/sec'", "L/s"]),
        (
            ["elapsed_time [s]", "command [1]", "flow [kg/s]"],
            None,
            ["unknown columns: 'flow [kg/s]'", "m_w is missing"],
        ),
        (["t [s]", "command [1]", "m_w [kg/s]"], None, ["elapsed_time or timestamp is missing", "--column"]),
        (["Trend", "", ""], None, ["row 2 has 3 cells where the header has 1", "begin the file with the header"]),
        (VALVE_HEADER, (5, 2, "nan"), ["m_w = 'nan' in row 7", "--drop"]),
        (VALVE_HEADER, (5, 1, ""), ["command = '' in row 7", "--drop"]),
        (VALVE_HEADER, (5, 2, "1,5"), ["m_w = '1,5' in row 7: give a number with a decimal point", "--drop"]),
        (VALVE_HEADER, (5, 1, "1.7"), ["command = 1.7 in row 7", "from 0 to 1", "check its unit"]),
        (VALVE_HEADER, (5, 2, "-999"), ["m_w = -999 kg/s in row 7", "fill or cut the gap"]),
        (VALVE_HEADER, (5, 0, "240"), ["elapsed_time: row 7 is at the same time as row 6", "--jumps split"]),
        (VALVE_HEADER, (5, 0, "10"), ["elapsed_time: row 7 is earlier than row 6"]),
    ],
)
def test_bad_logs_of_a_valve_are_refused_with_column_row_and_cure(valve_log, header, change, words):
    rows = valve_rows() if change is None else change_cell(valve_rows(), *change)
    assert_has_words(refusal(fc.fit_valve, valve_log(rows, header)), words)


@pytest.mark.parametrize(
    ("header", "change", "options", "words"),
    [
        (
            [*COIL_HEADER[:6], "T_supply [degC]"],
            None,
            {},
            ["'T_supply [degC]', did you mean 'T_sup'", "T_sup is missing"],
        ),
        (COIL_HEADER, (5, 3, 99999), {}, ["T_w_in = 99999 degC in row 7", "from 0.5 to 120"]),
        (COIL_HEADER, (5, 4, 0), {}, ["T_a_in is 0, first in row 7", "sensor off", "--drop"]),
        (COIL_HEADER, None, {"warm_up": 1e5}, ["0 temperatures to compare", "warm-up of 100000 s", "lower warm_up"]),
        (COIL_HEADER, None, {"minimise_on": "T"}, ["minimise_on = 'T'"]),
        (COIL_HEADER, None, {"minimise_on": "both"}, ["T_w_out is missing"]),
        (COIL_HEADER, None, {"holds": ["T_sup"]}, ["holds = 'T_sup'"]),
        (COIL_HEADER, None, {"n_volumes": 0}, ["n_volumes = 0"]),
        (COIL_HEADER, None, {"max_gap": 0}, ["max_gap = 0: ", "at least 1"]),
        (COIL_HEADER, None, {"constants": {"m_a": 1.2}}, ["m_a and constant m_a are both given"]),
        (
            COIL_HEADER,
            None,
            {"constants": {"T_dp_in": 99}},
            ["constants has T_dp_in = 99: give a number from -60 to 50 degC"],
        ),
        (COIL_HEADER, None, {"constants": {"elapsed_time": 1}}, ["constants = 'elapsed_time'"]),
    ],
)
def test_bad_logs_and_arguments_of_a_coil_are_refused(coil_log, header, change, options, words):
    rows = coil_rows() if change is None else change_cell(coil_rows(), *change)
    assert_has_words(refusal(fc.fit_coil, coil_log(rows, header), **options), words)


# ------------------------------------------------------------------------------------------------------------- time


def test_a_log_with_two_times_must_say_which_to_read(valve_log):
    header = ["timestamp", *VALVE_HEADER]
    rows = [[f"2024-07-01T{t // 3600:02d}:{t // 60 % 60:02d}:00", t, c, m] for t, c, m in valve_rows()]
    path = valve_log(rows, header)
    assert "elapsed_time and timestamp are both given" in refusal(fc.fit_valve, path)
    by_stamp = fc.fit_valve(path, columns={"timestamp": "timestamp"})
    assert by_stamp.parameters == fc.fit_valve(path, columns={"elapsed_time": "elapsed_time"}).parameters
    rows[5][0] = "midnight"
    assert "timestamp = 'midnight' in row 7" in refusal(
        fc.fit_valve, valve_log(rows, header), columns={"timestamp": "timestamp"}
    )
    fit = fc.fit_valve(valve_log(rows, header), columns={"timestamp": "timestamp"}, drop=True)
    assert "1 row left out: timestamp is not an admissible number (first in row 7)" in fit.notes


# --------------------------------------------------------------------------------------------- what is left out


def test_dropped_rows_gaps_and_jumps_are_counted(valve_log):
    rows = change_cell(change_cell(change_cell(valve_rows(), 5, 2, "nan"), 6, 2, "-999"), 9, 1, "off")
    fit = fc.fit_valve(valve_log(rows), drop=True)
    assert "1 row left out: command is not an admissible number (first in row 11)" in fit.notes
    assert any(note.startswith("2 values left out: m_w") for note in fit.notes)
    gappy = [[t + 3600 * (i > 30), c, m] for i, (t, c, m) in enumerate(valve_rows())]
    fit = fc.fit_valve(valve_log(gappy))
    assert any("1 gap in time (first: 3660 s between rows 32 and 33)" in note for note in fit.notes)
    bridged = fc.fit_valve(valve_log(gappy), max_gap=3660)
    assert not any("gap in time" in note for note in bridged.notes)
    backward = [[t - 900 * (i > 30), c, m] for i, (t, c, m) in enumerate(valve_rows())]
    fit = fc.fit_valve(valve_log(backward), jumps="split")
    assert any("goes back or does not advance 1 time:" in note for note in fit.notes)


def test_readings_that_scatter_about_a_bound_are_taken_as_the_bound(valve_log):
    rows = change_cell(change_cell(valve_rows(), 5, 1, "1.004"), 9, 2, "-0.01")
    fit = fc.fit_valve(valve_log(rows))
    assert float(fit.residuals["command"][5]) == 1.0
    assert float(fit.residuals["m_w"][9]) == 0.0
    assert any("1 value of command just outside the possible range" in note and "row 7)" in note for note in fit.notes)
    assert any("1 value of m_w just outside the possible range" in note and "row 11)" in note for note in fit.notes)
    assert "command = 1.2" in refusal(fc.fit_valve, valve_log(change_cell(valve_rows(), 5, 1, "1.2")))


def test_lines_without_content_are_no_rows(valve_log):
    rows = valve_rows()
    with_blanks = [*rows[:30], ["", "", ""], *rows[30:], [" ", "", ""], []]
    fit = fc.fit_valve(valve_log(with_blanks))
    assert fit.parameters == fc.fit_valve(valve_log(rows)).parameters
    assert int(fit.residuals["row"][30]) == 33
