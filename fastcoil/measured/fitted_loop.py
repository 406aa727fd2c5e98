"""The loop behind a trend log as a model, and what its day would have been with another valve or controller.

``play`` replays the day of the log with the fitted plant in place of the coil.  It is not the loop of the engine: the
plant has no control volumes, a step is a part of the log's interval (at 1 s, as in the engine, predicted errors change
by up to 4 %), and the day starts in the state that the log shows.

``Outcome.hunts`` is the metric of that name and is meant for true temperatures; ``Swing.is_regular`` (``measures``)
answers for a measured temperature, with noise, drift and gaps.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.measured.fitted_plant import FittedPlant, RecoveredPI, fit_plant, lagged, recover_pi
from fastcoil.measured.grid import DAY, held
from fastcoil.measured.identify import HORIZON
from fastcoil.measured.part import runs
from fastcoil.model.metric_table import HUNTING_SAMPLE, SETTLING_TIME, WARM_UP, alike, is_hunting

BUFFER = 1e-9  # least buffer of the inverse, so that round-off is no reversal


class Day(NamedTuple):
    """What a replay takes from the log, at the steps of the simulation, (n_steps,)."""

    disturbance: Array  # without noise, K
    noise: Array  # that the controller reads, K
    T_set: Array  # °C
    command: Array  # as logged
    works: Mask  # whether the controller works; else the logged command acts


class Played(NamedTuple):
    """Signals of a replay, (n_steps,): true temperature, °C; command, motor position and opening, fractions."""

    temperature: Array
    command: Array
    position: Array
    opening: Array


def _day_of(plant: FittedPlant, command: Array, T_set: Array, good: Mask, period: float) -> Day:
    """The day of a log; noise and disturbance are separated by how they change from sample to sample.

    period: samples to a period of a loop that hunts, else 0.  What is left of the hunting in the disturbance is what
    the plant does not get right, and would go on in a loop that is calm: a mean over whole periods takes it out.
    """
    n = plant.disturbance.size
    smooth, level = without_noise(plant.disturbance, good)
    noise_seen = plant.disturbance - smooth
    if period > 0.0:
        smooth = _mean_over(smooth, period)
    at = np.arange((n - 1) * plant.per_sample + 1) / plant.per_sample
    sample = at.astype(int)
    noise = level * np.random.default_rng(0).standard_normal(at.size)  # between samples it is unknown
    noise[:: plant.per_sample] = noise_seen
    works = good[sample] & good[np.minimum(sample + 1, n - 1)]
    return Day(np.interp(at, np.arange(n), smooth), noise, T_set[sample], command[sample], works)


def _mean_over(series: Array, width: float) -> Array:
    """Moving mean over ``width`` samples around each; fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(series)])
    k = np.arange(series.size)
    half = np.minimum(np.minimum(k, series.size - 1 - k) + 0.5, 0.5 * width)
    ends = np.arange(total.size, dtype=float)
    return np.asarray((np.interp(k + 0.5 + half, ends, total) - np.interp(k + 0.5 - half, ends, total)) / (2.0 * half))


def without_noise(series: Array, good: Mask) -> tuple[Array, float]:
    """A random walk seen through white noise, smoothed, and the noise's standard deviation.

    Changes from sample to sample have the variance q + 2 r and, one after the other, the covariance -r, with r that of
    the noise and q that of a step of the walk; the smoother is the one that is best for these (Muth 1960, both ways).
    """
    changes = np.diff(series)
    changes = changes[good[1:] & good[:-1]]
    most = 6.0 * 1.4826 * float(np.median(np.abs(changes)))
    changes = np.clip(changes, -most, most)
    variance = float(changes @ changes) / changes.size
    r = min(-float(changes[1:] @ changes[:-1]) / changes.size, 0.499 * variance)
    if r <= 0.0:
        return series, 0.0
    q = variance - 2.0 * r
    ahead = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))
    share = ahead / (ahead + r)
    once = lagged(series, share)[::-1]
    return lagged(once, share)[::-1], math.sqrt(r)


