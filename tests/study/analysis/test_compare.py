"""``fc.compare``: paired differences and shares, their intervals, censored times, failed scenarios, and the table."""

import copy
import pickle
import re

import numpy as np
import pytest
import xarray as xr
from helpers.results import result
from scipy import stats

import fastcoil as fc
from fastcoil.model.metric_table import STATUS_NON_FINITE
from fastcoil.study.analysis.paired import STATISTICS


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
        ({"baseline": {"kp": 0}, "over": "day", "threshold": -0.05}, "threshold = -0.05: give a number of at least 0"),
        ({"baseline": {"kp": 0}, "over": "day", "threshold": np.nan}, "threshold = nan"),
    ],
)
def test_a_mistake_gets_a_sentence(options, sentence):
    ds = result(("kp", "day"), rmse=np.zeros((2, 3)), learning_status=np.zeros((2, 3)))
    with pytest.raises(fc.InputError, match=".") as caught:
        fc.compare(ds, **options)
    assert sentence in str(caught.value)
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize(
    ("name", "unit", "sentence"),
    [
        ("rmse", "mK", "ds.rmse is in 'mK': give it in K"),
        ("kp", "percent", "ds.kp is in 'percent': give it in K-1"),
    ],
)
def test_numbers_in_other_units_are_refused_and_labels_in_another_order_are_the_same(name, unit, sentence):
    ds = result(("kp", "day"), rmse=np.random.default_rng(3).random((2, 3)))
    found = fc.compare(ds.isel(kp=[1, 0], day=[2, 0, 1]), baseline={"kp": 0}, over="day")
    xr.testing.assert_allclose(found.rmse.sel(kp=[0, 1]), fc.compare(ds, baseline={"kp": 0}, over="day").rmse)
    ds[name].attrs["units"] = unit
    for refused in (lambda: fc.compare(ds, baseline={"kp": 0}, over="day"), lambda: fc.sobol_indices(ds)):
        with pytest.raises(fc.InputError) as caught:
            refused()
        assert caught.value.problems == [sentence]


def test_a_metric_of_the_study_s_own_is_compared_like_ours():
    ds = result(("kp", "day"), rmse=[[1.0, 2.0], [1.5, 2.5]])
    own = ds.assign(peak=(10 * ds.rmse).assign_attrs(units="degC", long_name="highest temperature"))
    found = fc.compare(own, baseline={"kp": 0}, over="day")
    assert found.peak.sel(kp=1, statistic="mean") == pytest.approx(5.0)
    assert found.to_table().loc["highest temperature [°C]", "1"]["difference (95 %)"].startswith("+5")
    with pytest.raises(fc.InputError, match="'T_sup' is no number for each scenario"):
        fc.compare(
            own.assign(T_sup=ds.rmse.expand_dims(elapsed_time=2)), baseline={"kp": 0}, over="day", metrics="T_sup"
        )


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
    with pytest.raises(fc.InputError, match="single scenario without dimensions.*give a sweep that holds the baseline"):
        fc.compare(alone, baseline={"kp": 0}, over="day")


# Shares of pairs that differ by a threshold, with intervals over valves and days

EDGES = ("", "_low", "_high")


def shares(found, side):
    """Share, lower and upper end."""
    return found.sel(statistic=[f"share_{side}{edge}" for edge in EDGES]).values


def against_nothing(differences, over, **options):
    """The comparison of values with a baseline of zeros."""
    values = np.asarray(differences)
    ds = result(("kp", *over), rmse=np.stack([np.zeros(values.shape), values]))
    return fc.compare(ds, baseline={"kp": 0}, over=list(over), **options).rmse.sel(kp=1)


def crossed(n, valves, days, spread_of_valves, spread_of_days, seed):
    """Differences of ``n`` studies whose valves and days have effects of their own; their scatter by itself is 1."""
    rng = np.random.default_rng(seed)
    effects = spread_of_valves * rng.normal(size=(n, valves, 1)) + spread_of_days * rng.normal(size=(n, 1, days))
    return effects + rng.normal(size=(n, valves, days))


