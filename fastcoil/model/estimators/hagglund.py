"""Hägglund's estimate (J. Process Control 17, 2007) from how long the control error stays on one side of zero.

While the gap is crossed the valve stands still: the error is a square wave, and the PI integrates its way across.
"""

from typing import Any, NamedTuple

import numpy as np

from fastcoil.model.estimators.interface import Estimator, filter_weight, low_pass
from fastcoil.model.numerics.jit import exact

# conditions of acceptance, Hägglund (2007)
LEAST_DURATION_RATIO = 5.0  # duration of a half period over the integral time
LARGEST_PEAK_RATIO = 2.0  # largest error of a half period over its mean: a square wave has 1


@exact
def crossed_gap(duration, iae, kp, ti, plant_gain):
    """Gap crossed in a half period, d = K (Δt/Ti - 1/(K Kp)) Δy; fraction of stroke.

    duration: Δt, s.  iae: Δy Δt, K s.  kp: K, 1/K.  plant_gain: Kp, K per stroke.  All that the PI integrates crosses
    the gap, but for what moves the valve, Δy/Kp.  Written with one division, which takes as long as the rest.
    """
    return (kp * plant_gain * duration - ti) * iae / (plant_gain * ti * duration)


@exact
def is_evidence(duration, iae, peak, ti, d):
    """Whether a half period is evidence: long, nearly square, and with a gap d that a valve can have."""
    return duration >= LEAST_DURATION_RATIO * ti and peak * duration < LARGEST_PEAK_RATIO * iae and d > 0.0 and d < 1.0


@exact
def has_changed_sign(previous_e, e):
    """Whether an error changed its sign; NaN has none."""
    return (previous_e > 0.0 and e <= 0.0) or (previous_e <= 0.0 and e > 0.0)


@exact
def _smaller(a, b):
    return a if a < b else b


@exact
def _larger(a, b):
    return b if a < b else a


@exact
def median_of_five(a, b, c, d, e):
    """Median of five."""
    low = _larger(_smaller(a, b), _smaller(c, d))
    high = _smaller(_larger(a, b), _larger(c, d))
    return _larger(_smaller(low, high), _smaller(_larger(low, high), e))


class Parameters(NamedTuple):
    """Parameters of the loop that the estimator reads."""

    sample_time: float
    kp: float
    ti: float
    plant_gain: float
    estimate_share: float
    hagglund_filter_ratio: float
    hagglund_least_half_periods: float


class Memory(NamedTuple):
    """State from one sample to the next."""

    weight: float  # weight of a new value in the filter
    e: float  # filtered error, K
    duration: float  # duration of this half period so far, s; NaN before there is a zero crossing
    iae: float  # integral of the absolute error over it, K s
    peak: float  # largest absolute error in it, K
    n_counted: float  # half periods that counted
    d1: float  # gap of the last of them; below, of the four before
    d2: float
    d3: float
    d4: float
    d5: float


@exact
def initial_memory(p):
    """Memory at the start: nothing yet."""
    weight = filter_weight(p.hagglund_filter_ratio * p.ti, p.sample_time)
    return Memory(weight, np.nan, np.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@exact
def update_estimate(now, p, memory):
    """Add a sample to its half period, and where one ends, take its gap into the running median.

    The median of five ignores single disturbances.  An inverse that acts on the estimate leaves only the rest of the
    gap to be seen, so the estimate is then final.
    """
    e = low_pass(memory.e, now.e, memory.weight)
    size = abs(e)
    ends = has_changed_sign(memory.e, e)

    d = crossed_gap(memory.duration, memory.iae, p.kp, p.ti, p.plant_gain)
    is_final = p.estimate_share > 0.0 and memory.n_counted >= p.hagglund_least_half_periods
    counts = ends and not is_final and is_evidence(memory.duration, memory.iae, memory.peak, p.ti, d)
    n_counted = memory.n_counted + 1.0 if counts else memory.n_counted
    d1 = d if counts else memory.d1
    d2 = memory.d1 if counts else memory.d2
    d3 = memory.d2 if counts else memory.d3
    d4 = memory.d3 if counts else memory.d4
    d5 = memory.d4 if counts else memory.d5
    duration = (0.0 if ends else memory.duration) + p.sample_time
    # where the loop is off, or the valve at an end, the PI is not on its way across the gap
    duration = np.nan if now.u <= 0.0 or now.u >= 1.0 else duration
    iae = (0.0 if ends else memory.iae) + size * p.sample_time
    peak = size if ends or size > memory.peak else memory.peak
    has_estimate = counts and n_counted >= p.hagglund_least_half_periods
    next_memory = Memory(memory.weight, e, duration, iae, peak, n_counted, d1, d2, d3, d4, d5)
    return median_of_five(d1, d2, d3, d4, d5) if has_estimate else now.estimate, next_memory


def final_metrics(memory: Any) -> dict[str, np.ndarray]:
    """Return the metrics of Hägglund's estimator at the end of a run, by name."""
    gaps = np.stack([memory.d1, memory.d2, memory.d3, memory.d4, memory.d5])
    spread = np.where(np.asarray(memory.n_counted) >= len(gaps), np.ptp(gaps, axis=0), np.nan)
    return {"half_periods": np.asarray(memory.n_counted), "half_period_spread": spread}


ESTIMATOR = Estimator("hagglund", Parameters, Memory, update_estimate, initial_memory, results=final_metrics)
