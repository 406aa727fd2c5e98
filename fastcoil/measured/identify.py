"""Backlash of a valve from the command and supply temperature of a trend log, or why the log does not show it.

First the command: what moved it, and whether it and the temperature are of one clock.  Then the likelihood of each
candidate backlash, from one linear model for all candidates.

The model is an ARIX: the change of the temperature over half a minute from its own changes before, those of known
disturbances, and those of the opening and of its square, each a mean over half a minute that ends before the sample.
It is linear in all but the backlash, so that each candidate takes one small set of normal equations (separable least
squares, as in Jelali 2008).  The coefficients of the opening have a wide normal prior and are integrated out.

Closed loops have a trap.  The command between two samples answers temperatures that the model has not seen, so that the
command alone predicts the temperature, and a candidate of 0 is its opening.  ``Likelihood.with_command`` has
coefficients for the command; then only what the play operator changes counts.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs.series import format_count
from fastcoil.measured import thresholds
from fastcoil.measured.agreement import imply_pi
from fastcoil.measured.grid import forward_fill, is_range_good, mean_openings, motor_positions
from fastcoil.measured.measures import is_in_control
from fastcoil.measured.part import count_reversals

FEWEST_COMMAND_CHANGES = 40  # among which jumps of the command can be recognised
JUMP_QUANTILE = 0.9  # of what a robust fit of the command's changes leaves
END_TOLERANCE = 1e-3  # fraction of stroke, within which a command is at an end


def is_provoked(command: Array, temperature: Array, good: Mask, T_set: Array | None, interval: float) -> bool:
    """Whether the set-point changed by 0.3 K twice or, if it is not logged, the command jumped as if it had.

    A PI controller answers temperatures alone: its command changes by a linear function of the last temperatures and
    their changes.  The residual of a robust fit is 0 but for changes of the set-point and the like.
    """
    if T_set is not None:
        set_point_changes = np.abs(np.diff(np.asarray(T_set, float)))[good[1:] & good[:-1]]
        return bool(np.sum(set_point_changes >= 0.3) >= 2)  # K
    changes_at = np.flatnonzero(np.diff(command) != 0.0) + 1
    if changes_at.size < FEWEST_COMMAND_CHANGES:
        return False
    new, old, older = changes_at[2:], changes_at[1:-1], changes_at[:-2]
    is_unbroken = is_range_good(good, older, new)
    for end in (new, old):  # a command at its end does not follow the law
        is_unbroken &= (command[end] > END_TOLERANCE) & (command[end] < 1.0 - END_TOLERANCE)
    new, old, older = new[is_unbroken], old[is_unbroken], older[is_unbroken]
    if new.size < FEWEST_COMMAND_CHANGES:
        return False
    last_change, change_before = temperature[new] - temperature[old], temperature[old] - temperature[older]
    X = np.stack([last_change, change_before, temperature[new], np.ones(new.size)], axis=1)
    y, is_inlier = command[new] - command[old], np.ones(new.size, dtype=bool)
    for _ in range(4):
        residual = np.abs(y - X @ np.linalg.lstsq(X[is_inlier], y[is_inlier], rcond=None)[0])
        is_inlier = residual <= np.quantile(residual, JUMP_QUANTILE)
    jumps = new[residual > 4.0 * np.quantile(residual, JUMP_QUANTILE)]
    # a start-up makes some jumps, so three are needed, ten minutes apart
    return jumps.size > 0 and int(np.sum(np.diff(jumps) * interval > 600.0)) >= 2


def back_and_forth_share(command: Array, good: Mask) -> float:
    """Return the share of samples at which the command moves back at once, so that the stem may move unseen."""
    changes = np.diff(command)
    is_good = good[2:] & good[1:-1] & good[:-2]
    smaller = np.minimum(np.abs(changes[1:]), np.abs(changes[:-1]))
    is_turn = (changes[1:] * changes[:-1] < 0.0) & (smaller > 0.01)  # of the stroke
    return float(np.mean(is_turn[is_good])) if is_good.any() else 0.0


def count_end_arrivals(command: Array, good: Mask) -> int:
    """Count how often the command arrives at one of its ends."""
    is_at_end = (command <= END_TOLERANCE) | (command >= 1.0 - END_TOLERANCE)
    return int(np.sum(is_at_end[1:] & ~is_at_end[:-1] & good[1:] & good[:-1]))


HORIZON_S = 30.0  # long against the noise of a sensor, short against a coil; one interval in a coarser log
TEMPERATURE_LAGS = 8  # changes that enter the model, one a horizon
OPENING_LAGS = 4  # the same of the opening
DISTURBANCE_LAGS = 3  # and of each disturbance
PRIOR_PRECISION = 0.01  # 1/K²: coefficients of the opening are known to ± 10 K per stroke before the log is read
MODEL_ERROR = 0.1  # share of what the stem explains that counts as noise: coil and valve curve are not linear
LEAST_ROWS = 60  # of the model


class Likelihood(NamedTuple):
    """Log-likelihood of each candidate gap, of models without and with the command, and their number of rows."""

    without_command: Array
    with_command: Array
    rows: int
    outside_swing: float = 0.0  # largest power that the best model leaves at periods of 4 to 25 min, over the median
    outside_period: float = np.nan  # of that swing, s


def likelihoods(
    temperature: Array, positions: Array, disturbances: Iterable[Array], good: Mask, interval: float, candidates: Array
) -> Likelihood | None:
    """Compute the likelihood of candidate gaps, fractions of stroke from 0; None if the log is too short.

    temperature: (n,), °C.  positions: (n + 1,), of the motor.  disturbances: each (n,), what else moves the temperature
    and is in the log.  good: (n,), samples that may be used; a row of the model uses all its lags or is left out.
    """
    n, width = temperature.size, max(1, round(HORIZON_S / interval))
    span_samples = (max(TEMPERATURE_LAGS, OPENING_LAGS) + 1) * width + 1
    rows = np.arange(-(-span_samples // width) * width, n, width)
    rows = rows[is_range_good(good, rows - span_samples + 1, rows)]
    if rows.size < LEAST_ROWS:
        return None

    def lagged_change(series: Array, lag: int) -> Array:
        return np.asarray(series[rows - lag * width] - series[rows - (lag + 1) * width])

    y = lagged_change(temperature, 0)
    common = [lagged_change(temperature, lag) for lag in range(1, TEMPERATURE_LAGS + 1)]
    common += [lagged_change(series, lag) for series in disturbances for lag in range(DISTURBANCE_LAGS)]
    Z, _ = np.linalg.qr(np.stack([*common, np.ones(rows.size)], axis=1))
    y = y - Z @ (Z.T @ y)
    sum_of_squares, freedom = float(y @ y), rows.size - Z.shape[1]
    if sum_of_squares <= 0.0:
        return None
    # positions after the last sample have no temperature
    gram, product, X, M = _normal_equations(positions[:n], candidates, width, rows, Z, y)
    k = 2 * OPENING_LAGS
    without_command = _marginal_likelihood(gram[:, :k, :k], product[:, :k], sum_of_squares, freedom)
    with_command = _marginal_likelihood(gram, product, sum_of_squares, freedom)
    regressors = np.concatenate([X[with_command.argmax()], M])
    regressors -= (regressors @ Z) @ Z.T
    residual = y - np.linalg.lstsq(regressors.T, y, rcond=None)[0] @ regressors
    outside_swing, period = _find_outside_swing(residual, width * interval)
    return Likelihood(without_command, with_command, rows.size, outside_swing, period)


def _find_outside_swing(residual: Array, step: float) -> tuple[float, float]:
    """Find the largest power of a residual at periods of 4 to 25 min, over the median power; and its period, s."""
    power = np.abs(np.fft.rfft(residual * np.hanning(residual.size))) ** 2
    frequency = np.fft.rfftfreq(residual.size, step)
    is_swing = (frequency > 1.0 / 1500.0) & (frequency < 1.0 / 240.0)  # 1/s
    if not is_swing.any():
        return 0.0, np.nan
    k = int(np.argmax(np.where(is_swing, power, 0.0)))
    return float(power[k] / max(np.median(power[1:]), 1e-300)), float(1.0 / frequency[k])


def _normal_equations(
    positions: Array, candidates: Array, width: int, rows: Index, Z: Array, y: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the normal equations of each candidate: changes of opening, its square and motor, orthogonal to Z.

    Also return the changes themselves: of the openings, (candidates, lags, rows), and of the motor, (lags, rows).
    """
    # the piece that ends at sample r is r / width - 1
    end_blocks, k = rows // width - 2, 2 * OPENING_LAGS
    X = np.empty((candidates.size, k, rows.size))
    for power, means in enumerate(mean_openings(positions, candidates, width)):
        changes = np.ascontiguousarray(np.diff(means, axis=0).T)
        for lag in range(OPENING_LAGS):
            X[:, power * OPENING_LAGS + lag] = changes[:, end_blocks - lag]
    motor = np.diff(mean_openings(positions, np.zeros(1), width)[0][:, 0])
    M = np.stack([motor[end_blocks - lag] for lag in range(OPENING_LAGS)])
    M -= (M @ Z) @ Z.T
    in_common = (X.reshape(-1, rows.size) @ Z).reshape(candidates.size, k, -1)
    gram = np.empty((candidates.size, k + len(M), k + len(M)))
    gram[:, :k, :k] = X @ X.transpose(0, 2, 1) - in_common @ in_common.transpose(0, 2, 1)
    gram[:, :k, k:] = X @ M.T
    gram[:, k:, :k] = gram[:, :k, k:].transpose(0, 2, 1)
    gram[:, k:, k:] = M @ M.T
    return gram, np.concatenate([X @ y, np.broadcast_to(M @ y, (candidates.size, len(M)))], axis=1), X, M