def play(
    plant: FittedPlant, pi: RecoveredPI, day: Day, stroke_time: float, backlash: float, estimate: float = 0.0,
    buffer: float = 0.0,
) -> Played:  # fmt: skip
    """Replay a day: PI with clamped integral, inverse (none with an estimate of 0), motor, play, plant, disturbance."""
    n, step = day.T_set.size, plant.step
    c_1, c_2 = plant.curve
    least, most = plant.least, plant.most
    a_1, a_2 = (math.exp(-step / lag) for lag in plant.lags)
    every = max(1, round(pi.sample_time / step))
    kp, ki = pi.kp, pi.kp * every * step / pi.ti
    travel = step / stroke_time if stroke_time > 0.0 else 1.0
    stretch = 1.0 / (1.0 - backlash)
    buffer = max(buffer, BUFFER)
    disturbance, noise, T_set, logged = (s.tolist() for s in (day.disturbance, day.noise, day.T_set, day.command))
    works = day.works.tolist()
    position = command = u_ext = logged[0]
    mode = 1.0
    q = min(max(position - 0.5 * backlash, 0.0), 1.0 - backlash)
    inside = min(max(q * stretch, least), most)
    level = (c_1 + c_2 * inside) * inside + (c_1 + 2.0 * c_2 * inside) * (q * stretch - inside)
    slow = fast = level
    waiting = [level] * (plant.delay + 1)
    integral, worked = 0.0, False
    temperatures, commands, positions, opens = ([0.0] * n for _ in range(4))
    for k in range(n):
        temperature = fast + disturbance[k]
        if not works[k]:
            command = u_ext = logged[k]
            worked = False
        elif k % every == 0 or not worked:
            error = temperature + noise[k] - T_set[k]
            integral = integral + ki * error if worked else logged[k] - kp * error
            integral = 0.0 if integral < 0.0 else 1.0 if integral > 1.0 else integral
            u = kp * error + integral
            u = 0.0 if u < 0.0 else 1.0 if u > 1.0 else u
            turned = u < u_ext - buffer if mode > 0.0 else u > u_ext + buffer
            if turned:
                mode = -mode
            if turned or (u > u_ext if mode > 0.0 else u < u_ext):
                u_ext = u
                command = (1.0 - estimate) * u + (estimate if mode > 0.0 else 0.0)
                command = 0.0 if command < 0.0 else 1.0 if command > 1.0 else command
            worked = True
        ahead = command - position
        position = position + travel if ahead > travel else position - travel if ahead < -travel else command
        q = position - backlash if q < position - backlash else q
        q = position if q > position else q
        opening = q * stretch
        inside = least if opening < least else most if opening > most else opening
        level = (c_1 + c_2 * inside) * inside + (c_1 + 2.0 * c_2 * inside) * (opening - inside)
        temperatures[k], commands[k], positions[k], opens[k] = temperature, command, position, opening
        waiting[k % len(waiting)] = level
        slow += (waiting[(k + 1) % len(waiting)] - slow) * (1.0 - a_1)
        fast += (slow - fast) * (1.0 - a_2)
    return Played(*map(np.array, (temperatures, commands, positions, opens)))


LARGEST_WARM_UP = 0.125  # share of a short log that is left out at its start in place of ``WARM_UP``
MOVED = 1e-9  # change of opening that counts as a movement, fraction of stroke


class Outcome(NamedTuple):
    """A day of a loop; a day is 24 h of operation."""

    rmse: float  # of the true temperature against the set-point, K
    amplitude: float  # half of the mean peak to peak of the settled windows, K
    period: float  # settled seconds per upward crossing of the set-point, NaN below two
    travel_per_day: float  # of the motor, strokes
    reversals_per_day: float  # of the stem
    hunts: bool  # as the metric of that name


def _counted_steps(day: Day, step: float) -> Mask:
    """Steps that count, (n_steps,): the loop works, and the warm-up is over."""
    counted = day.works.copy()
    counted[: int(min(WARM_UP, LARGEST_WARM_UP * counted.size * step) / step)] = False
    return counted


