"""The backlash inverse: exact behind its own backlash, its known errors behind another, buffer and hold."""

from itertools import accumulate
from typing import NamedTuple

import numpy as np
import pytest
import reference
from helpers.stems import stem_positions
from hypothesis import given
from hypothesis import strategies as st

from fastcoil.model.control import FALLING, RISING, inverse_command, next_extreme, next_mode
from fastcoil.model.physics import opening

# halts, and both ends of the stroke, more often than chance would have them
OPENINGS = st.lists(st.one_of(st.floats(0.0, 1.0), st.sampled_from([0.0, 1.0, 0.3, 0.5])), min_size=1, max_size=60)
BACKLASHES = st.floats(0.0, 0.9)


class State(NamedTuple):
    """What the inverse remembers, and the command it gives."""

    mode: float = FALLING
    u_ext: float = 0.0
    command: float = 0.0


def step_inverse(state, u, estimate, buffer=0.0):
    """One call, as in the kernel: where u_ext does not change, neither does the command."""
    mode = next_mode(u, state.mode, state.u_ext, buffer)
    u_ext = next_extreme(u, mode, state.u_ext, mode != state.mode)
    command = inverse_command(u_ext, mode, estimate) if u_ext != state.u_ext else state.command
    return State(mode, u_ext, command)


def inverse_states(desired, estimate, buffer=0.0):
    return list(accumulate(desired, lambda state, u: step_inverse(state, u, estimate, buffer), initial=State()))[1:]


def cascade_openings(desired, estimate, x_bl, buffer=0.0):
    """Openings behind inverse and gearbox."""
    commands = [state.command for state in inverse_states(desired, estimate, buffer)]
    return np.array([opening(q, x_bl) for q in stem_positions(commands, x_bl)])


@given(OPENINGS, BACKLASHES, st.sampled_from([0.0, 1e-9, 0.01, 0.2]))
def test_equals_the_references(desired, estimate, buffer):
    command, mode, u_ext = 0.0, FALLING, 0.0
    for u, state in zip(desired, inverse_states(desired, estimate, buffer), strict=True):
        command, mode, u_ext = reference.backlash_inverse(u, estimate, buffer, mode, u_ext, command)
        assert state == (mode, u_ext, command)


@given(OPENINGS, BACKLASHES)
def test_exact_estimate_makes_the_cascade_the_identity(desired, x_bl):
    np.testing.assert_allclose(cascade_openings(desired, x_bl, x_bl), desired, rtol=0.0, atol=4e-16 / (1.0 - x_bl))


@given(OPENINGS, st.floats(0.001, 0.9), st.floats(0.0, 1.0))
def test_under_estimate_leaves_a_smaller_play_with_a_gain(desired, x_bl, ratio):
    estimate = ratio * x_bl
    width, gain = (x_bl - estimate) / (1.0 - estimate), (1.0 - estimate) / (1.0 - x_bl)
    expected = gain * stem_positions(desired, width)
    np.testing.assert_allclose(cascade_openings(desired, estimate, x_bl), expected, rtol=0.0, atol=1e-15 / (1.0 - x_bl))


@given(OPENINGS, st.floats(0.0, 0.5), st.floats(0.0, 0.4))
def test_over_estimate_is_a_relay_on_the_direction(desired, x_bl, delta):
    excess = delta / (1.0 - x_bl)
    openings = cascade_openings(desired, x_bl + delta, x_bl)
    mode = np.array([state.mode for state in inverse_states(desired, x_bl + delta)])
    u = np.array(desired)
    has_moved = np.logical_or.accumulate(u != 0.0)
    expected = np.where(mode == RISING, u + excess * (1.0 - u), u - excess * u)
    np.testing.assert_allclose(openings, np.where(has_moved, expected, 0.0), rtol=0.0, atol=4e-15)


@given(OPENINGS)
def test_estimate_0_is_the_plain_controller(desired):
    assert [state.command for state in inverse_states(desired, 0.0)] == desired


@given(OPENINGS, BACKLASHES, st.sampled_from([0.0, 1e-9, 0.01]))
def test_a_held_u_holds_everything(desired, estimate, buffer):
    last = inverse_states(desired, estimate, buffer)[-1]
    assert step_inverse(last, desired[-1], estimate, buffer) == last


def test_a_changed_estimate_acts_when_u_next_goes_on():
    held = step_inverse(inverse_states([0.4], 0.05)[-1], 0.4, 0.06)
    assert held.command == inverse_states([0.4], 0.05)[-1].command
    assert step_inverse(held, 0.41, 0.06).command == pytest.approx(0.94 * 0.41 + 0.06, abs=1e-16)


def test_buffer_ignores_reversals_up_to_its_size():
    modes = [state.mode for state in inverse_states([0.5, 0.375, 0.5, 0.375, 0.374], 0.05, buffer=0.125)]
    assert modes == [RISING, RISING, RISING, RISING, FALLING]
    back = [state.mode for state in inverse_states([0.5, 0.25, 0.375, 0.376], 0.05, buffer=0.125)]
    assert back == [RISING, FALLING, FALLING, RISING]


@given(OPENINGS, st.floats(0.01, 0.3), st.floats(0.0, 0.3))
def test_opening_lags_the_wanted_one_by_the_buffer_at_most(desired, x_bl, buffer):
    lag = cascade_openings(desired, x_bl, x_bl, buffer) - np.array(desired)
    assert np.all(np.abs(lag) <= buffer + 1e-15)


def test_round_off_is_no_reversal_with_the_default_buffer():
    u = [0.4, np.nextafter(0.4, 0.0)] * 100
    assert {state.mode for state in inverse_states(u, 0.07, buffer=1e-9)} == {RISING}
    assert {state.mode for state in inverse_states(u, 0.07, buffer=0.0)} == {RISING, FALLING}
