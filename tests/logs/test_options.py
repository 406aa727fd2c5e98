"""The options of ``read_checked_log``, and cures that suit the caller."""

import numpy as np
from helpers.refusals import only_problem, problems

from fastcoil.logs import ReadingOptions, read_checked_log
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.series import HUMIDITY_COLUMNS

HEADER = ["elapsed_time [s]", "m_a [kg/s]", "T_a_in [degC]"]
ROWS = [[0, 1.0, 25.0], [60, 1.2, 25.5], [120, 1.1, 26.0], [180, 1.3, 25.5]]
WANTED = ColumnSpec(required=("m_a", "T_a_in"), optional=("enabled",))


def test_known_columns_that_are_not_wanted_are_ignored_and_a_column_beside_its_constant_is_refused(write_log):
    path = write_log([*HEADER, "T_set [degC]"], [[*row, 14.0] for row in ROWS])
    assert "T_set" not in read_checked_log(path, WANTED).values
    message = only_problem(read_checked_log, path, WANTED, ReadingOptions(constants={"m_a": 9.0}))
    assert "m_a and constant m_a are both given: leave one out" in message


# ----------------------------------------------------------------------------------------------------------- unbroken


def test_gaps_and_batches_make_pieces_or_are_refused(write_log):
    gap = write_log(HEADER, [*ROWS, [999, 1.0, 25.0]], "gap.csv")
    log = read_checked_log(gap, WANTED)
    np.testing.assert_array_equal(log.batch, [0, 0, 0, 0, 1])
    assert any("1 gap in time (first: 819 s between rows 5 and 6)" in note for note in log.notes)
    message = only_problem(read_checked_log, gap, WANTED, ReadingOptions(refuse_gaps=True))
    assert "rows 5 and 6 are 819 s apart, others 60 s" in message
    assert "max_gap=819" in message
    assert read_checked_log(gap, WANTED, ReadingOptions(refuse_gaps=True, max_gap=819)).n_batches == 1
    batches = write_log([*HEADER, "batch"], [[*row, i // 2] for i, row in enumerate(ROWS)], "batches.csv")
    assert read_checked_log(batches, WANTED).n_batches == 2
    message = only_problem(read_checked_log, batches, WANTED, ReadingOptions(refuse_gaps=True))
    assert "rows 3 and 4 are of two batches" in message


# -------------------------------------------------------------------------------------------------- cures that suit


def test_options_of_a_command_are_named_only_where_there_is_one(write_log):
    path = write_log(["t [s]", "m_a", "T_a_in [degC]"], ROWS)
    python_problems = "\n".join(problems(read_checked_log, path, WANTED, ReadingOptions(constants={})))
    assert "--" not in python_problems
    assert "columns={'elapsed_time': 'its header'}" in python_problems
    command_problems = "\n".join(
        problems(read_checked_log, path, WANTED, ReadingOptions(constants={}, reader="read_log"))
    )
    assert "columns={'elapsed_time': 'its header'}, --column elapsed_time='its header'" in command_problems
    unit = write_log(["elapsed_time [s]", "m_a", "T_a_in [degC]"], ROWS)
    assert "units={'m_a': 'UNIT'} (" in only_problem(read_checked_log, unit, WANTED)
    assert "units={'m_a': 'UNIT'}, --unit m_a='UNIT' (" in only_problem(
        read_checked_log, unit, WANTED, ReadingOptions(reader="read_log")
    )


def test_a_constant_is_suggested_only_where_it_can_be_given(write_log):
    spec = ColumnSpec(required=("m_a", "T_a_in", HUMIDITY_COLUMNS, "T_sup"))
    path = write_log(HEADER, ROWS)
    humidity, supply = problems(read_checked_log, path, spec, ReadingOptions(constants={}, reader="read_log"))
    assert "W_a_in or RH_a_in or T_dp_in is missing" in humidity
    assert "constants={'W_a_in': NUMBER}, --constant W_a_in=NUMBER" in humidity
    assert "constant" not in supply  # what a sensor should show is no constant
    assert "constant" not in problems(read_checked_log, path, spec, ReadingOptions(reader="read_log"))[0]