def outcome_of(played: Played, day: Day, step: float) -> Outcome:
    """What a replayed day was like; step: s."""
    n = day.T_set.size
    counted = _counted_steps(day, step)
    error = played.temperature - day.T_set
    changed = np.diff(day.T_set, prepend=day.T_set[:1]) != 0.0
    changed |= ~day.works
    last = np.maximum.accumulate(np.where(changed, np.arange(n), 0))
    settled = counted & ((np.arange(n) - last) * step >= SETTLING_TIME)
    windows = [slice(first, last) for first, last in runs(settled)]
    swing = float(np.mean([np.ptp(played.temperature[w]) for w in windows])) if windows else math.nan
    every = max(1, round(HUNTING_SAMPLE / step))
    periods = np.concatenate([np.zeros(0), *(np.diff(_upward(error[w][::every])) * every * step for w in windows)])
    n_alike = sum(alike(period, before) for before, period in pairwise(periods))
    crossings = sum(_upward(error[w]).size for w in windows)
    days = max(int(counted.sum()), 1) * step / DAY
    both = counted[1:] & counted[:-1]
    turns = np.sign(np.diff(played.opening)[both & (np.abs(np.diff(played.opening)) > MOVED)])
    return Outcome(
        rmse=float(np.sqrt(np.mean(error[counted] ** 2))) if counted.any() else math.nan,
        amplitude=0.5 * swing,
        period=float(settled.sum()) * step / crossings if crossings >= 2 else math.nan,
        travel_per_day=float(np.sum(np.abs(np.diff(played.position))[both])) / days,
        reversals_per_day=float(np.sum(np.diff(turns) != 0.0)) / days,
        hunts=bool(is_hunting(swing, periods.size, n_alike)),
    )


def _upward(error: Array) -> Index:
    """Where the error comes up through 0."""
    return np.asarray(np.flatnonzero((error[:-1] < 0.0) & (error[1:] >= 0.0)) + 1)


MOST_SECONDS = 172800.0  # of a longer log the end is replayed
LARGEST_ERROR, LARGEST_TRAVEL_ERROR = 0.2, 0.4
"""By how much control error and motor travel of the replayed log may differ from the logged ones, as logarithms."""
GAIN_ERROR, LARGEST_SPREAD = 1.15, 1.5
"""A what-if is reported if that much more and less loop gain change no verdict, and the error by less than this."""
LEAST_EXPLAINED = 0.1
"""Share of the changes of the temperature that the command has to explain in a model of the loop that is used."""


class FittedLoop(NamedTuple):
    """A loop fitted to a log, ready to be replayed."""

    pi: RecoveredPI
    plant: FittedPlant
    day: Day
    backlash: float
    stroke_time: float
    doubt: str = ""  # why the loop is not to be trusted; empty if it is

    def played(self, backlash: float, kp: float = 1.0, ti: float = 1.0, *inverse: float) -> Outcome:
        """Its day with another backlash, with kp and ti times as large, with an inverse (estimate, buffer)."""
        pi = self.pi._replace(kp=kp * self.pi.kp, ti=ti * self.pi.ti)
        played = play(self.plant, pi, self.day, self.stroke_time, backlash, *inverse)
        return outcome_of(played, self.day, self.plant.step)


def fit_loop_model(
    command: Array, temperature: Array, T_set: Array | None, interval: float, backlash: float, stroke_time: float,
    sample_time: float | None = None, enabled: Mask | None = None, gains: tuple[float, float] | None = None,
    by_hand: Mask | None = None,
) -> FittedLoop | str:  # fmt: skip
    """Fit controller and plant to a trend log; one sentence if that cannot be done.

    command, temperature, T_set: (n,), fraction of stroke, °C, °C; NaN where missing.  interval: s.  backlash,
    stroke_time: of valve (fraction of stroke) and motor (s, 0 if it is as good as immediate).  sample_time: of the
    controller, s; found from the log if None.  enabled: whether the plant was on; all of it if None.  gains: kp, 1/K
    and above 0, and ti, s, of the controller; found from the log if None.  by_hand: where a test, not the controller,
    moved the valve: it tells of the plant only.
    """
    if T_set is None:
        return "the log has no set-point (T_set)"
    if interval > HORIZON:
        return f"the log has only one sample every {interval:.4g} s: log every {HORIZON:g} s or faster"
    last = slice(-int(MOST_SECONDS / interval), None)
    command, temperature, T_set = (np.asarray(series, float)[last] for series in (command, temperature, T_set))
    good = np.isfinite(command) & np.isfinite(temperature) & np.isfinite(T_set)
    good = good if enabled is None else good & np.asarray(enabled, bool)[last]
    controlled = good if by_hand is None else good & ~by_hand[last]
    if not good.any():
        return "no sample has command, temperature and set-point with the plant on"
    command, temperature, T_set = (held(series) for series in (command, temperature, T_set))
    pi = recover_pi(command, temperature, T_set, interval, controlled, sample_time, gains)
    if isinstance(pi, str):
        return pi
    plant = fit_plant(command, temperature, good, interval, backlash, stroke_time, pi)
    if plant is None:
        return "no plant model that responds to the valve explains the log: the temperature hardly follows the command"
    nothing = np.zeros(T_set.size)
    as_played = Played(temperature, nothing, nothing, nothing)
    seen = outcome_of(as_played, Day(nothing, nothing, T_set, nothing, controlled), interval)
    period = seen.period / interval if seen.hunts else 0.0  # in samples
    day = _day_of(plant, command, T_set, controlled, period)
    fitted = FittedLoop(pi, plant, day, backlash, stroke_time)
    return fitted._replace(doubt=too_little(fitted) or _doubt(fitted, command, temperature, T_set))


