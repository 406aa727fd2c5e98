"""Hägglund's estimate (J. Process Control 17, 2007) from how long the control error stays on one side of zero.

While the gap is crossed the valve stands still: the error is a square wave, and the PI integrates its way across.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fastcoil.estimators.family import Estimator, low_passed
from fastcoil.numerics.jit import exact

LONG = 5.0
"""A half period of at least so many integral times counts."""
PEAKED = 2.0
"""One whose largest error is at least so many times its mean is not square and does not count."""


@exact
def dead_band(duration, mean_e, kp, ti, plant_gain):
    """Gap crossed in a half period, d = K (Δt/Ti - 1/(K Kp)) Δy; fraction of stroke.

    duration: Δt, s.  mean_e: Δy, mean of the absolute error over it, K.  kp: gain K of the controller, 1/K.  plant_gain:
    Kp, K per stroke.  What the PI integrates is what crosses the gap, and what the valve moves, Δy/Kp.
    """
    return (kp * duration / ti - 1.0 / plant_gain) * mean_e


@exact
def counts(duration, mean_e, peak, ti, d):
    """Whether a half period is evidence: long, nearly square, and with a gap d that a valve can have."""
    return duration >= LONG * ti and peak < PEAKED * mean_e and d > 0.0 and d < 1.0


@exact
def crosses(before, e):
    """Whether an error changed sides; NaN has none."""
    return (before > 0.0 and e <= 0.0) or (before <= 0.0 and e > 0.0)


@exact
def _least(a, b):
    return a if a < b else b


@exact
def _most(a, b):
    return b if a < b else a


@exact
def median(a, b, c, d, e):
    """Median of five."""
    low = _most(_least(a, b), _least(c, d))
    high = _least(_most(a, b), _most(c, d))
    return _most(_least(low, high), _least(_most(low, high), e))


class Parameters(NamedTuple):
    """Parameters of the loop that the estimate uses."""

    sample_time: float
    kp: float
    ti: float
    plant_gain: float
    estimate_share: float
    hagglund_filter_ratio: float
    hagglund_least_half_periods: float


class Memory(NamedTuple):
    """What it remembers."""

    t: float = 0.0
    """Time of the last sample, s."""
    e: float = np.nan
    """Filtered error, K."""
    n: float = np.nan
    """Samples of this half period; NaN before the first zero crossing."""
    sum_e: float = 0.0
    """Their absolute errors, summed, K."""
    peak: float = 0.0
    """Largest of them, K."""
    counted: float = 0.0
    """Half periods that counted."""
    d1: float = np.nan
    """Gap of the last of them, and of the four before."""
    d2: float = np.nan
    d3: float = np.nan
    d4: float = np.nan
    d5: float = np.nan


@exact
def step(now, p, memory):
    """Add a sample to its half period, and where one ends, take its gap into the running median.

    The median of the last five needs five rows, forgets what is old, and is not moved by single disturbances, whose gaps
    are several times too large.  An inverse that acts on the estimate leaves only the rest of the gap to be seen, so
    the estimate is then final; where no share of it is assumed it goes on.
    """
    broken = now.t - memory.t > p.sample_time  # the loop was off: what it was in is no half period
    before = np.nan if broken else memory.e
    e = low_passed(before, now.e, p.hagglund_filter_ratio * p.ti, p.sample_time)
    size = abs(e)
    ends = crosses(before, e)

    duration, mean_e = memory.n * p.sample_time, memory.sum_e / memory.n
    d = dead_band(duration, mean_e, p.kp, p.ti, p.plant_gain)
    final = p.estimate_share > 0.0 and memory.counted >= p.hagglund_least_half_periods
    good = ends and not final and counts(duration, mean_e, memory.peak, p.ti, d)
    counted = memory.counted + 1.0 if good else memory.counted
    d1 = d if good else memory.d1
    d2 = memory.d1 if good else memory.d2
    d3 = memory.d2 if good else memory.d3
    d4 = memory.d3 if good else memory.d4
    d5 = memory.d4 if good else memory.d5
    n = np.nan if broken else memory.n + 1.0
    n = 1.0 if ends else n
    sum_e = size if ends else memory.sum_e + size
    peak = size if ends or size > memory.peak else memory.peak
    declared = good and counted >= p.hagglund_least_half_periods
    after = Memory(now.t, e, n, sum_e, peak, counted, d1, d2, d3, d4, d5)
    return median(d1, d2, d3, d4, d5) if declared else now.estimate, after


def results(memory: Any) -> dict[str, np.ndarray]:
    """The estimator's own metrics at the end of a run."""
    last = np.stack([memory.d1, memory.d2, memory.d3, memory.d4, memory.d5])
    return {"half_periods": np.asarray(memory.counted), "half_period_spread": last.max(axis=0) - last.min(axis=0)}


HAGGLUND = Estimator("hagglund", Parameters, Memory, step, results=results)
