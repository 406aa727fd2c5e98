"""The buffer as a multiple of the noise in u, and the noise found from the controller's own readings."""

from __future__ import annotations

import math

from fastcoil.model.numerics.jit import exact

SAMPLES = 100.0
"""Samples that the measured noise goes back over."""
FIRST_GUESS, LEAST = 0.1, 1e-3
"""Median second difference at the start, and the least that it may fall to, K: none would never rise again."""
# half of all normal numbers lie within 0.674 σ, and second differences of white noise have the variance 6 σ²
_NOISE = 1.0 / (0.6744897501960817 * math.sqrt(6.0))


@exact
def noise_buffer(least, ratio, kp, sigma, highest):
    """Buffer: ``ratio`` times the noise K_p σ that a PI passes on to u, up to ``highest``, but at least ``least``.

    sigma: K.  A ratio of 0 leaves ``least``.
    """
    b = ratio * abs(kp) * sigma
    b = highest if b > highest else b
    return least if b < least else b


@exact
def largest_buffer(swing, plant_gain):
    """Buffer at which the jump of u across it moves the supply temperature by ``swing``; both in K; swing 0 = any."""
    return swing / plant_gain if swing > 0.0 else math.inf


@exact
def median_difference(median, readings, e, e_1, e_2):
    """Median size of the second differences of the error, K, after so many readings; e, e_1, e_2: the last three.

    It goes up by a share of itself where the difference is larger, and down where it is smaller: by 1/readings, and by
    1/100 at least.  A drift has no second difference, and one as large as after a step of the set-point counts like
    any other; it would rule a mean of squares.
    """
    size = abs((e - e_1) - (e_1 - e_2))
    share = 1.0 / readings
    share = 1.0 / SAMPLES if share < 1.0 / SAMPLES else share
    moved = median * (1.0 + share if size > median else 1.0 - share)
    moved = LEAST if moved < LEAST else moved
    return moved if readings >= 3.0 else FIRST_GUESS


@exact
def noise_level(median):
    """Standard deviation of white noise whose second differences have this median size, K."""
    return _NOISE * median