def too_little(fitted: FittedLoop) -> str:
    """Why the model of a loop holds too little of it to be used, or nothing."""
    share = fitted.plant.explained
    if share >= LEAST_EXPLAINED:
        return ""
    return f"the command explains only {100 * share:.0f} % of the changes of the temperature"


def what_if(
    fitted: FittedLoop, backlash: float | None = None, kp_factor: float = 1.0, ti_factor: float = 1.0,
    estimate: float = 0.0, buffer: float = 0.0,
) -> Outcome | str:  # fmt: skip
    """What the logged day would have been with another backlash, kp, ti, or with a backlash inverse.

    A sentence where the answer turns on less than the fit can know: what changes is simulated with ``GAIN_ERROR`` more
    and less loop gain too, and all three have to agree.  backlash: that of the fit if None.  kp_factor, ti_factor:
    times the kp and ti of the log.  estimate, buffer: of the inverse; an estimate of 0 is the plain PI.
    """
    size = fitted.backlash if backlash is None else backlash
    if (size, kp_factor, ti_factor, estimate) == (fitted.backlash, 1.0, 1.0, 0.0):
        return fitted.played(size, 1.0, 1.0, 0.0, buffer)  # the log itself, which is known
    factors = (1.0, GAIN_ERROR, 1.0 / GAIN_ERROR)
    found, more, less = (fitted.played(size, factor * kp_factor, ti_factor, estimate, buffer) for factor in factors)
    errors = [found.rmse, more.rmse, less.rmse]
    if not found.hunts == more.hunts == less.hunts:
        undecided = "whether the loop hunts"
    elif not max(errors) < LARGEST_SPREAD * min(errors):
        undecided = f"between control errors of {min(errors):.2g} and {max(errors):.2g} K"
    else:
        return found
    return (
        f"a {100 * (GAIN_ERROR - 1.0):.0f} % change of the loop gain decides {undecided}, and the log does not show "
        "the gain that accurately"
    )


def _doubt(fitted: FittedLoop, command: Array, temperature: Array, T_set: Array) -> str:
    """Why the fitted loop is not to be trusted, or nothing: it has to repeat the log that it was fitted to."""
    day, plant = fitted.day, fitted.plant
    played = play(plant, fitted.pi, day, fitted.stroke_time, fitted.backlash)
    counted = _counted_steps(day, plant.step)[:: plant.per_sample]
    at = slice(None, None, plant.per_sample)
    true = temperature - day.noise[at]
    logged = float(np.sqrt(np.mean((true - T_set)[counted] ** 2)))
    replayed = float(np.sqrt(np.mean((played.temperature[at] - T_set)[counted] ** 2)))
    travels, travelled = (
        float(np.sum(np.abs(np.diff(series))[counted[1:]])) for series in (played.command[at], command)
    )
    travel_ratio = max(travels, 1e-9) / max(travelled, 1e-9)
    if abs(math.log(replayed / logged)) < LARGEST_ERROR and abs(math.log(travel_ratio)) < LARGEST_TRAVEL_ERROR:
        return ""
    return (
        f"the fitted loop does not reproduce the log: its control error is {replayed:.2g} K, the logged one "
        f"{logged:.2g} K; its command travels {travels:.3g} strokes, the logged one {travelled:.3g}"
    )
