"""Where no air flows the loop is off, and that is told; what a user says of ``enabled`` counts more."""

import warnings

import numpy as np
import pytest
from helpers.trend_logs import HEADER, replaced

from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import constant_day, design_day

NIGHT = np.where(np.arange(7200) < 5400, 0.0, 1.2)
SERIES = {"T_a_in": 25.0, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": 14.0}


@pytest.mark.parametrize(
    "made",
    [
        lambda: Boundary(m_a=NIGHT, **SERIES),
        lambda: constant_day(2.0, m_a=NIGHT),
        lambda: design_day(2.0, m_a=NIGHT),
    ],
    ids=["Boundary", "constant_day", "design_day"],
)
def test_seconds_without_air_flow_are_off_and_their_hours_are_told(made):
    with pytest.warns(UserWarning, match=r"m_a is 0 during 1\.5 h and enabled is left out") as told:
        boundary = made()
    assert len(told) == 1
    np.testing.assert_array_equal(boundary.series["enabled"][0], NIGHT > 0.0)


def test_a_given_enabled_is_kept_and_nothing_is_told():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (Boundary(m_a=NIGHT, enabled=1.0, **SERIES).series["enabled"] == 1.0).all()
        off = Boundary(m_a=NIGHT, enabled=NIGHT > 0.0, **SERIES)
        again = Boundary.from_dataset(off.to_dataset()).isel([0])
    assert again.sha256 == off.isel([0]).sha256


def test_a_log_without_status_is_off_where_its_fan_stands(write):
    with pytest.warns(UserWarning, match="m_a is 0 during"):
        boundary = Boundary.from_csv(write(HEADER, replaced(1, [1.0, 0.0, 0.0])))
    assert boundary.series["enabled"][0, 59:62].tolist() == [1.0, 0.0, 0.0]
