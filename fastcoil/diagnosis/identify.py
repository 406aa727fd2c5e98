"""The backlash of a valve from the command and the supply temperature of a trend log, or why the log cannot tell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.arrays import Array, Mask
from fastcoil.diagnosis.likelihood import HORIZON, Likelihood, likelihoods
from fastcoil.diagnosis.motion import motor_positions, turns

CANDIDATES = np.arange(0.0, 0.2501, 0.0025)
"""Sizes that are tried, fractions of stroke."""
SURE = 0.95
"""Probability of being right from which a size counts as identified."""
CONFIDENCE = 0.95
"""Of the interval."""
WEIGHT, WEIGHT_REACTION = 0.6, 0.3
"""Share of the log-likelihood that counts, without and with the reaction: residuals are neither independent nor
normal.  Chosen on populations of their own, see ``studies/diagnosis.py``."""
GOOD = 0.01
"""Up to this backlash a valve is called good; also the least tolerance of a size, beside ``TOLERANCE`` of it."""
TOLERANCE = 0.2
USUAL_STROKE_TIME = 90.0
"""Seconds, where nobody gives it."""
LEAST_TURN = 0.005
LEAST_SET_POINT_CHANGE, LEAST_SET_POINT_CHANGES = 0.3, 2
JUMP, LEAST_JUMPS, APART = 3.0, 3, 600.0
"""A change of the command is a jump if it exceeds the 95th percentile of the changes this many times.  A start-up makes
some, so that three are asked for, these many seconds apart."""
LEAST_CHANGES = 40


class Identification(NamedTuple):
    """What a log tells of the backlash.

    backlash: the most probable size, fraction of stroke; NaN where the log was not fit to compare any.
    low, high: interval of 95 %.
    identified: whether the size is right, to 20 % of itself or 1 % of stroke, with 95 % probability.
    reason: why not; empty if identified.
    candidates, probability: the profile.
    """

    backlash: float
    low: float
    high: float
    identified: bool
    reason: str
    candidates: Array
    probability: Array


def identify_backlash(
    command: Array,
    temperature: Array,
    interval: float,
    T_set: Array | None = None,
    disturbances: tuple[Array, ...] = (),
    enabled: Mask | None = None,
    stroke_time: float | None = None,
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
    """
    command, temperature = np.asarray(command, float), np.asarray(temperature, float)
    good = np.isfinite(command) & np.isfinite(temperature)
    for series in disturbances:
        good &= np.isfinite(series)
    good = good if enabled is None else good & np.asarray(enabled, bool)
    if interval > HORIZON:
        return _cannot(f"the log has a sample every {interval:g} s only: log every {HORIZON:g} s or faster")
    if not good.any():
        return _cannot("no sample has both a command and a temperature with the plant on")
    command = _held(command)
    seconds = USUAL_STROKE_TIME if stroke_time is None else stroke_time
    positions = motor_positions(command, interval / seconds if seconds > 0.0 else 1.0)
    if turns(positions, LEAST_TURN) == 0:
        return _cannot("the command never turns back, and a gap shows at turns only: change the set-point up and down")
    found = likelihoods(temperature, positions, disturbances, good, interval, CANDIDATES)
    if found is None:
        return _cannot("too little of the log can be used, or its temperature stands still: log for two hours or more")
    return _judged(found, _is_provoked(command, good, T_set, interval))


def _judged(found: Likelihood, provoked: bool) -> Identification:
    """The most probable size and whether it may be claimed.

    ``provoked``: whether something else than the temperature moved the command.  If nothing did, the command itself
    gets coefficients of its own, and a good valve is never claimed: a stem that stands still looks the same.
    """
    likelihood = WEIGHT * found.plain if provoked else WEIGHT_REACTION * found.reaction
    probability = np.exp(likelihood - likelihood.max())
    probability /= probability.sum()
    best = float(CANDIDATES[probability.argmax()])
    low, high = _interval(probability)
    right = np.abs(CANDIDATES - best) <= np.maximum(TOLERANCE * CANDIDATES, GOOD) + 1e-9
    reason = ""
    if best <= GOOD and not provoked:
        reason = (
            "the command only follows the temperature, and a stuck stem looks like a good one: change the set-point"
        )
        low, high = 0.0, float(CANDIDATES[-1])
    elif float(probability[right].sum()) < SURE:
        reason = f"gaps from {low:.1%} to {high:.1%} explain the log: change the set-point up and down, or log longer"
    elif best == CANDIDATES[-1]:
        reason = f"the gap is {best:.0%} of the stroke or more: the largest that is looked for"
    return Identification(best, low, high, not reason, reason, CANDIDATES, probability)


def _interval(probability: Array) -> tuple[float, float]:
    """The tails outside hold the same probability; a step of the candidates is added on both sides.

    Half of it is the width of a candidate, the rest for what a linear model sampled every 30 s gets wrong.
    """
    below, step = np.cumsum(probability), CANDIDATES[1] - CANDIDATES[0]
    low = CANDIDATES[np.argmax(below > 0.5 * (1.0 - CONFIDENCE))] - step
    high = CANDIDATES[np.argmax(below >= 0.5 * (1.0 + CONFIDENCE) - 1e-12)] + step
    return max(float(low), 0.0), min(float(high), float(CANDIDATES[-1]))


def _is_provoked(command: Array, good: Mask, T_set: Array | None, interval: float) -> bool:
    """Whether the set-point changed; where the log has none, whether the command jumped as it does then."""
    both = good[1:] & good[:-1]
    if T_set is not None:
        changes = np.abs(np.diff(np.asarray(T_set, float)))[both]
        return bool(np.sum(changes >= LEAST_SET_POINT_CHANGE) >= LEAST_SET_POINT_CHANGES)
    changes = np.abs(np.diff(command))[both]
    moved = changes[changes > 0.0]
    if moved.size < LEAST_CHANGES:
        return False
    jumps = np.flatnonzero((np.abs(np.diff(command)) > JUMP * np.quantile(moved, 0.95)) & both)
    return 1 + int(np.sum(np.diff(jumps) * interval > APART)) >= LEAST_JUMPS


def _held(series: Array) -> Array:
    """Missing values replaced by the last before them, those at the beginning by the first there is."""
    known = np.flatnonzero(np.isfinite(series))
    return series[known[np.maximum(np.searchsorted(known, np.arange(series.size), side="right") - 1, 0)]]


def _cannot(reason: str) -> Identification:
    nothing = np.full(CANDIDATES.size, 1.0 / CANDIDATES.size)
    return Identification(np.nan, 0.0, float(CANDIDATES[-1]), False, reason, CANDIDATES, nothing)
