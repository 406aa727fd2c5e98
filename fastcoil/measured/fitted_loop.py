"""Model of the loop behind a trend log, and its day with another valve or controller.

``replay_day`` replays the day of the log with the fitted plant in place of the coil.  It is not the loop of the engine:
the plant has no control volumes, a step is a part of the log's interval (at 1 s, as in the engine, predicted errors
change by up to 4 %), and the day starts in the state that the log shows.

``Outcome.hunts`` requires a regular swing of the true temperature; ``Swing.is_regular`` (``measures``) answers for a
measured one, with noise, drift and gaps.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.measured import thresholds
from fastcoil.measured.fitted_plant import FittedPlant, RecoveredPI, first_order_lag, fit_plant, recover_pi
from fastcoil.measured.grid import SECONDS_PER_DAY, forward_fill
from fastcoil.measured.identify import HORIZON_S
from fastcoil.measured.part import true_runs
from fastcoil.model.hunting import SWING_SAMPLE_S, is_same_period
from fastcoil.model.metric_table import HUNTING_SWING_K, SETTLING_TIME_S, WARM_UP_S

LEAST_PERIODS = 10  # whole periods that a replay must show before it counts as hunting
LEAST_REGULARITY = 2.0 / 3.0  # share of them that are as long as the one before


class ReplayInputs(NamedTuple):
    """Inputs of a replayed day, at the steps of the simulation, (n_steps,)."""

    disturbance: Array  # without noise, K
    noise: Array  # that the controller reads, K
    T_set: Array  # °C
    command: Array  # as logged
    is_automatic: Mask  # whether the controller works; else the logged command acts


class Replay(NamedTuple):
    """Signals of a replay, (n_steps,): true temperature, °C; command, position and opening, fractions of stroke."""

    temperature: Array
    command: Array
    position: Array
    opening: Array


def _build_inputs(plant: FittedPlant, command: Array, T_set: Array, good: Mask, period: float) -> ReplayInputs:
    """Return the series to replay the day of a log: its disturbance, separated from noise, its set-point and command.

    period: of a loop that hunts, in samples, else 0.  Hunting that is left in the disturbance is an error of the plant
    and would go on in a calm loop: a mean over whole periods removes it.
    """
    n = plant.disturbance.size
    smooth, noise_std = remove_noise(plant.disturbance, good)
    noise_seen = plant.disturbance - smooth
    if period > 0.0:
        # moving mean over a period, over less at the ends
        smooth_sum = np.concatenate([[0.0], np.cumsum(smooth)])
        k, ends = np.arange(n), np.arange(n + 1, dtype=float)
        half_width = np.minimum(np.minimum(k, n - 1 - k) + 0.5, 0.5 * period)
        sum_after, sum_before = (np.interp(k + 0.5 + side, ends, smooth_sum) for side in (half_width, -half_width))
        smooth = (sum_after - sum_before) / (2.0 * half_width)
    times = np.arange((n - 1) * plant.per_sample + 1) / plant.per_sample
    sample = times.astype(int)
    noise = noise_std * np.random.default_rng(0).standard_normal(times.size)  # between samples it is unknown
    noise[:: plant.per_sample] = noise_seen
    is_automatic = good[sample] & good[np.minimum(sample + 1, n - 1)]
    return ReplayInputs(np.interp(times, np.arange(n), smooth), noise, T_set[sample], command[sample], is_automatic)


def remove_noise(series: Array, good: Mask) -> tuple[Array, float]:
    """Smooth a random walk that was read with white noise; also return the standard deviation of that noise.

    Changes from sample to sample have the variance q + 2 r and successive ones the covariance -r, where r is that of
    the noise and q that of a step of the walk; the smoother is optimal for these (Muth 1960, both ways).
    """
    changes = np.diff(series)
    changes = changes[good[1:] & good[:-1]]
    largest_change = 6.0 * 1.4826 * float(np.median(np.abs(changes)))
    changes = np.clip(changes, -largest_change, largest_change)
    variance = float(changes @ changes) / changes.size
    r = min(-float(changes[1:] @ changes[:-1]) / changes.size, 0.499 * variance)
    if r <= 0.0:
        return series, 0.0
    q = variance - 2.0 * r
    gain_variance = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))
    weight = gain_variance / (gain_variance + r)
    return first_order_lag(first_order_lag(series, weight)[::-1], weight)[::-1], math.sqrt(r)


def replay_day(
    plant: FittedPlant, pi: RecoveredPI, day: ReplayInputs, stroke_time: float, backlash: float, estimate: float = 0.0,
    buffer: float = 0.0,
) -> Replay:  # fmt: skip
    """Simulate a day step by step: PI, backlash inverse (none with an estimate of 0), motor, gap, fitted plant."""
    n, step = day.T_set.size, plant.step
    c_1, c_2 = plant.curve
    least, most = plant.least, plant.most
    a_1, a_2 = (math.exp(-step / lag) for lag in plant.lags)
    sample_steps = max(1, round(pi.sample_time / step))
    kp, ki = pi.kp, pi.kp * sample_steps * step / pi.ti
    reach = step / stroke_time if stroke_time > 0.0 else 1.0
    stretch = 1.0 / (1.0 - backlash)
    buffer = max(buffer, 1e-9)  # so that round-off is no reversal
    disturbance, noise, T_set, logged_command, is_automatic = (series.tolist() for series in day)
    position = command = u_ext = logged_command[0]
    mode = 1.0
    q = min(max(position - 0.5 * backlash, 0.0), 1.0 - backlash)
    x = min(max(q * stretch, least), most)
    level = (c_1 + c_2 * x) * x + (c_1 + 2.0 * c_2 * x) * (q * stretch - x)
    slow = fast = level
    delayed_levels = [level] * (plant.delay + 1)
    integral, was_automatic = 0.0, False
    temperatures, commands, positions, openings = ([0.0] * n for _ in range(4))
    for k in range(n):
        temperature = fast + disturbance[k]
        if not is_automatic[k]:
            command = u_ext = logged_command[k]
            was_automatic = False
        elif k % sample_steps == 0 or not was_automatic:
            error = temperature + noise[k] - T_set[k]
            integral = integral + ki * error if was_automatic else logged_command[k] - kp * error
            integral = 0.0 if integral < 0.0 else 1.0 if integral > 1.0 else integral
            u = kp * error + integral
            u = 0.0 if u < 0.0 else 1.0 if u > 1.0 else u
            is_turning = u < u_ext - buffer if mode > 0.0 else u > u_ext + buffer
            if is_turning:
                mode = -mode
            if is_turning or (u > u_ext if mode > 0.0 else u < u_ext):
                u_ext = u
                command = (1.0 - estimate) * u + (estimate if mode > 0.0 else 0.0)
                command = 0.0 if command < 0.0 else 1.0 if command > 1.0 else command
            was_automatic = True
        ahead = command - position
        position = position + reach if ahead > reach else position - reach if ahead < -reach else command
        q = position - backlash if q < position - backlash else q
        q = position if q > position else q
        opening = q * stretch
        x = least if opening < least else most if opening > most else opening
        level = (c_1 + c_2 * x) * x + (c_1 + 2.0 * c_2 * x) * (opening - x)
        temperatures[k], commands[k], positions[k], openings[k] = temperature, command, position, opening
        delayed_levels[k % len(delayed_levels)] = level
        slow += (delayed_levels[(k + 1) % len(delayed_levels)] - slow) * (1.0 - a_1)
        fast += (slow - fast) * (1.0 - a_2)
    return Replay(*map(np.array, (temperatures, commands, positions, openings)))


class Outcome(NamedTuple):
    """Outcome of a day of a loop; a day is 24 h of operation."""

    rmse: float  # of the true temperature against the set-point, K
    amplitude: float  # half of the mean peak to peak of the settled windows, K
    period: float  # settled seconds per upward crossing of the set-point, NaN below two
    travel_per_day: float  # of the motor, strokes
    reversals_per_day: float  # of the stem
    hunts: bool  # whether it swings regularly


def _is_counted(day: ReplayInputs, step: float) -> Mask:
    """Whether each step counts in the outcome, (n_steps,): in automatic, and after the warm-up."""
    is_counted = day.is_automatic.copy()
    is_counted[: int(min(WARM_UP_S, 0.125 * is_counted.size * step) / step)] = False
    return is_counted


def evaluate_replay(replay: Replay, day: ReplayInputs, step: float) -> Outcome:
    """Compute error, swing, travel and hunting of a replayed day; step: s."""
    n = day.T_set.size
    is_counted = _is_counted(day, step)
    error = replay.temperature - day.T_set
    is_changed = np.diff(day.T_set, prepend=day.T_set[:1]) != 0.0
    is_changed |= ~day.is_automatic
    last_change = np.maximum.accumulate(np.where(is_changed, np.arange(n), 0))
    is_settled = is_counted & ((np.arange(n) - last_change) * step >= SETTLING_TIME_S)
    windows = [slice(*run) for run in true_runs(is_settled)]
    swing = float(np.mean([np.ptp(replay.temperature[w]) for w in windows])) if windows else math.nan
    every = max(1, round(SWING_SAMPLE_S / step))
    gaps = (np.diff(_find_upward_crossings(error[w][::every])) for w in windows)
    periods = np.concatenate([np.zeros(0), *(gap * every * step for gap in gaps)])
    n_same = sum(is_same_period(period, previous, 0.0) for previous, period in pairwise(periods))
    crossings = sum(_find_upward_crossings(error[w]).size for w in windows)
    days = max(int(is_counted.sum()), 1) * step / SECONDS_PER_DAY
    is_counted_step = is_counted[1:] & is_counted[:-1]
    moves = np.diff(replay.opening)
    directions = np.sign(moves[is_counted_step & (np.abs(moves) > 1e-9)])
    return Outcome(
        rmse=float(np.sqrt(np.mean(error[is_counted] ** 2))) if is_counted.any() else math.nan,
        amplitude=0.5 * swing,
        period=float(is_settled.sum()) * step / crossings if crossings >= 2 else math.nan,
        travel_per_day=float(np.sum(np.abs(np.diff(replay.position))[is_counted_step])) / days,
        reversals_per_day=float(np.sum(np.diff(directions) != 0.0)) / days,
        hunts=bool(swing > HUNTING_SWING_K and LEAST_PERIODS <= periods.size <= n_same / LEAST_REGULARITY),
    )


def _find_upward_crossings(error: Array) -> Index:
    """Find the indices at which the error rises through 0."""
    return np.asarray(np.flatnonzero((error[:-1] < 0.0) & (error[1:] >= 0.0)) + 1)


class FittedLoop(NamedTuple):
    """A loop fitted to a log, ready to be replayed."""

    pi: RecoveredPI
    plant: FittedPlant
    day: ReplayInputs
    backlash: float
    stroke_time: float
    doubt: str = ""  # why the loop is not to be trusted; empty if it is

    def replay_with(self, backlash: float, kp_factor: float = 1.0, ti_factor: float = 1.0, *inverse: float) -> Outcome:
        """Replay its day with another backlash, with kp and ti times as large, with an inverse (estimate, buffer)."""
        pi = self.pi._replace(kp=kp_factor * self.pi.kp, ti=ti_factor * self.pi.ti)
        replay = replay_day(self.plant, pi, self.day, self.stroke_time, backlash, *inverse)
        return evaluate_replay(replay, self.day, self.plant.step)


def fit_loop_model(
    command: Array, temperature: Array, T_set: Array | None, interval: float, backlash: float, stroke_time: float,
    sample_time: float | None = None, enabled: Mask | None = None, gains: tuple[float, float] | None = None,
    by_hand: Mask | None = None,
) -> FittedLoop | str:  # fmt: skip
    """Fit controller and plant to a trend log; return a sentence if that is impossible.

    The arguments are those of ``gather_evidence``.  backlash: fraction of stroke.  gains: kp, 1/K and above 0, and ti,
    s, of the controller, estimated if None.  by_hand: where a test, not the controller, moved the valve, which shows
    the plant only.
    """
    if T_set is None:
        return "the log has no set-point (T_set)"
    if interval > HORIZON_S:
        return f"the log has only one sample every {interval:.4g} s: log every {HORIZON_S:g} s or faster"
    last_two_days = slice(-int(172800.0 / interval), None)  # two days
    command, temperature, T_set = (np.asarray(series, float)[last_two_days] for series in (command, temperature, T_set))
    good = np.isfinite(command) & np.isfinite(temperature) & np.isfinite(T_set)
    good = good if enabled is None else good & np.asarray(enabled, bool)[last_two_days]
    is_controlled = good if by_hand is None else good & ~by_hand[last_two_days]
    if not good.any():
        return "no sample has command, temperature and set-point with the plant on"
    command, temperature, T_set = (forward_fill(series) for series in (command, temperature, T_set))
    pi = recover_pi(command, temperature, T_set, interval, is_controlled, sample_time, gains)
    if isinstance(pi, str):
        return pi
    plant = fit_plant(command, temperature, good, interval, backlash, stroke_time, pi)
    if plant is None:
        return "no plant model that responds to the valve explains the log: the temperature hardly follows the command"
    zeros = np.zeros(T_set.size)
    logged_replay = Replay(temperature, zeros, zeros, zeros)
    logged_outcome = evaluate_replay(logged_replay, ReplayInputs(zeros, zeros, T_set, zeros, is_controlled), interval)
    period = logged_outcome.period / interval if logged_outcome.hunts else 0.0  # in samples
    fitted = FittedLoop(pi, plant, _build_inputs(plant, command, T_set, is_controlled, period), backlash, stroke_time)
    return fitted._replace(doubt=why_unusable(fitted) or _why_doubtful(fitted, command, temperature, T_set))


def why_unusable(fitted: FittedLoop) -> str:
    """Return why a fitted loop cannot be used, since it explains too little of its log; empty if it can."""
    share = fitted.plant.explained
    if share >= 0.1:
        return ""
    return f"the command explains only {100 * share:.0f} % of the changes of the temperature"


def what_if(
    fitted: FittedLoop, backlash: float | None = None, kp_factor: float = 1.0, ti_factor: float = 1.0,
    estimate: float = 0.0, buffer: float = 0.0,
) -> Outcome | str:  # fmt: skip
    """Predict the logged day with another backlash, kp, ti, or with a backlash inverse.

    Returns a sentence where the answer depends on more than the fit can know: the change is simulated with 15 % more
    and less loop gain as well, and all three have to agree.  backlash: that of the fit if None.  kp_factor, ti_factor:
    times those of the log.  estimate, buffer: of the inverse; an estimate of 0 is the plain PI.
    """
    size = fitted.backlash if backlash is None else backlash
    if (size, kp_factor, ti_factor, estimate) == (fitted.backlash, 1.0, 1.0, 0.0):
        return fitted.replay_with(size, 1.0, 1.0, 0.0, buffer)  # the log itself, which is known
    factors = (1.0, thresholds.GAIN_ERROR_FACTOR, 1.0 / thresholds.GAIN_ERROR_FACTOR)
    outcomes = [fitted.replay_with(size, factor * kp_factor, ti_factor, estimate, buffer) for factor in factors]
    errors = [outcome.rmse for outcome in outcomes]
    if len({outcome.hunts for outcome in outcomes}) > 1:
        question = "whether the loop hunts"
    elif not max(errors) < thresholds.LARGEST_ERROR_RATIO * min(errors):
        question = f"between control errors of {min(errors):.2g} and {max(errors):.2g} K"
    else:
        return outcomes[0]
    change = f"a {100 * (thresholds.GAIN_ERROR_FACTOR - 1.0):.0f} % change of the loop gain"
    return f"{change} decides {question}, and the log does not show the gain that accurately"


def _why_doubtful(fitted: FittedLoop, command: Array, temperature: Array, T_set: Array) -> str:
    """Return why a prediction is doubtful, since the fitted loop does not reproduce its log; empty if it does."""
    day, plant = fitted.day, fitted.plant
    replay = replay_day(plant, fitted.pi, day, fitted.stroke_time, fitted.backlash)
    is_counted = _is_counted(day, plant.step)[:: plant.per_sample]
    logged_steps = slice(None, None, plant.per_sample)
    logged_error = float(np.sqrt(np.mean((temperature - day.noise[logged_steps] - T_set)[is_counted] ** 2)))
    replayed_error = float(np.sqrt(np.mean((replay.temperature[logged_steps] - T_set)[is_counted] ** 2)))
    moves = (np.abs(np.diff(series))[is_counted[1:]] for series in (replay.command[logged_steps], command))
    replayed_travel, logged_travel = (float(np.sum(move)) for move in moves)
    error_ratio, travel_ratio = replayed_error / logged_error, max(replayed_travel, 1e-9) / max(logged_travel, 1e-9)
    is_error_close = abs(math.log(error_ratio)) < thresholds.LARGEST_ERROR_LOG_RATIO
    if is_error_close and abs(math.log(travel_ratio)) < thresholds.LARGEST_TRAVEL_LOG_RATIO:
        return ""
    errors = f"its control error is {replayed_error:.2g} K, the logged one {logged_error:.2g} K"
    travels = f"its command travels {replayed_travel:.3g} strokes, the logged one {logged_travel:.3g}"
    return f"the fitted loop does not reproduce the log: {errors}; {travels}"
