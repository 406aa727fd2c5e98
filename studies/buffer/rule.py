"""How small and how large a buffer may be: closed formulas, and the describing function behind one of them.

A backlash inverse turns when u comes back from its extreme by more than the buffer b.  Too small a buffer turns on
noise; too large a one holds the valve until u has moved by b and then jumps there, which makes a cycle of its own.
All in plain numpy, for arrays of loops at once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

Values = Any  # a number, or an array of numbers
ALLOWED_TURNS_PER_HOUR = 10.0
"""False turns per hour that the lower bound allows: about as many as a loop makes without any noise."""
LOWER_SCALE = 0.9  # measured lower bound over the one of white noise, median of the valves and days of the choice
UPPER_SCALE = 1.3
"""Factor of the cycle's swing, median of the valves of the choice; the describing function alone gives 1.2."""
SWING_POWER = 0.4
"""Along the describing function 2 A |N| / b is 1.2 (90° / phase) to this power, within 7 % from 5 to 90°."""
CROSSING_GAIN = np.pi / 4
"""|L| where a lag of 90° meets the describing function: the least loop gain that a cycle of this buffer needs."""
LEAST_PHASE = np.radians(5.0)  # phase margins below this count as this: such a loop rings whatever the buffer


class Plant(NamedTuple):
    """Gain (K per stroke, above 0), time constant and dead time (s, with half a sample time) of a step."""

    gain: Values
    tau: Values
    theta: Values


def turns_per_sample(c: float) -> float:
    """Turns per sample of an inverse whose u is white noise, behind a buffer of ``c`` standard deviations: exact.

    With y the extreme in the direction of travel, in standard deviations, the next sample moves it with probability
    Q(y) and turns with probability Q(c - y).  The balance of these flows has the stationary density
    2 φ(y) Q(c - y) / (Q(y) + Q(c - y))², so that the turns are the mean of Q(c - y): 2/3 at c = 0, the turning points
    of a random series.
    """
    y, step = np.linspace(-9.0, c + 9.0, 4001, retstep=True)
    onward, back = ndtr(-y), ndtr(y - c)
    density = np.exp(-0.5 * y**2) / np.sqrt(2.0 * np.pi)
    return float(step * np.sum(2.0 * density * (back / (onward + back)) ** 2))


def noise_factor(sample_time: Values, per_hour: float = ALLOWED_TURNS_PER_HOUR) -> Values:
    """Buffer over the noise in u at which white noise turns the inverse so often per hour: 2 z, Q(z) = 2 p / π.

    p: turns per sample, per_hour x sample_time / 3600.  For c of 3 and more the exact rate is (π/2) Q(c/2) to 5 %: near
    c/2, where the extreme stands, moving on and turning are equally likely.
    """
    p = per_hour * sample_time / 3600.0
    return -2.0 * ndtri(np.minimum(2.0 * p / np.pi, 0.5))


def mean_noise_range(samples: float) -> float:
    """Mean peak to peak of so many samples of white noise, in standard deviations: what a trend of them shows."""
    y, step = np.linspace(-9.0, 9.0, 4001, retstep=True)
    return float(step * np.sum(1.0 - ndtr(y) ** samples - ndtr(-y) ** samples))


def smallest_buffer(kp: Values, sigma: Values, sample_time: Values, per_hour: float = ALLOWED_TURNS_PER_HOUR) -> Values:
    """Lower bound: the buffer behind which noise of standard deviation ``sigma``, K, turns it so often an hour."""
    return LOWER_SCALE * noise_factor(sample_time, per_hour) * kp * sigma


def describing_function(amplitude: Values) -> Values:
    """Describing function N from u to the held u_ext, for a sine of ``amplitude`` over b.

    After each extreme the output holds until u has come back by b, then jumps to u:
    N = 1 + (2/π) (sin φ - φ/2 - sin 2φ / 4) - j x²/π with x = b/A and cos φ = 1 - x; 0 below A = b/2.
    """
    a = np.asarray(amplitude, dtype=float)
    x = 1.0 / np.maximum(a, 0.5)
    phi = np.arccos(1.0 - x)
    n = 1.0 + (2.0 / np.pi) * (np.sin(phi) - 0.5 * phi - 0.25 * np.sin(2.0 * phi)) - 1j * x**2 / np.pi
    return np.where(a >= 0.5, n, 0.0)


