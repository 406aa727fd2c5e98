"""Half the gap added to u, the smooth inverse, the dead band, a buffer that goes with the noise: formula by formula."""

import math

import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st

from fastcoil.model import control

SHARES, ESTIMATES = st.floats(0.0, 1.0), st.floats(0.0, 0.9)


@given(SHARES, ESTIMATES, st.sampled_from([control.RISING, control.FALLING]))
def test_additive_equals_the_references_and_the_inverse_but_for_a_slow_term(u, x_hat, mode):
    command = control.additive_command(u, mode, x_hat)
    assert command == reference.additive_compensation(u, x_hat, mode)
    if x_hat / 2.0 <= u <= 1.0 - x_hat / 2.0:
        slow_term = control.inverse_command(u, mode, x_hat) - command
        assert slow_term == pytest.approx(x_hat * (0.5 - u), abs=1e-15)


@given(SHARES, SHARES, ESTIMATES, st.floats(1e-9, 1e3), st.sampled_from([1.0, 7.0, 3600.0]))
def test_smooth_equals_the_references(u, u_before, x_hat, rate, sample_time):
    command = control.smooth_command(u, u_before, x_hat, control.smooth_steepness(rate, sample_time))
    assert command == pytest.approx(reference.smooth_inverse(u, u_before, sample_time, x_hat, rate), abs=1e-14)


def test_smooth_overflows_nowhere_and_ends_at_the_inverse():
    for rate in (1e-300, 1e-12, 1e-6):
        for u_before, mode in ((0.4, control.RISING), (0.6, control.FALLING)):
            command = control.smooth_command(0.5, u_before, 0.06, control.smooth_steepness(rate, 30.0))
            assert command == control.inverse_command(0.5, mode, 0.06)


def test_smooth_is_in_the_middle_of_the_gap_at_rest_and_98_percent_across_at_its_rate():
    rate, sample_time = 1e-3, 10.0
    steepness = control.smooth_steepness(rate, sample_time)
    assert control.smooth_command(0.5, 0.5, 0.06, steepness) == 0.94 * 0.5 + 0.03
    crossed = (control.smooth_command(0.5, 0.5 - rate * sample_time, 0.06, steepness) - 0.94 * 0.5) / 0.06
    assert crossed == pytest.approx(0.5 * (1.0 + math.tanh(2.0)), abs=1e-12)
    assert round(crossed, 2) == 0.98


def test_a_dead_band_holds_up_to_its_edge_and_one_of_0_never():
    assert [control.in_dead_band(e, 0.2) for e in (-0.2, 0.0, 0.2, 0.2000001, -0.3)] == [True, True, True, False, False]
    assert not control.in_dead_band(0.0, 0.0)


def test_the_buffer_is_a_multiple_of_the_noise_in_u_within_its_limits():
    any_swing, small = control.largest_buffer(0.0, math.nan), control.largest_buffer(0.1, 20.0)
    unlimited = control.noise_buffer(1e-9, 6.0, 0.05, 0.02, any_swing)
    assert unlimited == pytest.approx(0.006, abs=1e-17)
    assert control.noise_buffer(1e-9, 6.0, -0.05, 0.02, any_swing) == unlimited
    assert control.noise_buffer(1e-9, 6.0, 0.05, 0.02, small) == 0.005
    assert control.noise_buffer(0.01, 6.0, 0.05, 0.02, small) == 0.01
    assert control.noise_buffer(0.01, 0.0, 0.05, 0.02, any_swing) == 0.01
    assert control.noise_buffer(1e-9, 6.0, 0.05, 0.0, small) == 1e-9


def noise_after_each_reading(readings):
    """Noise found in a series of readings, after every one of them."""
    median, before_last, last, noise_levels = 0.0, 0.0, 0.0, []
    for k, e in enumerate(readings, 1):
        median = control.median_difference(median, float(k), e, last, before_last)
        before_last, last = last, e
        noise_levels.append(control.noise_level(median))
    return np.array(noise_levels)


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=60))
def test_measured_noise_equals_the_references(readings):
    meter, expected = reference.NoiseMeter(), []
    for e in readings:
        meter.read(e)
        expected.append(meter.deviation)
    np.testing.assert_allclose(noise_after_each_reading(readings), expected, rtol=1e-12)


@pytest.mark.parametrize("sigma", [0.01, 0.05, 0.5])
def test_measured_noise_is_that_of_the_readings_whatever_drifts_and_steps(sigma):
    """A ramp of 10 K and a step of 2 K every 60 readings; a hundred readings are enough."""
    k = np.arange(3000)
    moving = 10.0 * k / k.size + 2.0 * (k // 60 % 2)
    sigma_measured = noise_after_each_reading(moving + sigma * np.random.default_rng(1).standard_normal(k.size))
    assert np.all(np.abs(sigma_measured[100:] / sigma - 1.0) < 0.4)
    assert sigma_measured[100:].mean() == pytest.approx(sigma, rel=0.06)


def test_measured_noise_starts_from_a_guess_and_rises_again_from_none():
    sigma_measured = noise_after_each_reading([14.0] * 500 + np.random.default_rng(2).normal(0.0, 0.05, 800).tolist())
    assert sigma_measured[0] == sigma_measured[1] == control.noise_level(control.FIRST_MEDIAN_DIFFERENCE_K)
    assert sigma_measured[499] == control.noise_level(control.LEAST_MEDIAN_DIFFERENCE_K)
    assert sigma_measured[-1] == pytest.approx(0.05, rel=0.4)
