"""assign, sel, isel and concat: what changes and what stays, in memory and as streams, and what is refused."""

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_refused

from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import constant_day, paper_day

CLOCK = {"start": "2024-01-30T06:00", "time_zone": "UTC-08:00"}
DAYS = paper_day(0.25, [5, 3, 8]).assign(**CLOCK)
N = DAYS.n_steps
STREAM = Boundary.from_days(lambda label: paper_day(0.25, label).of_day(0), day=[5, 3, 8], hours=0.25, **CLOCK)
held_and_streamed = pytest.mark.parametrize("days", [DAYS, STREAM], ids=["held", "streamed"])


def is_same(first, second):
    return first == second and np.array_equal(first.start, second.start) and first.time_zone == second.time_zone


@held_and_streamed
def test_assign_replaces_what_is_given_and_keeps_the_rest(days):
    T_set = np.linspace(12.0, 16.0, N)
    changed = days.assign(T_set=T_set, T_w_in=xr.DataArray([6.0, 7.0, 8.0], dims="day"))
    assert changed.is_streamed == days.is_streamed
    for k in range(3):
        expected = DAYS.of_day(k) | {"T_set": T_set, "T_w_in": np.full(N, 6.0 + k)}
        for name, values in changed.of_day(k).items():
            np.testing.assert_array_equal(values, expected[name])
    assert np.array_equal(changed.start, days.start)
    assert is_same(changed.assign(T_set=DAYS.series["T_set"], T_w_in=DAYS.series["T_w_in"]), DAYS)


@held_and_streamed
def test_none_takes_a_series_back_to_its_default(days):
    noisy = days.assign(noise=0.5, backlash_scale=2.0)
    assert (noisy.extremes["noise"], noisy.extremes["backlash_scale"]) == ((0.5, 0.5), (2.0, 2.0))
    assert noisy.assign(noise=None, backlash_scale=None) == days


@held_and_streamed
@pytest.mark.parametrize(
    ("field", "code", "value"),
    [
        ("T_set", "shape", np.ones(7)), ("T_set", "value", 99.0), ("m_a", "missing", None), ("day", "shape", [1, 2]),
        ("m_a", "shape", xr.DataArray([1.0, 2.0, 3.0], dims="day", coords={"day": [1, 2, 4]})),
        ("T_sett", "name", 14.0),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(days, field, code, value):
    assert_refused(field, code, days.assign, **{field: value})


def test_enabled_follows_a_new_air_flow_unless_it_was_given():
    stop = np.where(np.arange(N) < 90, 0.0, 1.0)
    with pytest.warns(UserWarning, match=r"m_a is 0 during 0\.025 h"):
        stopped = paper_day(0.25).assign(m_a=stop)
    np.testing.assert_array_equal(stopped.series["enabled"][0], stop)
    assert (stopped.assign(m_a=1.0).series["enabled"] == 1.0).all()
    with_enabled = paper_day(0.25).assign(enabled=1.0).assign(m_a=stop)
    assert (with_enabled.series["enabled"] == 1.0).all()
    with pytest.warns(UserWarning, match="m_a is 0"):
        assert with_enabled.assign(enabled=None) == stopped


@held_and_streamed
@pytest.mark.parametrize("day", [[2, 0], slice(1, None), np.array([False, True, True]), [-1]])
def test_isel_chooses_days_as_numpy_does(days, day):
    rows = np.arange(3)[day]
    chosen = days.isel(day)
    np.testing.assert_array_equal(chosen.day, DAYS.day[rows])
    np.testing.assert_array_equal(chosen.start, DAYS.start[rows])
    np.testing.assert_array_equal(chosen.series["T_a_in"], DAYS.series["T_a_in"][rows])
    assert chosen.has_day_dim
    assert chosen.is_streamed == days.is_streamed


@held_and_streamed
def test_one_day_has_no_dim_and_is_held(days):
    day = days.isel(1)
    assert (day.has_day_dim, day.is_streamed) == (False, False)
    assert day == paper_day(0.25, 3) == days.sel(3)
    assert day.start[0] == np.datetime64("2024-01-31T06:00")


@held_and_streamed
def test_sel_chooses_by_label(days):
    np.testing.assert_array_equal(days.sel([8, 5]).day, [8, 5])
    np.testing.assert_array_equal(days.sel(slice(3, 8)).day, [3, 8])
    np.testing.assert_array_equal(days.sel(slice(None, 3)).day, [5, 3])
    assert_refused("day", "name", days.sel, 4)
    assert_refused("day", "missing", days.sel, slice(8, 5))
    assert_refused("day", "duplicate", days.isel, [0, -3])
    assert_refused("day", "value", days.isel, [0, 3])


@pytest.mark.parametrize("parts", [(DAYS, DAYS), (STREAM, STREAM), (DAYS, STREAM)], ids=["held", "streamed", "mixed"])
def test_days_put_together_are_the_days_that_were_taken_apart(parts):
    first, second = parts[0].isel([0]), parts[1].isel([1, 2])
    joined = Boundary.concat([first, second])
    assert is_same(joined, DAYS)
    assert is_same(Boundary.concat([parts[0].isel(0), second]), DAYS)
    assert joined.is_streamed == any(part.is_streamed for part in parts)


@pytest.mark.parametrize(
    ("field", "code", "boundaries"),
    [
        ("boundaries", "duplicate", [DAYS, DAYS]),
        ("boundaries", "shape", [DAYS, constant_day(0.5).assign(start="2024-05-01")]),
        ("boundaries", "time", [DAYS, constant_day(0.25)]),
        ("boundaries", "time", [DAYS, constant_day(0.25).assign(start="2024-05-01", time_zone="UTC")]),
        ("boundaries", "type", []),
        ("boundaries[1]", "type", [DAYS, 3]),
    ],
)
def test_days_that_do_not_fit_are_not_joined(field, code, boundaries):
    assert_refused(field, code, Boundary.concat, boundaries)
