"""What a boundary promises: shapes, immutability, digests, round trips, and messages that name field, value, cure."""

import copy
import pickle
from functools import partial

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_only_problem, only_problem
from helpers.trend_logs import HEADER, replace_column

from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import constant_day, paper_day
from fastcoil.loops.boundary.series import BOUNDARY_SERIES

GOOD_SERIES = {"m_a": 1.0, "T_a_in": 25.0, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": np.full(60, 14.0)}


# ------------------------------------------------------------------------------------------------------ shapes


def test_every_series_is_float64_days_by_steps_and_read_only():
    boundary = Boundary(**GOOD_SERIES)
    assert list(boundary.series) == list(BOUNDARY_SERIES)
    for values in boundary.series.values():
        assert values.shape == (1, 60)
        assert values.dtype == np.float64
        assert values.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            values[0, 0] = 1.0
    assert (boundary.series["noise"] == 0.0).all()
    assert (boundary.series["enabled"] == 1.0).all()
    assert (boundary.n_days, boundary.n_steps, boundary.hours) == (1, 60, 60 / 3600)
    assert boundary.has_day_dim is False
    np.testing.assert_array_equal(boundary.day, [0])


def test_numbers_series_and_days_broadcast_together():
    T_w_in = xr.DataArray([6.0, 8.0], dims="day", coords={"day": [4, 2]})
    T_a_in = xr.DataArray(np.arange(60.0) / 10, dims="elapsed_time")
    m_a = np.array([[1.0] * 60, [2.0] * 60])
    boundary = Boundary(**GOOD_SERIES | {"T_w_in": T_w_in, "T_a_in": T_a_in, "m_a": m_a})
    assert boundary.has_day_dim
    np.testing.assert_array_equal(boundary.day, [4, 2])
    np.testing.assert_array_equal(boundary.series["T_w_in"][:, 7], [6.0, 8.0])
    np.testing.assert_array_equal(boundary.series["T_a_in"][1], np.arange(60.0) / 10)
    np.testing.assert_array_equal(boundary.series["m_a"][:, 59], [1.0, 2.0])


def test_labels_alone_make_a_day_dim_and_one_number_does_not():
    assert Boundary(**GOOD_SERIES, day=[9]).has_day_dim
    assert Boundary(**GOOD_SERIES, day=[9, 1]).series["m_a"].shape == (2, 60)
    alone = Boundary(**GOOD_SERIES, day=9)
    assert not alone.has_day_dim
    np.testing.assert_array_equal(alone.day, [9])


# ------------------------------------------------------------------------------------------------------- sameness


def test_equality_and_digest_follow_names_labels_and_samples():
    boundary = Boundary(**GOOD_SERIES)
    assert boundary == Boundary(**GOOD_SERIES)
    assert hash(boundary) == hash(Boundary(**GOOD_SERIES))
    assert boundary != "boundary"
    others = [
        Boundary(**GOOD_SERIES | {"T_a_in": np.nextafter(25.0, 26.0)}),
        Boundary(**GOOD_SERIES | {"m_a": 7.0, "T_w_in": 1.0}),
        Boundary(**GOOD_SERIES, day=1),
        Boundary(**GOOD_SERIES, day=[0]),
        Boundary(**GOOD_SERIES | {"T_set": np.full(61, 14.0)}),
    ]
    assert len({boundary.sha256, *(other.sha256 for other in others)}) == 6
    assert Boundary(**GOOD_SERIES, noise=-0.0) == boundary


# --------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("m_a", -0.1, ["m_a = -0.1 kg s-1", "from 0 to 200"]),
        ("T_a_in", 77.0, ["T_a_in = 77 degC", "from -40 to 60", "unit"]),
        ("W_a_in", 9.3, ["W_a_in = 9.3", "from 0 to 0.1"]),
        ("T_set", np.full(60, 95.0), ["T_set = 95 degC at second 0", "from -20 to 80"]),
        ("enabled", 0.5, ["enabled = 0.5", "whole, from 0 to 1"]),
        ("T_a_in", float("nan"), ["T_a_in is nan", "fill or cut"]),
        ("T_w_in", -999.0, ["T_w_in = -999 degC", "fill or cut the gap"]),
        ("T_a_in", "25", ["T_a_in = '25'", "give numbers"]),
        ("m_a", [[1.0], [1.0, 2.0]], ["m_a", "different length"]),
        ("m_a", [], ["m_a is empty", "at least one"]),
        ("m_a", None, ["m_a is missing", "air flow", "kg s-1"]),
        ("m_a", xr.DataArray(np.ones(60), dims="time"), ["m_a", "('time',)", "elapsed_time"]),
        ("m_a", np.ones(59), ["T_set has 60 samples where m_a has 59", "the same number"]),
    ],
)
def test_a_bad_series_is_named_with_its_value_and_the_cure(name, value, words):
    assert_only_problem(words, Boundary, **GOOD_SERIES | {name: value})