def test_the_shares_count_the_pairs_that_differ_by_at_least_as_much():
    found = against_nothing([-0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.3, 0.4], ("day",), threshold=0.1)
    assert shares(found, "below")[0] == 2 / 8
    assert shares(found, "above")[0] == 3 / 8


def test_relative_to_the_baseline_the_threshold_is_a_share_of_it():
    ds = result(("kp", "day"), rmse=[[2.0, 2.0, 2.0, 2.0], [1.8, 1.91, 2.1, 2.0]])
    found = fc.compare(ds, baseline={"kp": 0}, over="day", relative=True, threshold=0.05).rmse.sel(kp=1)
    assert (shares(found, "below")[0], shares(found, "above")[0]) == (0.25, 0.25)


def test_at_0_an_equal_value_is_neither_lower_nor_higher():
    found = against_nothing([-1e-9, 0.0, 0.0, 2.0], ("day",), threshold=0.0)
    assert (shares(found, "below")[0], shares(found, "above")[0]) == (0.25, 0.25)


def test_a_time_that_never_came_is_higher_by_any_threshold():
    ds = result(("kp", "day"), learn_time_reached=[[100.0, np.nan, np.nan], [np.nan, 50.0, np.nan]])
    found = fc.compare(ds, baseline={"kp": 0}, over="day", metrics="learn_time_reached", threshold=1e6)
    found = found.learn_time_reached.sel(kp=1)
    assert (shares(found, "below")[0], shares(found, "above")[0]) == pytest.approx((1 / 3, 1 / 3))


def test_the_other_statistics_are_the_same_to_the_bit():
    values = np.random.default_rng(2).normal(size=(3, 8, 5))
    ds = result(("kp", "sample", "day"), rmse=values)
    options = {"baseline": {"kp": 0}, "over": ["sample", "day"], "relative": True}
    plain, more = fc.compare(ds, **options), fc.compare(ds, **options, threshold=0.1)
    np.testing.assert_array_equal(more.rmse.sel(statistic=plain.statistic), plain.rmse)
    assert more.sizes["statistic"] == plain.sizes["statistic"] + 6


@pytest.mark.parametrize("p", [0.03, 0.5, 0.9])
def test_of_independent_pairs_the_interval_is_wilsons(p):
    n = 400
    holds = np.random.default_rng(3).random(n) < p
    found = shares(against_nothing(np.where(holds, -1.0, 0.0), ("sample",), threshold=0.5), "below")
    expected = stats.binomtest(int(holds.sum()), n).proportion_ci(method="wilson")
    assert found == pytest.approx([holds.mean(), *expected], abs=2e-3)


def test_where_all_pairs_agree_the_interval_is_that_of_as_many_valves():
    found = shares(against_nothing(np.full((40, 3), -1.0), ("sample", "day"), threshold=0.5), "below")
    expected = stats.binomtest(40, 40).proportion_ci(method="wilson")
    assert found == pytest.approx([1.0, *expected])


def test_the_interval_is_about_that_of_valves_and_days_drawn_anew():
    values = crossed(1, 60, 14, 1.0, 0.7, seed=4)[0]
    holds, rng = values < -0.5, np.random.default_rng(5)
    low, high = shares(against_nothing(values, ("sample", "day"), threshold=0.5), "below")[1:]
    anew = [holds[rng.integers(60, size=60)][:, rng.integers(14, size=14)].mean() for _ in range(2000)]
    assert high - low == pytest.approx(np.diff(np.quantile(anew, [0.025, 0.975]))[0], rel=0.15)
    # as if valves and days said nothing of each other
    alone = stats.binomtest(int(holds.sum()), holds.size).proportion_ci(method="wilson")
    assert high - low > 2.5 * (alone.high - alone.low)


def coverage(valves, days, of_valves, of_days):
    """In what share of simulated studies the interval holds the true share."""
    values = crossed(300, valves, days, of_valves, of_days, seed=6)
    true = stats.norm.cdf(-0.5 / np.sqrt(1.0 + of_valves**2 + of_days**2))
    ds = result(("kp", "tuning", "sample", "day"), rmse=np.stack([np.zeros(values.shape), values]))
    found = fc.compare(ds, baseline={"kp": 0}, over=["sample", "day"], threshold=0.5).rmse.sel(kp=1)
    low, high = (found.sel(statistic=f"share_below_{edge}") for edge in ("low", "high"))
    return float(((low <= true) & (true <= high)).mean())


