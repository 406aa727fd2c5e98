"""Promises of a boundary: shapes, immutability, digests, round trips, and the field and code of every refusal."""

import copy
import pickle
from functools import partial

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_refused
from helpers.trend_logs import HEADER, replace_column

from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import constant_day, paper_day
from fastcoil.loops.boundary.series import BOUNDARY_SERIES

GOOD_SERIES = {"m_a": 1.0, "T_a_in": 25.0, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": np.full(60, 14.0)}


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
    T_a_in = xr.DataArray(20 + np.arange(60.0) / 10, dims="elapsed_time")
    m_a = np.array([[1.0] * 60, [2.0] * 60])
    boundary = Boundary(**GOOD_SERIES | {"T_w_in": T_w_in, "T_a_in": T_a_in, "m_a": m_a})
    assert boundary.has_day_dim
    np.testing.assert_array_equal(boundary.day, [4, 2])
    np.testing.assert_array_equal(boundary.series["T_w_in"][:, 7], [6.0, 8.0])
    np.testing.assert_array_equal(boundary.series["T_a_in"][1], 20 + np.arange(60.0) / 10)
    np.testing.assert_array_equal(boundary.series["m_a"][:, 59], [1.0, 2.0])


def test_labels_alone_make_a_day_dim_and_one_number_does_not():
    assert Boundary(**GOOD_SERIES, day=[9]).has_day_dim
    assert Boundary(**GOOD_SERIES, day=[9, 1]).series["m_a"].shape == (2, 60)
    alone = Boundary(**GOOD_SERIES, day=9)
    assert not alone.has_day_dim
    np.testing.assert_array_equal(alone.day, [9])


def test_equality_and_digest_follow_names_labels_and_samples():
    boundary = Boundary(**GOOD_SERIES)
    assert boundary == Boundary(**GOOD_SERIES)
    assert hash(boundary) == hash(Boundary(**GOOD_SERIES))
    assert boundary != "boundary"
    changes = [{"T_a_in": np.nextafter(25.0, 26.0)}, {"m_a": 7.0, "T_w_in": 1.0}, {"day": 1}, {"day": [0]}]
    changes.append({"T_set": np.full(61, 14.0)})
    assert len({boundary.sha256, *(Boundary(**GOOD_SERIES | change).sha256 for change in changes)}) == 6
    assert Boundary(**GOOD_SERIES, noise=-0.0) == boundary


HOT = np.full((3, 60), 25.0)
HOT[1, 40:43] = 61.0
TWO_DAYS = np.ones((2, 60))


def labelled_days(*labels):
    return xr.DataArray([1.0, 2.0], dims="day", coords={"day": [*labels]})


@pytest.mark.parametrize(
    ("field", "code", "changes"),
    [
        ("m_a", "value", {"m_a": -0.1}), ("T_a_in", "value", {"T_a_in": 77.0}),
        ("T_set", "value", {"T_set": np.full(60, 95.0)}), ("enabled", "value", {"enabled": 0.5}),
        ("T_a_in", "value", {"T_a_in": float("nan")}), ("T_w_in", "value", {"T_w_in": -999.0}),
        ("T_a_in", "type", {"T_a_in": "25"}), ("m_a", "shape", {"m_a": [[1.0], [1.0, 2.0]]}),
        ("m_a", "shape", {"m_a": []}), ("m_a", "missing", {"m_a": None}),
        ("m_a", "shape", {"m_a": xr.DataArray(np.ones(60), dims="time")}), ("T_set", "shape", {"m_a": np.ones(59)}),
        ("T_a_in", "value", {"T_a_in": HOT, "day": [10, 20, 30]}),
        ("T_a_in", "value", {"T_a_in": np.ma.masked_equal(HOT[1], 61.0)}),
        ("day", "duplicate", {"m_a": TWO_DAYS, "day": [1, 1]}), ("day", "value", {"m_a": TWO_DAYS, "day": [-1, 2]}),
        ("day", "value", {"m_a": TWO_DAYS, "day": [0.5, 2]}), ("day", "shape", {"m_a": TWO_DAYS, "day": [1, 2, 3]}),
        ("T_w_in", "shape", {"m_a": TWO_DAYS, "T_w_in": np.ones((3, 60))}),
        ("T_w_in", "shape", {"m_a": labelled_days(1, 2), "T_w_in": labelled_days(2, 1)}),
    ],
)  # fmt: skip
def test_a_bad_series_or_label_is_refused(field, code, changes):
    assert_refused(field, code, Boundary, **GOOD_SERIES | changes)


@pytest.mark.parametrize("seed", [1, [5, 3]])
def test_dataset_pickle_and_copy_round_trips(seed):
    boundary = paper_day(0.1, seed)
    read = Boundary.from_dataset(boundary.to_dataset())
    for other in (read, pickle.loads(pickle.dumps(boundary)), copy.deepcopy(boundary)):
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
    assert_refused("elapsed_time", "time", Boundary.from_dataset, gap)
    assert_refused("T_w_in", "missing", Boundary.from_dataset, ds.drop_vars("T_w_in"))
    assert_refused("m_a", "unit", Boundary.from_dataset, ds.assign(m_a=ds.m_a.drop_attrs()))
    assert_refused("elapsed_time", "missing", Boundary.from_dataset, ds.drop_vars("elapsed_time"))


NIGHT = np.where(np.arange(7200) < 5400, 0.0, 1.2)
SERIES = {"T_a_in": 25.0, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": 14.0}


@pytest.mark.parametrize("make_day", [partial(Boundary, **SERIES), partial(constant_day, 2.0)])
def test_seconds_without_air_flow_are_off_and_their_hours_are_reported(make_day):
    with pytest.warns(UserWarning, match=r"m_a is 0 during 1\.5 h and enabled is left out") as caught:
        boundary = make_day(m_a=NIGHT)
    assert len(caught) == 1
    np.testing.assert_array_equal(boundary.series["enabled"][0], NIGHT > 0.0)


def test_a_log_without_status_is_off_where_its_fan_stands(write_log):
    with pytest.warns(UserWarning, match="m_a is 0 during"):
        boundary = Boundary.from_csv(write_log(HEADER, replace_column(1, [1.0, 0.0, 0.0])))
    assert boundary.series["enabled"][0, 59:62].tolist() == [1.0, 0.0, 0.0]


@pytest.mark.parametrize("changes", [{"W_a_in": 0.05}, {"T_a_in": 0.0}, {"W_a_in": np.linspace(0.01, 0.06, 60)}])
def test_air_above_saturation_at_any_pressure_is_refused(changes):
    assert_refused("W_a_in", "data", Boundary, **GOOD_SERIES | changes)
    assert Boundary(**GOOD_SERIES | {"W_a_in": 0.042}).n_steps == 60  # saturated at 50 kPa
