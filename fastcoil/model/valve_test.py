"""The valve test: a relay with ramps and holds in place of the PI, by which the temperature tells the gap.

The command holds until the loop is calm (``settle``), then moves at a rate that the motor can follow in the direction
that brings the temperature back to the set-point of the start.  When the temperature has passed it by a threshold, the
command holds, turns and moves the other way, until the time is over.  Each turn crosses the gap once.  A ramp slower
than the motor leaves its stroke time out of what the temperature tells.
"""

from typing import NamedTuple

import numpy as np

from fastcoil.model.control import clipped
from fastcoil.model.estimators.interface import low_passed, weight_of_new
from fastcoil.model.numerics.jit import exact

OFF, SETTLE, RAMP, HOLD = 0.0, 1.0, 2.0, 3.0
"""Phases."""
NO, EXCURSION, END_OF_STROKE, SWING, DISABLED = 0.0, 1.0, 2.0, 3.0, 4.0
"""Why a test was aborted, in the order of the flags of the metric ``test_aborted``."""
WATCHED, CALM = 60.0, 0.3
"""Last seconds of settling, and K that the temperature may move in them."""
OVERSHOOT, OF_LIMIT = 0.5, 1 / 3
"""K by which the temperature is to run on beyond the threshold while the command holds, and at most this share of the
limit: gain x rate x lag of the plant.  The next ramp has the rate at which it does."""
SLOWEST, FASTEST, FASTER = 0.2, 4.0, 2.0
"""A ramp's least and greatest rate over the given one, and over that of the ramp before."""
FARTHEST = 0.3
"""Fraction of stroke after which a ramp ends though the temperature has not passed the threshold."""
AT_FIRST = 2.0
"""Times the limit that the error may reach before the first ramp has ended: a loop that hunts starts anywhere."""
MEAN_TIME, SWINGS = 600.0, 0.05
"""Seconds that the mean of the command goes back over, and fraction of stroke off that mean from which a test begins
at the mean: the command of a loop that swings widely is held in its middle, and not at an end of its swing."""


class Parameters(NamedTuple):
    """Parameters of the loop that the test uses."""

    sample_time: float
    test_minutes: float
    test_rate: float
    test_threshold: float
    test_settle: float
    test_hold: float
    test_excursion: float


class Memory(NamedTuple):
    """What it remembers."""

    phase: float = OFF
    elapsed: float = 0.0
    """Since the start of the test, s."""
    since: float = 0.0
    """Since the start of the phase, s."""
    direction: float = 0.0
    """1 opening, -1 closing."""
    ramp: float = 0.0
    """Rate of the ramps, 1/s."""
    turned_at: float = 0.0
    """Command at which the ramp began."""
    reference: float = 0.0
    """Set-point of the start, °C."""
    lowest: float = 0.0
    highest: float = 0.0
    """Error so far in this phase, K; of settling in its last part."""
    ramps: float = 0.0
    """That have ended."""
    mean: float = np.nan
    """Of the command before the test."""
    aborted: float = NO


@exact
def begin(T_set, p, memory):
    """Memory at the start of a test."""
    before = -p.sample_time  # the first step is at 0
    return Memory(SETTLE, before, before, 0.0, p.test_rate, 0.0, T_set, 0.0, 0.0, 0.0, memory.mean, NO)


@exact
def held_command(command, memory):
    """Command that is held from the start of a test on."""
    return memory.mean if abs(command - memory.mean) > SWINGS else command


@exact
def mean_of(command, p, memory):
    """Memory after one more sample without a test."""
    m = memory
    mean = low_passed(m.mean, command, weight_of_new(MEAN_TIME, p.sample_time))
    return Memory(OFF, m.elapsed, m.since, m.direction, m.ramp, m.turned_at, m.reference, m.lowest, m.highest, m.ramps,
                  mean, m.aborted)  # fmt: skip


@exact
def next_rate(rate, overshoot, p):
    """Rate of the next ramp, 1/s: so that the temperature runs on as is wished; at most twice as fast as the last."""
    limited = OF_LIMIT * p.test_excursion
    wished = OVERSHOOT if OVERSHOOT < limited else limited
    share = wished / overshoot if overshoot > wished / FASTER else FASTER
    rate = rate * share
    rate = FASTEST * p.test_rate if rate > FASTEST * p.test_rate else rate
    return SLOWEST * p.test_rate if rate < SLOWEST * p.test_rate else rate


@exact
def step(e, command, enabled, p, memory):
    """One sample of the test: (command, Memory).  e: error from ``reference``, K, positive where the valve should open.

    The phase is OFF after the last sample, and after an abort.
    """
    m = memory
    elapsed, since = m.elapsed + p.sample_time, m.since + p.sample_time
    begins = since <= 0.0 or (m.phase == SETTLE and since <= p.test_settle - WATCHED)
    lowest = e if begins or e < m.lowest else m.lowest
    highest = e if begins or e > m.highest else m.highest

    at_end = (m.direction > 0.0 and command >= 1.0) or (m.direction < 0.0 and command <= 0.0)
    passed = at_end or m.direction * e < -p.test_threshold or abs(command - m.turned_at) >= FARTHEST
    settled = m.phase == SETTLE and since >= p.test_settle
    reached = m.phase == RAMP and passed
    turns = m.phase == HOLD and since >= p.test_hold
    phase = RAMP if settled or turns else (HOLD if reached else m.phase)
    beyond = (-lowest if m.direction > 0.0 else highest) - p.test_threshold
    ramp = next_rate(m.ramp, beyond, p) if turns else m.ramp
    back = 1.0 if e > 0.0 else -1.0
    direction = back if settled else (-m.direction if turns else m.direction)
    turned_at = command if settled or turns else m.turned_at
    moved = command + (direction * ramp * p.sample_time if phase == RAMP else 0.0)

    aborted = SWING if settled and highest - lowest > CALM else NO
    # turning there is enough where the temperature has come back
    aborted = END_OF_STROKE if m.phase == RAMP and at_end and m.direction * e > 0.0 else aborted
    no_room = (e < 0.0 and command <= 0.0) or (e > 0.0 and command >= 1.0)
    aborted = END_OF_STROKE if elapsed <= 0.0 and no_room else aborted
    limit = p.test_excursion * (AT_FIRST if m.ramps == 0.0 else 1.0)
    aborted = EXCURSION if abs(e) > limit else aborted
    over = elapsed >= 60.0 * p.test_minutes
    aborted = NO if over else (aborted if enabled else DISABLED)
    ends = over or aborted != NO
    changes = phase != m.phase
    ramps = m.ramps + (1.0 if reached else 0.0)
    after = Memory(OFF if ends else phase, elapsed, 0.0 if changes else since, direction, ramp, turned_at, m.reference,
                   e if changes else lowest, e if changes else highest, ramps, m.mean, aborted)  # fmt: skip
    return command if aborted != NO else clipped(moved), after
