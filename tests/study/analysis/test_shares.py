"""``fc.compare(threshold=…)``: shares of pairs that differ by as much, with intervals over valves and days."""

import numpy as np
import pytest
from helpers.results import result
from scipy import stats

import fastcoil as fc

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


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"threshold": -0.05}, "threshold = -0.05: give a number of at least 0"),
        ({"threshold": "5 %"}, "threshold = '5 %': give a number of at least 0"),
        ({"threshold": np.nan}, "threshold = nan"),
        ({"threshold": True}, "threshold = True"),
        (
            {"threshold": 0.05, "metrics": ["rmse", "iae"]},
            "threshold counts in the unit of the metrics, and these have K, K h: name metrics of one unit",
        ),
    ],
)
def test_a_threshold_that_says_nothing_is_refused(options, sentence):
    ds = result(("kp", "day"), rmse=np.ones((2, 3)), iae=np.ones((2, 3)))
    with pytest.raises(fc.InputError) as caught:
        fc.compare(ds, baseline={"kp": 0}, over="day", **options)
    (problem,) = caught.value.problems
    assert sentence in problem


def test_metrics_of_several_units_may_share_a_relative_threshold():
    ds = result(("kp", "day"), rmse=np.ones((2, 3)), iae=np.ones((2, 3)))
    found = fc.compare(ds, baseline={"kp": 0}, over="day", relative=True, threshold=0.05)
    assert float(found.iae.sel(kp=1, statistic="share_below")) == 0.0
    assert "units_metadata" not in found.rmse.attrs  # a share is no difference of temperatures