def _marginal_likelihood(gram: Array, product: Array, sum_of_squares: float, freedom: int) -> Array:
    """Return the log-likelihood of each candidate from its normal equations, the coefficients integrated out."""
    unit = np.eye(gram.shape[1])
    precision = PRIOR_PRECISION * sum_of_squares / freedom
    coefficients = np.linalg.solve(gram + precision * unit, product[..., np.newaxis])[..., 0]
    residual_sum = np.maximum(sum_of_squares - np.sum(product * coefficients, axis=1), 1e-12 * sum_of_squares)
    residual_sum += MODEL_ERROR * (sum_of_squares - residual_sum.min())
    log_determinant = np.linalg.slogdet(unit + gram / precision)[1]
    return np.asarray(-0.5 * freedom * np.log(residual_sum / sum_of_squares) - 0.5 * log_determinant)


CANDIDATES = np.arange(0.0, 0.2501, 0.0025)  # sizes of the gap, fractions of stroke
GOOD_BACKLASH = 0.01  # fraction of stroke, up to which a valve is good
SIZE_TOLERANCE = 0.2  # share of itself, or ``GOOD_BACKLASH``, within which a size is right
LEAST_CERTAINTY = 0.95  # probability of being right, of an identified size
_IS_GOOD_CANDIDATE = CANDIDATES <= GOOD_BACKLASH + 1e-9
USUAL_STROKE_TIME = 90.0  # s, of a motor whose own is not given
LEAST_REVERSAL = 0.005  # of the motor that counts, fraction of stroke
LONGEST_INTERVAL = 60.0  # s between samples of a log that can show a gap
CLOCK_SHIFTS_S = (60.0, 120.0, 180.0)  # of the command, with which it must not explain the temperature better
MORE_EVIDENCE_CURE = "step the set-point up and down, or log longer"
_JUMPY_COMMAND = (
    "the command jumps back and forth from sample to sample, so movements of the stem between samples may be missed: "
    "log at the controller's sample time, state that time (sample_time, --sample-time) and step the set-point up and "
    "down, or give four days or more"
)


