"""Logs beyond all bounds: too many cells, columns, seconds, and texts without end get short sentences."""

import time

import pytest
from helpers.refusals import only_problem, problems

import fastcoil as fc
from fastcoil.logs import table as layout

HEADER = ["elapsed_time [s]", "m_a [kg/s]", "T_a_in [degC]", "W_a_in", "T_w_in [degC]", "T_set [degC]"]
ROW = [1.1, 25, 0.01, 7, 14]
UNIT = {"units": {"W_a_in": "1"}}


def test_a_time_a_million_times_too_large_is_refused_before_it_fills_the_memory(write_log):
    path = write_log(HEADER, [[60e6 * k, *ROW] for k in range(160)])
    start = time.monotonic()
    problem = only_problem(fc.Boundary.from_csv, path, **UNIT)
    assert problem == (
        "log.csv lasts 9,540,000,000 s from the first row to the last: at most 50,000,000 s can be read, "
        "check the unit of the time, or give hours"
    )
    assert time.monotonic() - start < 5.0


@pytest.mark.parametrize("time_of_last", ["1e308", "-1e308", "1e11"])
def test_a_time_beyond_three_centuries_is_refused(write_log, time_of_last):
    path = write_log(HEADER, [[0, *ROW], [60, *ROW], [time_of_last, *ROW]])
    assert "must be from -1e+10 to 1e+10 s; check its unit" in problems(fc.Boundary.from_csv, path, **UNIT)[0]


def test_a_number_that_overflows_in_our_unit_is_refused(write_log):
    path = write_log(
        [*HEADER[:2], "T_a_in [degF]", *HEADER[3:]], [[60 * k, 1.1, "1.7e308", *ROW[2:]] for k in range(3)]
    )
    assert "T_a_in = 1.7e+308 degF in row 2" in only_problem(fc.Boundary.from_csv, path, **UNIT)
    path = write_log(["elapsed_time [h]", *HEADER[1:]], [["1e306", *ROW], ["1.7e308", *ROW]])
    assert "elapsed_time = 1e+306 h in row 2: must be from" in only_problem(fc.Boundary.from_csv, path, **UNIT)


def test_too_many_cells_are_refused_while_they_are_read(write_log, monkeypatch):
    monkeypatch.setattr(layout, "_MAX_CELLS", 100)
    path = write_log(HEADER, [[60 * k, *ROW] for k in range(100)])
    assert "has more than 100 cells: leave out columns, or cut it into parts" in only_problem(
        fc.Boundary.from_csv, path
    )
