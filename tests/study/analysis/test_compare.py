"""``fc.compare``: paired differences, their intervals, censored times, failed scenarios."""

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import fastcoil as fc
from fastcoil.model.metric_table import STATUS_NON_FINITE
from fastcoil.study.analysis.paired import STATISTICS


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


def test_replicates_that_share_a_day_do_not_count_as_independent():
    rng = np.random.default_rng(4)
    of_day = rng.normal(0.0, 1.0, 12)[:, None] + 0.001 * rng.normal(size=(12, 50))
    ds = result(("kp", "day", "replicate"), rmse=[np.zeros((12, 50)), of_day])
    found = fc.compare(ds, baseline={"kp": 0}, over=["day", "replicate"]).rmse.sel(kp=1)
    width = float(found.sel(statistic="high") - found.sel(statistic="low"))
    assert width > 0.7 * 2 * 1.96 * of_day.std() / np.sqrt(12)


@pytest.mark.parametrize("n", [2, 4])
def test_the_interval_covers_the_true_mean_as_often_as_it_says_also_with_few_days(n):
    rng = np.random.default_rng(5)
    of_day = rng.normal(0.7, 1.0, (2000, n, 1)) + rng.normal(0.0, 0.5, (2000, n, 3))
    ds = result(("kp", "tuning", "day", "replicate"), rmse=[0.0 * of_day, of_day])
    found = fc.compare(ds, baseline={"kp": 0}, over=["replicate", "day"]).rmse.sel(kp=1)
    covered = (found.sel(statistic="low") <= 0.7) & (found.sel(statistic="high") >= 0.7)
    assert 0.93 < float(covered.mean()) < 0.97


def test_the_interval_of_days_is_that_of_scipy_at_its_level():
    values = np.array([0.3, 1.1, 0.2, 0.9])
    ds = result(("kp", "day"), rmse=[np.zeros(4), values])
    found = fc.compare(ds, baseline={"kp": 0}, over="day", level=0.8).rmse.sel(kp=1, statistic=["low", "high"])
    expected = stats.t.interval(0.8, 3, values.mean(), stats.sem(values))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_scatter_of_several_dims_adds_up():
    of_sample, of_day = np.array([0.0, 1.0, 5.0, 2.0]), np.array([0.3, 2.0, 1.0])
    values = of_sample[:, None] + of_day
    ds = result(("kp", "sample", "day"), rmse=[0.0 * values, values])
    found = fc.compare(ds, baseline={"kp": 0}, over=["sample", "day"]).rmse.sel(kp=1)
    half = stats.t.ppf(0.975, 2) * np.hypot(stats.sem(of_sample), stats.sem(of_day))
    assert float(found.sel(statistic="high") - found.sel(statistic="mean")) == pytest.approx(half)


def test_the_noise_of_one_day_says_nothing_of_other_days():
    ds = result(("kp", "day", "replicate"), rmse=[[[1.0] * 5], [np.arange(5.0)]])
    compared = [fc.compare(ds, baseline={"kp": 0}, over=over).rmse.sel(kp=1, statistic=["low", "high"])
                for over in (["day", "replicate"], "replicate")]  # fmt: skip
    assert np.isnan(compared[0]).all()
    assert np.isfinite(compared[1]).all()


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
    expected = stats.t.interval(0.95, 1, 2.0, stats.sem([1.0, 3.0]))
    np.testing.assert_allclose(found.sel(statistic=["low", "high"]), expected)


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
        ({"baseline": {"kp": 0}, "over": "day", "relative": 1}, "relative = 1"),
        ({"baseline": {"kp": [0]}, "over": "day"}, "kp = [0] is not a single label; give one, such as 0"),
        ({"baseline": {"kp": "0"}, "over": "day"}, "no label '0'"),
        ({"baseline": {"kp": True}, "over": "day"}, "no label True"),
        ({"baseline": "kp", "over": "day"}, "baseline = 'kp': must be a dict"),
        ({"baseline": {"kp": 0}, "over": ["day", "day"]}, "over: 'day' is given more than once"),
        ({"baseline": {"kp": 0}, "over": None}, "over = None: must be a name or a list of names"),
        ({"baseline": {"kp": 0}, "over": "day", "metrics": []}, "metrics is empty"),
        ({"baseline": {"kp": 0}, "over": "day", "metrics": "learning_status"}, "'learning_status' is a flag"),
    ],
)
def test_a_mistake_gets_a_sentence(options, sentence):
    ds = result(("kp", "day"), rmse=np.zeros((2, 3)), learning_status=np.zeros((2, 3)))
    with pytest.raises(fc.InputError, match=".") as caught:
        fc.compare(ds, **options)
    assert sentence in str(caught.value)
    assert len(caught.value.problems) == 1


