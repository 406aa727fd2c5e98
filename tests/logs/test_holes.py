"""A missing value costs its cell, not its row: measured ones are left out, single inputs bridged, all counted."""

import numpy as np
import pytest
from helpers.refusals import assert_refused

from fastcoil.logs import ReadingOptions, read_checked_log
from fastcoil.logs.columns import ColumnSpec

WANTED = ColumnSpec(required=("command", "m_a", "T_a_in", "T_sup"), optional=("enabled",), measured=("T_sup",))
HEADER = ["elapsed_time [s]", "command [%]", "m_a [kg/s]", "T_a_in [degC]", "T_sup [degC]", "enabled"]
TIMES = [60 * k for k in range(12)]


def log_rows():
    return [[t, 10 * (k // 3), 1 + 0.1 * k, 25 + k, 14 + 0.5 * k, 1] for k, t in enumerate(TIMES)]


def read(write_log, rows, **options):
    return read_checked_log(write_log(HEADER, rows), WANTED, ReadingOptions(drop=True, reader="read_log", **options))


def assert_equals_complete_log(log, ignored=()):
    """All rows are there with the values of the whole log, but for some columns."""
    assert log.time.tolist() == TIMES
    complete = np.array(log_rows(), dtype=float)
    for k, name in enumerate(("command", "m_a", "T_a_in", "T_sup", "enabled"), 1):
        if name not in ignored:
            np.testing.assert_allclose(log.values[name], complete[:, k] / (100 if name == "command" else 1))


@pytest.mark.parametrize("missing", ["", "nan", "-999", "null"])
def test_a_missing_input_is_bridged_and_its_row_keeps_all_others(write_log, missing):
    rows = log_rows()
    rows[4][2] = rows[7][3] = missing  # both run straight, so that nothing is lost
    log = read(write_log, rows)
    assert_equals_complete_log(log)
    assert log.notes == [
        "1 missing value of m_a bridged: on a straight line between its neighbours (first in row 6)",
        "1 missing value of T_a_in bridged: on a straight line between its neighbours (first in row 9)",
    ]
    assert log.n_batches == 1


def test_commands_and_switches_are_held_over_a_missing_value(write_log):
    rows = log_rows()
    rows[3][1] = rows[5][5] = ""
    log = read(write_log, rows)
    assert_equals_complete_log(log, ignored=("command",))
    assert log.values["command"][2:5].tolist() == [0.0, 0.0, 0.1]
    assert "1 missing value of command bridged: held (first in row 5)" in log.notes


def test_a_missing_measured_value_is_left_out_of_its_column_alone(write_log):
    rows = log_rows()
    rows[4][4] = rows[5][4] = ""
    log = read(write_log, rows)
    assert_equals_complete_log(log, ignored=("T_sup",))
    assert np.flatnonzero(np.isnan(log.values["T_sup"])).tolist() == [4, 5]


@pytest.mark.parametrize(
    ("places", "left"),
    [
        ([(4, 2), (5, 2)], 10),  # two in a row of one column
        ([(0, 2)], 11),  # nothing before it
        ([(11, 2)], 11),  # nothing after it
        ([(4, 2), (5, 3)], 12),  # each alone in its column
        ([(4, 2), (6, 2)], 12),
        ([(4, 0)], 11),  # the time itself
        ([(k, 0) for k in range(2, 12)], 2),
    ],
)
def test_only_a_value_between_two_others_is_bridged(write_log, places, left):
    rows = log_rows()
    for i, k in places:
        rows[i][k] = ""
    assert read(write_log, rows).time.size == left


def test_a_single_row_that_is_left_is_no_log(write_log):
    rows = [[t if k == 0 else "", *row] for k, (t, *row) in enumerate(log_rows())]
    assert_refused("log.csv", "data", read, write_log, rows)


def test_times_begin_at_0_without_round_off(write_log):
    log = read(write_log, [[f"{1000 + 0.1 * k:.1f}", *row[1:]] for k, row in enumerate(log_rows())])
    assert log.time.tolist() == [k / 10 for k in range(12)]


def test_nothing_is_bridged_over_gaps_jumps_and_batches(write_log):
    rows = log_rows()
    rows[4][2] = ""
    late = [[row[0] + 3600 * (k > 4), *row[1:]] for k, row in enumerate(rows)]
    assert read(write_log, late).time.size == 11
    assert read(write_log, late, max_gap=4000).time.size == 12
    assert read(write_log, rows, max_gap=30).time.size == 11
    backward = [[row[0] - 500 * (k > 4), *row[1:]] for k, row in enumerate(rows)]
    assert read(write_log, backward, jumps="split").time.size == 11
    batches = [[*row, k // 5] for k, row in enumerate(rows)]
    assert read_checked_log(write_log([*HEADER, "batch"], batches), WANTED, ReadingOptions(drop=True)).time.size == 11


def test_without_drop_missing_values_are_refused_with_the_cure(write_log):
    rows = log_rows()
    rows[4][2] = ""
    options = ReadingOptions(drop=False, reader="read_log")
    assert_refused("m_a", "value", read_checked_log, write_log(HEADER, rows), WANTED, options)
