"""The self-learning rule of section 3.3: step the estimate up until the mode switches chatter."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fastcoil.model.estimators.interface import Estimator, is_sample
from fastcoil.model.metric_table import LEARNING_STATUS_MEANINGS
from fastcoil.model.numerics.jit import exact

# what an interval is worth, see ``classify_interval``
EVIDENCE_ENOUGH = 0.0
EVIDENCE_QUIET = 1.0
EVIDENCE_UNMEASURABLE = 2.0
SET_POINT_STEP_K = 0.1  # change between two samples that is a step
SETTLING_TIME_S = 600.0  # time after it, or after an end of the valve, in which the error is not due to the estimate


@exact
def switch_frequency(switches, interval):
    """Mode switches per 10 min over an interval in s."""
    return switches / (interval / 600.0)


@exact
def is_chatter(f, f_ref, ratio, floor):
    """Whether f exceeds ``ratio`` times the reference frequency; the paper's 200 % is ratio = 2, floor = 0."""
    reference = floor if f_ref < floor else f_ref
    return f > ratio * reference


@exact
def classify_interval(switches, f, f_ref, sample_time, min_switches, max_reference):
    """Return what an interval is worth: enough for a step, too quiet, or unmeasurable as a reference.

    f_ref: negative until there is a reference.  A controller switches at most once a sample: a reference near that
    limit cannot be exceeded ``ratio`` times, whatever the backlash.  With ``min_switches`` 0 and ``max_reference`` 1
    every interval is enough, as in the paper.
    """
    is_unmeasurable = f_ref < 0.0 and f > max_reference * 600.0 / sample_time
    evidence = EVIDENCE_UNMEASURABLE if is_unmeasurable else EVIDENCE_ENOUGH
    return EVIDENCE_QUIET if switches < min_switches else evidence


@exact
def is_error_worse(squares, n, reference_squares, reference_n, ratio):
    """Whether the rms of n errors, given sums of squares, exceeds ``ratio`` times the reference; never at 0."""
    return ratio > 0.0 and squares * reference_n > ratio * ratio * reference_squares * n


@exact
def next_estimate(x_hat, step, down, lower, cap):
    """Estimate after an update: one step down when it chatters, else one up, within lower–cap."""
    estimate = x_hat - step if down else x_hat + step
    estimate = lower if estimate < lower else estimate
    return cap if estimate > cap else estimate


class Parameters(NamedTuple):
    """Parameters of the loop that the learner reads."""

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
    learning_reference: float
    learning_error_ratio: float


class Memory(NamedTuple):
    """State from one sample to the next."""

    next_update: float  # end of the interval, s
    switches: float  # mode switches before the interval
    reference: float  # switch frequency of the first interval, per 10 min; negative until there is one
    learning: float  # 1 until learning is over
    climbing: float  # 1 until the first step down
    step: float  # last step
    evidence: float  # what the last interval was worth: EVIDENCE_ENOUGH, EVIDENCE_QUIET or EVIDENCE_UNMEASURABLE
    moved_at: float  # time of the last step, s; negative before the first
    moved_to: float  # estimate after it
    last_was_down: float  # 1 if it went down
    time_first_down: float
    estimate_first_down: float
    n_averaged: float  # intervals in the mean that is the reference, so far; -1 in the interval that is left out
    frequencies: float  # sum of their switch frequencies, per 10 min
    squares: float  # sum of the squares of the settled control errors in the interval, K²
    n_errors: float  # number of these errors
    reference_squares: float  # the same in all intervals of the reference
    reference_n_errors: float
    T_set: float  # set-point at the last sample, °C
    settled_from: float  # time from which the error is settled, s


@exact
def initial_memory(p):
    """Memory at the start: the first interval has no reference yet."""
    step_before = p.learning_step / p.learning_growth  # as if one step had gone up before
    n_averaged = -1.0 if p.learning_reference > 0.0 else 0.0
    return Memory(
        p.learning_interval, 0.0, -1.0, 1.0, 1.0, step_before, EVIDENCE_ENOUGH, -1.0, np.nan, 0.0, np.nan, np.nan,
        n_averaged, 0.0, 0.0, 0.0, 0.0, 0.0, np.nan, 0.0,
    )  # fmt: skip


