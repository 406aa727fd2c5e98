"""The options of ``read_log``, and cures that suit the caller."""

import numpy as np
from helpers.refusals import only_problem, problems

from fastcoil.logs import Reading, read_log
from fastcoil.logs.columns import Wanted
from fastcoil.logs.series import HUMIDITIES

HEADER = ["elapsed_time [s]", "m_a [kg/s]", "T_a_in [degC]"]
ROWS = [[0, 1.0, 25.0], [60, 1.2, 25.5], [120, 1.1, 26.0], [180, 1.3, 25.5]]
WANTED = Wanted(needed=("m_a", "T_a_in"), optional=("enabled",))


def test_known_columns_that_are_not_wanted_are_ignored_and_a_column_beside_its_constant_is_refused(write):
    path = write([*HEADER, "T_set [degC]"], [[*row, 14.0] for row in ROWS])
    assert "T_set" not in read_log(path, WANTED).values
    message = only_problem(read_log, path, WANTED, Reading(constants={"m_a": 9.0}))
    assert "m_a and constant m_a are both given: leave one out" in message


# ----------------------------------------------------------------------------------------------------------- unbroken


def test_gaps_and_batches_make_pieces_or_are_refused(write):
    gap = write(HEADER, [*ROWS, [999, 1.0, 25.0]], "gap.csv")
    log = read_log(gap, WANTED)
    np.testing.assert_array_equal(log.batch, [0, 0, 0, 0, 1])
    assert any("1 gap in time (first: 819 s between rows 5 and 6)" in note for note in log.notes)
    message = only_problem(read_log, gap, WANTED, Reading(unbroken=True))
    assert "rows 5 and 6 are 819 s apart, others 60 s" in message
    assert "max_gap=819" in message
    assert read_log(gap, WANTED, Reading(unbroken=True, max_gap=819)).n_batches == 1
    batches = write([*HEADER, "batch"], [[*row, i // 2] for i, row in enumerate(ROWS)], "batches.csv")
    assert read_log(batches, WANTED).n_batches == 2
    message = only_problem(read_log, batches, WANTED, Reading(unbroken=True))
    assert "rows 3 and 4 are of two batches" in message


# -------------------------------------------------------------------------------------------------- cures that suit


def test_options_of_a_command_are_named_only_where_there_is_one(write):
    path = write(["t [s]", "m_a", "T_a_in [degC]"], ROWS)
    plain = "\n".join(problems(read_log, path, WANTED, Reading(constants={})))
    assert "--" not in plain
    assert "columns={'elapsed_time': 'its header'}" in plain
    both = "\n".join(problems(read_log, path, WANTED, Reading(constants={}, has_command=True)))
    assert "columns={'elapsed_time': 'its header'}, --column elapsed_time='its header'" in both
    unit = write(["elapsed_time [s]", "m_a", "T_a_in [degC]"], ROWS)
    assert "units={'m_a': 'UNIT'} (" in only_problem(read_log, unit, WANTED)
    assert "units={'m_a': 'UNIT'}, --unit m_a='UNIT' (" in only_problem(
        read_log, unit, WANTED, Reading(has_command=True)
    )


def test_a_constant_is_suggested_only_where_it_can_be_given(write):
    wanted = Wanted(needed=("m_a", "T_a_in", HUMIDITIES, "T_sup"))
    path = write(HEADER, ROWS)
    humidity, supply = problems(read_log, path, wanted, Reading(constants={}, has_command=True))
    assert "W_a_in or RH_a_in or T_dp_in is missing" in humidity
    assert "constants={'W_a_in': NUMBER}, --constant W_a_in=NUMBER" in humidity
    assert "constant" not in supply  # what a sensor should show is no constant
    assert "constant" not in problems(read_log, path, wanted, Reading(has_command=True))[0]
