"""A log as samples at equal intervals, and the positions of motor and stem."""

import numpy as np
import pytest
from helpers.refusals import assert_refused

from fastcoil.logs import CheckedLog
from fastcoil.logs.own_values import find_own_values
from fastcoil.measured.grid import (
    join_grids,
    keep_own_values,
    logging_increment,
    mean_openings,
    motor_positions,
    openings,
    resample_log,
)


def make_log(time, batch=None, **values):
    time = np.asarray(time, float)
    batch = np.zeros(time.size, np.int64) if batch is None else np.asarray(batch)
    values = {"command": 0.5 + 0.001 * time, "T_sup": 14.0 + 0.01 * time} | values
    return CheckedLog(
        name="a log", time=time,
        values={name: np.asarray(series, float) for name, series in values.items()}, batch=batch,
        rows=np.arange(time.size),
    )  # fmt: skip


def test_a_regular_log_stays_as_it_is():
    grid, notes = resample_log(make_log(np.arange(0, 600, 10)))
    assert (grid.interval, notes) == (10.0, [])
    np.testing.assert_array_equal(grid.time, np.arange(0, 600, 10))
    np.testing.assert_allclose(grid.values["T_sup"], 14.0 + 0.01 * grid.time)
    assert grid.on.all()


def test_jitter_is_moved_and_a_lost_sample_is_missing_while_its_command_holds():
    time = np.delete(np.arange(0, 3000, 10) + np.random.default_rng(1).uniform(-1.5, 1.5, 300), [100, 101])
    command = 0.5 + 0.0001 * np.arange(300)
    grid, _ = resample_log(make_log(time - time[0], command=np.delete(command, [100, 101]), T_sup=np.repeat(14.0, 298)))
    assert grid.interval == 10.0
    assert grid.time.size == 300
    assert list(np.flatnonzero(np.isnan(grid.values["T_sup"]))) == [100, 101]
    np.testing.assert_allclose(grid.values["command"][99:103], command[[99, 99, 99, 102]])


def test_a_log_of_changes_holds_every_value():
    time = np.cumsum(np.random.default_rng(2).integers(1, 25, 200)).astype(float)
    time -= time[0]
    T = 14.0 + np.arange(200)
    grid, notes = resample_log(make_log(time, T_sup=T))
    assert "irregular" in notes[0]
    assert np.isfinite(grid.values["T_sup"]).all()
    tick = round(float(time[40] / grid.interval))
    assert grid.values["T_sup"][tick] == T[np.flatnonzero(np.rint(time / grid.interval) == tick)[-1]]


def test_a_long_silence_is_cut_and_nothing_is_known_in_it():
    time = np.concatenate([np.arange(0, 600, 10), 86400 + np.arange(0, 600, 10)])
    grid, _ = resample_log(make_log(time, batch=np.repeat([0, 1], 60)))
    silent = ~grid.on
    assert 55 <= silent.sum() <= 65
    assert np.isnan(grid.values["command"][silent]).all()
    assert grid.time[-1] == 86400 + 590


def test_pieces_follow_each_other_where_time_goes_back():
    time = np.concatenate([np.arange(0, 600, 10), np.arange(0, 600, 10)])
    grid, _ = resample_log(make_log(time, batch=np.repeat([0, 1], 60)))
    assert np.isfinite(grid.values["T_sup"]).sum() == 120


def test_a_plant_that_is_off_is_told():
    enabled = np.where(np.arange(60) < 30, 1.0, 0.0)
    grid, _ = resample_log(make_log(np.arange(0, 600, 10), enabled=enabled))
    np.testing.assert_array_equal(grid.on, enabled > 0)


def test_a_log_too_short_or_too_long_is_refused():
    assert_refused("log", "data", resample_log, make_log(np.arange(0, 100, 10)))
    assert_refused("log", "size", resample_log, make_log(np.arange(2.1e5) * 1.0))


def test_the_change_that_a_temperature_needs_to_be_logged_is_found():
    walk = 14.0 + np.cumsum(np.random.default_rng(3).normal(0, 0.03, 4000))
    kept, last = [walk[0]], walk[0]
    for value in walk:
        if abs(value - last) >= 0.3:
            kept.append(value)
            last = value
    assert logging_increment(np.array(kept)) == pytest.approx(0.3, abs=0.03)
    assert logging_increment(walk) == 0.0
    assert logging_increment(np.round(walk, 1)) == 0.0


def test_the_motor_runs_to_the_command_no_faster_than_it_can():
    command = np.random.default_rng(3).uniform(0, 1, 60)
    positions = motor_positions(command, 0.1, 1.0)
    at = command[0]
    for k, target in enumerate(command):
        assert positions[k] == at
        at += min(max(target - at, -0.1), 0.1)
    assert positions[-1] == at
    np.testing.assert_array_equal(motor_positions(command, 1.0, 0.0)[1:], command)