def test_relative_differences_are_those_of_shares_of_the_partner():
    rng = np.random.default_rng(8)
    values = rng.uniform(0.5, 2.0, (3, 6))
    ds = result(("kp", "day"), rmse=values)
    found = fc.compare(ds, baseline={"kp": 0}, over="day", relative=True)
    by_hand = fc.compare(result(("kp", "day"), rmse=values / values[0]), baseline={"kp": 0}, over="day")
    kept = [s for s in STATISTICS if s not in ("baseline", "value")]
    np.testing.assert_allclose(found.rmse.sel(statistic=kept), by_hand.rmse.sel(statistic=kept), rtol=1e-12, atol=1e-14)
    plain = fc.compare(ds, baseline={"kp": 0}, over="day").rmse.sel(statistic=["baseline", "value"])
    np.testing.assert_array_equal(found.rmse.sel(statistic=["baseline", "value"]), plain)
    assert found.attrs["relative"] == 1
    assert found.rmse.attrs["units"] == "1"


def test_against_a_baseline_of_0_an_equal_value_is_no_change_and_any_other_is_infinite():
    ds = result(("kp", "day"), reversals=[[0.0, 0.0, 4.0], [0.0, 0.0, 2.0], [0.0, 3.0, 2.0]])
    found = fc.compare(ds, baseline={"kp": 0}, over="day", relative=True).reversals
    assert found.sel(kp=1, statistic=["q05", "median", "q95"]).values.tolist() == [-0.5, 0.0, 0.0]
    assert float(found.sel(kp=1, statistic="mean")) == pytest.approx(-0.5 / 3)
    assert found.sel(kp=2, statistic=["q05", "median", "q95"]).values.tolist() == [-0.5, 0.0, np.inf]
    assert np.isnan(found.sel(kp=2, statistic=["mean", "low", "high"])).all()
    assert float(found.sel(kp=2, statistic="n_pairs")) == 3


def test_relative_to_a_negative_baseline_more_is_positive():
    ds = result(("kp", "day"), size_error=[[-0.02, -0.02], [-0.01, -0.03]])
    found = fc.compare(ds, baseline={"kp": 0}, over="day", relative=True).size_error
    assert found.sel(kp=1, statistic=["q05", "q95"]).values.tolist() == pytest.approx([-0.5, 0.5])


def test_a_time_that_came_is_a_whole_share_below_one_that_never_did():
    ds = result(("kp", "day"), learn_time_reached=[[np.nan, np.nan, 100.0], [50.0, np.nan, np.nan]])
    found = fc.compare(ds, baseline={"kp": 0}, over="day", relative=True).learn_time_reached
    assert found.sel(kp=1, statistic=["q05", "median", "q95"]).values.tolist() == [-1.0, 0.0, np.inf]


def test_a_single_scenario_has_nothing_to_compare():
    alone = result(("kp", "day"), rmse=np.zeros((1, 1))).isel(kp=0, day=0)
    with pytest.raises(fc.InputError) as caught:
        fc.compare(alone, baseline={"kp": 0}, over="day")
    (problem,) = caught.value.problems
    assert "ds is a single scenario without dimensions" in problem
    assert "give a sweep that holds the baseline" in problem