class Identification(NamedTuple):
    """Backlash of a valve as identified from a log."""

    backlash: float  # the most probable size, fraction of stroke; NaN where the log was not fit to compare any
    low: float  # interval of 95 %
    high: float
    identified: bool  # whether the size is right, to 20 % of itself or 1 % of stroke, with 95 % probability
    reason: str  # why not; empty if identified
    probability: Array  # of each of ``CANDIDATES``
    temperature_lag: float = 0.0
    """Seconds by which the temperatures are logged after the commands, which was corrected.  Negative: the commands are
    logged late, or their controller reads slowly; both were considered."""


class DayEvidence(NamedTuple):
    """Evidence of the backlash in one day of a log."""

    likelihoods: list[Likelihood]  # for each shift of the clock; none where nothing can be compared
    provoked: bool = False  # whether the command moved for another reason than the temperature
    doubt: str = ""  # why nothing may be claimed of this day
    weight: float = 1.0  # share of the likelihood that counts, less where the valve moves between the samples
    temperature_lag: float = 0.0
    unseen_share: float = 0.0  # share of the gap that reversals between the samples may hide
    is_jumpy: bool = False  # whether the command jumps back and forth, so that a few days claim nothing
    positions: Array = np.zeros(1)  # of the motor, fractions of stroke
    is_misplaced: bool = False  # whether the command answers another loop, or moves before its temperature
    placebo_margin: float = 0.0  # of the log-likelihood above that of other hours and of the log backwards