@exact
def update_estimate(now, p, memory):
    """Update the estimate where an interval ends or, with an early trip, as soon as it chatters."""
    is_due = is_sample(now.t, p.sample_time)
    sees_error = is_due and p.learning_error_ratio > 0.0
    at_end = now.u <= 0.0 or now.u >= 1.0
    counts = sees_error and now.t > memory.settled_from and not at_end
    squares = memory.squares + now.e * now.e if counts else memory.squares
    n_errors = memory.n_errors + 1.0 if counts else memory.n_errors
    unsettles = sees_error and (at_end or abs(now.T_set - memory.T_set) > SET_POINT_STEP_K)

    learning, climbing = memory.learning > 0.0, memory.climbing > 0.0
    switches = now.switches - memory.switches
    f = switch_frequency(switches, p.learning_interval)
    # one that ends while a valve test runs is taken at the first sample after it
    ends = now.t >= memory.next_update and (is_due or now.t == memory.next_update)
    evidence = classify_interval(
        switches, f, memory.reference, p.sample_time, p.learning_min_switches, p.learning_max_reference
    )
    is_enough = evidence == EVIDENCE_ENOUGH
    is_start_up = memory.n_averaged < 0.0
    joins = learning and ends and is_enough and memory.reference < 0.0 and not is_start_up
    n_averaged = memory.n_averaged + 1.0 if joins or (is_start_up and ends) else memory.n_averaged
    frequencies = memory.frequencies + f if joins else memory.frequencies
    completes = joins and n_averaged >= p.learning_reference
    reference = frequencies / n_averaged if completes else memory.reference
    chatter = is_chatter(reference if completes else f, reference, p.learning_ratio, p.learning_floor)
    rises = is_error_worse(
        squares, n_errors, memory.reference_squares, memory.reference_n_errors, p.learning_error_ratio
    )
    down = chatter or (ends and memory.reference >= 0.0 and rises)
    trips = p.learning_early_trip > 0.0 and reference >= 0.0 and chatter and is_due
    acts = learning and (ends or trips)
    moves = acts and is_enough and reference >= 0.0

    # it grows during the first climb; a step down undoes the last one up
    size = memory.step * p.learning_growth if climbing and not down else memory.step
    moved_to = next_estimate(now.estimate, size, down, p.backlash_estimate, p.learning_cap)
    first_down = moves and down and climbing
    stops = first_down and p.learning_stop > 0.0
    kept = moved_to * p.learning_final  # slightly too low is safer than slightly too high
    kept = p.backlash_estimate if kept < p.backlash_estimate else kept
    x_hat = kept if stops else moved_to
    next_memory = Memory(
        now.t + p.learning_interval if acts else memory.next_update,
        now.switches if acts else memory.switches,
        reference,
        0.0 if stops else memory.learning,
        0.0 if first_down else memory.climbing,
        (size * p.learning_shrink if down else size) if moves else memory.step,
        evidence if acts else memory.evidence,
        now.t if moves else memory.moved_at,
        moved_to if moves else memory.moved_to,
        (1.0 if down else 0.0) if moves else memory.last_was_down,
        now.t if first_down else memory.time_first_down,
        moved_to if first_down else memory.estimate_first_down,
        n_averaged,
        frequencies,
        0.0 if acts else squares,
        0.0 if acts else n_errors,
        memory.reference_squares + squares if joins else memory.reference_squares,
        memory.reference_n_errors + n_errors if joins else memory.reference_n_errors,
        now.T_set if sees_error else memory.T_set,
        now.t + SETTLING_TIME_S if unsettles else memory.settled_from,
    )
    return x_hat if moves else now.estimate, next_memory


@exact
def learn_times(t, p, memory, x_bl, reached, confirmed):
    """Times of the first step that reached the backlash x_bl to half a step, and of the first one down after it."""
    has_stepped = memory.moved_at == t
    has_reached = has_stepped and memory.moved_to >= x_bl - 0.5 * p.learning_step - 1e-12
    reached = t if has_reached and np.isnan(reached) else reached
    steps_back = has_stepped and memory.last_was_down > 0.0 and reached <= t
    return reached, t if steps_back and np.isnan(confirmed) else confirmed


def acting_periods(rows: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the seconds at whose multiples the learners of a block act: intervals, and samples where these count."""
    count = (rows["learning_early_trip"] > 0.0) | (rows["learning_error_ratio"] > 0.0) | (rows["test_start"] >= 0.0)
    return np.concatenate([rows["learning_interval"], rows["sample_time"][count]])


def is_error_watched(rows: Mapping[str, np.ndarray]) -> bool:
    """Whether any learner of a block looks at the control error."""
    return bool(np.any(rows["learning_error_ratio"] > 0.0))


def final_metrics(memory: Memory) -> dict[str, np.ndarray]:
    """Return the metrics of the learner at the end of a run, by name."""
    flag = LEARNING_STATUS_MEANINGS.index
    no_reference = np.where(memory.evidence == EVIDENCE_QUIET, flag("no_evidence"), flag("not_identifiable"))
    has_reference = (np.asarray(memory.reference) >= 0.0) | (memory.evidence == EVIDENCE_ENOUGH)
    climbing = np.where(has_reference, flag("learning"), no_reference)
    after_step_down = np.where(np.asarray(memory.learning) > 0.0, flag("stepped_down"), flag("stopped"))
    return {
        "learn_time_first_down": np.asarray(memory.time_first_down),
        "estimate_first_down": np.asarray(memory.estimate_first_down),
        "learning_status": np.where(np.isnan(memory.time_first_down), climbing, after_step_down),
    }


ESTIMATOR = Estimator(
    "learner", Parameters, Memory, update_estimate, initial_memory, acting_periods, learn_times, final_metrics,
    sees_error=is_error_watched,
)  # fmt: skip
