"""Describing function of gap, inverse and buffer: the textbook's, python-control's, and that of the laws themselves."""

import numpy as np
import pytest

from fastcoil.design.describing_function import describing_function, limiter_gain, rate_limiter_gain, temperature
from fastcoil.model.control import FALLING, additive_command, inverse_command, next_extreme, next_mode
from fastcoil.model.physics import backlash, opening


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("size", [0.02, 0.07, 0.3])
def test_play_and_limiter_are_those_of_python_control(size):
    control = pytest.importorskip("control")
    amplitude = size * np.array([0.2, 0.49, 0.51, 0.6, 0.99, 1.0, 1.01, 3.0, 50.0])
    gap, limit = np.array(size), np.array(size)
    play, limiter = control.friction_backlash_nonlinearity(size), control.saturation_nonlinearity(size)
    expected = [[theirs.describing_function(A) for A in amplitude] for theirs in (play, limiter)]
    np.testing.assert_allclose(describing_function(amplitude, gap, gap), expected[0], atol=1e-12)
    np.testing.assert_allclose(limiter_gain(amplitude, -limit, limit), expected[1], atol=1e-12)


def simulate_laws(A, x_bl, x_hat, buffer, law=inverse_command, n=4000):
    """N of u → opening: two periods of a sinus through the controller's and the valve's own formulas."""
    phase = 2.0 * np.pi * np.arange(2 * n) / n
    mode, u_ext, command, q, out = FALLING, 0.5, 0.5, 0.5 * (1.0 - x_bl), []
    for u in (0.5 + A * np.sin(phase)).tolist():
        mode_before, u_before, mode = mode, u_ext, next_mode(u, mode, u_ext, buffer)
        u_ext = next_extreme(u, mode, u_before, mode != mode_before)
        command = law(u_ext, mode, x_hat) if u_ext != u_before else command
        q = backlash(q, command, x_bl)
        out.append(opening(q, x_bl))
    return complex(np.mean(np.array(out[n:]) * np.exp(-1j * phase[n:])) * 2j / A)


@pytest.mark.parametrize("x_hat", [0.0, 0.03, 0.08, 0.11], ids=["none", "too small", "right", "too large"])
@pytest.mark.parametrize("buffer", [1e-9, 0.02, 0.06])
@pytest.mark.parametrize("law", [inverse_command, additive_command])
def test_an_inverse_is_what_its_law_does(x_hat, buffer, law):
    x_bl, A = 0.08, 0.1
    whole = 1.0 - x_hat if law is inverse_command else 1.0
    width = (x_bl - x_hat) / whole
    N = describing_function(np.array(A), np.array(width), np.array(max(width, buffer)))
    assert simulate_laws(A, x_bl, x_hat, buffer, law) == pytest.approx(complex(N) * whole / (1.0 - x_bl), abs=3e-3)


def test_a_motor_far_too_slow_follows_a_triangle_and_one_fast_enough_its_target():
    """It climbs as fast as it may all the time: a triangle of height π/(2 r), late by the angle of cosine π/(2 r)."""
    faster = np.array([2.0, 5.0, 20.0])
    height = 0.5 * np.pi / faster
    expected = 8.0 / np.pi**2 * height * np.exp(-1j * np.arccos(height))
    np.testing.assert_allclose(rate_limiter_gain(faster), expected, atol=4e-3)
    np.testing.assert_allclose(rate_limiter_gain(np.array([0.0, 0.5, 1.0])), 1.0, atol=1e-2)


def test_the_temperature_at_an_opening_is_that_of_the_curve_which_ends_at_0_and_1():
    curve = np.array([[20.0, 16.0, 15.0], [18.0, 17.0, 10.0]])
    opening = np.array([[[-0.2, 0.25]], [[0.75, 1.5]]])
    np.testing.assert_allclose(temperature(curve, opening), [[[20.0, 18.0]], [[13.5, 10.0]]])
