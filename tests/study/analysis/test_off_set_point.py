"""The summary of a run tells of scenarios that do not hold their set-point, and only of them."""

import numpy as np
import xarray as xr

from fastcoil.study.analysis.summary import summary


def result(share_off, hunts):
    n = len(share_off)
    values = {"status": np.zeros(n, np.int8), "rmse": np.ones(n), "share_off": share_off, "hunts": hunts}
    return xr.Dataset({name: ("sample", np.asarray(v)) for name, v in values.items()})


def test_scenarios_off_their_set_point_for_over_half_of_the_time_are_told():
    lines = summary(result([0.51, 1.0, 0.5, np.nan], [1.0, 0.0, 1.0, np.nan]))
    (told,) = [line for line in lines if "off their set-point" in line]
    assert told.startswith(
        "2 of 4 are more than 0.5 K off their set-point for over half of the time, 1 of them hunting"
    )


def test_nothing_is_told_where_the_set_point_is_held():
    assert not [line for line in summary(result([0.5, 0.0], [1.0, 0.0])) if "off their" in line]
