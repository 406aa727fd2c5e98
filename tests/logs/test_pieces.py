"""Samples on 1-s steps, logs of changes, and the pieces between gaps."""

import numpy as np
import pytest
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.logs import ReadingOptions, read_checked_log
from fastcoil.logs.columns import ColumnSpec
from fastcoil.logs.pieces import require_whole_seconds, resample_at_seconds
from fastcoil.measured.fit_coil import build_record

TIME = np.array([0.0, 4.0, 6.0])


def test_held_series_keep_their_value_and_others_run_straight():
    values = {"T_set": np.array([14.0, 15.0, 13.0]), "T_a_in": np.array([20.0, 24.0, 23.0])}
    resampled = resample_at_seconds(TIME, values, np.arange(7.0), hold=["T_set"])
    assert list(resampled) == list(values)
    np.testing.assert_array_equal(resampled["T_set"], [14, 14, 14, 14, 15, 15, 13])
    np.testing.assert_array_equal(resampled["T_a_in"], [20, 21, 22, 23, 24, 23.5, 23])


def test_steps_of_less_than_a_second_are_refused():
    require_whole_seconds("log.csv", 0.999)
    assert_refused("log.csv", "time", require_whole_seconds, "log.csv", 0.5)


WANTED = ColumnSpec(required=("command", "m_w"), measured=("m_w",))
HEADER = ["elapsed_time [s]", "command [%]", "m_w [kg/s]"]


def change_log_rows(seed=1, hours=8, noise=0.01):
    """Rows of a valve of 9 % backlash, one for each change; looked for every 5 s."""
    rng = np.random.default_rng(seed)
    holds = rng.choice([60, 120, 300, 600, 900], size=2000, p=[0.3, 0.3, 0.2, 0.1, 0.1])
    n = 3600 * hours
    command = np.repeat(rng.uniform(0.1, 0.9, holds.size), holds)[:n]
    q, opening = 0.0, np.empty(n)
    for t, position in enumerate(command):
        q = min(max(q, position - 0.09), position)
        opening[t] = q / 0.91
    flow = 2.0 * (1.0 + 0.7 * np.exp(-9.0 * (opening - 0.38))) ** (-1.0 / 0.7) + rng.normal(0.0, noise, n)
    rows = []
    for t in range(0, n, 5):
        if not rows or abs(100 * command[t] - rows[-1][1]) > 0.1 or abs(flow[t] - rows[-1][2]) > 3 * noise:
            rows.append([t, round(100 * command[t], 1), round(flow[t], 3)])
    return rows


def test_a_log_of_changes_is_one_piece_and_says_so(write_log):
    log = read_checked_log(write_log(HEADER, change_log_rows()), WANTED, ReadingOptions(reader="read_log"))
    steps = np.diff(log.time)
    assert np.sum(steps > 3 * np.median(steps)) > 30  # each of them was a gap
    assert log.n_batches == 1
    assert log.change_of_value
    (note,) = log.notes
    assert note.startswith("rows are 5 to 900 s apart, and each has a change: a log of changes, values hold between")
    assert note.endswith("are no gaps (another limit: fc.read_log(..., max_gap=...), --max-gap)")


def test_max_gap_still_rules(write_log):
    path = write_log(HEADER, change_log_rows())
    assert read_checked_log(path, WANTED, ReadingOptions(max_gap=900)).n_batches == 1
    assert read_checked_log(path, WANTED, ReadingOptions(max_gap=500)).n_batches > 5


def test_an_outage_is_a_gap_of_a_log_of_changes_too(write_log):
    late = [[t + 40_000 * (k > 150), *row] for k, (t, *row) in enumerate(change_log_rows())]
    log = read_checked_log(write_log(HEADER, late), WANTED)
    assert log.n_batches == 2
    assert log.change_of_value


@pytest.mark.parametrize("lost", [0.1, 0.3])
def test_a_log_of_regular_rows_of_which_some_are_lost_is_none(write_log, lost):
    rng = np.random.default_rng(3)
    command = np.repeat(rng.uniform(10, 90, 60), 10)
    rows = [[60 * t, round(c, 1), round(1 + 0.01 * c + rng.normal(0, 0.01), 3)] for t, c in enumerate(command)]
    log = read_checked_log(write_log(HEADER, [row for row in rows if rng.uniform() > lost]), WANTED)
    assert not log.change_of_value
    assert log.n_batches == 1 + np.sum(np.diff(log.time) > 180)


@pytest.mark.parametrize("noise", [0.0, 0.3], ids=["no value changes", "all values change in each row"])
def test_irregular_rows_that_are_not_of_changes_are_none(write_log, noise):
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.choice([5, 20, 90, 600], 200))
    rows = [[t, 50 + noise * rng.normal(), 2 + noise * rng.normal()] for t in times]
    log = read_checked_log(write_log(HEADER, rows), WANTED)
    assert not log.change_of_value
    assert log.n_batches > 1


def test_values_of_a_log_of_changes_hold_in_a_boundary_and_in_a_coil_record(write_log):
    rows = [[t, c / 50, 25, 0.01, 7, 14 + c // 50, c / 50, 15 + c // 50] for t, c, _ in change_log_rows(hours=3)]
    names = ["m_a [kg/s]", "T_a_in [degC]", "W_a_in [1]", "T_w_in [degC]", "T_set [degC]", "m_w [kg/s]", "T_sup [degC]"]
    rows = [row for k, row in enumerate(rows) if k == 0 or row[1:] != rows[k - 1][1:]]
    rows = [[t, *rest[:1], 25 + k % 2, *rest[2:]] for k, (t, *rest) in enumerate(rows)]
    path = write_log([HEADER[0], *names], rows)
    with pytest.warns(UserWarning, match="a log of changes, values hold between rows"):
        day = fc.Boundary.from_csv(path, columns={"T_set": "T_set"})
    latest = np.searchsorted([row[0] for row in rows], np.arange(day.n_steps), side="right") - 1
    np.testing.assert_allclose(day.series["m_a"][0], np.array([row[1] for row in rows])[latest])
    spec = ColumnSpec(required=("m_w", "m_a", "T_w_in", "T_a_in", "W_a_in", "T_sup"), measured=("T_sup",))
    log = read_checked_log(path, spec)
    (piece,) = build_record(log, fc.Loop(), (), np.ones(log.time.size, dtype=bool)).pieces
    np.testing.assert_allclose(piece.series[:, 0], day.series["m_a"][0])
