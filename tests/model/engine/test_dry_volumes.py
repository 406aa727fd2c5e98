"""Leaving out what does nothing where all is dry changes no number; a run traced every second leaves nothing out."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.engine.coil import dew_point_bound
from fastcoil.model.metric_table import METRICS
from fastcoil.model.physics import saturation_humidity_ratio


@pytest.mark.kernel
@pytest.mark.parametrize("air_march", ["lagged", "quasistatic"])
def test_a_coil_that_gets_wet_and_dry_again_is_the_same_whether_or_not_saturation_is_found_everywhere(air_march):
    t = np.arange(2400.0)
    humidity = 0.0085 + 0.004 * np.sin(t / 60.0) + 0.0005 * np.sin(t / 3.0)
    humidity[1500:] = np.where(t[1500:] % 60 < 1, 0.014, 0.004)  # puffs, in the first volumes when these are looked at
    day = fc.Boundary(m_a=1.1, T_a_in=25.0, W_a_in=humidity, T_w_in=7.0, T_set=np.where(t % 1200 < 600, 14.0, 17.0))
    loop = fc.Loop(backlash=[0.0, 0.07], kp=[0.01, 0.03], pressure=[90_000.0, 101_325.0], air_march=air_march)
    traced = fc.simulate(loop, day, warm_up=300, traces=["wet_volumes"], n_jobs=1)
    untraced = fc.simulate(loop, day, warm_up=300, n_jobs=1)
    assert traced.wet_volumes.min() == 0.0
    assert traced.wet_volumes.max() == 8.0
    assert (untraced.condensate > 0.0).all()
    for name in METRICS:
        np.testing.assert_array_equal(untraced[name], traced[name], err_msg=name)


@pytest.mark.kernel
@pytest.mark.parametrize("pressure", [80_000.0, 101_325.0])
def test_dry_metal_begins_just_above_the_dew_point_whatever_was_searched_before(pressure):
    for dew_point in (-15.0, 0.0, 0.03, 12.3, 49.98, 55.0):
        W = saturation_humidity_ratio(dew_point, pressure)
        for before in (-20.0, 15.0, 60.0, np.inf):
            assert dew_point <= dew_point_bound(before, W, pressure) < dew_point + 0.1
    assert dew_point_bound(15.0, 1.0, pressure) == np.inf