@pytest.mark.parametrize(
    ("valves", "days", "of_valves", "of_days"),
    [(40, 5, 1.0, 0.5), (128, 10, 1.0, 1.0), (20, 20, 0.0, 0.0), (40, 3, 0.5, 0.2), (60, 8, 0.1, 1.0)],
)
def test_the_interval_holds_the_true_share_as_often_as_it_says(valves, days, of_valves, of_days):
    assert 0.92 < coverage(valves, days, of_valves, of_days) <= 1.0


@pytest.mark.parametrize("days", [2, 3])
def test_two_or_three_days_that_decide_alone_say_less_than_their_interval(days):
    """What the page says of it."""
    assert 0.80 <= coverage(40, days, 0.2, 2.0) < 0.92


@pytest.mark.parametrize("differences", [np.random.default_rng(7).normal(size=30), [-1.0, 1.0] * 16])
def test_a_single_day_says_nothing_of_other_days(differences):
    found = against_nothing(np.reshape(differences, (-1, 1)), ("sample", "day"), threshold=0.5)
    value, *edges = shares(found, "below")
    assert 0.0 < value < 1.0
    assert np.isnan(edges).all()


def test_noise_of_the_same_day_does_not_count_as_independent():
    of_day = np.repeat(np.random.default_rng(8).normal(size=(12, 1)), 50, axis=1)
    together = shares(against_nothing(of_day, ("day", "replicate"), threshold=0.3), "below")
    alone = shares(against_nothing(of_day[:, 0], ("day",), threshold=0.3), "below")
    np.testing.assert_allclose(together, alone)
    always = shares(against_nothing(np.full((12, 50), -1.0), ("day", "replicate"), threshold=0.3), "below")
    assert always == pytest.approx([1.0, *stats.binomtest(12, 12).proportion_ci(method="wilson")])


def test_metrics_of_several_units_may_share_a_relative_threshold_only():
    ds = result(("kp", "day"), rmse=np.ones((2, 3)), iae=np.ones((2, 3)))
    with pytest.raises(
        fc.InputError, match="in the unit of the metrics, and these have K, K h: name metrics of one un"
    ):
        fc.compare(ds, baseline={"kp": 0}, over="day", threshold=0.05, metrics=["rmse", "iae"])
    found = fc.compare(ds, baseline={"kp": 0}, over="day", relative=True, threshold=0.05)
    assert float(found.iae.sel(kp=1, statistic="share_below")) == 0.0
    assert "units_metadata" not in found.rmse.attrs  # a share is no difference of temperatures


# The table says to people what the Dataset says

NUMBER = re.compile(r"[+−]?[\d.,]+")


def numbers(text):
    return [float(n.replace("−", "-").replace(",", "")) for n in NUMBER.findall(text)]


@pytest.fixture(scope="module")
def ratios():
    rng = np.random.default_rng(1)
    rmse = np.array([1.0, 0.8, 0.79])[:, None, None] * rng.uniform(0.5, 1.5, (1, 12, 6)) + 0.02 * rng.random((3, 12, 6))
    return result(
        ("estimate_ratio", "sample", "day"), {"estimate_ratio": [0.0, 0.5, 1.0]}, rmse=rmse, share_off=0.1 * rmse,
        learn_time_reached=np.full(rmse.shape, np.nan), half_periods=np.full(rmse.shape, np.nan),
    )  # fmt: skip


def compared(ratios, **options):
    return fc.compare(ratios, baseline={"estimate_ratio": 0.0}, over=["sample", "day"], **options)


def test_every_label_but_that_of_the_baseline_has_a_row_with_its_unit(ratios):
    table = compared(ratios, metrics=["rmse", "share_off"]).to_table()
    assert table.index.names == ["metric", "estimate / backlash [%]"]
    assert table.index.to_list() == [
        (metric, label) for metric in ("RMS error [K]", "share of time with |e| > 0.5 K [%]") for label in ("50", "100")
    ]
    assert list(table) == ["baseline", "value", "difference (95 %)", "lower in", "pairs"]


