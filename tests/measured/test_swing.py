"""Swings and the indices that people know: what comes back regularly, how far, how fast, and what it costs."""

import numpy as np
import pytest

from fastcoil.measured.measures import in_control, settled, swing_of

N, INTERVAL = 2880, 10.0
TIME = np.arange(N) * INTERVAL
EVERYWHERE = np.ones(N, bool)


def drawn(seed):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("period", [200.0, 700.0, 2400.0])
def test_a_swing_under_noise_drift_and_gaps_is_found_with_its_size_and_period(period):
    series = (
        0.4 * np.sin(2 * np.pi * TIME / period) + drawn(1).normal(0, 0.1, N) + np.cumsum(drawn(2).normal(0, 0.01, N))
    )
    good = EVERYWHERE.copy()
    good[1000:1040] = False
    found = swing_of(np.where(good, series, 99.0), good, INTERVAL)
    assert found.is_regular
    assert found.period == pytest.approx(period, rel=0.05)
    assert found.peak_to_peak == pytest.approx(0.8, rel=0.25)


def test_what_wanders_without_a_rhythm_is_no_swing():
    found = [
        swing_of(np.convolve(drawn(s).normal(size=N), np.exp(-np.arange(60) / 15), "same"), EVERYWHERE, INTERVAL)
        for s in range(20)
    ]
    assert sum(one.is_regular for one in found) <= 1


def test_regularity_is_a_third_of_the_mean_over_the_deviation_of_the_intervals():
    """Between zero crossings of the autocovariance, here in plain Python for every running mean that is taken away."""
    series = np.sin(2 * np.pi * TIME / 200.0) + drawn(5).normal(0, 1.0, N)
    expected = []
    for half in (30, 90, 180):
        rest = np.array([series[k] - series[max(k - half, 0) : k + half].mean() for k in range(N)])
        covariance = np.array([rest[lag:] @ rest[: N - lag] / (N - lag) for lag in range(240)])
        at = np.flatnonzero(covariance[1:] * covariance[:-1] < 0.0)
        between = np.diff(at + covariance[at] / (covariance[at] - covariance[at + 1]))[:10]
        expected.append(pytest.approx(between.mean() / (3 * between.std(ddof=1)), rel=0.01))
    assert swing_of(series, EVERYWHERE, INTERVAL).regularity in expected


def test_a_swing_that_nobody_minds_or_that_is_seen_seven_times_is_not_called_regular():
    small = swing_of(0.04 * np.sin(2 * np.pi * TIME / 600), EVERYWHERE, INTERVAL)
    assert small.regularity > 1.0
    assert not small.is_regular
    seven = swing_of(np.sin(2 * np.pi * TIME / 4000), EVERYWHERE, INTERVAL)
    assert seven.period == pytest.approx(4000.0, rel=0.05)
    assert not seven.is_regular
    assert not swing_of(np.zeros(N), EVERYWHERE, INTERVAL).is_regular


def test_the_loop_is_settled_ten_minutes_after_the_set_point_stood_still():
    T_set = np.where(TIME < 10000, 14.0, 16.0)
    found = settled(T_set, EVERYWHERE, INTERVAL)
    assert found[TIME < 10000][61:].all()
    assert not found[(TIME >= 10000) & (TIME < 10590)].any()
    assert found[TIME >= 10600].all()
    slow_reset = 14.0 + TIME / 3600.0  # 1 K in an hour
    assert settled(slow_reset, EVERYWHERE, INTERVAL)[61:].all()
    assert not settled(5 * slow_reset, EVERYWHERE, INTERVAL).any()


def test_a_valve_that_stays_closed_is_out_of_control_and_one_that_touches_the_end_is_not():
    command = np.where((TIME > 5000) & (TIME < 9000), 0.0, 0.5)
    command[2000:2030] = 1.0
    found = in_control(command, EVERYWHERE, INTERVAL)
    assert not found[(TIME > 5000) & (TIME < 9000)].any()
    assert found[2000:2030].all()
