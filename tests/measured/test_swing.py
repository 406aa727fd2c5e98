"""Swings and the indices that people know: what comes back regularly, how far, how fast, and what it costs."""

import numpy as np
import pytest

from fastcoil.measured.measures import is_in_control, is_settled, measure_swing

N, INTERVAL = 2880, 10.0
TIME = np.arange(N) * INTERVAL
EVERYWHERE = np.ones(N, bool)


generator = np.random.default_rng


@pytest.mark.parametrize("period", [200.0, 700.0, 2400.0])
def test_a_swing_under_noise_drift_and_gaps_is_found_with_its_size_and_period(period):
    noise, drift = generator(1).normal(0, 0.1, N), np.cumsum(generator(2).normal(0, 0.01, N))
    series = 0.4 * np.sin(2 * np.pi * TIME / period) + noise + drift
    good = EVERYWHERE.copy()
    good[1000:1040] = False
    swing = measure_swing(np.where(good, series, 99.0), good, INTERVAL)
    assert swing.is_regular
    assert swing.period == pytest.approx(period, rel=0.05)
    assert swing.peak_to_peak == pytest.approx(0.8, rel=0.25)


def test_what_wanders_without_a_rhythm_is_no_swing():
    series = (np.convolve(generator(s).normal(size=N), np.exp(-np.arange(60) / 15), "same") for s in range(20))
    assert sum(measure_swing(s, EVERYWHERE, INTERVAL).is_regular for s in series) <= 1


def test_regularity_is_a_third_of_the_mean_over_the_deviation_of_the_intervals():
    """Between zero crossings of the autocovariance, here in plain Python for every running mean that is taken away."""
    series = np.sin(2 * np.pi * TIME / 200.0) + generator(5).normal(0, 1.0, N)
    expected = []
    for half in (30, 90, 180):
        detrended = np.array([series[k] - series[max(k - half, 0) : k + half].mean() for k in range(N)])
        covariance = np.array([detrended[lag:] @ detrended[: N - lag] / (N - lag) for lag in range(240)])
        at = np.flatnonzero(covariance[1:] * covariance[:-1] < 0.0)
        between = np.diff(at + covariance[at] / (covariance[at] - covariance[at + 1]))[:10]
        expected.append(pytest.approx(between.mean() / (3 * between.std(ddof=1)), rel=0.01))
    assert measure_swing(series, EVERYWHERE, INTERVAL).regularity in expected


def test_a_swing_that_nobody_minds_or_that_is_seen_seven_times_is_not_called_regular():
    small = measure_swing(0.04 * np.sin(2 * np.pi * TIME / 600), EVERYWHERE, INTERVAL)
    assert small.regularity > 1.0
    assert not small.is_regular
    seven = measure_swing(np.sin(2 * np.pi * TIME / 4000), EVERYWHERE, INTERVAL)
    assert seven.period == pytest.approx(4000.0, rel=0.05)
    assert not seven.is_regular
    assert not measure_swing(np.zeros(N), EVERYWHERE, INTERVAL).is_regular


def test_the_loop_is_settled_ten_minutes_after_the_set_point_stood_still():
    T_set = np.where(TIME < 10000, 14.0, 16.0)
    is_settled_at = is_settled(T_set, EVERYWHERE, INTERVAL)
    assert is_settled_at[TIME < 10000][61:].all()
    assert not is_settled_at[(TIME >= 10000) & (TIME < 10590)].any()
    assert is_settled_at[TIME >= 10600].all()
    slow_reset = 14.0 + TIME / 3600.0  # 1 K in an hour
    assert is_settled(slow_reset, EVERYWHERE, INTERVAL)[61:].all()
    assert not is_settled(5 * slow_reset, EVERYWHERE, INTERVAL).any()


def test_a_valve_that_stays_closed_is_out_of_control_and_one_that_touches_the_end_is_not():
    command = np.where((TIME > 5000) & (TIME < 9000), 0.0, 0.5)
    command[2000:2030] = 1.0
    has_say = is_in_control(command, EVERYWHERE, INTERVAL)
    assert not has_say[(TIME > 5000) & (TIME < 9000)].any()
    assert has_say[2000:2030].all()