def test_the_numbers_are_those_of_the_dataset_to_the_digits_shown(ratios):
    found = compared(ratios, metrics="rmse", relative=True, threshold=0.05, level=0.9)
    table = found.to_table()
    row, at = table.loc["RMS error [K]", "100"], found.rmse.sel(estimate_ratio=1.0)
    assert numbers(row["difference (90 %)"]) == pytest.approx(
        [100 * float(at.sel(statistic=s)) for s in ("mean", "low", "high")], abs=0.5
    )
    assert re.fullmatch(r"−[\d.]+ % \(−[\d.]+ to −[\d.]+\)", row["difference (90 %)"])
    assert numbers(row["lower by 5 % in (90 %)"]) == [
        round(100 * float(at.sel(statistic=f"share_below{edge}"))) for edge in ("", "_low", "_high")
    ]
    assert numbers(row["baseline"]) == pytest.approx([float(at.sel(statistic="baseline"))], rel=5e-3)
    assert row["pairs"] == "72"


def test_a_difference_has_the_digits_that_its_interval_leaves():
    ds = result(("kp", "day"), rmse=[[1.0, 1.0, 1.0], [0.8, 0.75, 0.78]])
    table = fc.compare(ds, baseline={"kp": 0}, over="day").to_table()
    # Student's interval of -0.20, -0.25, -0.22: -0.2233 ± 4.303 · 0.02517 / √3
    assert table["difference (95 %)"].to_list() == ["−0.22 (−0.29 to −0.16)"]


def test_an_absolute_threshold_is_told_in_the_unit_of_the_reader(ratios):
    table = compared(ratios, metrics="share_off", threshold=0.01).to_table()
    assert "lower by 1 % in (95 %)" in table
    row, at = table.iloc[0], compared(ratios, metrics="share_off").share_off.sel(estimate_ratio=0.5)
    assert numbers(row["difference (95 %)"])[0] == pytest.approx(100 * float(at.sel(statistic="mean")), rel=0.05)
    assert "lower in (95 %)" in compared(ratios, metrics="rmse", threshold=0.0).to_table()


def test_what_never_came_is_told_and_what_no_pair_has_is_left_out(ratios):
    some = ratios.copy(deep=True)
    some.learn_time_reached[2, :, :] = 3600.0
    table = compared(some).to_table()
    assert "counted half periods" not in table.index.get_level_values("metric")
    row = table.loc["time to reach the backlash [h]", "100"]
    assert (row["baseline"], row["value"], row["difference (95 %)"]) == ("never", "1", "median −∞")
    assert table.loc["time to reach the backlash [h]", "50"]["never"] == "72"
    assert "never" not in compared(some, metrics="rmse").to_table()


def test_parts_copies_and_pickles_have_the_table_too(ratios):
    found = compared(ratios, metrics="rmse")
    whole = found.to_table()
    part = found.sel(estimate_ratio=1.0).to_table()
    assert part.iloc[0].to_list() == whole.iloc[1].to_list()
    for other in (copy.deepcopy(found), pickle.loads(pickle.dumps(found)), found[["rmse"]]):
        assert other.to_table().equals(whole)
    assert len(found.sel(estimate_ratio=0.0).to_table()) == 0


def test_the_baseline_may_be_a_name_or_a_number_of_numpy():
    ds = result(
        ("controller", "kp", "day"), {"controller": ["pi", "inverse"]}, rmse=np.random.default_rng(2).random((2, 2, 4))
    )
    table = fc.compare(ds, baseline={"controller": np.str_("pi"), "kp": np.int64(1)}, over="day").to_table()
    assert table.index.to_list() == [
        ("RMS error [K]", c, k) for c, k in (("pi", "0"), ("inverse", "0"), ("inverse", "1"))
    ]


def test_a_selection_of_statistics_has_no_table(ratios):
    with pytest.raises(fc.InputError, match=r"call it before .sel\(statistic="):
        compared(ratios).sel(statistic="mean").to_table()
    with pytest.raises(fc.InputError, match="on what compare returned"):
        compared(ratios).drop_attrs().to_table()
