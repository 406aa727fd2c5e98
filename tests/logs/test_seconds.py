"""Samples on 1-s steps: held or on straight lines, and times with round-off."""

import numpy as np
import pytest
from helpers.refusals import only_problem

from fastcoil.logs.pieces import at_seconds, require_whole_seconds

TIME = np.array([0.0, 4.0, 6.0])


def test_held_series_keep_their_value_and_others_run_straight():
    values = {"T_set": np.array([14.0, 15.0, 13.0]), "T_a_in": np.array([20.0, 24.0, 23.0])}
    found = at_seconds(TIME, values, np.arange(7.0), hold=["T_set"])
    assert list(found) == list(values)
    np.testing.assert_array_equal(found["T_set"], [14, 14, 14, 14, 15, 15, 13])
    np.testing.assert_array_equal(found["T_a_in"], [20, 21, 22, 23, 24, 23.5, 23])


def test_a_sample_late_by_round_off_counts_for_its_second():
    late = {"T_set": np.array([14.0, 15.0, 13.0])}
    time = TIME + np.array([0.0, 5e-7, 0.0])
    assert at_seconds(time, late, np.array([4.0]), hold=["T_set"])["T_set"] == 14.0
    assert at_seconds(time, late, np.array([4.0]), hold=["T_set"], slack=1e-6)["T_set"] == 15.0


@pytest.mark.parametrize("step", [0.999, 1.0, 60.0])
def test_steps_of_a_second_or_more_are_accepted(step):
    require_whole_seconds("log.csv", step)


def test_shorter_steps_are_refused():
    message = only_problem(require_whole_seconds, "log.csv", 0.5)
    assert message == "log.csv: the rows are 0.5 s apart: thin or average the log to 1 s or more"