def identify_backlash(*log: Any, **options: Any) -> Identification:
    """Identify the backlash of a valve from a trend log; the arguments are those of ``gather_evidence``."""
    return combine_days([gather_evidence(*log, **options)])


def combine_days(days: Sequence[DayEvidence]) -> Identification:
    """Identify the backlash from the evidence of several days: one gap, and a plant for each day.

    Days with a doubt do not count if half of the days or more have none; but a doubt about clock, direction or loop is
    one of all days if more than a fifth of them have it, or if all together fit backwards or other hours as well.
    With many days, a command that jumps back and forth is no doubt: each day may show what moved between its samples.
    """
    comparable, doubt = [day for day in days if day.likelihoods], ""
    if not comparable:
        flat, reason = np.full(CANDIDATES.size, 1.0 / CANDIDATES.size), _most_frequent([day.doubt for day in days])
        return Identification(np.nan, 0.0, float(CANDIDATES[-1]), False, reason, flat)
    has_many_days = len(comparable) >= thresholds.MANY_DAYS
    if not has_many_days:
        comparable = [day._replace(doubt=day.doubt or _JUMPY_COMMAND) if day.is_jumpy else day for day in comparable]
    undoubted_days = [day for day in comparable if not day.doubt]
    misplaced_doubts = [day.doubt for day in comparable if day.is_misplaced]
    placebo_margins = [day.placebo_margin for day in comparable if day.placebo_margin]
    if len(misplaced_doubts) > thresholds.MOST_MISPLACED_SHARE * len(comparable):
        doubt = _most_frequent(misplaced_doubts)
    elif placebo_margins and sum(placebo_margins) < thresholds.LEAST_PLACEBO_MARGIN:
        doubt = next((day.doubt for day in comparable if day.placebo_margin < thresholds.LEAST_PLACEBO_MARGIN), "")
    elif 2 * len(undoubted_days) >= len(comparable):
        comparable = undoubted_days
    else:
        doubt = _most_frequent([day.doubt for day in comparable if day.doubt])
    is_provoked_once = any(day.provoked for day in comparable)
    steady_weight = thresholds.COMMAND_WEIGHT
    if has_many_days:
        steady_weight = min(thresholds.POOLED_WEIGHT, thresholds.MOST_STEADY_WEIGHT / len(comparable))
    log_likelihoods = np.array([_day_likelihood(day, steady_weight) for day in comparable])
    logarithm = log_likelihoods.sum(axis=0)
    probability = np.exp(logarithm - np.logaddexp.reduce(logarithm))
    size = judge_size(probability, is_provoked_once, doubt)
    if size.identified and has_many_days and not is_provoked_once:
        is_other = np.abs(CANDIDATES - size.backlash) > max(SIZE_TOLERANCE * size.backlash, GOOD_BACKLASH) + 1e-9
        preference = log_likelihoods[:, CANDIDATES == size.backlash] - log_likelihoods[:, is_other]
        errors = np.maximum(preference.std(axis=0, ddof=1) / np.sqrt(len(preference)), 1e-12)
        if np.min(preference.mean(axis=0) / errors) < thresholds.LEAST_AGREEMENT:
            doubt = "the days show different gaps: step the set-point up and down on one"
            size = judge_size(probability, is_provoked_once, doubt)
    n_reversals = sum(count_reversals(day.positions, max(size.low, LEAST_REVERSAL)) for day in comparable)
    if size.identified and n_reversals < thresholds.LEAST_REVERSALS:
        doubt = f"the valve reversed only {format_count(n_reversals, 'time')} by more than such a gap, and "
        doubt += f"{thresholds.LEAST_REVERSALS} reversals are needed: {MORE_EVIDENCE_CURE}"
        size = judge_size(probability, is_provoked_once, doubt)
    high = min(size.high + max(day.unseen_share for day in comparable) * size.backlash, float(CANDIDATES[-1]))
    return size._replace(high=high, temperature_lag=_most_frequent([day.temperature_lag for day in comparable]))


