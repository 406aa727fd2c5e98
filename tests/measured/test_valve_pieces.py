"""Logs of a valve in many pieces: those that are no record in time are refused at once, before any work."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from fastcoil.measured.valve_problem import ValveProblem


class Solved(Exception):
    """The fit would begin."""


@pytest.fixture(autouse=True)
def no_work(monkeypatch):
    def solve(*_):
        raise Solved

    monkeypatch.setattr(ValveProblem, "solve", solve)


def log(time, batch=None):
    """A log of a valve that opens and closes, at these times, s."""
    command = 0.5 + 0.4 * np.sin(np.asarray(time) / 100.0)
    columns = {"command": (command, "1"), "m_w": (2.0 * command**2, "kg s-1")}
    variables = {name: ("elapsed_time", values, {"units": unit}) for name, (values, unit) in columns.items()}
    if batch is not None:
        variables["batch"] = ("elapsed_time", batch)
    return xr.Dataset(variables, {"elapsed_time": ("elapsed_time", time, {"units": "s"})})


FORWARD = 10.0 * np.arange(240)


@pytest.mark.parametrize("n", [120, 240])
def test_a_reversed_log_is_refused_at_once_with_the_cure(n):
    with pytest.raises(fc.InputError) as caught:
        fc.fit_valve(log(FORWARD[:n][::-1]), jumps="split")
    (sentence,) = caught.value.problems
    assert sentence.endswith(
        f"time goes back after {n - 1} of {n} rows: the log looks reversed, newest row first; sort its rows, oldest "
        "first"
    )
    with pytest.raises(fc.InputError, match="looks reversed"):
        fc.fit_valve(log(FORWARD), validation=log(FORWARD[::-1]), jumps="split")


def test_pieces_of_a_row_or_two_are_refused():
    pairs = FORWARD + 500.0 * (np.arange(240) // 2)
    with pytest.raises(fc.InputError, match="its 240 rows are in 120 pieces.*at least 3 rows for each.*max_gap"):
        fc.fit_valve(log(pairs), max_gap=100.0)


def test_a_log_that_goes_back_now_and_then_is_fitted():
    with pytest.raises(Solved):
        fc.fit_valve(log(FORWARD - 3600.0 * (np.arange(240) > 120)), jumps="split")


def test_a_fit_of_many_pieces_says_that_it_takes_minutes():
    with pytest.warns(UserWarning, match="is in 60 pieces, .*this takes minutes"), pytest.raises(Solved):
        fc.fit_valve(log(FORWARD, np.arange(240) // 4))
