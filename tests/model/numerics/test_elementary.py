"""exp, log and sincos_turns against 40-digit arithmetic, in units in the last place, and at the edges."""

import math
import os
from decimal import Decimal, localcontext

import numpy as np
import pytest

from fastcoil.model.numerics.elementary import exp, log, sincos_turns
from fastcoil.model.numerics.jit import JIT_ENABLED

# without the compiler fma rounds twice
ULP = 1.1 if JIT_ENABLED else 2.0
# the reduced argument is rounded before the polynomials see it
SINCOS_ULP = 2.0
INF, NAN = math.inf, math.nan
TWO_PI = Decimal("6.283185307179586476925286766559005768394338798750")
# the third array lies halfway between two reductions, where the polynomial is worst
EXP_ARGUMENTS = np.r_[
    np.linspace(-708.0, 708.0, 20011), np.linspace(-2.0, 2.0, 10007), math.log(2.0) * (np.arange(-1000, 1000) + 0.5),
    np.logspace(-300, 0, 101), -np.logspace(-300, 0, 101),
]  # fmt: skip
LOG_ARGUMENTS = np.r_[
    np.logspace(-307.6, 308.2, 20011), np.linspace(0.5, 2.0, 10007), 1.0 + np.logspace(-15.9, -1, 2003),
    1.0 - np.logspace(-15.9, -1, 2003), np.nextafter(math.sqrt(0.5), [0.0, 1.0]),
    np.finfo(float).tiny, np.finfo(float).max,
]  # fmt: skip
ARGUMENT_STRIDE = 1 if os.environ.get("FASTCOIL_FULL") else 4
"""Every so many arguments are compared: 40 digits take time."""
TURNS = np.r_[
    np.arange(0, 1, 2.0**-12), np.random.default_rng(1).random(4001), np.nextafter(np.arange(1, 9) / 8.0, 0.0),
    np.nextafter(np.arange(8) / 8.0, 1.0), 2.0**-53, 1.0 - 2.0**-53,
]  # fmt: skip


@pytest.fixture(autouse=True)
def _forty_digits():
    with localcontext() as context:
        context.prec = 40
        yield


def error_in_ulps(value, true):
    """Error of a float against a Decimal."""
    return abs(Decimal(value) - true) / Decimal(math.ulp(float(true)))


def decimal_sin(x):
    term = total = x
    for k in range(1, 25):
        term *= -x * x / ((2 * k) * (2 * k + 1))
        total += term
    return total


def decimal_sincos_turns(u):
    """Sine and cosine, reduced to the nearest quarter of a turn, which is exact."""
    quarter = round(4 * u)
    r = (Decimal(u) - Decimal(quarter) / 4) * TWO_PI
    sin, cos = decimal_sin(r), 1 - 2 * decimal_sin(r / 2) ** 2
    return [(sin, cos), (cos, -sin), (-sin, -cos), (-cos, sin)][quarter % 4]


def test_exp_ulp():
    assert max(error_in_ulps(exp(x), Decimal(x).exp()) for x in EXP_ARGUMENTS[::ARGUMENT_STRIDE].tolist()) <= ULP


def test_log_ulp():
    arguments = [x for x in LOG_ARGUMENTS[::ARGUMENT_STRIDE].tolist() if x != 1.0]
    assert max(error_in_ulps(log(x), Decimal(x).ln()) for x in arguments) <= ULP


def test_sincos_turns_ulp():
    worst = 0
    for u in TURNS.tolist():
        for value, true in zip(sincos_turns(u), decimal_sincos_turns(u), strict=True):
            worst = max(worst, error_in_ulps(value, true)) if true else worst
    assert worst <= SINCOS_ULP


@pytest.mark.parametrize(
    ("x", "limited"), [(0.0, 0.0), (-0.0, 0.0), (-INF, -708.0), (-1e300, -708.0), (1e300, 708.0), (INF, 708.0)]
)
def test_exp_at_the_edges(x, limited):
    assert exp(0.0) == 1.0
    assert exp(x) == exp(limited)
    assert 0.0 < exp(x) < INF


@pytest.mark.parametrize(
    ("x", "value"),
    [(1.0, 0.0), (0.0, -INF), (-0.0, -INF), (INF, INF), (-1.0, NAN), (-INF, NAN), (-1e-300, NAN)],
)
def test_log_at_the_edges(x, value):
    with np.errstate(over="ignore"):  # the interpreter notices that integers wrap around
        np.testing.assert_equal(log(x), value)


@pytest.mark.parametrize("u", [0.0, 0.25, 0.5, 0.75])
def test_sincos_turns_of_whole_quarters_are_exact(u):
    assert sincos_turns(u) == (round(math.sin(2 * math.pi * u)), round(math.cos(2 * math.pi * u)))


def test_nan_stays_nan():
    assert math.isnan(exp(NAN))
    assert math.isnan(log(NAN))
    assert all(map(math.isnan, sincos_turns(NAN)))


@pytest.mark.parametrize(("function", "arguments"), [(exp, EXP_ARGUMENTS), (log, LOG_ARGUMENTS)])
def test_monotone(function, arguments):
    neighbours = arguments * (1 - 1e-9)
    values = [function(x) for x in np.unique([arguments, neighbours]).tolist()]
    assert np.all(np.diff(values) >= 0.0)
