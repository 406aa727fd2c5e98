"""What both fits refuse of their arguments and of logs that show nothing."""

import numpy as np
import pytest
from helpers.log_files import coil_rows, valve_rows
from helpers.refusals import refusal
from helpers.simulated_logs import make_valve_log

import fastcoil as fc

pytestmark = pytest.mark.kernel


class FitStarted(Exception):
    """The fit would begin."""


def test_a_valve_that_stands_still_a_flat_flow_a_short_log_and_another_unit_are_refused(valve_log):
    for changed, words in (
        ([[t, "0.5", m] for t, _, m in valve_rows()], "command is 0.5 from row 2 to row 61"),
        ([[t, c, "1.0"] for t, c, _ in valve_rows()], "m_w is 1 from row"),
        (valve_rows(12), "at least 20"),
        ([[t, float(c) / 100, m] for t, c, m in valve_rows()], "command is never above 0.0"),
    ):
        assert words in refusal(fc.fit_valve, valve_log(changed))


def test_a_dead_sensor_and_a_dry_pipe_are_refused(coil_log):
    for column, value, words in ((6, 15.0, "T_sup is 15"), (1, 0.0, "m_w is 0"), (2, 0.0, "m_a is 0")):
        rows = [[*r[:column], value, *r[column + 1 :]] for r in coil_rows()]
        assert f"{words} throughout" in refusal(fc.fit_coil, coil_log(rows))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"split": 2.0}, "split = 2.0: give the share to fit, above 0 and at most 1"),
        ({"m_max": "2"}, "m_max = '2': give a flow above 0 kg/s"),
        ({"m_max": 0.1}, "m_max = 0.1 kg/s: valve.csv has flows up to"),
        ({"jumps": "x"}, "jumps = 'x'"),
        ({"columns": ["m_w"]}, "columns = ['m_w']: give a mapping of names, such as {'m_w': 'its header'}"),
    ],
)
def test_bad_arguments_of_a_valve_are_refused(valve_log, options, words):
    assert words in refusal(fc.fit_valve, valve_log(valve_rows()), **options)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"warm_up": "2"}, "warm_up = '2': give a number of seconds, 0 or more"),
        ({"T_initial": "x"}, "T_initial = 'x': give a number (from 0 to 50)"),
        ({"n_volumes": [4, 8]}, "n_volumes = [4, 8]: give one value"),
        ({"minimise_on": ["T_sup"]}, "minimise_on = ['T_sup']: choose 'T_sup' or 'both'"),
        (
            {"holds": "m_x"},
            "holds = 'm_x', did you mean 'm_w'?: choose 'm_w', 'm_a', 'T_w_in', 'T_a_in', 'W_a_in', 'RH_a_in' "
            "or 'T_dp_in'",
        ),
        ({"constants": {"T_w_out": "x"}}, "coil.csv: constants has T_w_out = 'x': give a number from 0.1 to 150 degC"),
    ],
)
def test_bad_arguments_of_a_coil_are_refused(coil_log, options, sentence):
    assert refusal(fc.fit_coil, coil_log(coil_rows()), **options) == sentence


def test_pieces_of_a_row_or_two_are_refused_and_a_log_that_goes_back_now_and_then_is_not(monkeypatch):
    def solve(*_):
        raise FitStarted

    monkeypatch.setattr("fastcoil.measured.valve_problem.ValveProblem.solve", solve)
    time = 10.0 * np.arange(240)
    command = 0.5 + 0.4 * np.sin(time / 100.0)
    log = make_valve_log(command, 2.0 * command**2, 10.0)

    def at(time):
        return log.assign_coords(elapsed_time=("elapsed_time", time, {"units": "s"}))

    words = "its 240 rows are in 120 pieces.*at least 3 rows for each.*max_gap"
    with pytest.raises(fc.InputError, match=words):
        fc.fit_valve(at(time + 500.0 * (np.arange(240) // 2)), max_gap=100.0)
    reversed_log = at(time[::-1])
    for logs in ({"log": reversed_log}, {"log": log, "validation": reversed_log}):
        with pytest.raises(fc.InputError, match="sort the rows, oldest first"):
            fc.fit_valve(**logs, jumps="split")
    with pytest.raises(FitStarted):
        fc.fit_valve(at(time - 3600.0 * (np.arange(240) > 120)), jumps="split")


def test_a_pump_that_is_off_by_declaration_is_not_compared():
    rng = np.random.default_rng(3)
    rows = np.array(valve_rows(200), dtype=float)
    flow, enabled = rows[:, 2].copy(), np.ones(200)
    enabled[60:80] = 0.0
    flow[60:80] = rng.uniform(0, 2, 20)
    fit = fc.fit_valve(make_valve_log(rows[:, 1], flow, enabled=enabled))
    assert fit.parameters["backlash"] == pytest.approx(0.07, abs=1e-3)
    assert "20 flows not compared: enabled is 0" in fit.notes
