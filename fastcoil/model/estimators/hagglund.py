"""Hägglund's estimate (J. Process Control 17, 2007) from how long the control error stays on one side of zero.

While the gap is crossed the valve stands still: the error is a square wave, and the PI integrates its way across.
"""

from typing import Any, NamedTuple

import numpy as np

from fastcoil.model.estimators.interface import Estimator, low_passed, weight_of_new
from fastcoil.model.numerics.jit import exact

LONG = 5.0
"""A half period of at least so many integral times counts."""
PEAKED = 2.0
"""One whose largest error is at least so many times its mean is not square and does not count."""


@exact
def dead_band(duration, iae, kp, ti, plant_gain):
    """Gap crossed in a half period, d = K (Δt/Ti - 1/(K Kp)) Δy; fraction of stroke.

    duration: Δt, s.  iae: integral of the absolute error over it, Δy Δt, K s.  kp: gain K of the controller, 1/K.
    plant_gain: Kp, K per stroke.  All that the PI integrates crosses the gap, but for what moves the valve, Δy/Kp.
    Written with one division, which takes as long as the rest.
    """
    return (kp * plant_gain * duration - ti) * iae / (plant_gain * ti * duration)


@exact
def counts(duration, iae, peak, ti, d):
    """Whether a half period is evidence: long, nearly square, and with a gap d that a valve can have."""
    return duration >= LONG * ti and peak * duration < PEAKED * iae and d > 0.0 and d < 1.0


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

    weight: float
    """Of a new value in the filter."""
    e: float
    """Filtered error, K."""
    duration: float
    """Of this half period so far, s; NaN before there is a zero crossing."""
    iae: float
    """Integral of the absolute error over it, K s."""
    peak: float
    """Largest absolute error in it, K."""
    counted: float
    """Half periods that counted."""
    d1: float
    """Gap of the last of them, and of the four before."""
    d2: float
    d3: float
    d4: float
    d5: float


@exact
def start(p):
    """Memory at the start: nothing yet."""
    weight = weight_of_new(p.hagglund_filter_ratio * p.ti, p.sample_time)
    return Memory(weight, np.nan, np.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@exact
def step(now, p, memory):
    """Add a sample to its half period, and where one ends, take its gap into the running median.

    The median of the last five needs five rows, forgets what is old, and ignores single disturbances, whose gaps are
    several times too large.  An inverse that acts on the estimate leaves only the rest of the gap to be seen, so the
    estimate is then final; where no share of it is assumed it goes on.
    """
    e = low_passed(memory.e, now.e, memory.weight)
    size = abs(e)
    ends = crosses(memory.e, e)

    d = dead_band(memory.duration, memory.iae, p.kp, p.ti, p.plant_gain)
    final = p.estimate_share > 0.0 and memory.counted >= p.hagglund_least_half_periods
    good = ends and not final and counts(memory.duration, memory.iae, memory.peak, p.ti, d)
    counted = memory.counted + 1.0 if good else memory.counted
    d1 = d if good else memory.d1
    d2 = memory.d1 if good else memory.d2
    d3 = memory.d2 if good else memory.d3
    d4 = memory.d3 if good else memory.d4
    d5 = memory.d4 if good else memory.d5
    duration = (0.0 if ends else memory.duration) + p.sample_time
    # where the loop is off, or the valve at an end, the PI is not on its way across the gap
    duration = np.nan if now.u <= 0.0 or now.u >= 1.0 else duration
    iae = (0.0 if ends else memory.iae) + size * p.sample_time
    peak = size if ends or size > memory.peak else memory.peak
    declared = good and counted >= p.hagglund_least_half_periods
    after = Memory(memory.weight, e, duration, iae, peak, counted, d1, d2, d3, d4, d5)
    return median(d1, d2, d3, d4, d5) if declared else now.estimate, after


def results(memory: Any) -> dict[str, np.ndarray]:
    """The estimator's own metrics at the end of a run."""
    last = np.stack([memory.d1, memory.d2, memory.d3, memory.d4, memory.d5])
    spread = np.where(np.asarray(memory.counted) >= len(last), last.max(axis=0) - last.min(axis=0), np.nan)
    return {"half_periods": np.asarray(memory.counted), "half_period_spread": spread}


ESTIMATOR = Estimator("hagglund", Parameters, Memory, step, start, results=results)
