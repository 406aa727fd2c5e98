"""``identify_online.py``: the days and valves on which good valves are tried."""

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies import days as kinds
from studies.learning import identify_online


@pytest.mark.parametrize("kind", [kinds.CONSTANT, kinds.HEATING])
def test_the_set_point_steps_by_one_size_a_day_every_half_hour(kind):
    T_set = identify_online.stepping_days(kind).series["T_set"]
    assert T_set.shape == (len(identify_online.GOOD_DAYS), kinds.HOURS * 3600)
    steps = np.diff(T_set)
    assert set(np.unique(np.nonzero(steps)[1] + 1)) == set(range(1800, kinds.HOURS * 3600, 1800))
    for day in steps:
        sizes = np.abs(day[day != 0.0])
        assert sizes.size == 2 * kinds.HOURS - 1
        np.testing.assert_allclose(sizes, sizes[0])
        assert 0.25 <= sizes[0] <= 2.0
    assert np.ptp(np.abs(steps).max(axis=1)) > 0.5


@pytest.mark.kernel
def test_good_valves_have_the_march_and_gains_of_their_presets_and_no_gap(monkeypatch):
    monkeypatch.setattr(identify_online, "GOOD_VALVES", 12)
    names, values = ("air_march", "kp", "ti"), []
    for gains in identify_online.GAINS:
        loop = identify_online.good_valves(kinds.CONSTANT, gains)
        assert not np.any(loop["backlash"])
        values.append(list(zip(*(xr.DataArray(loop[name]).values for name in names), strict=True)))
    of_presets, after_simc = map(set, values)
    assert of_presets == {tuple(fc.Loop.preset(name)[n] for n in names) for name in identify_online.GOOD_PRESETS}
    assert len({kp for _, kp, _ in after_simc}) == 12
