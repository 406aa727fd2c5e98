"""Logs beyond all bounds: too many cells, columns, seconds, and texts without end get short sentences."""

import time

import pytest
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.logs import table as layout

HEADER = ["elapsed_time [s]", "m_a [kg/s]", "T_a_in [degC]", "W_a_in", "T_w_in [degC]", "T_set [degC]"]
ROW = [1.1, 25, 0.01, 7, 14]
UNIT = {"units": {"W_a_in": "1"}}


def test_a_time_a_million_times_too_large_is_refused_before_it_fills_the_memory(write_log):
    path = write_log(HEADER, [[60e6 * k, *ROW] for k in range(160)])
    start = time.monotonic()
    assert_refused("log.csv", "size", fc.Boundary.from_csv, path, **UNIT)
    assert time.monotonic() - start < 5.0


@pytest.mark.parametrize("time_of_last", ["1e308", "-1e308", "1e11"])
def test_a_time_beyond_three_centuries_is_refused(write_log, time_of_last):
    path = write_log(HEADER, [[0, *ROW], [60, *ROW], [time_of_last, *ROW]])
    with pytest.raises(fc.InputError, match="must be from -1e\\+10 to 1e\\+10 s; check its unit") as raised:
        fc.Boundary.from_csv(path, **UNIT)
    assert (raised.value.field, raised.value.code) == ("elapsed_time", "value")


def test_a_number_that_overflows_in_our_unit_is_refused(write_log):
    rows = [[60 * k, 1.1, "1.7e308", *ROW[2:]] for k in range(3)]
    path = write_log([*HEADER[:2], "T_a_in [degF]", *HEADER[3:]], rows)
    assert_refused("T_a_in", "value", fc.Boundary.from_csv, path, **UNIT)
    path = write_log(["elapsed_time [h]", *HEADER[1:]], [["1e306", *ROW], ["1.7e308", *ROW]])
    assert_refused("elapsed_time", "value", fc.Boundary.from_csv, path, **UNIT)


def test_too_many_cells_are_refused_while_they_are_read(write_log, monkeypatch):
    monkeypatch.setattr(layout, "_MAX_CELLS", 100)
    path = write_log(HEADER, [[60 * k, *ROW] for k in range(100)])
    assert_refused(str(path), "size", fc.Boundary.from_csv, path)
