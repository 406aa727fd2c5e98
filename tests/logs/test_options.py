"""The options of ``read_checked_log``, and cures that suit the caller."""

import numpy as np
import pytest
from helpers.refusals import assert_mistakes, assert_refused

from fastcoil.logs import ReadingOptions, read_checked_log
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.series import HUMIDITY_COLUMNS

HEADER = ["elapsed_time [s]", "m_a [kg/s]", "T_a_in [degC]"]
ROWS = [[0, 1.0, 25.0], [60, 1.2, 25.5], [120, 1.1, 26.0], [180, 1.3, 25.5]]
WANTED = ColumnSpec(required=("m_a", "T_a_in"), optional=("enabled",))


def test_known_columns_that_are_not_wanted_are_ignored_and_a_column_beside_its_constant_is_refused(write_log):
    path = write_log([*HEADER, "T_set [degC]"], [[*row, 14.0] for row in ROWS])
    assert "T_set" not in read_checked_log(path, WANTED).values
    assert_refused("m_a", "conflict", read_checked_log, path, WANTED, ReadingOptions(constants={"m_a": 9.0}))


# ----------------------------------------------------------------------------------------------------------- unbroken


def test_gaps_and_batches_make_pieces_or_are_refused(write_log):
    gap = write_log(HEADER, [*ROWS, [999, 1.0, 25.0]], "gap.csv")
    log = read_checked_log(gap, WANTED)
    np.testing.assert_array_equal(log.batch, [0, 0, 0, 0, 1])
    assert any("1 gap in time (first: 819 s between rows 5 and 6)" in note for note in log.notes)
    assert_refused("elapsed_time", "time", read_checked_log, gap, WANTED, ReadingOptions(refuse_gaps=True))
    assert read_checked_log(gap, WANTED, ReadingOptions(refuse_gaps=True, max_gap=819)).n_batches == 1
    batches = write_log([*HEADER, "batch"], [[*row, i // 2] for i, row in enumerate(ROWS)], "batches.csv")
    assert read_checked_log(batches, WANTED).n_batches == 2
    assert_refused("batch", "time", read_checked_log, batches, WANTED, ReadingOptions(refuse_gaps=True))


# -------------------------------------------------------------------------------------------------- cures that suit


@pytest.mark.parametrize("reader", ["function", "read_log"])
def test_options_of_a_command_are_named_only_where_there_is_one(write_log, reader):
    path = write_log(["t [s]", "m_a", "T_a_in [degC]"], ROWS)
    options = ReadingOptions(constants={}, reader=reader)
    error = assert_mistakes([("t [s]", "name"), ("elapsed_time", "missing")], read_checked_log, path, WANTED, options)
    assert ("--column" in str(error)) == ("fc.read_log" in str(error)) == (reader == "read_log")
    unit = write_log(["elapsed_time [s]", "m_a", "T_a_in [degC]"], ROWS)
    error = assert_refused("m_a", "unit", read_checked_log, unit, WANTED, ReadingOptions(reader=reader))
    assert ("--unit" in str(error)) == (reader == "read_log")


def test_a_constant_is_suggested_only_where_it_can_be_given(write_log):
    spec = ColumnSpec(required=("m_a", "T_a_in", HUMIDITY_COLUMNS, "T_sup"))
    path, mistakes = write_log(HEADER, ROWS), [("W_a_in", "missing"), ("T_sup", "missing")]
    for constants, has_hint in (({}, True), (None, False)):
        options = ReadingOptions(constants=constants, reader="read_log")
        humidity, supply = assert_mistakes(mistakes, read_checked_log, path, spec, options).problems
        assert ("constant" in humidity) is has_hint
        assert "constant" not in supply  # what a sensor should show is no constant
