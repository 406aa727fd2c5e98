"""Labels that a user types, and changes against a case."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from helpers.refusals import assert_refused
from helpers.results import drawn_result, make_result

from fastcoil.study.analysis.selected import (
    describe_labels,
    group_by_parameters,
    matches_label,
    select_labels,
)


@pytest.fixture
def ds():
    rng = np.random.default_rng(1)
    return make_result(
        ("backlash", "tuning", "day"), {"backlash": [0.0, 0.02, 0.07], "tuning": ["slow", "fast"]},
        rmse=rng.uniform(0.5, 1.0, (3, 2, 4)), reversals=rng.integers(0, 3, (3, 2, 4)),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("label", "text", "same"),
    [
        (0.07, "0.07", True),
        (0.07, "7e-2", True),
        (0.07, "0.0701", False),
        (1, "1", True),
        (1, "one", False),
        ("1", "1", True),
        ("1", "1.0", False),
        (np.datetime64("2026-01-02"), "2026-01-02", True),
        (np.datetime64("2026-01-02"), "2026-01-03", False),
    ],
)
def test_a_text_means_a_label_and_no_neighbour_of_it(label, text, same):
    assert matches_label(label, text) is same


def test_a_drawn_parameter_with_few_values_picks_its_samples():
    ds = drawn_result(50)
    selection = select_labels(ds, {"sample_time": ["10"], "day": ["0"]})
    xr.testing.assert_identical(selection, ds.isel(day=0, sample=np.flatnonzero(ds.sample_time.values == 10.0)))
    assert describe_labels(selection, {"sample_time": ["10"]}) == "sample time = 10 s"


@pytest.mark.parametrize(
    ("at", "code"),
    [({"backlash": ["0.02", "much"]}, "choice"), ({"tuning": ["fastt"]}, "choice"), ({"backlas": ["0.02"]}, "name")],
)
def test_an_unknown_label_is_refused_with_those_that_there_are(ds, at, code):
    assert_refused("--at", code, select_labels, ds, at)


@pytest.mark.parametrize("n", [80, 101])
def test_groups_are_those_of_pandas_with_all_their_members(n):
    ds = drawn_result(n)
    groups = group_by_parameters(ds, ["kp"])
    assert groups.rmse.dims == ("day", "kp", "sample")
    frame = ds.rmse.to_dataframe().reset_index()
    frame["group"] = pd.qcut(frame.kp, 8, labels=False)
    for k, members in frame.groupby("group"):
        place = groups.rmse.isel(kp=k).values
        # cuts fall on either side of a value that pandas interpolates
        assert abs(int(groups.members[k]) - len(members) / 2) <= 1
        if n == 80:
            np.testing.assert_allclose(np.sort(place[np.isfinite(place)]), np.sort(members.rmse))
            assert float(groups.kp[k]) == pytest.approx(members.kp.median())
    assert int(groups.members.max() - groups.members.min()) <= 1
    assert int(groups.members.sum()) == n


def test_nothing_is_lost_nor_made_up():
    ds = drawn_result(101)
    ds.status[1, 7] = 2
    for names in (["kp"], ["kp", "ti"], ["sample_time"]):
        groups = group_by_parameters(ds, names)
        for metric in ("rmse", "iae", "status"):
            values = groups[metric].values
            np.testing.assert_array_equal(np.sort(values[np.isfinite(values)]), np.sort(ds[metric].values.ravel()))
        assert (groups.rmse.notnull() == groups.status.notnull()).all()
    assert groups.rmse.attrs == ds.rmse.attrs
    assert groups.sample_time.attrs["units"] == "s"


def test_two_parameters_share_the_scenarios_out_as_a_histogram_does():
    ds = drawn_result(400)
    groups = group_by_parameters(ds, ["kp", "ti"])
    assert groups.rmse.dims == ("day", "kp", "ti", "sample")
    cuts = [np.sort(ds[n].values)[(np.arange(1, 8) * 400) // 8] for n in ("kp", "ti")]
    edges = [np.concatenate([[-np.inf], c, [np.inf]]) for c in cuts]
    counts, *_ = np.histogram2d(ds.kp.values, ds.ti.values, edges)
    np.testing.assert_array_equal(groups.members, counts)
    low, high = int(counts.min()), int(counts.max())
    assert groups.sample.attrs["pooled_as"] == f"{low} to {high} samples in each of 8 × 8 cells"


def test_traces_and_coordinates_of_the_samples_stay_behind():
    ds = drawn_result(40)
    ds["T_sup"] = ds.rmse.expand_dims(elapsed_time=2)
    groups = group_by_parameters(ds, ["kp"])
    assert "T_sup" not in groups
    assert "ti" not in groups.coords
    assert groups.day.values.tolist() == [0, 1]


def test_too_few_to_group_are_refused():
    assert_refused("kp", "data", group_by_parameters, drawn_result(500).isel(sample=slice(9)), ["kp", "ti"])
