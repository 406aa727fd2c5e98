"""Shares and means over valves and days, with their intervals."""

import math

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from studies.common import mean_of, share_of


def test_a_share_has_the_interval_of_wilson_where_cases_are_independent_and_a_wider_one_where_days_are_alike():
    rng = np.random.default_rng(3)
    without_days = xr.DataArray(rng.random(50) < 0.2, dims="sample")
    p = float(without_days.mean())
    half = 1.96 * math.sqrt(p * (1 - p) / 50 + 1.96**2 / 10000)
    low, high = ((p + 1.96**2 / 100 + side) / (1 + 1.96**2 / 50) for side in (-half, half))
    assert share_of(without_days) == pytest.approx((p, low, high), abs=0.003)
    of_valve = np.repeat(rng.random((50, 1)) < 0.2, 20, axis=1)
    share_of_alike_days = share_of(xr.DataArray(of_valve, dims=("sample", "day")))
    share_of_free_days = share_of(xr.DataArray(rng.random((50, 20)) < 0.2, dims=("sample", "day")))
    assert share_of_alike_days.high - share_of_alike_days.low > 3 * (share_of_free_days.high - share_of_free_days.low)
    share_of_none = share_of(xr.DataArray(np.zeros((50, 20)), dims=("sample", "day")))
    assert (share_of_none.value, share_of_none.low) == (0.0, 0.0)
    assert str(share_of_none) == "0 % (0 to 7)"


def test_a_mean_scatters_with_its_valves_and_with_its_days():
    of_valve, of_day = np.array([0.0, 1.0, 5.0, 2.0]), np.array([0.3, 2.0, 1.0])
    middle, half = mean_of(xr.DataArray(of_valve[:, None] + of_day, dims=("sample", "day")))
    assert middle == pytest.approx(2.0 + 1.1)
    assert half == pytest.approx(1.96 * math.hypot(stats.sem(of_valve), stats.sem(of_day)))
