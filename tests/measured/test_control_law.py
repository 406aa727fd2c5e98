"""What the commands of a log say about the controller."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.measured.agreement import imply_pi
from fastcoil.measured.fitted_plant import _fit_best_pi, recover_pi, regress_pi
from fastcoil.measured.identify import back_and_forth_share, count_end_arrivals, is_provoked

INTERVAL = 10.0


def simulate_loop(T_set=None, n=2160, every=1, seed=0, offset=0.5):
    """Temperatures that wander with noise, and what a PI controller answers every so many samples: (command, T)."""
    draw = np.random.default_rng(seed)
    T = 14.0 + np.convolve(draw.normal(0, 0.05, n + 60), np.ones(60) / 8, "same")[:n] + draw.normal(0, 0.02, n)
    e = T - (14.0 if T_set is None else T_set)
    acts = np.arange(0, n, every)
    u = offset + 0.02 * e[acts] + 0.0005 * np.cumsum(e[acts] - e[acts].mean())
    return np.repeat(u, every)[:n], T


def stepped_set_point(n=2160):
    """A set-point that steps by 1 K or more every half hour."""
    return np.repeat(14.0 + np.array([0, 1, -1, 2, 0, 1.5, -0.5, 1, 0, -1, 0.5, 2]), n // 12)


ALL_GOOD = np.ones(2160, bool)


@pytest.mark.parametrize("every", [1, 3])
def test_steps_of_the_set_point_are_seen_without_its_column(every):
    command, T = simulate_loop(stepped_set_point(), every=every)
    assert is_provoked(command, T, ALL_GOOD, None, INTERVAL)
    assert not is_provoked(*simulate_loop(every=every), ALL_GOOD, None, INTERVAL)


def test_a_column_of_the_set_point_decides_where_there_is_one():
    command, T = simulate_loop()
    assert is_provoked(command, T, ALL_GOOD, stepped_set_point(), INTERVAL)
    assert not is_provoked(*simulate_loop(stepped_set_point()), ALL_GOOD, np.full(2160, 14.0), INTERVAL)
    off = np.diff(stepped_set_point(), prepend=14.0) != 0  # no sample at which it steps may be used
    assert not is_provoked(command, T, ~off, stepped_set_point(), INTERVAL)


def test_what_jumps_only_at_the_start_and_at_its_ends_provokes_nothing():
    command, T = simulate_loop()
    command[:12] = np.linspace(0, 0.5, 12)
    assert not is_provoked(command, T, ALL_GOOD, None, INTERVAL)
    for k in range(200, 2000, 300):
        command[k : k + 60] = 1.0
    assert not is_provoked(command, T, ALL_GOOD, None, INTERVAL)
    assert count_end_arrivals(command, ALL_GOOD) == 6
    assert count_end_arrivals(command, np.arange(2160) > 600) == 4


def test_a_chattering_inverse_moves_to_and_fro_and_a_loop_that_hunts_does_not():
    t = np.arange(2160)
    hunts = 0.5 + 0.3 * np.sin(t / 8)
    assert back_and_forth_share(hunts, ALL_GOOD) == 0.0
    assert back_and_forth_share(hunts + 0.005 * (t % 2), ALL_GOOD) == 0.0
    chatters = hunts + 0.05 * (np.random.default_rng(2).random(2160) < 0.5)
    assert 0.1 < back_and_forth_share(chatters, ALL_GOOD) < 0.5
    assert back_and_forth_share(chatters, ~ALL_GOOD) == 0.0


@pytest.mark.parametrize("samples", [-9, -1, 0, 1, 12])
def test_a_column_that_stands_late_is_found_by_the_control_law_without_its_set_point(samples):
    command, T = simulate_loop(stepped_set_point())
    law = imply_pi(command, np.roll(T, samples), None, ALL_GOOD, INTERVAL)
    assert law.temperature_lag == samples
    assert law.explained > law.least_explained


def test_a_command_that_answers_no_temperature_of_the_log_implies_no_law():
    draw = np.random.default_rng(5)
    command, T = simulate_loop()
    for unrelated in (np.clip(0.5 + np.cumsum(draw.normal(0, 0.01, 2160)), 0, 1), command + draw.normal(0, 0.02, 2160)):
        law = imply_pi(unrelated, T, None, ALL_GOOD, INTERVAL)
        assert law.explained < law.least_explained
    for still, good in ((np.full(2160, 0.5), ALL_GOOD), (command, np.arange(2160) % 8 > 0)):
        assert np.isnan(imply_pi(still, T, None, good, INTERVAL).explained)


@pytest.mark.kernel
@pytest.mark.parametrize("sample_time", [5.0, 7.0, 12.0, 15.0, 20.0, 45.0])
def test_gains_of_a_loop_that_hunts_are_found_whatever_the_rhythm_of_its_controller(sample_time):
    """A swing of four minutes, a sample every 10 s: the controller may read a temperature between two of them."""
    loop = fc.Loop.preset("lbnl").assign(backlash=0.09, noise_std=0.01, kp=0.03, ti=15.0, sample_time=sample_time)
    day = fc.paper_day(hours=3, seed=2)
    ds = fc.simulate(loop, day, traces=["command", "T_measured"], trace_interval=10)
    command, T = (ds[name].values.astype(float) for name in ("command", "T_measured"))
    pi = recover_pi(command, T, day.series["T_set"][0, ::10], 10.0, np.ones(T.size, bool), None)
    assert pi.sample_time == sample_time
    assert (pi.kp, pi.ti) == pytest.approx((0.03, 15.0), rel=0.05)


def test_commands_that_fit_no_pi_that_is_not_saturated_have_none():
    """The gains of one half saturate the integral in that half and not in the other, and the other way round."""

    def half(n, error, command, kp):
        swings = 0.2 * (-1.0) ** np.arange(n)
        return error + swings, command + kp * swings

    (e_1, u_1), (e_2, u_2) = half(41, 10.0, 0.5, 0.06), half(61, 14.0, 0.9, -0.06)
    before = np.delete(np.arange(101), 40)
    assert regress_pi(np.r_[u_1, u_2], np.r_[e_1, e_2], before, before + 1, np.zeros(100)) is None


def test_changes_over_two_samples_are_enough_where_pieces_have_four():
    """Every second row may begin or end a change: a lag of 1 sees none, one of 4 leaves the piece."""
    rng, rows = np.random.default_rng(1), np.arange(400)
    error, integral = rng.normal(0.0, 0.5, 400), np.cumsum(rng.normal(0.0, 5.0, 400))
    command = 0.5 + 0.02 * error + 3e-4 * integral
    fit = _fit_best_pi(command, error, rows, rows[1:] % 4 > 0, integral, rows % 2 == 0)
    assert (fit.kp, fit.ki) == pytest.approx((0.02, 3e-4))
