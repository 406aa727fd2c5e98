"""What both fits refuse of their arguments and of logs that show nothing."""

import numpy as np
import pytest
from helpers.log_files import coil_rows, valve_rows
from helpers.refusals import assert_mistakes, assert_refused
from helpers.simulated_logs import make_valve_log

import fastcoil as fc

pytestmark = pytest.mark.kernel


class FitStarted(Exception):
    """The fit would begin."""


@pytest.mark.parametrize(
    ("change", "mistakes"),
    [
        (lambda rows: [[t, "0.5", m] for t, _, m in rows], [("command", "data")]),
        (lambda rows: [[t, c, "1.0"] for t, c, _ in rows], [("m_w", "data")]),
        (lambda rows: rows[:12], [("log", "data")]),
        (lambda rows: [[t, float(c) / 100, m] for t, c, m in rows], [("command", "unit")]),
    ],
    ids=["still", "flat", "short", "percent"],
)
def test_a_log_that_shows_nothing_of_its_valve_is_refused(valve_log, change, mistakes):
    assert_mistakes(mistakes, fc.fit_valve, valve_log(change(valve_rows())))


def test_a_dead_sensor_and_a_dry_pipe_are_refused(coil_log):
    for column, value, name in ((6, 15.0, "T_sup"), (1, 0.0, "m_w"), (2, 0.0, "m_a")):
        rows = [[*r[:column], value, *r[column + 1 :]] for r in coil_rows()]
        assert_refused(name, "data", fc.fit_coil, coil_log(rows))


def test_bad_arguments_are_refused(valve_log, coil_log):
    valve, coil = valve_log(valve_rows()), coil_log(coil_rows())
    assert_refused("split", "value", fc.fit_valve, valve, split=2.0)
    assert_refused("m_max", "type", fc.fit_valve, valve, m_max="2")
    assert_refused("m_max", "conflict", fc.fit_valve, valve, m_max=0.1)
    assert_refused("warm_up", "type", fc.fit_coil, coil, warm_up="2")
    assert_refused("n_volumes", "value", fc.fit_coil, coil, n_volumes=[4, 8])
    assert_refused("holds", "choice", fc.fit_coil, coil, holds="m_x")


def test_pieces_of_a_row_or_two_are_refused_and_a_log_that_goes_back_now_and_then_is_not(monkeypatch):
    def solve(*_):
        raise FitStarted

    monkeypatch.setattr("fastcoil.measured.valve_problem.ValveProblem.solve", solve)
    time = 10.0 * np.arange(240)
    command = 0.5 + 0.4 * np.sin(time / 100.0)
    log = make_valve_log(command, 2.0 * command**2, 10.0)

    def at(time):
        return log.assign_coords(elapsed_time=("elapsed_time", time, {"units": "s"}))

    assert_refused("log", "time", fc.fit_valve, fc.read_log(at(time + 500.0 * (np.arange(240) // 2)), max_gap=100.0))
    backwards = fc.read_log(at(time[::-1]), jumps="split")
    assert_refused("elapsed_time", "time", fc.fit_valve, backwards)
    with pytest.raises(FitStarted):
        fc.fit_valve(fc.read_log(at(time - 3600.0 * (np.arange(240) > 120)), jumps="split"))


def test_a_pump_that_is_off_by_declaration_is_not_compared():
    rows = np.array(valve_rows(200), dtype=float)
    flow, enabled = rows[:, 2].copy(), np.ones(200)
    enabled[60:80] = 0.0
    flow[60:80] = np.random.default_rng(3).uniform(0, 2, 20)
    fit = fc.fit_valve(make_valve_log(rows[:, 1], flow, enabled=enabled))
    assert fit.parameters["backlash"] == pytest.approx(0.07, abs=1e-3)
    assert "20 flows not compared: enabled is 0" in fit.notes
