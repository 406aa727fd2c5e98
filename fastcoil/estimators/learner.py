"""The self-learning rule of section 3.3: step the estimate up until the mode switches chatter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fastcoil.control.pi import sample_number
from fastcoil.estimators.family import Estimator
from fastcoil.numerics.jit import exact
from fastcoil.outputs import LEARNING_STATUS

ENOUGH, QUIET, UNMEASURABLE = 0.0, 1.0, 2.0


@exact
def switch_frequency(switches, interval):
    """Mode switches per 10 min over an interval in s."""
    return switches / (interval / 600.0)


@exact
def chatters(f, f_ref, ratio, floor):
    """Whether f exceeds ``ratio`` times the reference frequency; the paper's 200 % is ratio = 2, floor = 0."""
    reference = floor if f_ref < floor else f_ref
    return f > ratio * reference


@exact
def evidence(switches, f, f_ref, sample_time, min_switches, max_reference):
    """Whether an interval is ENOUGH evidence for a step, too QUIET, or UNMEASURABLE as a reference.

    f_ref: negative until there is a reference.  A controller switches at most once a sample: a reference near that
    limit cannot be exceeded ``ratio`` times, whatever the backlash.  With ``min_switches`` 0 and ``max_reference`` 1
    every interval is enough, as in the paper.
    """
    unmeasurable = f_ref < 0.0 and f > max_reference * 600.0 / sample_time
    reason = UNMEASURABLE if unmeasurable else ENOUGH
    return QUIET if switches < min_switches else reason


@exact
def updated(x_hat, step, down, lower, cap):
    """Estimate after an update: one step down when it chatters, else one up, within lower–cap."""
    stepped = x_hat - step if down else x_hat + step
    stepped = lower if stepped < lower else stepped
    return cap if stepped > cap else stepped


@exact
def step_size(last, down, climbing, growth):
    """Next step: it grows during the first climb of the estimate; a step down undoes the last one up."""
    return last * growth if climbing and not down else last


@exact
def final_estimate(x_hat, factor, lower):
    """Estimate to keep when learning stops: slightly too low is safer than slightly too high."""
    kept = x_hat * factor
    return lower if kept < lower else kept


class Parameters(NamedTuple):
    """Parameters of the loop that the learner uses."""

    sample_time: float
    backlash_estimate: float
    learning_step: float
    learning_interval: float
    learning_ratio: float
    learning_floor: float
    learning_cap: float
    learning_min_switches: float
    learning_max_reference: float
    learning_early_trip: float
    learning_growth: float
    learning_shrink: float
    learning_final: float
    learning_stop: float


class Memory(NamedTuple):
    """What the learner remembers."""

    next_update: float
    """End of the interval, s."""
    switches: float
    """Mode switches before the interval."""
    reference: float
    """Switch frequency of the first interval, per 10 min; negative until there is one."""
    learning: float
    """1 until learning is over."""
    climbing: float
    """1 until the first step down."""
    step: float
    """Last step."""
    evidence: float
    """What the last interval was worth: ENOUGH, QUIET, UNMEASURABLE."""
    moved_at: float
    """Time of the last step, s; negative before the first."""
    moved_to: float
    """Estimate after it."""
    down: float
    """1 if it was one down."""
    time_first_down: float
    estimate_first_down: float


@exact
def start(p):
    """Memory at the start: the first interval has no reference yet."""
    before = p.learning_step / p.learning_growth  # as if one step had gone up before
    return Memory(p.learning_interval, 0.0, -1.0, 1.0, 1.0, before, ENOUGH, -1.0, np.nan, 0.0, np.nan, np.nan)


@exact
def step(now, p, memory):
    """Update the estimate where an interval ends or, with an early trip, as soon as it chatters."""
    learning, climbing = memory.learning > 0.0, memory.climbing > 0.0
    switches = now.switches - memory.switches
    f = switch_frequency(switches, p.learning_interval)
    ends = memory.next_update == now.t
    good = evidence(switches, f, memory.reference, p.sample_time, p.learning_min_switches, p.learning_max_reference)
    enough = good == ENOUGH
    reference = f if learning and ends and memory.reference < 0.0 and enough else memory.reference
    down = chatters(f, reference, p.learning_ratio, p.learning_floor)
    # for the sake of other lanes this may run more often than this one samples
    samples = sample_number(now.t, p.sample_time) * p.sample_time == now.t
    trips = p.learning_early_trip > 0.0 and reference >= 0.0 and down and samples
    acts = learning and (ends or trips)
    moves = acts and enough

    size = step_size(memory.step, down, climbing, p.learning_growth)
    moved_to = updated(now.estimate, size, down, p.backlash_estimate, p.learning_cap)
    first_down = moves and down and climbing
    stops = first_down and p.learning_stop > 0.0
    x_hat = final_estimate(moved_to, p.learning_final, p.backlash_estimate) if stops else moved_to
    after = Memory(
        now.t + p.learning_interval if acts else memory.next_update,
        now.switches if acts else memory.switches,
        reference,
        0.0 if stops else memory.learning,
        0.0 if first_down else memory.climbing,
        (size * p.learning_shrink if down else size) if moves else memory.step,
        good if acts else memory.evidence,
        now.t if moves else memory.moved_at,
        moved_to if moves else memory.moved_to,
        (1.0 if down else 0.0) if moves else memory.down,
        now.t if first_down else memory.time_first_down,
        moved_to if first_down else memory.estimate_first_down,
    )
    return x_hat if moves else now.estimate, after


@exact
def confirms(t, p, memory, x_bl, reached, confirmed):
    """Times of the first step that reached the backlash x_bl to half a step, and of the first one down after it."""
    moved = memory.moved_at == t
    there = moved and memory.moved_to >= x_bl - 0.5 * p.learning_step - 1e-12
    reached = t if there and np.isnan(reached) else reached
    back = moved and memory.down > 0.0 and reached <= t
    return reached, t if back and np.isnan(confirmed) else confirmed


def periods(rows: Mapping[str, np.ndarray]) -> np.ndarray:
    """Seconds that the learners of a block act at multiples of: intervals, and samples where trips are early."""
    early = rows["learning_early_trip"] > 0.0
    return np.concatenate([rows["learning_interval"], rows["sample_time"][early]])


def results(memory: Memory) -> dict[str, np.ndarray]:
    """The learner's own metrics at the end of a run."""
    word = LEARNING_STATUS.index
    no_reference = np.where(memory.evidence == QUIET, word("no_evidence"), word("not_identifiable"))
    climbing = np.where(
        (np.asarray(memory.reference) >= 0.0) | (memory.evidence == ENOUGH), word("learning"), no_reference
    )
    down = np.where(np.asarray(memory.learning) > 0.0, word("stepped_down"), word("stopped"))
    return {
        "learn_time_first_down": np.asarray(memory.time_first_down),
        "estimate_first_down": np.asarray(memory.estimate_first_down),
        "learning_status": np.where(np.isnan(memory.time_first_down), climbing, down),
    }


LEARNER = Estimator("learner", Parameters, Memory, step, start, periods, confirms, results)
