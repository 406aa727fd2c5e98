"""exp, log and sine/cosine in binary64 that the compiler inlines and vectorises.

The C library's functions would keep a loop over lanes scalar.  These are branch-free, and every rounding is fixed by
``fma``, so a value depends on its argument alone.  exp and log are within 1.1 ulp, sine and cosine within 2.
"""

import math

import numpy as np

from fastcoil.model.numerics.jit import exact, fma

_LOG2_E = 1.0 / math.log(2.0)
# ln 2 split so that n * LN2_HIGH is exact for |n| < 2**11 (21 trailing zero bits)
_LN2_HIGH = float.fromhex("0x1.62e42fee00000p-1")
_LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")
# adding 1.5 * 2**52 rounds to the nearest integer and leaves it in the low bits of the significand
_ROUNDER = 6755399441055744.0
_ROUNDER_BITS = np.float64(_ROUNDER).view(np.int64)
_SQRT_HALF_BITS = np.int64(0x3FE6A09E667F3BCD)
_ONE_BITS = np.int64(0x3FF0000000000000)
_EXPONENT_SHIFT = np.int64(52)

# Chebyshev interpolants of (e^r - 1 - r)/r^2 on |r| <= ln 2 / 2, which leaves 1.6e-17 in e^r, and of
# (atanh(s)/s - 1)/s^2 in s^2, which leaves 5e-18 in atanh
_EXP_COEFFICIENTS = (
    2.51003767988125e-08, 2.762007713646922e-07, 2.7557268478279004e-06, 2.480152131972762e-05,
    0.00019841269863041851, 0.0013888888917198419, 0.008333333333330065, 0.04166666666662416,
    0.16666666666666669, 0.5,
)  # fmt: skip
_ATANH_COEFFICIENTS = (
    0.07308292712444311, 0.07665855309105386, 0.09091444727837474, 0.11111105565129939, 0.14285714313001635,
    0.19999999999949722, 0.3333333333333335,
)  # fmt: skip
_SIN_TAYLOR = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(8, 0, -1))
_COS_TAYLOR = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(8, 0, -1))


@exact
def polynomial(x, coefficients):
    """Evaluate a polynomial at x; ``coefficients``: a tuple of at least four, highest power first.

    Even and odd powers are summed apart: two chains of half the length, which the processor overlaps.
    """
    z = x * x
    high, low = coefficients[0], coefficients[1]
    for c in coefficients[2::2]:
        high = fma(high, z, c)
    for c in coefficients[3::2]:
        low = fma(low, z, c)
    if len(coefficients) % 2 == 0:
        return fma(high, x, low)
    return fma(low, x, high)


@exact
def _bits(x):
    return np.float64(x).view(np.int64)


@exact
def _from_bits(bits):
    return np.int64(bits).view(np.float64)


@exact
def exp(x):
    """e^x.  Arguments are clamped to ±708, so the result is never 0 nor inf; NaN stays NaN."""
    x = -708.0 if x < -708.0 else x
    x = 708.0 if x > 708.0 else x
    shifted = fma(x, _LOG2_E, _ROUNDER)
    n = shifted - _ROUNDER
    r = fma(n, -_LN2_LOW, fma(n, -_LN2_HIGH, x))
    two_to_n = _from_bits((_bits(shifted) << _EXPONENT_SHIFT) + _ONE_BITS)
    return fma(r, fma(r, polynomial(r, _EXP_COEFFICIENTS), 1.0), 1.0) * two_to_n


@exact
def log(x):
    """ln x for normal positive x; -inf at 0, NaN below 0 and for NaN, inf stays inf."""
    bits = _bits(x)
    # x = 2^n m with m in [sqrt(1/2), sqrt(2)); n * 2^52 is kept as an integer
    n_shifted = (bits - _SQRT_HALF_BITS) & np.int64(-0x10000000000000)
    m = _from_bits(bits - n_shifted)
    n = _from_bits((n_shifted >> _EXPONENT_SHIFT) + _ROUNDER_BITS) - _ROUNDER
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    # ln m = 2 atanh s = 2 s + 2 s z P(z), and 2 s = f - f s
    tail = s * (2.0 * z * polynomial(z, _ATANH_COEFFICIENTS) - f)
    result = fma(n, _LN2_HIGH, fma(n, _LN2_LOW, tail) + f)
    result = np.nan if not x >= 0.0 else result
    result = -np.inf if x == 0.0 else result
    return np.inf if x == np.inf else result


@exact
def sincos_turns(u):
    """(sin 2πu, cos 2πu) for 0 <= u < 1."""
    quarter = (u * 4.0 + _ROUNDER) - _ROUNDER
    r = (u * 4.0 - quarter) * (0.5 * math.pi)
    z = r * r
    s = fma(r * z, polynomial(z, _SIN_TAYLOR), r)
    c = fma(z, polynomial(z, _COS_TAYLOR), 1.0)
    odd = quarter == 1.0 or quarter == 3.0
    sin = c if odd else s
    cos = s if odd else c
    sin = -sin if quarter == 2.0 or quarter == 3.0 else sin
    cos = -cos if quarter == 1.0 or quarter == 2.0 else cos
    return sin, cos
