"""Why a loop swings: the gap of its valve, its tuning, or something from outside."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.diagnosis.fitted_loop import FittedLoop, what_if
from fastcoil.diagnosis.measures import Measures
from fastcoil.diagnosis.outcome import Outcome
from fastcoil.diagnosis.swing import Swing, running_mean

NONE, BACKLASH, TUNING, DISTURBANCE, UNKNOWN = "none", "backlash", "tuning", "disturbance", "unknown"
FULL_SWING = 0.6
"""Swing of the command that no gap makes, fraction of stroke: the loop is unstable, the ends of the valve hold it."""
ALIKE, LEAST_SIZE = 1.6, 0.5
"""A model swings as the log does if the periods differ by less than this factor, and if its swing has at least this
share of the logged one."""
FORETELLS = 0.8
"""Margin max |L||N| of the describing function above which a gap may make the loop hunt."""
_KICKED, _LEAST_KICK = 600.0, 1.0
"""Seconds and K by which the set-point is off at first, so that a cycle that needs a start gets it."""


class Cause(NamedTuple):
    """The cause, one word of those above, and why, a sentence."""

    name: str
    because: str


def cause_of(measures: Measures, fitted: FittedLoop | str) -> Cause:
    """Judge why a loop swings.

    The fitted loop is simulated on the day of the log with all fast disturbances taken away, with its gap and without.
    What still swings then swings by itself.

    Parameters
    ----------
    measures
        What the log shows.
    fitted
        The loop as a model, or why there is none.
    """
    swing, stroke = measures.swing, measures.command_swing
    if not swing.is_regular:
        return Cause(UNKNOWN, measures.blind) if measures.blind else Cause(NONE, "no swing comes back regularly")
    if stroke > FULL_SWING:
        return Cause(
            TUNING, f"the command swings over {stroke:.0%} of the stroke, more than a gap makes it: lower the gain"
        )
    if isinstance(fitted, str):
        return Cause(UNKNOWN, f"the loop could not be modelled: {fitted}")
    return _of_model(fitted, swing)


def _of_model(fitted: FittedLoop, swing: Swing) -> Cause:
    quiet = by_itself(fitted, swing)
    with_gap, without = what_if(quiet), what_if(quiet, backlash=0.0)
    if isinstance(without, Outcome) and _swings_alike(without, swing):
        return Cause(TUNING, "the loop would hunt with a perfect valve, too: lower the gain")
    if isinstance(with_gap, Outcome) and _swings_alike(with_gap, swing):
        if isinstance(without, str):
            return Cause(UNKNOWN, f"gap or tuning: {without}")
        return Cause(BACKLASH, "the loop would not hunt without it")
    if fitted.margin < FORETELLS:
        return Cause(DISTURBANCE, "the loop would not hunt by itself: look for what swings outside, water or air")
    return Cause(UNKNOWN, "the model of the loop does not swing as the log does")


def by_itself(fitted: FittedLoop, swing: Swing) -> FittedLoop:
    """The loop on its day without noise, and without any disturbance as fast as the swing."""
    day, step = fitted.day, fitted.plant.step
    everywhere = np.ones(day.disturbance.size, dtype=bool)
    slow = running_mean(day.disturbance, everywhere, max(3, round(2.0 * swing.period / step)))
    started = np.arange(day.T_set.size) * step >= _KICKED
    kick = np.where(started, 0.0, max(swing.peak_to_peak, _LEAST_KICK))
    return fitted._replace(day=day._replace(disturbance=slow, noise=np.zeros_like(day.noise), T_set=day.T_set + kick))


def _swings_alike(outcome: Outcome, swing: Swing) -> bool:
    if not outcome.hunts or 2.0 * outcome.amplitude < LEAST_SIZE * swing.peak_to_peak:
        return False
    return bool(abs(np.log(outcome.period / swing.period)) < np.log(ALIKE))
