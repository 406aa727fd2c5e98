"""The backlash of a valve from the command and the supply temperature of a trend log, or why the log cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Mask
from fastcoil.measured.diagnosis.control_law import arrivals, is_provoked, late, share_to_and_fro
from fastcoil.measured.diagnosis.likelihood import HORIZON, Likelihood, likelihoods
from fastcoil.measured.diagnosis.motion import motor_positions, turns

CANDIDATES = np.arange(0.0, 0.2501, 0.0025)
"""Sizes that are tried, fractions of stroke."""
SURE = 0.95
"""Probability of being right from which a size counts as identified."""
CONFIDENCE = 0.95
"""Of the interval."""
WEIGHT, WEIGHT_REACTION = 0.8, 0.3
"""Share of the log-likelihood that counts, without and with the reaction: residuals are neither independent nor
normal.  Chosen on populations of their own, see ``studies/diagnosis/diagnosis.py``."""
GOOD = 0.01
"""Up to this backlash a valve is called good; also the least tolerance of a size, beside ``TOLERANCE`` of it."""
TOLERANCE = 0.2
LEAST_ODDS = 300.0
"""Of the most probable size against the most probable one of a good valve, for a valve to be called worse than good."""
USUAL_STROKE_TIME = 90.0
"""Seconds, where nobody gives it."""
LEAST_TURN = 0.005
MOST_ARRIVALS, SWING = (10, 0.2), 0.05
"""Of the command at its ends: that many, and that share of its turns by more than ``SWING``."""
LONGEST_INTERVAL = 60.0
MOST_TO_AND_FRO, JUMPY_COUNTS = 0.01, 0.5
"""Share of the samples at which the command may move back what it moved the sample before; the share of the likelihood
that counts of a log with more."""


class Identification(NamedTuple):
    """What a log tells of the backlash.

    backlash: the most probable size, fraction of stroke; NaN where the log was not fit to compare any.
    low, high: interval of 95 %.
    identified: whether the size is right, to 20 % of itself or 1 % of stroke, with 95 % probability.
    reason: why not; empty if identified.
    candidates, probability: the profile.
    late: seconds by which the temperatures of the log stand late beside the commands; they were moved back by that.
    Negative: the commands stand late, or their controller is slow to read; both were reckoned with.
    """

    backlash: float
    low: float
    high: float
    identified: bool
    reason: str
    candidates: Array
    probability: Array
    late: float = 0.0


def identify_backlash(
    command: Array,
    temperature: Array,
    interval: float,
    T_set: Array | None = None,
    disturbances: tuple[Array, ...] = (),
    enabled: Mask | None = None,
    stroke_time: float | None = None,
    sample_time: float | None = None,
) -> Identification:
    """Identify the backlash of a valve from a trend log.

    Parameters
    ----------
    command, temperature
        (n,): command to the actuator, fraction of stroke, and measured supply temperature, °C.  NaN where missing.
    interval
        Seconds from sample to sample.
    T_set
        Set-point, °C, if the log has it.
    disturbances
        What else the log has that moves the temperature: air flow, entering air temperature.
    enabled
        Whether the plant was on; all of it if None.
    stroke_time
        Of the motor, s; 90 if None, 0 if it is as good as immediate.
    sample_time
        Of the controller, s, if known.
    """
    command, temperature = np.asarray(command, float), np.asarray(temperature, float)
    good = np.isfinite(command) & np.isfinite(temperature)
    for series in disturbances:
        good &= np.isfinite(series)
    good = good if enabled is None else good & np.asarray(enabled, bool)
    if interval > LONGEST_INTERVAL:
        return _cannot(f"the log has a sample every {interval:g} s only: log every {HORIZON:g} s or faster")
    if not good.any():
        return _cannot("no sample has both a command and a temperature with the plant on")
    seconds = USUAL_STROKE_TIME if stroke_time is None else stroke_time
    travel = interval / seconds if seconds > 0.0 else 1.0
    log = _Log(_held(command), _held(temperature), tuple(np.asarray(d, float) for d in disturbances), good)
    positions = motor_positions(log.command, travel)
    if turns(positions, LEAST_TURN) == 0:
        return _cannot("the command never turns back, and a gap shows at turns only: change the set-point up and down")
    samples = late(log.command, log.temperature, good)
    # a command that answers old temperatures may be that of a slow controller, and stand where it belongs
    logs = [log.moved(samples)] if samples >= 0 else [log, log.moved(samples)]
    found = [each for each in (_compared(one, interval, travel) for one in logs) if each is not None]
    if not found:
        return _cannot("too little of the log can be used, or its temperature stands still: log for two hours or more")
    provoked = is_provoked(log.command, log.temperature, good, T_set, interval)
    unseen = sample_time is None or sample_time < interval
    in_step = sample_time is not None and not unseen and (sample_time / interval) % 1.0 < 1e-6
    doubt, counts = "", min(1.0, HORIZON / interval) if unseen else 1.0
    jumpy = share_to_and_fro(log.command, good) > MOST_TO_AND_FRO
    counts *= JUMPY_COUNTS if jumpy else 1.0
    if jumpy and not (provoked and in_step):
        doubt = (
            "the command jumps to and fro from sample to sample, and the stem may have moved between them unseen: log "
            "as often as the controller acts, say its sample time, and change the set-point up and down"
        )
    elif arrivals(log.command, good) > max(MOST_ARRIVALS[0], MOST_ARRIVALS[1] * turns(positions, SWING)):
        doubt = "the command runs to its ends again and again: lower the gain of the controller, and log again"
    return _judged(found, provoked, doubt, counts)._replace(late=samples * interval)


class _Log(NamedTuple):
    """What is compared, each (n,)."""

    command: Array
    temperature: Array
    disturbances: tuple[Array, ...]
    good: Mask

    def moved(self, samples: int) -> _Log:
        """The temperatures and all that is measured with them moved to where they belong, if they stand late."""
        if samples == 0:
            return self
        n = self.command.size
        at, seen = slice(max(-samples, 0), n - max(samples, 0)), slice(max(samples, 0), n - max(-samples, 0))
        disturbances = tuple(series[seen] for series in self.disturbances)
        return _Log(self.command[at], self.temperature[seen], disturbances, self.good[at] & self.good[seen])


def _compared(log: _Log, interval: float, travel: float) -> Likelihood | None:
    positions = motor_positions(log.command, travel)
    return likelihoods(log.temperature, positions, log.disturbances, log.good, interval, CANDIDATES)


def _judged(found: Sequence[Likelihood], provoked: bool, doubt: str, counts: float) -> Identification:
    """The most probable size and whether it may be claimed.

    found: of each way in which the columns may fit in time.  provoked: whether something else than the temperature
    moved the command.  If nothing did, the command itself gets coefficients of its own, and a good valve is never
    claimed: a stem that stands still looks the same.  doubt: why nothing may be claimed of this log, if so.  counts:
    share of the likelihood that counts, less where the controller moves the valve between the samples.
    """
    probability = np.zeros(CANDIDATES.size)
    for one in found:
        likelihood = counts * (WEIGHT * one.plain if provoked else WEIGHT_REACTION * one.reaction)
        of_one = np.exp(likelihood - likelihood.max())
        probability += of_one / of_one.sum() / len(found)
    right = np.abs(CANDIDATES[:, np.newaxis] - CANDIDATES) <= np.maximum(TOLERANCE * CANDIDATES, GOOD) + 1e-9
    surely = right @ probability
    best = int(probability.argmax())
    if surely[best] < SURE <= surely.max():
        best = int(surely.argmax())
    backlash, good = float(CANDIDATES[best]), CANDIDATES <= GOOD + 1e-9
    worse = bool(probability.max() >= LEAST_ODDS * probability[good].max())
    low, high = _interval(probability)
    low = low if worse else 0.0
    reason = doubt
    if doubt:
        low, high = 0.0, float(CANDIDATES[-1])
    elif backlash <= GOOD and not provoked:
        reason = (
            "the command only follows the temperature, and a stuck stem looks like a good one: change the set-point"
        )
        low, high = 0.0, float(CANDIDATES[-1])
    elif surely[best] < SURE or (backlash > GOOD and not worse):
        sizes = f"gaps from {100 * low:.1f} % to {100 * high:.1f} %"
        reason = f"{sizes} explain the log: change the set-point up and down, or log longer"
    elif high >= CANDIDATES[-1]:
        reason = f"the gap may be {100 * high:.0f} % of the stroke or more, and larger ones are not looked for"
    return Identification(backlash, low, high, not reason, reason, CANDIDATES, probability)


def _interval(probability: Array) -> tuple[float, float]:
    """The tails outside hold the same probability; a step of the candidates is added on both sides.

    Half of it is the width of a candidate, the rest for what a linear model sampled every 30 s gets wrong.
    """
    below, step = np.cumsum(probability), CANDIDATES[1] - CANDIDATES[0]
    low = CANDIDATES[np.argmax(below > 0.5 * (1.0 - CONFIDENCE))] - step
    high = CANDIDATES[np.argmax(below >= 0.5 * (1.0 + CONFIDENCE) - 1e-12)] + step
    return max(float(low), 0.0), min(float(high), float(CANDIDATES[-1]))


def _held(series: Array) -> Array:
    """Missing values replaced by the last before them, those at the beginning by the first there is."""
    known = np.flatnonzero(np.isfinite(series))
    return series[known[np.maximum(np.searchsorted(known, np.arange(series.size), side="right") - 1, 0)]]


def _cannot(reason: str) -> Identification:
    nothing = np.full(CANDIDATES.size, 1.0 / CANDIDATES.size)
    return Identification(np.nan, 0.0, float(CANDIDATES[-1]), False, reason, CANDIDATES, nothing)
