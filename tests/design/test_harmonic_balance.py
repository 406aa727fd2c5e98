"""Harmonic balance against tables of loops that can be written down."""

import numpy as np
import pytest

from fastcoil.design.describing_function import describing_function
from fastcoil.design.limit_cycle import Swings, find_sustained_cycle, frequency_at, harmonic_balance

W = np.geomspace(1e-3, 100.0, 1500)
GAP = 0.01


def balance_with_gap(L):
    A = 0.5001 * GAP * np.geomspace(1.0, 1e4, 800)[None]
    N = describing_function(A, np.array(GAP), np.array(GAP))
    return A, harmonic_balance(W, L[None], lambda _: lambda _: N, A.shape[1], np.zeros(1))


@pytest.mark.parametrize(
    ("ratio", "critical"),
    [
        (0.1, {0.0: 0.43, 0.1: 0.34, 0.2: 0.28, 0.3: 0.23, 0.5: 0.17, 1.0: 0.10}),
        (0.2, {0.0: 1.11, 0.1: 0.85, 0.2: 0.67, 0.3: 0.55, 0.5: 0.40, 1.0: 0.23}),
        (0.3, {0.0: 2.2, 0.1: 1.6, 0.2: 1.24, 0.3: 0.99, 0.5: 0.68, 1.0: 0.37}),
        (0.5, {0.0: 7.6, 0.1: 4.9, 0.2: 3.3, 0.3: 2.4, 0.5: 1.5, 1.0: 0.70}),
        (0.75, {0.1: 14.8, 0.2: 7.2, 0.3: 4.7, 0.5: 2.6, 1.0: 1.17}),
    ],
)
def test_the_gain_at_which_a_lag_with_delay_begins_to_cycle(ratio, critical):
    """ti / lag, and delay / lag → the gain; without delay the phase falls and rises again."""
    s = 1j * W
    for delay, gain in critical.items():
        L = (1.0 + 1.0 / (ratio * s)) * np.exp(-delay * s) / (1.0 + s)
        assert 1.0 / balance_with_gap(L)[1].product.max() == pytest.approx(gain, rel=0.04, abs=0.006), delay


@pytest.mark.parametrize(
    ("z", "amplitude", "w", "output"),
    [
        (0.5, 1.05, 0.600, 0.647),
        (1.0, 0.849, 0.796, 0.421),
        (2.0, 0.721, 1.041, 0.271),
        (4.0, 0.640, 1.347, 0.173),
        (8.0, 0.588, 1.729, 0.110),
    ],
)
def test_the_cycle_of_a_pi_before_an_integrator(z, amplitude, w, output):
    """z = gain ti; amplitudes of u and stem over the gap, w ti.  A hair of delay ends the rise of the phase."""
    s = 1j * W
    A, balance = balance_with_gap(z * (1.0 + 1.0 / s) / s * np.exp(-1e-3 * s))
    at = frequency_at(W, balance.place)
    u = np.broadcast_to(A, at.shape)
    goes_on, cycle = find_sustained_cycle(Swings(balance.product, at, u, u * balance.size), 10.0 * GAP)
    assert goes_on.all()
    assert (cycle.u[0] / GAP, cycle.w[0]) == (pytest.approx(amplitude, rel=0.01), pytest.approx(w, rel=0.01))
    assert cycle.T[0] / GAP == pytest.approx(output, rel=0.01)


def test_a_cycle_has_to_be_started():
    """Of the two cycles the smaller one parts: a swing below it dies, one above it ends in the larger one."""
    s = 1j * W
    A, balance = balance_with_gap(0.5 * (1.0 + 10.0 / s) * np.exp(-0.1 * s) / (1.0 + s))
    at, u = frequency_at(W, balance.place), np.broadcast_to(A, balance.place.shape)
    swings = Swings(balance.product, at, u, u)
    ends = [find_sustained_cycle(swings, start) for start in (0.51 * GAP, 0.6 * GAP, 1.0, 20.0)]
    assert [bool(goes_on[0]) for goes_on, _ in ends] == [False, True, True, True]
    assert len({round(float(cycle.u[0]), 9) for goes_on, cycle in ends if goes_on[0]}) == 1


@pytest.mark.parametrize("scale", [1.0, 1e-10])
def test_the_cycle_is_where_the_product_is_1_by_logarithms_however_small_the_swing(scale):
    """One piece falls from 1e4 to 1e-8: a third of the way, in logarithms.  The others never balance."""
    product, swing = np.zeros((3, 1, 2)), np.full((3, 1, 2), scale)
    product[0, 0], swing[0, 0] = (1e4, 1e-8), (scale, 8.0 * scale)
    goes_on, cycle = find_sustained_cycle(Swings(product, swing, swing, swing), 5.0 * scale)
    assert goes_on.all()
    np.testing.assert_allclose([cycle.product, *cycle[1:]], [[1.0], *3 * [[2.0 * scale]]], rtol=1e-9)


def test_a_loop_without_a_gap_has_the_inverse_of_its_gain_margin():
    s = 1j * W
    L = 3.0 * np.exp(-0.2 * s) / (s * (1.0 + s))
    balance = harmonic_balance(W, L[None], lambda _: lambda w: np.ones(w.shape, complex), 5, np.zeros(1))
    w = 1.0
    for _ in range(50):  # where the phase is -180°: atan w + 0.2 w = 90°
        w -= (np.arctan(w) + 0.2 * w - 0.5 * np.pi) / (1.0 / (1.0 + w * w) + 0.2)
    np.testing.assert_allclose(balance.product[0], 3.0 / (w * np.hypot(1.0, w)), rtol=1e-4)
