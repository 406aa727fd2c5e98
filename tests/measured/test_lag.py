"""A time shift between the columns of a log is told and taken out; logs without one are left as they are."""

import numpy as np
import pytest
from helpers.full import full_except
from helpers.refusals import assert_refused
from helpers.simulated_logs import VALVE_TRUTH, add_noise, ar1_noise, make_valve_log, random_walk, valve_flows

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.logs.columns import ColumnSpec
from fastcoil.measured.fit_valve import delay_command, remove_lag

pytestmark = pytest.mark.kernel


def log_in_pieces(seed, shifts, n=60, sd=0.03, backlash=0.07):
    """Batches of ``n`` rows of a valve, the flow of each logged so many rows late."""
    rng = np.random.default_rng(seed)
    commands, logged = [], []
    for shift in shifts:
        command = random_walk(rng, n=n + 40)
        flow = valve_flows(command, start=rng.uniform(), backlash=backlash) + ar1_noise(rng, n + 40, sd, 0.5)
        commands.append(command[20 : n + 20])
        logged.append(np.maximum(flow[20 - shift : n + 20 - shift], 1e-3))
    batch = np.repeat(np.arange(float(len(shifts))), n)
    return make_valve_log(np.concatenate(commands), np.concatenate(logged), batch=batch)


def to_checked_log(log):
    """The same as a checked log, all of it fitted."""
    checked_log = read_checked_log(log, ColumnSpec(("command", "m_w")))
    return checked_log, np.ones(checked_log.time.size, dtype=bool)


def test_a_shift_from_one_piece_on_is_told_and_taken_out():
    log = log_in_pieces(1, [0, 0, 1, 1], n=80)
    fit = fc.fit_valve(log, split=1.0, holds="command")
    low, high = fit.intervals["backlash"]
    assert low <= VALVE_TRUTH["backlash"] <= high
    assert high - low < 0.04
    words = "from row 160 (piece 3 of 4) to row 319 the flow is logged 1 sample (60 s) after the command"
    assert any(note.startswith(words) for note in fit.notes)
    left = fc.fit_valve(log, split=1.0, lag=0, m_max=2.0, holds="command")
    assert not any("logged" in note for note in left.notes)
    assert left.rmse["fit"] > 2.0 * fit.rmse["fit"]


def test_what_is_held_back_is_moved_like_the_last_piece_that_is_fitted():
    """Its own flows, logged at once, do not say so."""
    logs = (log_in_pieces(1, [0, 1, 1, last_shift], n=80) for last_shift in (1, 0))
    late, in_time = (fc.fit_valve(log, split=0.75, holds="command") for log in logs)
    assert late.parameters == in_time.parameters
    assert late.rmse["validation"] < 1.3 * late.rmse["fit"] < 0.5 * in_time.rmse["validation"]
    words = "from row 80 (piece 2 of 4) to row 319 the flow is logged 1 sample"
    assert any(note.startswith(words) for note in in_time.notes)


SHIFTS = [(1, "auto"), (-1, "auto"), (0, "auto"), (1, 60.0), (0, -60.0)]


@pytest.mark.parametrize(("shift", "lag"), full_except(SHIFTS, [(-1, "auto")]))
def test_nothing_that_is_held_back_changes_a_bit_of_the_fit(shift, lag):
    """Neither flows nor commands, also where a flow is logged before its command and that one is held back."""
    log, other_log = (log_in_pieces(seed, [shift], n=300) for seed in (7, 8))
    for name in ("command", "m_w"):
        other_log[name][:180] = log[name][:180]
    fit_1, fit_2 = (fc.fit_valve(data, split=0.6, lag=lag, holds="command") for data in (log, other_log))
    for name in ("parameters", "intervals", "standard_errors", "held", "n_used", "n_effective"):
        assert getattr(fit_1, name) == getattr(fit_2, name), name
    assert fit_1.rmse["fit"] == fit_2.rmse["fit"]
    assert fit_1.profile.identical(fit_2.profile)
    assert fit_1.rmse["validation"] != fit_2.rmse["validation"]
    for fit in (fit_1, fit_2):
        is_noted = any(note.startswith("throughout the flow is logged 1 sample") for note in fit.notes)
        assert is_noted == (lag == "auto" and shift != 0)


@pytest.mark.parametrize(
    ("shift", "words"),
    [(2, "2 samples (120 s) after the command"), (-1, "1 sample (60 s) before the command")],
)
def test_a_shift_throughout_is_found_in_either_direction(shift, words):
    log, all_of_it = to_checked_log(log_in_pieces(2, [shift] * 4))
    shifted = remove_lag(log, all_of_it, all_of_it)
    assert [note for note in shifted.notes if note.startswith(f"throughout the flow is logged {words}")]
    np.testing.assert_array_equal(shifted.values["command"], delay_command(log, 60.0 * shift)[0])


def test_no_shift_is_found_where_there_is_none():
    """Clean logs of four kinds, white and autocorrelated noise up to 0.1 kg/s, backlash or none: none is moved."""
    for seed in range(8):
        rng = np.random.default_rng(3000 + seed)
        backlash = (0.0, 0.05, 0.12)[seed % 3]
        command = (random_walk(rng, n=240), 0.5 + 0.3 * np.sin(np.arange(240) / 8.0),
                   np.repeat(rng.uniform(0, 1, 24), 10),
                   np.clip(0.5 + np.cumsum(rng.normal(0.0, 0.03, 240)), 0.05, 0.95))[seed % 4]  # fmt: skip
        flow = add_noise(rng, valve_flows(command, backlash=backlash), (0.02, 0.1)[seed % 2], (0.0, 0.9)[seed // 2 % 2])
        log, all_of_it = to_checked_log(make_valve_log(command, flow, batch=np.arange(240) // (80, 12)[seed // 4]))
        assert remove_lag(log, all_of_it, all_of_it) is log, seed


def test_a_given_lag_is_taken_as_it_is():
    log = log_in_pieces(4, [2, 2, 2])
    fit = fc.fit_valve(log, split=1.0, lag=np.float32(120.0), holds="command")
    assert "the flow is compared with the command 120 s before it, as given" in fit.notes
    assert fit.parameters["backlash"] == pytest.approx(VALVE_TRUTH["backlash"], abs=0.01)
    assert (fit.residuals["part"].values[:2] == "unused").all()  # no row says what the command was
    for wrong in ("later", True, 1e9, [60.0]):
        assert_refused("lag", "value" if wrong == 1e9 else "type", fc.fit_valve, log, lag=wrong)


def test_the_shift_of_the_part_to_fit_does_not_depend_on_what_follows():
    log = log_in_pieces(5, [0, 1, 1, 0, 0])
    fitting = np.arange(300) < 180
    log_1, good = to_checked_log(log)
    log_2, _ = to_checked_log(log_in_pieces(5, [0, 1, 1, 3, -2], sd=0.3))
    for name in ("command", "m_w"):
        log_2.values[name][:180] = log_1.values[name][:180]
    command_1, command_2 = (remove_lag(a, good, fitting).values["command"][:180] for a in (log_1, log_2))
    np.testing.assert_array_equal(command_1, command_2)