def test_the_first_offending_second_and_day_are_named():
    T_a_in = np.full((3, 60), 25.0)
    T_a_in[1, 40:43] = 61.0
    message = only_problem(Boundary, **GOOD_SERIES | {"T_a_in": T_a_in}, day=[10, 20, 30])
    assert "T_a_in = 61 degC at second 40 of day 20" in message
    assert "(3 samples in total)" in message
    masked = np.ma.masked_equal(T_a_in[1], 61.0)
    assert "T_a_in is nan at second 40" in only_problem(Boundary, **GOOD_SERIES | {"T_a_in": masked})


@pytest.mark.parametrize(
    ("day", "words"),
    [
        ([1, 1], ["day label 1", "twice"]),
        ([-1, 2], ["day = [-1, 2]", "from 0 to 4294967295"]),
        ([0.5, 2], ["day = [0.5, 2]", "whole"]),
        ([1, 2, 3], ["3 labels for 2 days", "one label for each"]),
    ],
)
def test_bad_day_labels(day, words):
    assert_only_problem(words, Boundary, **GOOD_SERIES | {"m_a": np.ones((2, 60))}, day=day)


def test_days_that_disagree():
    assert_only_problem(
        ["T_w_in has 3 days where m_a has 2"],
        Boundary,
        **GOOD_SERIES | {"m_a": np.ones((2, 60)), "T_w_in": np.ones((3, 60))},
    )
    a = xr.DataArray([1.0, 2.0], dims="day", coords={"day": [1, 2]})
    b = xr.DataArray([7.0, 8.0], dims="day", coords={"day": [2, 1]})
    assert_only_problem(["T_w_in has day [2 1] where m_a has [1 2]"], Boundary, **GOOD_SERIES | {"m_a": a, "T_w_in": b})


@pytest.mark.parametrize("seed", [1, [5, 3]])
def test_dataset_pickle_and_copy_round_trips(seed):
    boundary = paper_day(0.1, seed)
    for other in (
        Boundary.from_dataset(boundary.to_dataset()),
        pickle.loads(pickle.dumps(boundary)),
        copy.deepcopy(boundary),
    ):
        assert other == boundary
        np.testing.assert_array_equal(other.day, boundary.day)
        assert other.has_day_dim == boundary.has_day_dim
        assert not other.series["m_a"].flags.writeable


def test_dataset_has_units_names_and_coordinates():
    ds = paper_day(0.1, [5, 3]).to_dataset()
    assert ds.sizes == {"day": 2, "elapsed_time": 360}
    assert ds.elapsed_time.attrs["units"] == "s"
    assert ds.elapsed_time.values[-1] == 359.0
    for name, series in BOUNDARY_SERIES.items():
        assert ds[name].attrs["units"] == series.unit
        assert ds[name].attrs["long_name"]
    assert ds.noise.attrs["units_metadata"] == "temperature: difference"
    assert paper_day(0.1).to_dataset().m_a.dims == ("elapsed_time",)


def test_a_part_of_a_dataset_keeps_its_label_and_needs_no_start():
    ds = paper_day(0.1, [5, 3]).to_dataset()
    ds["T_outside"] = ("elapsed_time", np.full(360, np.nan))  # ignored
    boundary = Boundary.from_dataset(ds.isel(day=1, elapsed_time=slice(100, None)))
    assert not boundary.has_day_dim
    np.testing.assert_array_equal(boundary.day, [3])
    np.testing.assert_array_equal(boundary.series["m_a"], ds.m_a.values[1:, 100:])


def test_from_dataset_is_strict():
    ds = paper_day(0.1).to_dataset()
    gap = ds.isel(elapsed_time=[*range(50), *range(53, 360)])
    assert_only_problem(["elapsed_time has a step of 4 s after sample 49: give 1-s steps"], Boundary.from_dataset, gap)
    missing = ds.drop_vars("T_w_in")
    assert_only_problem(["T_w_in is missing", "entering water temperature"], Boundary.from_dataset, missing)
    assert_only_problem(["units"], Boundary.from_dataset, ds.assign(m_a=ds.m_a.drop_attrs()))
    assert_only_problem(["coordinate"], Boundary.from_dataset, ds.drop_vars("elapsed_time"))


NIGHT = np.where(np.arange(7200) < 5400, 0.0, 1.2)
SERIES = {"T_a_in": 25.0, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": 14.0}


@pytest.mark.parametrize("made", [partial(Boundary, **SERIES), partial(constant_day, 2.0)])
def test_seconds_without_air_flow_are_off_and_their_hours_are_told(made):
    with pytest.warns(UserWarning, match=r"m_a is 0 during 1\.5 h and enabled is left out") as caught:
        boundary = made(m_a=NIGHT)
    assert len(caught) == 1
    np.testing.assert_array_equal(boundary.series["enabled"][0], NIGHT > 0.0)


def test_a_log_without_status_is_off_where_its_fan_stands(write_log):
    with pytest.warns(UserWarning, match="m_a is 0 during"):
        boundary = Boundary.from_csv(write_log(HEADER, replace_column(1, [1.0, 0.0, 0.0])))
    assert boundary.series["enabled"][0, 59:62].tolist() == [1.0, 0.0, 0.0]
