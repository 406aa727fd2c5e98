"""The valve test: a relay with ramps and holds in place of the PI, by which the temperature tells the gap.

The command holds until the loop is calm, then moves slower than the motor towards the set-point of the start.  When the
temperature has passed it by a threshold, the command holds, turns and moves the other way, until the time is over.
Each turn crosses the gap once.

A test waits until a known air flow is calm, and is refused if it is not within an hour; where it changes later, the
limit of the temperature is wider on that side.
"""

from typing import NamedTuple

import numpy as np

from fastcoil.model.control import clip01
from fastcoil.model.estimators.interface import filter_weight, low_pass
from fastcoil.model.numerics.jit import exact

PHASE_OFF = 0.0  # phases of a test
PHASE_SETTLE = 1.0
PHASE_RAMP = 2.0
PHASE_HOLD = 3.0
# why a test was aborted, in the order of the flags of the metric ``test_aborted``
NOT_ABORTED = 0.0
ABORTED_EXCURSION = 1.0
ABORTED_END_OF_STROKE = 2.0
ABORTED_SWING = 3.0
ABORTED_DISABLED = 4.0
ABORTED_VARYING_AIR = 5.0

# calibrated in studies/valve_test
CALM_WINDOW_S = 60.0  # last part of settling
LARGEST_CALM_SWING_K = 0.3  # by which the temperature may move in it
TARGET_OVERSHOOT_K = 0.5  # beyond the threshold while the command holds: gain x rate x lag; sets the next ramp's rate
LARGEST_OVERSHOOT_SHARE = 1 / 3  # of ``test_excursion``, that the overshoot aims at
LEAST_RATE_RATIO = 0.2  # of a ramp's rate over ``test_rate``
LARGEST_RATE_RATIO = 4.0  # likewise
LARGEST_INCREASE = 2.0  # of a ramp's rate over that of the ramp before
LONGEST_RAMP_STROKE = 0.3  # after which a ramp ends though the temperature has not passed the threshold
FIRST_RAMP_LIMIT_RATIO = 2.0  # of the limit before the first ramp has ended: a loop that hunts starts anywhere
MEAN_COMMAND_TIME_S = 600.0  # of the filter of the command before the test
MEAN_AIR_TIME_S = 300.0  # of the filter of the air flow
CALM_AIR_TIME_S = 300.0  # for which the air flow has been calm when a test begins
LARGEST_CALM_AIR_CHANGE = 0.08  # of the air flow from that mean, share of it
LONGEST_WAIT_S = 3600.0  # for calm air
LEAST_AIR_CHANGE = 0.05  # of the air flow from that mean, that widens the limit
CHANGED_AIR_LIMIT_RATIO = 2.0  # of the limit then
LARGEST_CALM_DEVIATION = 0.05  # fraction of stroke from that mean; a command that swings wider is held at its mean


class Parameters(NamedTuple):
    """Parameters of the loop that the test reads."""

    sample_time: float
    test_minutes: float
    test_rate: float
    test_threshold: float
    test_settle: float
    test_hold: float
    test_excursion: float


class Memory(NamedTuple):
    """State of the test from one sample to the next."""

    phase: float = PHASE_OFF
    elapsed: float = 0.0  # time since the start of the test, s
    phase_elapsed: float = 0.0  # time since the start of the phase, s
    direction: float = 0.0  # 1 opening, -1 closing
    ramp_rate: float = 0.0  # rate of the ramps, 1/s
    ramp_start: float = 0.0  # command at which the ramp began
    reference: float = 0.0  # set-point at the start, °C
    lowest: float = 0.0  # extremes of the error in this phase, K; while settling in its last part
    highest: float = 0.0
    ramps_ended: float = 0.0  # number of ramps that have ended
    mean: float = np.nan  # filtered command before the test
    aborted: float = NOT_ABORTED
    air_flow: float = 0.0  # filtered, kg/s; 0 if it is not known
    calm_for: float = CALM_AIR_TIME_S  # time for which the air flow has been calm, s; as if so before the first sample
    waited: float = 0.0  # time for which a requested test has waited for calm air, s


@exact
def begin_test(T_set, p, memory):
    """Return the Memory at the start of a test, whose errors are from the set-point ``T_set``."""
    t = -p.sample_time  # the first step is at 0
    return Memory(
        PHASE_SETTLE, t, t, 0.0, p.test_rate, 0.0, T_set, 0.0, 0.0, 0.0, memory.mean, NOT_ABORTED, memory.air_flow,
        memory.calm_for, 0.0,
    )  # fmt: skip


@exact
def held_command(command, memory):
    """Return the command that a test holds first: the mean before it if the command swings, else the present one."""
    return memory.mean if abs(command - memory.mean) > LARGEST_CALM_DEVIATION else command


@exact
def mean_air_flow(m_a, p, memory):
    """Filtered air flow, kg/s; an unknown one, 0, negative or NaN, leaves it as it is."""
    start = memory.air_flow if memory.air_flow > 0.0 else m_a
    return low_pass(start, m_a, filter_weight(MEAN_AIR_TIME_S, p.sample_time)) if m_a > 0.0 else memory.air_flow


@exact
def change_of_air(m_a, mean):
    """Relative change of the air flow from its mean; 0 if either is not known."""
    return m_a / mean - 1.0 if m_a > 0.0 and mean > 0.0 else 0.0


