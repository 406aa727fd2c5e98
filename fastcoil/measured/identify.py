"""The backlash of a valve from the command and the supply temperature of a trend log, or why the log does not show it.

First the command: what moved it, and whether it and the temperature are of one clock.  Then the likelihood of each
candidate backlash, from a linear model that is solved for all candidates at once.

The model is an ARIX: the change of the temperature over half a minute from its own changes before, those of known
disturbances, and those of the opening and of its square, each a mean over half a minute that ends before the sample.
It is linear in all but the backlash, so that each candidate takes one small set of normal equations (separable least
squares, as in Jelali 2008).  The coefficients of the opening have a wide normal prior and are integrated out.

Closed loops have a trap.  The command between two samples answers temperatures that the model has not seen, so that
the command alone predicts the temperature, and a candidate of 0 is its opening.  ``reaction`` gives the command
coefficients of its own; then only what the play operator changes counts.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs.series import format_count
from fastcoil.measured.agreement import imply_pi
from fastcoil.measured.grid import forward_fill, is_range_good, mean_openings, motor_positions
from fastcoil.measured.measures import is_in_control
from fastcoil.measured.part import count_reversals

LEAST_SET_POINT_CHANGE, LEAST_SET_POINT_CHANGES = 0.3, 2
JUMP_QUANTILE, JUMP_FACTOR, LEAST_JUMPS, JUMP_SPACING_S = 0.9, 4.0, 3, 600.0
"""What a change of the command leaves unexplained is a jump if it exceeds this quantile of all that many times.  A
start-up makes some, so that three are asked for, these many seconds apart."""
FEWEST_COMMAND_CHANGES, END_TOLERANCE = 40, 1e-3
LEAST_BACK_AND_FORTH = 0.01  # of the stroke: what a command moves one way and straight back, sample by sample


def is_provoked(command: Array, temperature: Array, good: Mask, T_set: Array | None, interval: float) -> bool:
    """Whether the set-point changed; where the log has none, whether the command jumped as it does then.

    A PI controller answers temperatures alone: its command changes by a linear function of the last temperatures and
    their changes.  What a robust fit of that leaves is 0 but for changes of the set-point, and the like.
    """
    if T_set is not None:
        changed = np.abs(np.diff(np.asarray(T_set, float)))[good[1:] & good[:-1]]
        return bool(np.sum(changed >= LEAST_SET_POINT_CHANGE) >= LEAST_SET_POINT_CHANGES)
    at = np.flatnonzero(np.diff(command) != 0.0) + 1
    if at.size < FEWEST_COMMAND_CHANGES:
        return False
    now, before, long_before = at[2:], at[1:-1], at[:-2]
    is_unbroken = is_range_good(good, long_before, now)
    for end in (now, before):  # a command at its end does not follow the law
        is_unbroken &= (command[end] > END_TOLERANCE) & (command[end] < 1.0 - END_TOLERANCE)
    now, before, long_before = now[is_unbroken], before[is_unbroken], long_before[is_unbroken]
    if now.size < FEWEST_COMMAND_CHANGES:
        return False
    last_change, change_before = temperature[now] - temperature[before], temperature[before] - temperature[long_before]
    X = np.stack([last_change, change_before, temperature[now], np.ones(now.size)], axis=1)
    residual = np.abs(_robust_residual(X, command[now] - command[before]))
    jumps = now[residual > JUMP_FACTOR * np.quantile(residual, JUMP_QUANTILE)]
    return jumps.size > 0 and 1 + int(np.sum(np.diff(jumps) * interval > JUMP_SPACING_S)) >= LEAST_JUMPS


def back_and_forth_share(command: Array, good: Mask) -> float:
    """Share of samples at which the command moves back what it moved before, or more: the stem may move unseen."""
    changes = np.diff(command)
    is_good = good[2:] & good[1:-1] & good[:-2]
    is_turn = (changes[1:] * changes[:-1] < 0.0) & (
        np.minimum(np.abs(changes[1:]), np.abs(changes[:-1])) > LEAST_BACK_AND_FORTH
    )
    return float(np.mean(is_turn[is_good])) if is_good.any() else 0.0


def count_end_arrivals(command: Array, good: Mask) -> int:
    """How often the command arrives at one of its ends."""
    at_end = (command <= END_TOLERANCE) | (command >= 1.0 - END_TOLERANCE)
    return int(np.sum(at_end[1:] & ~at_end[:-1] & good[1:] & good[:-1]))


def _robust_residual(X: Array, y: Array) -> Array:
    """What a linear model leaves, fitted without the largest tenth of what it leaves."""
    coefficients = np.linalg.lstsq(X, y, rcond=None)[0]
    for _ in range(3):
        residual = np.abs(y - X @ coefficients)
        is_inlier = residual <= np.quantile(residual, JUMP_QUANTILE)
        coefficients = np.linalg.lstsq(X[is_inlier], y[is_inlier], rcond=None)[0]
    return np.asarray(y - X @ coefficients)


PREDICTION_HORIZON_S = 30.0
"""Seconds over which the model predicts: long against the noise of a sensor, short against a coil.  An interval, where
the log has longer ones."""
TEMPERATURE_LAGS, OPENING_LAGS, DISTURBANCE_LAGS = 8, 4, 3
"""Changes of the temperature, the opening and each known disturbance that enter, one a horizon."""
PRIOR_PRECISION = 0.01
"""Of the prior of the opening's coefficients, 1/K²: each is known to ± 10 K per stroke before the log is read."""
MODEL_ERROR = 0.1
"""Share of what the stem explains that counts as if it were noise: coil and valve curve are not linear, and where the
temperature swings far, as in a loop that hunts, that is what the residuals are made of."""
LEAST_ROWS = 60


