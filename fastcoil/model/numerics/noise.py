"""Counter-based Gaussian noise, Philox4x32-10 (Salmon et al. 2011, doi:10.1145/2063384.2063405), and a low-pass filter.

A number depends on (seed, sample, channel, replicate, day) only, not on the scenario, thread or earlier draws: every
loop of a study has the same noise, so differences between loops are paired.
"""

import numpy as np

from fastcoil.model.numerics.elementary import log, sincos_turns
from fastcoil.model.numerics.jit import exact, kernel

RNG_NAME = "philox4x32-10;boxmuller;v1"
MEASUREMENT_CHANNEL = 0
"""Channel of the measurement noise."""

# multipliers and key increments of Philox4x32, Salmon et al. (2011)
_MULTIPLIER_0 = np.uint64(0xD2511F53)
_MULTIPLIER_1 = np.uint64(0xCD9E8D57)
_WEYL_0 = np.uint64(0x9E3779B9)
_WEYL_1 = np.uint64(0xBB67AE85)
_WORD_MASK = np.uint64(0xFFFFFFFF)
_WORD_BITS = np.uint64(32)


@exact
def philox(c0, c1, c2, c3, k0, k1):
    """Return four random 32-bit words for a counter c0–c3 and a key k0, k1, all held in uint64."""
    for _ in range(10):
        product_0 = _MULTIPLIER_0 * c0
        product_1 = _MULTIPLIER_1 * c2
        c0, c1, c2, c3 = (
            (product_1 >> _WORD_BITS) ^ c1 ^ k0,
            product_1 & _WORD_MASK,
            (product_0 >> _WORD_BITS) ^ c3 ^ k1,
            product_0 & _WORD_MASK,
        )
        k0 = (k0 + _WEYL_0) & _WORD_MASK
        k1 = (k1 + _WEYL_1) & _WORD_MASK
    return c0, c1, c2, c3


@exact
def uniform(low, high):
    """Return the top 52 of 64 random bits as a number between 0 and 1, centred in its cell: never 0 nor 1."""
    # as the significand of a number between 1 and 2
    bits = ((low | (high << _WORD_BITS)) >> np.uint64(12)) | np.uint64(0x3FF0000000000000)
    return np.uint64(bits).view(np.float64) - (1.0 - 2.0**-53)


@exact
def normal_pair(pair, channel, replicate, day, k0, k1):
    """Return two independent standard normal numbers: samples 2·pair and 2·pair + 1 of a channel."""
    r0, r1, r2, r3 = philox(pair, channel, replicate, day, k0, k1)
    radius = np.sqrt(-2.0 * log(uniform(r0, r1)))
    sin, cos = sincos_turns(uniform(r2, r3))
    return radius * cos, radius * sin


@kernel
def low_pass(x, decay, y):
    """Filter x, (n,), into y, which may be x: y[t] = decay y[t - 1] + (1 - decay) x[t] with decay = e^(-dt/τ)."""
    gain = 1.0 - decay
    carried = 0.0
    for t in range(x.size):
        y[t] = gain * x[t] + carried
        carried = decay * y[t]
