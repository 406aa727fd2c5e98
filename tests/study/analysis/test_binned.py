"""Drawn parameters as axes: groups of equal counts, whose members are those that pandas would put there."""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from helpers.results import drawn, result

import fastcoil as fc
from fastcoil.base.errors import InputError
from fastcoil.study.analysis.selected import binned, drawn_parameters


@pytest.mark.parametrize("n", [80, 101])
def test_groups_are_those_of_pandas_with_all_their_members(n):
    ds = drawn(n)
    found = binned(ds, ["kp"])
    assert found.rmse.dims == ("day", "kp", "sample")
    frame = ds.rmse.to_dataframe().reset_index()
    frame["group"] = pd.qcut(frame.kp, 8, labels=False)
    for k, members in frame.groupby("group"):
        place = found.rmse.isel(kp=k).values
        # cuts fall on either side of a value that pandas interpolates
        assert abs(int(found.members[k]) - len(members) / 2) <= 1
        if n == 80:
            np.testing.assert_allclose(np.sort(place[np.isfinite(place)]), np.sort(members.rmse))
            assert float(found.kp[k]) == pytest.approx(members.kp.median())
    assert int(found.members.max() - found.members.min()) <= 1
    assert int(found.members.sum()) == n


def test_nothing_is_lost_nor_made_up():
    ds = drawn(101)
    ds.status[1, 7] = 2
    for names in (["kp"], ["kp", "ti"], ["sample_time"]):
        found = binned(ds, names)
        for metric in ("rmse", "iae", "status"):
            values = found[metric].values
            np.testing.assert_array_equal(np.sort(values[np.isfinite(values)]), np.sort(ds[metric].values.ravel()))
        assert (found.rmse.notnull() == found.status.notnull()).all()
    assert found.rmse.attrs == ds.rmse.attrs
    assert found.sample_time.attrs["units"] == "s"


def test_a_parameter_with_few_values_has_a_group_for_each():
    ds = drawn(60)
    found = binned(ds, ["sample_time"])
    assert found.sample_time.values.tolist() == [5.0, 10.0, 30.0]
    expected = ds.rmse.groupby("sample_time").median(...)
    np.testing.assert_allclose(found.rmse.median(["day", "sample"]), expected)


def test_two_parameters_share_the_scenarios_out_as_a_histogram_does():
    ds = drawn(400)
    found = binned(ds, ["kp", "ti"])
    assert found.rmse.dims == ("day", "kp", "ti", "sample")
    cuts = [np.sort(ds[n].values)[(np.arange(1, 8) * 400) // 8] for n in ("kp", "ti")]
    edges = [np.concatenate([[-np.inf], c, [np.inf]]) for c in cuts]
    counts, *_ = np.histogram2d(ds.kp.values, ds.ti.values, edges)
    np.testing.assert_array_equal(found.members, counts)
    low, high = int(counts.min()), int(counts.max())
    assert found.sample.attrs["pooled_as"] == f"{low} to {high} samples in each of 8 × 8 cells"


def test_a_parameter_along_two_dims_is_grouped_over_both():
    rng = np.random.default_rng(1)
    kp = xr.DataArray(rng.random((20, 3)), dims=("sample", "design"))
    ds = result(("day", "sample", "design"), {"kp": kp}, rmse=rng.random((2, 20, 3)))
    found = binned(ds, ["kp"])
    assert found.rmse.dims == ("day", "kp", "sample")
    assert int(found.members.sum()) == 60


def test_traces_and_coordinates_of_the_samples_stay_behind():
    ds = drawn(40)
    ds["T_sup"] = ds.rmse.expand_dims(elapsed_time=2)
    found = binned(ds, ["kp"])
    assert "T_sup" not in found
    assert "ti" not in found.coords
    assert found.day.values.tolist() == [0, 1]


@pytest.mark.parametrize(
    ("n", "names", "sentence"),
    [
        (80, ["kpp"], "kpp is no drawn parameter, did you mean 'kp'?: drawn are kp, ti, sample_time"),
        (80, ["day"], "day is no drawn parameter: drawn are"),
        (9, ["kp", "ti"], "kp and ti: 9 drawn scenarios are too few to group"),
    ],
)
def test_what_cannot_be_grouped_is_refused(n, names, sentence):
    ds = drawn(n) if n > 9 else drawn(500).isel(sample=slice(None, None, 60))
    with pytest.raises(InputError) as caught:
        binned(ds, names)
    assert str(caught.value).startswith(sentence.replace("9 drawn", f"{ds.sizes['sample']} drawn"))


def test_only_numbers_that_differ_along_other_dims_are_drawn():
    ds = drawn(20).assign_coords(law=("sample", ["pi"] * 20), buffer=("sample", np.zeros(20)), backlash=0.07)
    assert drawn_parameters(ds) == ["kp", "ti", "sample_time"]
    assert drawn_parameters(result(("kp", "day"), rmse=np.ones((2, 2)))) == []


def test_the_axes_of_fc_plot_take_drawn_parameters():
    ds = drawn(80)
    axes = fc.plot.bands(ds, x="kp")
    groups = np.array_split(np.argsort(ds.kp.values), 8)
    np.testing.assert_allclose(axes.lines[-1].get_ydata(), [np.median(ds.rmse.values[:, g]) for g in groups])
    assert fc.plot.map(ds, x="kp", y="ti").collections[0].get_array().shape == (4, 4)
    plt.close("all")