def _day_likelihood(day: DayEvidence, steady_weight: float) -> Array:
    """Return the log-likelihood of each candidate from a day; a good valve wins only if the set-point moved."""
    if day.provoked:
        readings = [thresholds.LIKELIHOOD_WEIGHT * likelihood.without_command for likelihood in day.likelihoods]
    else:
        readings = [steady_weight * likelihood.with_command for likelihood in day.likelihoods]
    weighted = [day.weight * reading for reading in readings]
    log_likelihood = np.asarray(np.logaddexp.reduce([reading - np.logaddexp.reduce(reading) for reading in weighted]))
    return log_likelihood if day.provoked else np.minimum(log_likelihood, log_likelihood[~_IS_GOOD_CANDIDATE].max())


def _most_frequent(values: Sequence[Any]) -> Any:
    return Counter(values).most_common(1)[0][0]


def gather_evidence(
    command: Array, temperature: Array, interval: float, T_set: Array | None = None,
    disturbances: tuple[Array, ...] = (), enabled: Mask | None = None, stroke_time: float | None = None,
    sample_time: float | None = None, lag: float | None = None,
) -> DayEvidence:  # fmt: skip
    """Gather the evidence of the backlash in one day of a log with a sample every ``interval`` s.

    command, temperature: (n,), fraction of stroke, °C; NaN where missing.  T_set: °C, if logged.  disturbances: logged
    series that move the temperature: air flow, entering air temperature.  enabled: whether the plant was on, always if
    None.  stroke_time: of the motor, s; 90 if None, 0 if immediate.  sample_time: of the controller, s, if known.  lag:
    by which the temperature is logged late, s; estimated if None.
    """
    command, temperature = np.asarray(command, float), np.asarray(temperature, float)
    good = np.isfinite(command) & np.isfinite(temperature)
    for series in disturbances:
        good &= np.isfinite(series)
    good = good if enabled is None else good & np.asarray(enabled, bool)
    if interval > LONGEST_INTERVAL:
        doubt = f"the log has only one sample every {interval:.4g} s: log every {HORIZON_S:g} s or faster"
        return DayEvidence([], doubt=doubt)
    if not good.any():
        return DayEvidence([], doubt="no sample has both a command and a temperature with the plant on")
    stroke_time = USUAL_STROKE_TIME if stroke_time is None else stroke_time
    command, temperature, n = forward_fill(command), forward_fill(temperature), command.size
    positions = motor_positions(command, interval, stroke_time)
    if count_reversals(positions, LEAST_REVERSAL) == 0:
        doubt = "the command never reverses, and a gap shows only at reversals: step the set-point up and down"
        return DayEvidence([], doubt=doubt)
    is_known = good if T_set is None else good & np.isfinite(T_set)
    filled_T_set = None if T_set is None else forward_fill(np.asarray(T_set, float))
    pi = imply_pi(command, temperature, filled_T_set, is_known, interval)
    lag_samples = pi.temperature_lag if lag is None else round(lag / interval)
    series = np.stack([temperature, *disturbances])

    def likelihood_at(shift: int, ends: int = 0, direction: int = 1, rolled: int = 0) -> Likelihood | None:
        """Return the likelihood with T moved ``shift`` samples earlier, rolled, less ``ends``; -1: read backwards."""
        command_rows = slice(max(-shift, 0) + ends, n - max(shift, 0) - ends)
        temperature_rows = slice(max(shift, 0) + ends, n - max(-shift, 0) - ends)
        motor = motor_positions(command[command_rows][::direction], interval, stroke_time)
        T, *other_series = np.roll(series[:, temperature_rows], rolled, axis=1)[:, ::direction]
        is_good = (good[command_rows] & np.roll(good[temperature_rows], rolled))[::direction]
        return likelihoods(T, motor, other_series, is_good, interval, CANDIDATES)

    # a command that answers old temperatures may be that of a slow controller, and stand where it belongs
    shifts = (0, lag_samples) if lag_samples < 0 and lag is None else (lag_samples,)
    readings = [likelihood for shift in shifts if (likelihood := likelihood_at(shift))]
    if not readings:
        doubt = "too little of the log is usable, or the temperature hardly changes: log for two hours or more"
        return DayEvidence([], doubt=doubt)
    was_provoked = is_provoked(command, temperature, good, T_set, interval)
    is_unseen = sample_time is None or sample_time < interval
    is_in_step = sample_time is not None and not is_unseen and (sample_time / interval) % 1.0 < 1e-6
    doubt, placebo_margin, weight = "", 0.0, min(1.0, HORIZON_S / interval) if is_unseen else 1.0
    is_jumpy = back_and_forth_share(command, is_in_control(command, good, interval)) > thresholds.MOST_BACK_AND_FORTH
    weight *= thresholds.JUMPY_WEIGHT if is_jumpy else 1.0
    if pi.is_another:
        cure = "check that both belong to the same loop and the same clock"
        doubt = f"a PI of this temperature explains only {100 * pi.explained:.3g} % of the command's changes: {cure}; "
        doubt += "no size can be claimed for a loop with another control law"
    elif pi.ti < -interval:
        cure = "check that the rows are in chronological order and that both points share one clock"
        doubt = f"the command moves before the temperature change that it responds to: {cure}"
    elif readings[0].outside_swing > thresholds.LARGEST_OUTSIDE_SWING:
        swings = f"something outside the loop swings the temperature every {readings[0].outside_period / 60.0:.0f} min"
        cure = "log the entering air too (T_a_in, m_a)" if len(disturbances) < 2 else "look for a swing of the water"
        doubt = f"{swings}, before the command answers: {cure}, or calm what swings"
    elif was_provoked:
        clock_shifts = CLOCK_SHIFTS_S if lag is None else ()
        doubt, placebo_margin = _why_misplaced(likelihood_at, lag_samples, interval, n, clock_shifts)
    most_arrivals = thresholds.MOST_ARRIVALS_PER_REVERSAL * count_reversals(positions, 0.05)
    if not doubt and count_end_arrivals(command, good) > max(thresholds.MOST_ARRIVALS, most_arrivals):
        doubt = "the command keeps reaching 0 or 100 %: raise Ti until the loop is calm, then log again"
    unseen_share = thresholds.UNSEEN_TURN_SHARE if is_unseen and interval > HORIZON_S else 0.0
    is_jumpy &= not (was_provoked and is_in_step)
    is_foreign = pi.is_another and pi.explained < thresholds.LEAST_OWN_EXPLAINED
    return DayEvidence(
        readings, was_provoked, doubt, weight, lag_samples * interval, unseen_share, is_jumpy, positions,
        is_foreign or pi.ti < -interval, placebo_margin,
    )  # fmt: skip


