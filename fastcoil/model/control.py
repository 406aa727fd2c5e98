"""The paper's controller, Figs 6 and 8, as scalar functions: PI law, backlash inverse and its alternatives, buffer."""

import math

import numpy as np

from fastcoil.model.numerics.elementary import exp
from fastcoil.model.numerics.jit import exact


@exact
def clip01(x):
    """Limit x to 0–1."""
    x = 0.0 if x < 0.0 else x
    return 1.0 if x > 1.0 else x


@exact
def sample_number(t, sample_time):
    """Number of the last controller sample at or before t: samples are taken where t mod sample_time = 0."""
    return np.floor(t / sample_time)


@exact
def in_dead_band(e, dead_band):
    """Whether the controller holds at an error e inside its dead band, both in K; a dead band of 0 never holds."""
    return abs(e) <= dead_band and dead_band > 0.0


@exact
def integral_part(integral, e, ki):
    """Integral part at a controller sample, 0–1; ki = K_p T_s / T_i, 1/K.  The new error is added before use."""
    return clip01(integral + ki * e)


@exact
def desired_opening(e, integral, kp):
    """PI output u, 0–1.  e: T - T_set (cooling), T_set - T (heating), K."""
    return clip01(kp * e + integral)


RISING = 1.0
FALLING = -1.0


@exact
def next_mode(u, mode, u_ext, buffer):
    """Mode, RISING or FALLING, at u: it turns when u comes back from its extreme u_ext by more than ``buffer``."""
    turned_down = mode > 0.0 and u < u_ext - buffer
    turned_up = mode < 0.0 and u > u_ext + buffer
    mode = FALLING if turned_down else mode
    return RISING if turned_up else mode


@exact
def next_extreme(u, mode, u_ext, has_turned):
    """u_ext at u: u itself at a turn or further on, else held."""
    is_further = (mode > 0.0 and u > u_ext) or (mode < 0.0 and u < u_ext)
    return u if has_turned or is_further else u_ext


@exact
def inverse_command(u_ext, mode, x_hat):
    """Command that makes the opening u_ext behind a backlash x_hat: (1 - x̂) u, plus x̂ when rising."""
    return clip01((1.0 - x_hat) * u_ext + (x_hat if mode > 0.0 else 0.0))


@exact
def additive_command(u_ext, mode, x_hat):
    """u_ext plus half the estimate x_hat in the direction of u, 0–1: Hägglund (2007), with δ = x̂.

    The direction is the buffered mode: the sign of du/dt would follow the noise.
    """
    half = 0.5 * x_hat
    return clip01(u_ext + (half if mode > 0.0 else -half))


@exact
def smooth_steepness(rate, sample_time):
    """4 / (rate T_s), of the smooth inverse: how fast its logistic function rises with a change of u.  rate: 1/s."""
    return 4.0 / (rate * sample_time)


@exact
def smooth_command(u, u_before, x_hat, steepness):
    """(1 - x̂) u + x̂ ½ (1 + tanh(k du/dt)) with k = 2/rate, 0–1: Zhou, Zhang and Wen (2007), Eqs 5–7.

    du/dt is the change over one sample; steepness: of ``smooth_steepness``.  At ``rate`` 98 % of the gap has been
    crossed.
    """
    crossed_share = 1.0 / (1.0 + exp(steepness * (u_before - u)))
    return clip01((1.0 - x_hat) * u + x_hat * crossed_share)


@exact
def noise_buffer(least, ratio, kp, sigma, highest):
    """Buffer, ``least`` to ``highest``: ``ratio`` times the noise K_p σ that a PI passes on to u; sigma: K."""
    b = ratio * abs(kp) * sigma
    b = highest if b > highest else b
    return least if b < least else b


@exact
def largest_buffer(swing, plant_gain):
    """Buffer at which the jump of u across it moves the supply temperature by ``swing``; both in K; swing 0 = any."""
    return swing / plant_gain if swing > 0.0 else math.inf


FIRST_MEDIAN_DIFFERENCE_K = 0.1  # before the third reading, and a guess until the median has been learned
LEAST_MEDIAN_DIFFERENCE_K = 1e-3  # a median of 0 would never rise again: it moves by shares of itself


@exact
def median_difference(median, readings, e, e_1, e_2):
    """Median size of the second differences of the error, K, after so many readings; e, e_1, e_2: the last three.

    It goes up or down by a share of itself, 1/readings and 1/100 at least.  A drift has no second difference, and one
    as large as after a step of the set-point, which would rule a mean of squares, counts like any other.
    """
    size = abs((e - e_1) - (e_1 - e_2))
    share = 1.0 / readings
    share = 0.01 if share < 0.01 else share
    new_median = median * (1.0 + share if size > median else 1.0 - share)
    new_median = LEAST_MEDIAN_DIFFERENCE_K if new_median < LEAST_MEDIAN_DIFFERENCE_K else new_median
    return new_median if readings >= 3.0 else FIRST_MEDIAN_DIFFERENCE_K


# half of all normal numbers lie within 0.674 σ, and second differences of white noise have the variance 6 σ²
_NOISE_PER_MEDIAN_DIFFERENCE = 1.0 / (0.6744897501960817 * math.sqrt(6.0))


@exact
def noise_level(median):
    """Standard deviation of white noise whose second differences have this median size, K."""
    return _NOISE_PER_MEDIAN_DIFFERENCE * median
