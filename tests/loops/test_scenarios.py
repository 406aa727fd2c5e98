"""The ways to sweep a parameter, the scenarios they make, and what cannot be swept together."""

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.loops.clashes import check_clashes
from fastcoil.loops.scenarios import Layout


def layout_and_columns(loop, n_days=None, replicates=1):
    """Parameters of all scenarios, in their flat order."""
    day = fc.paper_day(hours=0.1, seed=list(range(n_days)) if n_days else 1)
    layout = Layout(loop, day, replicates)
    check_clashes(layout.loop, day.series["T_set"])
    return layout, layout.columns(np.arange(layout.size))


def test_a_list_is_a_dimension_of_its_own():
    loop = fc.Loop(backlash=[0.02, 0.07, 0.15], kp=np.array([0.01, 0.02]), air_march=["quasistatic", "lagged"])
    assert loop.sizes == {"backlash": 3, "kp": 2, "air_march": 2}
    assert loop.coordinates()["backlash"].values.tolist() == [0.02, 0.07, 0.15]
    assert loop.coordinates()["air_march"].values.tolist() == ["quasistatic", "lagged"]


def test_a_pair_is_zipped_along_a_shared_dimension():
    loop = fc.Loop(kp=("tuning", [0.01, 0.02]), ti=("tuning", [10.0, 20.0]))
    assert loop.sizes == {"tuning": 2}
    assert loop.coordinates()["ti"].dims == ("tuning",)


def test_a_dataarray_keeps_its_dims_and_labels():
    kp = xr.DataArray([0.01, 0.02], dims="controller", coords={"controller": ["slow", "fast"]})
    loop = fc.Loop(kp=kp, backlash=xr.DataArray(np.full((2, 3), 0.05), dims=("controller", "size")))
    assert loop.sizes == {"controller": 2, "size": 3}
    assert loop.coordinates()["controller"].values.tolist() == ["slow", "fast"]


def test_dims_come_in_the_order_of_assignment_and_a_changed_sweep_comes_last():
    loop = fc.Loop(kp=[0.01, 0.02], backlash=[0.05, 0.07])
    assert list(loop.sizes) == ["kp", "backlash"]
    assert list(loop.assign(kp=[0.01, 0.03]).sizes) == ["backlash", "kp"]
    assert list(loop.assign(kp=0.02).sizes) == ["backlash"]


def test_axis_labels_are_rounded_so_that_sel_finds_them():
    axis = np.linspace(0.01, 0.15, 15)
    assert 0.07 not in axis.tolist()
    labels = fc.Loop(backlash=axis).coordinates()["backlash"]
    assert labels.assign_coords(backlash=labels).sel(backlash=0.07) == 0.07
    zipped = fc.Loop(backlash=("sample", axis))["backlash"]
    assert zipped.values.tolist() == axis.tolist()


def test_scenarios_are_the_product_of_the_dimensions_last_one_fastest():
    loop = fc.Loop(backlash=[0.05, 0.07], kp=("tuning", [0.01, 0.02, 0.03]), ti=("tuning", [10.0, 20.0, 30.0]))
    layout, parameters = layout_and_columns(loop, n_days=2, replicates=2)
    assert layout.sizes == {"day": 2, "backlash": 2, "tuning": 3, "replicate": 2}
    assert parameters["replicate"].tolist() == [0, 1] * 12
    assert parameters["kp"].tolist() == [0.01, 0.01, 0.02, 0.02, 0.03, 0.03] * 4
    assert parameters["ti"].tolist() == [10.0, 10.0, 20.0, 20.0, 30.0, 30.0] * 4
    assert parameters["backlash"].tolist() == ([0.05] * 6 + [0.07] * 6) * 2
    assert parameters["day"].tolist() == [0] * 12 + [1] * 12
    assert np.all(parameters["C_c"] == 30.0)
    assert np.all(np.isnan(parameters["rangeability"]))


def test_any_slice_of_the_scenarios_is_that_of_all_of_them():
    loop = fc.Loop(backlash=np.linspace(0.0, 0.1, 7), kp=[0.01, 0.02, 0.03], action=["heating", "cooling"])
    layout, parameters = layout_and_columns(loop)
    some = layout.columns(np.arange(5, 29))
    assert all(some[name].tolist() == parameters[name][5:29].tolist() for name in ("backlash", "kp", "action"))


@pytest.mark.parametrize("dim", ["day", "volume", "status", "rmse", "T_sup"])
def test_dims_of_results_cannot_be_swept(dim):
    assert_refused("backlash", "name", fc.Loop, backlash=(dim, [0.05, 0.07]))


DIFFERENT_LENGTHS = {"kp": ("tuning", [0.01, 0.02]), "ti": ("tuning", [10.0, 20.0, 30.0])}


def test_zipped_parameters_of_different_length_are_refused_where_they_are_given():
    assert_refused("ti", "shape", fc.Loop, **DIFFERENT_LENGTHS)
    assert_refused("ti", "shape", fc.Loop().assign, **DIFFERENT_LENGTHS)
    assert_refused("ti", "shape", fc.Loop(kp=DIFFERENT_LENGTHS["kp"]).assign, ti=DIFFERENT_LENGTHS["ti"])


def test_labels_of_one_dim_that_differ():
    slow, fast = (xr.DataArray([0.01, 0.02], dims="case", coords={"case": names}) for names in (["a", "b"], ["a", "c"]))
    assert_refused("backlash", "shape", fc.Loop, kp=slow, backlash=fast)
    kp = xr.DataArray([1.0, 2.0], dims="ti", coords={"ti": [10.0, 21.0]})
    assert_refused("kp", "shape", fc.Loop, ti=[10.0, 20.0], kp=kp)


def test_neither_another_parameter_nor_a_coordinate_of_the_clock_can_be_a_dim():
    assert_refused("buffer", "name", layout_and_columns, fc.Loop(backlash=("buffer", [0.05, 0.07])))
    day = fc.paper_day(hours=0.1).assign(start="2024-07-01")
    assert_refused("time", "name", Layout, fc.Loop(kp=("time", [0.1, 0.2])), day)