@pytest.mark.parametrize("width", [1, 3])
def test_openings_are_means_of_those_of_the_play_operator(width):
    positions = motor_positions(np.random.default_rng(4).uniform(0, 1, 41), 0.1, 1.0)
    sizes = np.array([0.0, 0.07, 0.2])
    means, squares = mean_openings(positions, sizes, width)
    assert means.shape == squares.shape == (41 // width, 3)
    for j, size in enumerate(sizes):
        q, stem = min(max(positions[0] - size / 2, 0), 1 - size), []
        for position in positions:
            q = min(max(q, position - size), position)
            stem.append(q / (1 - size))
        np.testing.assert_allclose(openings(positions, size), stem, atol=1e-14)
        between = [(a + b) / 2 for a, b in zip(stem[:-1], stem[1:], strict=True)]
        for k in range(41 // width):
            piece = between[k * width : (k + 1) * width]
            assert means[k, j] == pytest.approx(sum(piece) / width, abs=1e-14)
            assert squares[k, j] == pytest.approx(sum(o * o for o in piece) / width, abs=1e-14)


def random_walk(n, seed=3):
    return 14.0 + np.cumsum(np.random.default_rng(seed).normal(0.0, 0.05, n))


def poll(series, step, phase=0.0, jitter=0.0, seed=6):
    """A series whose rows repeat the value of the last poll, ``step`` rows apart; and how many polls there were."""
    times = np.arange(phase, series.size, step)
    times = np.sort(times + jitter * step * np.random.default_rng(seed).uniform(-1.0, 1.0, times.size))
    last = np.searchsorted(times, np.arange(series.size), side="right") - 1
    return series[np.clip(times[np.maximum(last, 0)], 0, series.size - 1).astype(int)]


EVERY_ROW = np.ones(3600, bool)


@pytest.mark.parametrize("resolution", [0.0, 0.01, 0.1])
@pytest.mark.parametrize(
    ("step", "phase", "jitter"), [(1.5, 0.2, 0.0), (2.5, 0.0, 0.05), (6.1, 4.0, 0.05), (30, 11, 0)]
)
def test_a_point_that_is_polled_is_found_at_any_ratio_and_phase(step, phase, jitter, resolution):
    series = poll(random_walk(3600), step, phase, jitter)
    series = np.round(series / resolution) * resolution if resolution else series
    own = find_own_values(series, EVERY_ROW, holds=False)
    if resolution < 0.1:
        assert own.spacing == pytest.approx(step, rel=0.05)
    elif step > 2.0:  # of 1.5 rows a coarse sensor shows nothing
        assert own.spacing == pytest.approx(step, rel=0.2)
    if own and resolution == 0.0:
        assert own.rows.size == pytest.approx(3600 / step, rel=0.02)


@pytest.mark.parametrize("step", [2.5, 6, 17.3])
def test_straight_lines_between_samples_are_found(step):
    times = np.arange(0.0, 3600.0, step)
    series = np.interp(np.arange(3600), times, random_walk(times.size))
    assert find_own_values(series, EVERY_ROW, holds=False).spacing == pytest.approx(step, rel=0.05)


def test_noise_coarse_sensors_and_resting_commands_have_a_value_of_their_own_in_each_row():
    T = random_walk(3600)
    for series in (T, np.round(T, 1), np.round(random_walk(3600, 5) / 0.5) * 0.5, np.full(3600, 14.0)):
        assert find_own_values(series, EVERY_ROW, holds=False) is None
    command = np.round(0.5 + 0.1 * np.sin(np.arange(3600) / 100.0), 3)
    assert find_own_values(command, EVERY_ROW, holds=True) is None


def test_of_polled_points_the_samples_stay_that_the_slower_one_got():
    time = np.arange(0.0, 36000.0, 60.0)
    T, command = poll(random_walk(600), 2.5, 0.7), poll(random_walk(600, 8) / 30.0, 1.5)
    days = [resample_log(make_log(time, command=command, T_sup=T))[0]] * 2
    grid, notes = keep_own_values(join_grids(days))
    assert grid.interval == 150.0
    assert [note.split(":")[0] for note in notes] == [
        "T_sup has values of its own only every 2–3 min", "command has values of its own only every 60–120 s",
    ]  # fmt: skip
    own = np.flatnonzero(np.diff(T) != 0.0) + 1
    assert np.isin(T[own], grid.values["T_sup"]).all()
    assert [day.stop - day.start for day in grid.day_slices()] == pytest.approx([244, 240], abs=1)
    assert keep_own_values(resample_log(make_log(time, T_sup=random_walk(600)))[0])[1] == []


def test_days_in_a_row_are_apart_and_keep_what_all_of_them_have():
    columns = ({"T_set": np.full(720, 14.0)}, {})
    days = [resample_log(make_log(np.arange(0, 7200, 10), **extra_columns))[0] for extra_columns in columns]
    grid = join_grids(days)
    assert set(grid.values) == {"command", "T_sup"}
    assert [day.stop - day.start for day in grid.day_slices()] == [780, 720]
    assert not grid.on[720:780].any()
    np.testing.assert_array_equal(grid.values["T_sup"][780:], days[1].values["T_sup"])
    assert grid.time[[0, 719, 780, -1]].tolist() == [0.0, 7190.0, 86400.0, 93590.0]
    starts = [np.datetime64("2026-03-02T08:00"), np.datetime64("2026-03-05T09:00")]
    assert join_grids(days, starts).time[[719, 780]].tolist() == [7190.0, 73 * 3600.0]
    assert_refused("log", "time", join_grids, [days[0], resample_log(make_log(np.arange(0, 7200, 30)))[0]])


def test_a_long_log_is_cut_into_days_and_a_short_rest_stays_with_the_last():
    grid, _ = resample_log(make_log(np.arange(0, 2.3 * 86400, 60)))
    assert [(day.start, day.stop) for day in grid.day_slices()] == [(0, 1440), (1440, 3312)]