class Likelihood(NamedTuple):
    """Log-likelihood of each candidate, without and with coefficients for the command itself; rows that it rests on."""

    without_command: Array
    with_command: Array
    rows: int


def likelihoods(
    temperature: Array, positions: Array, disturbances: Iterable[Array], good: Mask, interval: float, candidates: Array
) -> Likelihood | None:
    """Compare candidate sizes of the backlash, fractions of stroke from 0; None if the log is too short.

    temperature: (n,), °C.  positions: (n + 1,), of the motor.  disturbances: each (n,), what else moves the temperature
    and is in the log.  good: (n,), samples that may be used; a row of the model uses all its lags or is left out.
    """
    n, width = temperature.size, max(1, round(PREDICTION_HORIZON_S / interval))
    span = (max(TEMPERATURE_LAGS, OPENING_LAGS) + 1) * width + 1
    rows = np.arange(-(-span // width) * width, n, width)
    rows = rows[is_range_good(good, rows - span + 1, rows)]
    if rows.size < LEAST_ROWS:
        return None

    def change(series: Array, lag: int) -> Array:
        return np.asarray(series[rows - lag * width] - series[rows - (lag + 1) * width])

    y = change(temperature, 0)
    common = [change(temperature, lag) for lag in range(1, TEMPERATURE_LAGS + 1)]
    common += [change(series, lag) for series in disturbances for lag in range(DISTURBANCE_LAGS)]
    Z, _ = np.linalg.qr(np.stack([*common, np.ones(rows.size)], axis=1))
    y = y - Z @ (Z.T @ y)
    total, freedom = float(y @ y), rows.size - Z.shape[1]
    if total <= 0.0:
        return None
    # positions after the last sample have no temperature
    gram, product = _normal_equations(positions[:n], candidates, width, rows, Z, y)
    k = 2 * OPENING_LAGS
    without_command = _evidence(gram[:, :k, :k], product[:, :k], total, freedom)
    return Likelihood(without_command, _evidence(gram, product, total, freedom), rows.size)


def _normal_equations(
    positions: Array, candidates: Array, width: int, rows: Index, Z: Array, y: Array
) -> tuple[Array, Array]:
    """Left and right sides for each candidate, for what is orthogonal to Z: its opening, the square, then the motor."""
    # the piece that ends at sample r is r / width - 1
    ends, k = rows // width - 2, 2 * OPENING_LAGS
    X = np.empty((candidates.size, k, rows.size))
    for first, means in enumerate(mean_openings(positions, candidates, width)):
        changes = np.ascontiguousarray(np.diff(means, axis=0).T)
        for lag in range(OPENING_LAGS):
            X[:, first * OPENING_LAGS + lag] = changes[:, ends - lag]
    motor = np.diff(mean_openings(positions, np.zeros(1), width)[0][:, 0])
    M = np.stack([motor[ends - lag] for lag in range(OPENING_LAGS)])
    M -= (M @ Z) @ Z.T
    in_common = (X.reshape(-1, rows.size) @ Z).reshape(candidates.size, k, -1)
    gram = np.empty((candidates.size, k + len(M), k + len(M)))
    gram[:, :k, :k] = X @ X.transpose(0, 2, 1) - in_common @ in_common.transpose(0, 2, 1)
    gram[:, :k, k:] = X @ M.T
    gram[:, k:, :k] = gram[:, :k, k:].transpose(0, 2, 1)
    gram[:, k:, k:] = M @ M.T
    return gram, np.concatenate([X @ y, np.broadcast_to(M @ y, (candidates.size, len(M)))], axis=1)


def _evidence(gram: Array, product: Array, total: float, freedom: int) -> Array:
    """Log-likelihood with the coefficients integrated out, for each candidate."""
    unit = np.eye(gram.shape[1])
    precision = PRIOR_PRECISION * total / freedom
    coefficients = np.linalg.solve(gram + precision * unit, product[..., np.newaxis])[..., 0]
    residual_sum = np.maximum(total - np.sum(product * coefficients, axis=1), 1e-12 * total)
    residual_sum += MODEL_ERROR * (total - residual_sum.min())
    return np.asarray(
        -0.5 * freedom * np.log(residual_sum / total) - 0.5 * np.linalg.slogdet(unit + gram / precision)[1]
    )


CANDIDATES = np.arange(0.0, 0.2501, 0.0025)  # sizes that are tried, fractions of stroke
LEAST_CERTAINTY = 0.95  # probability of being right from which a size counts as identified
CONFIDENCE = 0.95  # of the interval
LIKELIHOOD_WEIGHT, REACTION_WEIGHT, POOLED_WEIGHT = 0.8, 0.3, 0.6
"""Share of the log-likelihood that counts, without and with the reaction, and with it where many days are pooled:
residuals are neither independent nor normal.  Chosen on populations of other seeds than ``studies/diagnosis`` has."""
MANY_DAYS, MOST_STEADY_WEIGHT, LEAST_AGREEMENT = 4, 6.0, 2.0
"""Days from which on they are many; what constant set-points weigh at most, all days together, since what a linear
model gets wrong repeats itself; standard errors between days by which these have to prefer a size to any other."""
SIZE_TOLERANCE, GOOD_BACKLASH = 0.2, 0.01
"""A size is known if it is right to this share of itself or of the stroke; up to ``GOOD`` a valve is called good."""
LEAST_ODDS = 300.0
"""Of the most probable size against the most probable one of a good valve, for a valve to be called worse than good."""
_IS_GOOD_CANDIDATE = CANDIDATES <= GOOD_BACKLASH + 1e-9
USUAL_STROKE_TIME = 90.0  # s, where it is not given
UNSEEN_TURN_SHARE = (
    0.1  # share of itself by which a gap may be larger than is shown by a log whose samples miss turns of the valve
)
LEAST_TURN_SIZE = 0.005
LEAST_TURNS = 3
"""Turns by more than the gap below which no size is claimed: those of the study ``least_movement`` were all wrong."""
MOST_ARRIVALS, ARRIVAL_SWING = (10, 0.2), 0.05
"""Of the command at its ends: that many, and that share of its turns by more than ``SWING``."""
LONGEST_INTERVAL = 60.0
CLOCK_SHIFTS_S, LARGEST_SHIFT_GAIN, LEAST_PLACEBO_MARGIN = (60.0, 120.0, 180.0), 10.0, 10.0
"""Seconds by which the command is moved to see whether it explains the temperature better at another time; by how much
the logarithm of the likelihood may rise, and by how much it has to exceed that of placebos."""
MOST_BACK_AND_FORTH, JUMPY_WEIGHT = 0.01, 0.5
"""Share of the samples at which the command may move back what it moved the sample before; the share of the likelihood
that counts of a log with more, which claims nothing alone."""
MORE_EVIDENCE_CURE = "step the set-point up and down, or log longer"
_JUMPY_COMMAND = (
    "the command jumps back and forth from sample to sample, so movements of the stem between samples may be missed: "
    "log at the controller's sample time, state that time (sample_time, --sample-time) and step the set-point up and "
    "down, or give four days or more"
)


class Identification(NamedTuple):
    """The backlash as a log shows it."""

    backlash: float  # the most probable size, fraction of stroke; NaN where the log was not fit to compare any
    low: float  # interval of 95 %
    high: float
    identified: bool  # whether the size is right, to 20 % of itself or 1 % of stroke, with 95 % probability
    reason: str  # why not; empty if identified
    probability: Array  # of each of ``CANDIDATES``
    temperature_lag: float = 0.0
    """Seconds by which the temperatures of the log stand late beside the commands; they were moved back by that.
    Negative: the commands stand late, or their controller is slow to read; both were reckoned with."""


class DayEvidence(NamedTuple):
    """What one day of a log shows of the backlash."""

    likelihoods: list[Likelihood]  # of each way in which the columns may fit in time; none where nothing can be compared
    provoked: bool = False  # whether something else than the temperature moved the command
    doubt: str = ""  # why nothing may be claimed of this day, if so
    weight: float = 1.0  # share of the likelihood that counts, less where the valve moves between the samples
    temperature_lag: float = 0.0
    unseen_share: float = 0.0  # share of the gap that turns between the samples may hide
    is_jumpy: bool = False  # whether the command jumps to and fro, and so few days claim nothing
    positions: Array = np.zeros(1)  # of the motor, fractions of stroke


def identify_backlash(*log: Any, **options: Any) -> Identification:
    """Identify the backlash of a valve from a trend log; the arguments are those of ``gather_evidence``."""
    return combine_days([gather_evidence(*log, **options)])


def combine_days(days: Sequence[DayEvidence]) -> Identification:
    """The backlash of a valve from what each of its days shows: one gap, a plant of its own every day.

    Days with a doubt do not count where half of the days or more have none.  Where there are many, each may show what
    moved between its samples.
    """
    compared, doubt = [day for day in days if day.likelihoods], ""
    if not compared:
        flat, reason = np.full(CANDIDATES.size, 1.0 / CANDIDATES.size), _most_frequent([day.doubt for day in days])
        return Identification(np.nan, 0.0, float(CANDIDATES[-1]), False, reason, flat)
    has_many_days = len(compared) >= MANY_DAYS
    compared = [
        day._replace(doubt=day.doubt or _JUMPY_COMMAND) if day.is_jumpy and not has_many_days else day
        for day in compared
    ]
    sound = [day for day in compared if not day.doubt]
    if 2 * len(sound) >= len(compared):
        compared = sound
    else:
        doubt = _most_frequent([day.doubt for day in compared if day.doubt])
    provoked = any(day.provoked for day in compared)
    steady_weight = min(POOLED_WEIGHT, MOST_STEADY_WEIGHT / len(compared)) if has_many_days else REACTION_WEIGHT
    log_likelihoods = np.array([_day_likelihood(day, steady_weight) for day in compared])
    logarithm = log_likelihoods.sum(axis=0)
    probability = np.exp(logarithm - np.logaddexp.reduce(logarithm))
    identification = judge_size(probability, provoked, doubt)
    if (
        identification.identified
        and has_many_days
        and not provoked
        and _day_agreement(log_likelihoods, identification.backlash) < LEAST_AGREEMENT
    ):
        identification = judge_size(
            probability, provoked, "the days show different gaps: step the set-point up and down on one"
        )
    n_turns = sum(count_reversals(day.positions, max(identification.low, LEAST_TURN_SIZE)) for day in compared)
    if identification.identified and n_turns < LEAST_TURNS:
        shortfall = f"the valve reversed only {format_count(n_turns, 'time')} by more than such a gap, and {LEAST_TURNS} reversals"
        identification = judge_size(probability, provoked, f"{shortfall} are needed: {MORE_EVIDENCE_CURE}")
    high = min(identification.high + max(day.unseen_share for day in compared) * identification.backlash, float(CANDIDATES[-1]))
    return identification._replace(high=high, temperature_lag=_most_frequent([day.temperature_lag for day in compared]))


def _day_likelihood(day: DayEvidence, steady_weight: float) -> Array:
    """What a day adds to the log-likelihood of each candidate; a constant set-point shows no good valve."""
    log_likelihoods = [
        day.weight * (LIKELIHOOD_WEIGHT * likelihood.without_command if day.provoked else steady_weight * likelihood.with_command)
        for likelihood in day.likelihoods
    ]
    combined = np.asarray(
        np.logaddexp.reduce(
            [log_likelihood - np.logaddexp.reduce(log_likelihood) for log_likelihood in log_likelihoods]
        )
    )
    return combined if day.provoked else np.minimum(combined, combined[~_IS_GOOD_CANDIDATE].max())


def _day_agreement(log_likelihoods: Array, backlash: float) -> float:
    """By how many standard errors the days prefer a size to the one that they prefer it least to."""
    others = np.abs(CANDIDATES - backlash) > max(SIZE_TOLERANCE * backlash, GOOD_BACKLASH) + 1e-9
    preferred = log_likelihoods[:, CANDIDATES == backlash] - log_likelihoods[:, others]
    errors = preferred.std(axis=0, ddof=1) / np.sqrt(len(log_likelihoods))
    return float(np.min(preferred.mean(axis=0) / np.maximum(errors, 1e-12)))


def _most_frequent(values: Sequence[Any]) -> Any:
    return Counter(values).most_common(1)[0][0]


def gather_evidence(
    command: Array, temperature: Array, interval: float, T_set: Array | None = None,
    disturbances: tuple[Array, ...] = (), enabled: Mask | None = None, stroke_time: float | None = None,
    sample_time: float | None = None, lag: float | None = None,
) -> DayEvidence:  # fmt: skip
    """What a trend log with a sample every ``interval`` s shows of the backlash of its valve.

    command, temperature: (n,), fraction of stroke, °C; NaN where missing.  T_set: °C, if the log has it.  disturbances:
    what else the log has that moves the temperature: air flow, entering air temperature.  enabled: whether the plant
    was on; all of it if None.  stroke_time: of the motor, s; 90 if None, 0 if it is as good as immediate.  sample_time:
    of the controller, s, if known.  lag: by which the temperature is known to be logged late, s; found if None.
    """
    command, temperature = np.asarray(command, float), np.asarray(temperature, float)
    good = np.isfinite(command) & np.isfinite(temperature)
    for series in disturbances:
        good &= np.isfinite(series)
    good = good if enabled is None else good & np.asarray(enabled, bool)
    if interval > LONGEST_INTERVAL:
        return DayEvidence(
            [],
            doubt=f"the log has only one sample every {interval:.4g} s: log every {PREDICTION_HORIZON_S:g} s or faster",
        )
    if not good.any():
        return DayEvidence([], doubt="no sample has both a command and a temperature with the plant on")
    stroke_time = USUAL_STROKE_TIME if stroke_time is None else stroke_time
    command, temperature, n = forward_fill(command), forward_fill(temperature), command.size
    positions = motor_positions(command, interval, stroke_time)
    if count_reversals(positions, LEAST_TURN_SIZE) == 0:
        return DayEvidence(
            [],
            doubt="the command never reverses, and a gap shows only at reversals: step the set-point up and down",
        )
    is_known = good if T_set is None else good & np.isfinite(T_set)
    law = imply_pi(
        command, temperature, None if T_set is None else forward_fill(np.asarray(T_set, float)), is_known, interval
    )
    samples = law.temperature_lag if lag is None else round(lag / interval)
    series = np.stack([temperature, *disturbances])

    def likelihood_at(shift: int, ends: int = 0, direction: int = 1, rolled: int = 0) -> Likelihood | None:
        """With T moved some samples earlier, or rolled to another hour; without some ends; backwards if way is -1."""
        command_slice = slice(max(-shift, 0) + ends, n - max(shift, 0) - ends)
        temperature_slice = slice(max(shift, 0) + ends, n - max(-shift, 0) - ends)
        positions_read = motor_positions(command[command_slice][::direction], interval, stroke_time)
        temperatures_read = np.roll(series[:, temperature_slice], rolled, axis=1)[:, ::direction]
        is_good = (good[command_slice] & np.roll(good[temperature_slice], rolled))[::direction]
        return likelihoods(temperatures_read[0], positions_read, temperatures_read[1:], is_good, interval, CANDIDATES)

    # a command that answers old temperatures may be that of a slow controller, and stand where it belongs
    readings = [
        likelihood
        for shift in ((0, samples) if samples < 0 and lag is None else (samples,))
        if (likelihood := likelihood_at(shift))
    ]
    if not readings:
        return DayEvidence(
            [],
            doubt="too little of the log is usable, or the temperature hardly changes: log for two hours or more",
        )
    provoked = is_provoked(command, temperature, good, T_set, interval)
    is_unseen = sample_time is None or sample_time < interval
    is_in_step = sample_time is not None and not is_unseen and (sample_time / interval) % 1.0 < 1e-6
    doubt, weight = "", min(1.0, PREDICTION_HORIZON_S / interval) if is_unseen else 1.0
    is_jumpy = back_and_forth_share(command, is_in_control(command, good, interval)) > MOST_BACK_AND_FORTH
    weight *= JUMPY_WEIGHT if is_jumpy else 1.0
    if law.is_another:
        doubt = (
            f"a PI of this temperature explains only {100 * law.explained:.3g} % of the command's changes: check that both "
            "belong to the same loop and the same clock; no size can be claimed for a loop with another control law"
        )
    elif law.ti < -interval:
        doubt = (
            "the command moves before the temperature change that it responds to: check that the rows are in "
            "chronological order and that both points share one clock"
        )
    elif provoked and (
        why_misplaced := _why_misplaced(likelihood_at, samples, interval, n, CLOCK_SHIFTS_S if lag is None else ())
    ):
        doubt = why_misplaced
    elif count_end_arrivals(command, good) > max(
        MOST_ARRIVALS[0], MOST_ARRIVALS[1] * count_reversals(positions, ARRIVAL_SWING)
    ):
        doubt = "the command keeps reaching 0 or 100 %: raise Ti until the loop is calm, then log again"
    unseen_share = UNSEEN_TURN_SHARE if is_unseen and interval > PREDICTION_HORIZON_S else 0.0
    return DayEvidence(readings, provoked, doubt, weight, samples * interval, unseen_share, is_jumpy and not (provoked and is_in_step),
                 positions)  # fmt: skip


def _why_misplaced(
    likelihood_at: Callable[..., Likelihood | None], samples: int, interval: float, n: int, shifts: Sequence[float]
) -> str:
    """Whether the command explains the temperature of another time as well, in words; empty if it does not.

    Other times are the same log backwards and its other hours, which are placebos, and clocks that differ by one of the
    ``shifts``, s: a shift counts that explains more, and with another gap.  It can be told only where something else
    than the temperature moved the command.
    """
    ends = int(CLOCK_SHIFTS_S[-1] / interval) + abs(samples)

    def best(shift: int, **options: int) -> tuple[float, float]:
        """The largest likelihood and the gap that has it."""
        evidence = likelihood_at(shift, ends - abs(shift), **options)
        return (float(evidence.without_command.max()), float(CANDIDATES[evidence.without_command.argmax()])) if evidence else (0.0, 0.0)

    likelihood, size = best(samples)
    if best(samples, direction=-1)[0] > likelihood - LEAST_PLACEBO_MARGIN:
        return (
            "the log fits just as well when it is read backwards: check that the command drives this valve, and that "
            "the rows are in chronological order"
        )
    if max(best(samples, rolled=quarters * n // 4)[0] for quarters in (1, 2, 3)) > likelihood - LEAST_PLACEBO_MARGIN:
        return (
            "the command explains the temperatures of other hours just as well: check that it drives this valve, or "
            "log longer"
        )
    for shift in shifts:
        shifted_likelihood, shifted_size = best(samples - round(shift / interval))
        if shifted_likelihood > likelihood + LARGEST_SHIFT_GAIN and abs(shifted_size - size) > max(
            SIZE_TOLERANCE * size, GOOD_BACKLASH
        ):
            return (
                f"the temperature fits a command logged {shift:g} s after it even better: check that both points share "
                "one clock, or give the lag between them (lag, --lag)"
            )
    return ""


def judge_size(
    probability: Array, provoked: bool, doubt: str, cure: str = MORE_EVIDENCE_CURE
) -> Identification:  # fmt: skip
    """The most probable size and whether it may be claimed.

    Where nothing but the temperature moved the command, the command itself has coefficients of its own, and a good
    valve is never claimed: a stem that stands still looks the same.
    """
    is_right = (
        np.abs(CANDIDATES[:, np.newaxis] - CANDIDATES) <= np.maximum(SIZE_TOLERANCE * CANDIDATES, GOOD_BACKLASH) + 1e-9
    )
    certainty = is_right @ probability
    best = int(probability.argmax())
    if certainty[best] < LEAST_CERTAINTY <= certainty.max():
        best = int(certainty.argmax())
    backlash = float(CANDIDATES[best])
    is_worse = bool(probability.max() >= LEAST_ODDS * probability[_IS_GOOD_CANDIDATE].max())
    if not doubt and backlash <= GOOD_BACKLASH and not provoked:
        doubt = (
            "the command only follows the temperature, so a stem that stands still looks like one without a gap: step "
            "the set-point"
        )
    low, high = (0.0, float(CANDIDATES[-1])) if doubt else _interval(probability)
    low, reason = low if is_worse else 0.0, doubt
    if not doubt and (certainty[best] < LEAST_CERTAINTY or (backlash > GOOD_BACKLASH and not is_worse)):
        sizes = f"gaps from {100 * low:.1f} % to {100 * high:.1f} %"
        reason = f"{sizes} explain the log: {cure}"
    elif not doubt and high >= CANDIDATES[-1]:
        reason = f"the gap may be {100 * high:.0f} % of the stroke or more; larger gaps are not tested"
    return Identification(backlash, low, high, not reason, reason, probability)


def _interval(probability: Array) -> tuple[float, float]:
    """The tails outside hold the same probability; a step of the candidates is added on both sides.

    Half of it is the width of a candidate, the rest for what a linear model sampled every 30 s gets wrong.
    """
    below, step = np.cumsum(probability), CANDIDATES[1] - CANDIDATES[0]
    low = CANDIDATES[np.argmax(below > 0.5 * (1.0 - CONFIDENCE))] - step
    high = CANDIDATES[np.argmax(below >= 0.5 * (1.0 + CONFIDENCE) - 1e-12)] + step
    return max(float(low), 0.0), min(float(high), float(CANDIDATES[-1]))
