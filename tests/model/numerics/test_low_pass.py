"""The low-pass filter equals SciPy's ``lfilter`` to the bit."""

import numpy as np
import pytest
from scipy.signal import lfilter

from fastcoil.model.numerics.noise import low_pass


@pytest.mark.parametrize("tau", [1, 60, 120, 300, 1e4])
def test_it_equals_lfilter_to_the_bit(tau):
    x, decay = np.random.default_rng(3).standard_normal(5000), np.exp(-1.0 / tau)
    y = np.empty_like(x)
    low_pass(x, decay, y)
    np.testing.assert_array_equal(y, lfilter([1.0 - decay], [1.0, -decay], x))


def test_it_may_filter_in_place():
    x = np.random.default_rng(4).standard_normal(100)
    y = np.empty_like(x)
    low_pass(x, 0.9, y)
    low_pass(x, 0.9, x)
    np.testing.assert_array_equal(x, y)