def _why_misplaced(
    likelihood_at: Callable[..., Likelihood | None], lag_samples: int, interval: float, n: int, shifts: Sequence[float]
) -> tuple[str, float]:
    """Return why the command explains the temperature of another time as well, or empty, and the margin of placebos.

    Other times are placebos, the log backwards and its other hours, and clocks that differ by one of the ``shifts``, s,
    which count if they explain more with another gap.  Only a provoked day can show this.
    """

    def best_fit(shift: int, **options: int) -> tuple[float, float]:
        """Return the largest log-likelihood and the gap that has it."""
        likelihood = likelihood_at(
            shift, round(CLOCK_SHIFTS_S[-1] / interval) + abs(lag_samples) - abs(shift), **options
        )
        if likelihood is None:
            return 0.0, 0.0
        return float(likelihood.without_command.max()), float(CANDIDATES[likelihood.without_command.argmax()])

    likelihood, size = best_fit(lag_samples)
    backwards = likelihood - best_fit(lag_samples, direction=-1)[0]
    margin = min(backwards, *(likelihood - best_fit(lag_samples, rolled=k * n // 4)[0] for k in (1, 2, 3)))
    if backwards < thresholds.LEAST_PLACEBO_MARGIN:
        cure = "check that the command drives this valve, and that the rows are in chronological order"
        return f"the log fits just as well when it is read backwards: {cure}", margin
    if margin < thresholds.LEAST_PLACEBO_MARGIN:
        cure = "check that it drives this valve, or log longer"
        return f"the command explains the temperatures of other hours just as well: {cure}", margin
    for shift in shifts:
        shifted_likelihood, shifted_size = best_fit(lag_samples - round(shift / interval))
        is_another_size = abs(shifted_size - size) > max(SIZE_TOLERANCE * size, GOOD_BACKLASH)
        if shifted_likelihood > likelihood + thresholds.LARGEST_SHIFT_GAIN and is_another_size:
            cure = "check that both points share one clock, or give the lag between them (lag, --lag)"
            return f"the temperature fits a command logged {shift:g} s after it even better: {cure}", margin
    return "", margin


def judge_size(probability: Array, provoked: bool, doubt: str, cure: str = MORE_EVIDENCE_CURE) -> Identification:
    """Return the most probable gap with its interval, and whether it counts as identified.

    On a day that is not provoked, a good valve is never claimed: a stem that stands still looks the same.
    """
    tolerances = np.maximum(SIZE_TOLERANCE * CANDIDATES, GOOD_BACKLASH) + 1e-9
    certainty = (np.abs(CANDIDATES[:, np.newaxis] - CANDIDATES) <= tolerances) @ probability
    k = int(probability.argmax())
    if certainty[k] < LEAST_CERTAINTY <= certainty.max():
        k = int(certainty.argmax())
    backlash = float(CANDIDATES[k])
    is_worse = bool(probability.max() >= thresholds.LEAST_ODDS * probability[_IS_GOOD_CANDIDATE].max())
    if not doubt and backlash <= GOOD_BACKLASH and not provoked:
        trap = "the command only follows the temperature, so a stem that stands still looks like one without a gap"
        doubt = f"{trap}: step the set-point"
    low, high, reason = 0.0, float(CANDIDATES[-1]), doubt
    if not doubt:
        # equal tails; half a step is the width of a candidate, the rest the error of a linear model
        cumulative, step = np.cumsum(probability), CANDIDATES[1] - CANDIDATES[0]
        first, last = np.argmax(cumulative > 0.5 * (1.0 - 0.95)), np.argmax(cumulative >= 0.5 * (1.0 + 0.95) - 1e-12)
        low = max(float(CANDIDATES[first] - step), 0.0) if is_worse else 0.0
        high = min(float(CANDIDATES[last] + step), high)
    if not doubt and (certainty[k] < LEAST_CERTAINTY or (backlash > GOOD_BACKLASH and not is_worse)):
        reason = f"gaps from {100 * low:.1f} % to {100 * high:.1f} % explain the log: {cure}"
    elif not doubt and high >= CANDIDATES[-1]:
        reason = f"the gap may be {100 * high:.0f} % of the stroke or more; larger gaps are not tested"
    return Identification(backlash, low, high, not reason, reason, probability)