def loop_response(plant: Plant, kp: Values, ti: Values, w: Values) -> Values:
    """L(jω) of PI and plant."""
    s = 1j * w
    return kp * plant.gain * (1.0 + 1.0 / (s * ti)) * np.exp(-s * plant.theta) / (1.0 + s * plant.tau)


def cycle_frequency(plant: Plant, kp: Values, ti: Values) -> Values:
    """ω at which |L| = π/4, rad/s, from a quadratic in ω²: about that of the buffer's cycle."""
    loop_gain_squared, lag_ratio_squared = (kp * plant.gain / CROSSING_GAIN) ** 2, (plant.tau / ti) ** 2
    excess = loop_gain_squared - 1.0
    return (
        np.sqrt((excess + np.sqrt(excess**2 + 4.0 * lag_ratio_squared * loop_gain_squared)) / (2.0 * lag_ratio_squared))
        / ti
    )


def phase_margin(plant: Plant, kp: Values, ti: Values) -> Values:
    """Phase margin at that frequency, rad.  Above 90° the buffer has no cycle, at 0 the loop rings without it."""
    w = cycle_frequency(plant, kp, ti)
    return 0.5 * np.pi - (w * plant.theta + np.arctan(w * plant.tau) - np.arctan(w * ti))


def swing_per_buffer(plant: Plant, kp: Values, ti: Values) -> Values:
    """Swing of the supply temperature, peak to peak, over b, K: 2 A |N| K / √(1 + ω²τ²), with A from the phase."""
    w = cycle_frequency(plant, kp, ti)
    margin = np.clip(phase_margin(plant, kp, ti), LEAST_PHASE, 0.5 * np.pi)
    return UPPER_SCALE * plant.gain * (0.5 * np.pi / margin) ** SWING_POWER / np.sqrt(1.0 + (w * plant.tau) ** 2)


def largest_buffer(plant: Plant, kp: Values, ti: Values, swing: Values) -> Values:
    """Upper bound: buffer whose own cycle swings the supply temperature by ``swing``, K peak to peak."""
    return swing / swing_per_buffer(plant, kp, ti)


class Cycle(NamedTuple):
    """Period (s), swing over b (K peak to peak); NaN where there is no cycle."""

    period: Values
    swing: Values


def predict_cycle(plant: Plant, kp: Values, ti: Values) -> Cycle:
    """Predict the buffer's cycle from its describing function, without the fits: L = -1/N, at falling |L||N|.

    All arguments along one dim.
    """
    amplitude = 0.5 * np.geomspace(1.0, 1e3, 2000)
    n = describing_function(amplitude)
    lags = -np.angle(n)
    w = np.geomspace(1e-4, 0.3, 3000)
    loop_gain = np.abs(
        loop_response(Plant(*(np.asarray(v)[:, None] for v in plant)), _as_column(kp), _as_column(ti), w)
    )
    margin = 0.5 * np.pi - (
        w * _as_column(plant.theta) + np.arctan(w * _as_column(plant.tau)) - np.arctan(w * _as_column(ti))
    )
    is_in_range = (margin > lags[-1]) & (margin <= lags[0])
    a = np.interp(margin, lags[::-1], amplitude[::-1])
    product = np.where(is_in_range, loop_gain * np.abs(describing_function(a)), np.nan)
    is_falling = (product[:, :-1] >= 1.0) & (product[:, 1:] < 1.0)
    last_fall = is_falling.shape[1] - 1 - is_falling[:, ::-1].argmax(1)
    row = np.arange(len(last_fall))
    opening = a[row, last_fall] * np.abs(describing_function(a[row, last_fall]))
    swing = 2.0 * opening * np.asarray(plant.gain) / np.sqrt(1.0 + (w[last_fall] * np.asarray(plant.tau)) ** 2)
    has_no_cycle = ~is_falling.any(1)
    return Cycle(np.where(has_no_cycle, np.nan, 2.0 * np.pi / w[last_fall]), np.where(has_no_cycle, np.nan, swing))


def _as_column(values: Values) -> Values:
    return np.asarray(values)[:, None]
