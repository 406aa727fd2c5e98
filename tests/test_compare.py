"""``fc.compare``: paired differences, their intervals, censored times, failed scenarios."""

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from fastcoil.outputs import STATUS_NON_FINITE
from fastcoil.pairing import STATISTICS


def result(dims, **metrics):
    """A result as simulate would give it, with these values."""
    first = np.asarray(next(iter(metrics.values())))
    ds = xr.Dataset({name: (dims, np.asarray(values, dtype=float)) for name, values in metrics.items()})
    ds["status"] = (dims, np.zeros(first.shape, dtype=np.int8))
    return ds.assign_coords({dim: np.arange(n) for dim, n in ds.sizes.items()})


def test_the_difference_is_taken_within_pairs_not_between_means():
    rng = np.random.default_rng(1)
    weather = rng.normal(0.0, 10.0, 40)
    ds = result(("kp", "day"), rmse=[weather, weather + 0.3 + 0.01 * rng.normal(size=40)])
    found = fc.compare(ds, baseline={"kp": 0}, over="day").rmse.sel(kp=1)
    assert found.sel(statistic="mean") == pytest.approx(0.3, abs=0.01)
    assert 0.29 < float(found.sel(statistic="low")) < float(found.sel(statistic="high")) < 0.31
    assert float(found.sel(statistic="share_lower")) == 0.0
    assert float(found.sel(statistic="n_pairs")) == 40


def test_the_baseline_compared_with_itself_differs_by_nothing():
    ds = result(("kp", "day"), rmse=np.random.default_rng(2).random((3, 7)))
    found = fc.compare(ds, baseline={"kp": 1}, over="day").rmse.sel(kp=1)
    assert found.sel(statistic=["mean", "low", "high", "median"]).values.tolist() == [0.0] * 4
    assert float(found.sel(statistic="share_lower")) == 0.5


def test_the_interval_of_independent_pairs_is_that_of_the_normal_theory():
    n = 400
    values = np.random.default_rng(3).normal(1.0, 2.0, n)
    ds = result(("kp", "replicate"), rmse=[np.zeros(n), values])
    found = fc.compare(ds, baseline={"kp": 0}, over="replicate").rmse.sel(kp=1)
    half = 1.959964 * values.std() / np.sqrt(n)
    for edge, expected in (("low", values.mean() - half), ("high", values.mean() + half)):
        assert float(found.sel(statistic=edge)) == pytest.approx(expected, abs=0.05 * half)


def test_replicates_that_share_a_day_do_not_count_as_independent():
    rng = np.random.default_rng(4)
    of_day = rng.normal(0.0, 1.0, 12)[:, None] + 0.001 * rng.normal(size=(12, 50))
    ds = result(("kp", "day", "replicate"), rmse=[np.zeros((12, 50)), of_day])
    found = fc.compare(ds, baseline={"kp": 0}, over=["day", "replicate"]).rmse.sel(kp=1)
    width = float(found.sel(statistic="high") - found.sel(statistic="low"))
    assert width > 0.7 * 2 * 1.96 * of_day.std() / np.sqrt(12)


def test_quantiles_are_those_of_the_sorted_differences():
    ds = result(("kp", "day"), rmse=[np.zeros(20), np.arange(1.0, 21.0)])
    found = fc.compare(ds, baseline={"kp": 0}, over="day").rmse.sel(kp=1)
    assert found.sel(statistic=["q05", "q25", "median", "q75", "q95"]).values.tolist() == [1, 5, 10, 15, 19]


def test_a_time_that_never_came_is_later_than_any_that_did():
    never = np.nan
    baseline, value = [100.0, 100.0, never, never, 100.0], [50.0, never, 80.0, never, 90.0]
    ds = result(("kp", "day"), learn_time_reached=[baseline, value])
    found = fc.compare(ds, baseline={"kp": 0}, over="day").learn_time_reached.sel(kp=1)
    assert float(found.sel(statistic="n_pairs")) == 5
    assert float(found.sel(statistic="n_censored")) == 2
    # differences: -50, +inf, -inf, a tie of two that never came, -10
    assert float(found.sel(statistic="share_lower")) == pytest.approx(3.5 / 5)
    assert float(found.sel(statistic="median")) == -10.0
    assert float(found.sel(statistic="q05")) == -np.inf
    assert float(found.sel(statistic="q95")) == np.inf
    assert np.isnan(found.sel(statistic=["mean", "low", "high"])).all()
    # of the values 50, 80, 90, never, never the middle one
    assert float(found.sel(statistic="value")) == 90.0


def test_a_failed_scenario_takes_its_pair_out_and_no_other():
    ds = result(("kp", "day"), rmse=[[1.0, 1.0, 1.0], [2.0, np.nan, 4.0]])
    ds["status"][1, 1] = STATUS_NON_FINITE
    found = fc.compare(ds, baseline={"kp": 0}, over="day").rmse.sel(kp=1)
    assert float(found.sel(statistic="n_pairs")) == 2
    assert float(found.sel(statistic="mean")) == 2.0


def test_nothing_is_claimed_of_a_single_pair_or_of_none():
    ds = result(("kp", "day"), rmse=[[1.0], [2.0]])
    found = fc.compare(ds, baseline={"kp": 0}, over="day").rmse.sel(kp=1)
    assert float(found.sel(statistic="mean")) == 1.0
    assert np.isnan(found.sel(statistic=["low", "high"])).all()
    ds["status"][:] = STATUS_NON_FINITE
    found = fc.compare(ds, baseline={"kp": 0}, over="day").rmse.sel(kp=1)
    assert float(found.sel(statistic="n_pairs")) == 0
    assert np.isnan(found.sel(statistic="median"))


@pytest.mark.kernel
def test_every_metric_of_a_simulation_can_be_compared(swept):
    found = fc.compare(swept, baseline={"backlash": 0.0}, over=["day", "replicate"])
    assert set(found.rmse.dims) == {"n_volumes", "backlash", "tuning", "statistic"}
    assert found.statistic.values.tolist() == list(STATISTICS)
    by_hand = (swept.rmse - swept.rmse.sel(backlash=0.0)).mean(["day", "replicate"])
    xr.testing.assert_allclose(
        found.rmse.sel(statistic="mean", drop=True).transpose(*by_hand.dims), by_hand.drop_attrs(), atol=1e-12
    )


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"baseline": {"kpp": 0}, "over": "day"}, "did you mean 'kp'"),
        ({"baseline": {"kp": 7}, "over": "day"}, "no label 7; choose one of 0, 1"),
        ({"baseline": {"kp": 0}, "over": "replicate"}, "'replicate' is no dimension"),
        ({"baseline": {"kp": 0}, "over": "kp"}, "choose one or the other"),
        ({"baseline": {"kp": 0}, "over": "day", "metrics": ["rmsee"]}, "did you mean 'rmse'"),
        ({"baseline": {}, "over": "day"}, "baseline is empty"),
        ({"baseline": {"kp": 0}, "over": []}, "over is empty"),
        ({"baseline": {"kp": 0}, "over": "day", "level": 95}, "level = 95"),
    ],
)
def test_a_mistake_gets_a_sentence(options, sentence):
    ds = result(("kp", "day"), rmse=np.zeros((2, 3)))
    with pytest.raises(fc.InputError, match=".") as caught:
        fc.compare(ds, **options)
    assert sentence in str(caught.value)