@exact
def watch_loop(command, m_a, enabled, is_requested, p, memory):
    """Take one sample while no test runs: (whether one begins, Memory); a requested test waits for calm air."""
    m = memory
    air_flow = mean_air_flow(m_a, p, m)
    is_calm = abs(change_of_air(m_a, air_flow)) <= LARGEST_CALM_AIR_CHANGE
    calm_for = m.calm_for + p.sample_time if is_calm else 0.0
    waits = m.phase == PHASE_OFF and (is_requested or m.waited > 0.0)
    begins = waits and (calm_for >= CALM_AIR_TIME_S or not enabled)
    waited = m.waited + p.sample_time if waits and not begins else 0.0
    is_refused = waited > LONGEST_WAIT_S
    mean = low_pass(m.mean, command, filter_weight(MEAN_COMMAND_TIME_S, p.sample_time))
    return begins, Memory(
        PHASE_OFF, m.elapsed, m.phase_elapsed, m.direction, m.ramp_rate, m.ramp_start, m.reference, m.lowest,
        m.highest, m.ramps_ended, m.mean if begins else mean, ABORTED_VARYING_AIR if is_refused else m.aborted,
        air_flow, calm_for, 0.0 if is_refused else waited,
    )  # fmt: skip


@exact
def next_ramp_rate(rate, overshoot, p):
    """Rate of the next ramp, 1/s, by which the temperature overshoots as intended; at most twice the last one."""
    largest_overshoot = LARGEST_OVERSHOOT_SHARE * p.test_excursion
    target_overshoot = TARGET_OVERSHOOT_K if TARGET_OVERSHOOT_K < largest_overshoot else largest_overshoot
    rate_ratio = target_overshoot / overshoot if overshoot > target_overshoot / LARGEST_INCREASE else LARGEST_INCREASE
    rate = rate * rate_ratio
    rate = LARGEST_RATE_RATIO * p.test_rate if rate > LARGEST_RATE_RATIO * p.test_rate else rate
    return LEAST_RATE_RATIO * p.test_rate if rate < LEAST_RATE_RATIO * p.test_rate else rate


@exact
def step_test(e, command, m_a, enabled, p, memory):
    """Take one sample of the test: (command, Memory); PHASE_OFF after the last sample, and after an abort.

    e: error from ``reference``, K, positive where the valve should open; more air makes it more positive.
    """
    m = memory
    elapsed, phase_elapsed = m.elapsed + p.sample_time, m.phase_elapsed + p.sample_time
    is_new = phase_elapsed <= 0.0 or (m.phase == PHASE_SETTLE and phase_elapsed <= p.test_settle - CALM_WINDOW_S)
    lowest = e if is_new or e < m.lowest else m.lowest
    highest = e if is_new or e > m.highest else m.highest

    at_end = (m.direction > 0.0 and command >= 1.0) or (m.direction < 0.0 and command <= 0.0)
    has_passed = at_end or m.direction * e < -p.test_threshold or abs(command - m.ramp_start) >= LONGEST_RAMP_STROKE
    has_settled = m.phase == PHASE_SETTLE and phase_elapsed >= p.test_settle
    ends_ramp = m.phase == PHASE_RAMP and has_passed
    turns = m.phase == PHASE_HOLD and phase_elapsed >= p.test_hold
    phase = PHASE_RAMP if has_settled or turns else (PHASE_HOLD if ends_ramp else m.phase)
    overshoot = (-lowest if m.direction > 0.0 else highest) - p.test_threshold
    ramp_rate = next_ramp_rate(m.ramp_rate, overshoot, p) if turns else m.ramp_rate
    first_direction = 1.0 if e > 0.0 else -1.0
    direction = first_direction if has_settled else (-m.direction if turns else m.direction)
    ramp_start = command if has_settled or turns else m.ramp_start
    next_command = command + (direction * ramp_rate * p.sample_time if phase == PHASE_RAMP else 0.0)

    aborted = ABORTED_SWING if has_settled and highest - lowest > LARGEST_CALM_SWING_K else NOT_ABORTED
    # where the temperature has come back, turning at the end is enough
    aborted = ABORTED_END_OF_STROKE if m.phase == PHASE_RAMP and at_end and m.direction * e > 0.0 else aborted
    no_room = (e < 0.0 and command <= 0.0) or (e > 0.0 and command >= 1.0)
    aborted = ABORTED_END_OF_STROKE if elapsed <= 0.0 and no_room else aborted
    limit = p.test_excursion * (FIRST_RAMP_LIMIT_RATIO if m.ramps_ended == 0.0 else 1.0)
    air_flow = mean_air_flow(m_a, p, m)
    # what the measured air explains is not done by the stem
    is_by_air = (1.0 if e > 0.0 else -1.0) * change_of_air(m_a, air_flow) > LEAST_AIR_CHANGE
    limit = CHANGED_AIR_LIMIT_RATIO * p.test_excursion if is_by_air else limit
    aborted = ABORTED_EXCURSION if abs(e) > limit else aborted
    is_over = elapsed >= 60.0 * p.test_minutes
    aborted = NOT_ABORTED if is_over else (aborted if enabled else ABORTED_DISABLED)
    ends = is_over or aborted != NOT_ABORTED
    changes = phase != m.phase
    ramps_ended = m.ramps_ended + (1.0 if ends_ramp else 0.0)
    next_memory = Memory(
        PHASE_OFF if ends else phase, elapsed, 0.0 if changes else phase_elapsed, direction, ramp_rate,
        ramp_start, m.reference, e if changes else lowest, e if changes else highest, ramps_ended, m.mean,
        aborted, air_flow, m.calm_for, 0.0,
    )  # fmt: skip
    return command if aborted != NOT_ABORTED else clip01(next_command), next_memory
