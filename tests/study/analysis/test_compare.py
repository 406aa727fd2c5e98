"""``fc.compare``: paired differences and shares, their intervals, censored times, failed scenarios, and the table."""

import re

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import assert_refused, refuses
from helpers.results import make_result
from scipy import stats

import fastcoil as fc
from fastcoil.base import arrays
from fastcoil.model.metric_table import STATUS_NON_FINITE
from fastcoil.study.analysis import paired
from fastcoil.study.analysis.paired import STATISTICS
from fastcoil.study.analysis.selected import mask_dataset


def against_0(ds, **options):
    """Differences of the RMS error, or of the metric asked for, between the labels 1 and 0 of kp."""
    metric = options.get("metrics", "rmse")
    return fc.compare(ds, **{"baseline": {"kp": 0}, "over": "day", **options})[metric].sel(kp=1)


def statistics_at(metric, *statistics):
    """Some statistics as a list of numbers."""
    return metric.sel(statistic=list(statistics)).values.tolist()


def test_the_difference_is_taken_within_pairs_not_between_means():
    rng = np.random.default_rng(1)
    weather = rng.normal(0.0, 10.0, 40)
    ds = make_result(("kp", "day"), rmse=[weather, weather + 0.3 + 0.01 * rng.normal(size=40)])
    mean, low, high, lower, n_pairs = statistics_at(against_0(ds), "mean", "low", "high", "share_lower", "n_pairs")
    assert mean == pytest.approx(0.3, abs=0.01)
    assert 0.29 < low < high < 0.31
    assert (lower, n_pairs) == (0.0, 40)


@pytest.mark.parametrize("n", [2, 4])
def test_the_interval_covers_the_true_mean_as_often_as_it_says_also_with_few_days(n):
    rng = np.random.default_rng(5)
    of_day = rng.normal(0.7, 1.0, (2000, n, 1)) + rng.normal(0.0, 0.5, (2000, n, 3))
    ds = make_result(("kp", "tuning", "day", "replicate"), rmse=[0.0 * of_day, of_day])
    metric = against_0(ds, over=["replicate", "day"])
    covered = (metric.sel(statistic="low") <= 0.7) & (metric.sel(statistic="high") >= 0.7)
    assert 0.93 < float(covered.mean()) < 0.97


def test_the_interval_of_days_is_that_of_scipy_at_its_level():
    values = np.array([0.3, 1.1, 0.2, 0.9])
    metric = against_0(make_result(("kp", "day"), rmse=[np.zeros(4), values]), level=0.8)
    assert statistics_at(metric, "low", "high") == pytest.approx(
        stats.t.interval(0.8, 3, values.mean(), stats.sem(values))
    )


def test_the_scatter_of_several_dims_adds_up():
    of_sample, of_day = np.array([0.0, 1.0, 5.0, 2.0]), np.array([0.3, 2.0, 1.0])
    values = of_sample[:, None] + of_day
    ds = make_result(("kp", "sample", "day"), rmse=[0.0 * values, values])
    half = stats.t.ppf(0.975, 2) * np.hypot(stats.sem(of_sample), stats.sem(of_day))
    mean, high = statistics_at(against_0(ds, over=["sample", "day"]), "mean", "high")
    assert high - mean == pytest.approx(half)


def test_the_noise_of_one_day_says_nothing_of_other_days():
    ds = make_result(("kp", "day", "replicate"), rmse=[[[1.0] * 5], [np.arange(5.0)]])
    assert np.isnan(statistics_at(against_0(ds, over=["day", "replicate"]), "low", "high")).all()
    assert np.isfinite(statistics_at(against_0(ds, over="replicate"), "low", "high")).all()


def test_quantiles_are_those_of_the_sorted_differences():
    ds = make_result(("kp", "day"), rmse=[np.zeros(20), np.arange(1.0, 21.0)])
    assert statistics_at(against_0(ds), "q05", "q25", "median", "q75", "q95") == [1, 5, 10, 15, 19]


def test_a_time_that_never_came_is_later_than_any_that_did():
    """The differences are -50, +inf, -inf, a tie of two that never came, and -10."""
    never = np.nan
    baseline, value = [100.0, 100.0, never, never, 100.0], [50.0, never, 80.0, never, 90.0]
    metric = against_0(make_result(("kp", "day"), learn_time_reached=[baseline, value]), metrics="learn_time_reached")
    assert statistics_at(metric, "n_pairs", "n_censored", "share_lower") == pytest.approx([5, 2, 3.5 / 5])
    assert statistics_at(metric, "q05", "median", "q95", "value") == [-np.inf, -10.0, np.inf, 90.0]
    assert np.isnan(statistics_at(metric, "mean", "low", "high")).all()


def test_a_failed_scenario_takes_its_pair_out_and_no_other():
    ds = make_result(("kp", "day"), rmse=[[1.0, 1.0, 1.0], [2.0, np.nan, 4.0]])
    ds["status"][1, 1] = STATUS_NON_FINITE
    expected = [2, 2.0, *stats.t.interval(0.95, 1, 2.0, stats.sem([1.0, 3.0]))]
    assert statistics_at(against_0(ds), "n_pairs", "mean", "low", "high") == pytest.approx(expected)


def test_nothing_is_claimed_of_a_single_pair_or_of_none():
    ds = make_result(("kp", "day"), rmse=[[1.0], [2.0]])
    assert statistics_at(against_0(ds), "mean", "low", "high") == pytest.approx([1.0, np.nan, np.nan], nan_ok=True)
    ds["status"][:] = STATUS_NON_FINITE
    assert statistics_at(against_0(ds), "n_pairs", "median") == pytest.approx([0, np.nan], nan_ok=True)


@pytest.mark.kernel
def test_every_metric_of_a_simulation_can_be_compared(swept_result):
    comparison = fc.compare(swept_result, baseline={"backlash": 0.0}, over=["day", "replicate"])
    assert set(comparison.rmse.dims) == {"n_volumes", "backlash", "tuning", "statistic"}
    assert comparison.statistic.values.tolist() == list(STATISTICS)
    by_hand = (swept_result.rmse - swept_result.rmse.sel(backlash=0.0)).mean(["day", "replicate"])
    xr.testing.assert_allclose(
        comparison.rmse.sel(statistic="mean", drop=True).transpose(*by_hand.dims), by_hand.drop_attrs(), atol=1e-12
    )


@pytest.mark.parametrize(
    ("options", "field", "code"),
    [
        ({"baseline": {"kpp": 0}, "over": "day"}, "baseline", "name"),
        ({"baseline": {"kp": 7}, "over": "day"}, "baseline", "choice"),
        ({"baseline": {"kp": 0}, "over": "replicate"}, "over", "name"),
        ({"baseline": {"kp": 0}, "over": "kp"}, "over", "conflict"),
        ({"baseline": {"kp": 0}, "over": "day", "metrics": ["rmsee"]}, "metrics", "name"),
        ({"baseline": {"kp": 0}, "over": []}, "over", "missing"),
        ({"baseline": {"kp": [0]}, "over": "day"}, "baseline", "choice"),
        ({"baseline": {"kp": True}, "over": "day"}, "baseline", "choice"),
        ({"baseline": "kp", "over": "day"}, "baseline", "type"),
        ({"baseline": {"kp": 0}, "over": ["day", "day"]}, "over", "duplicate"),
        ({"baseline": {"kp": 0}, "over": "day", "metrics": "learning_status"}, "metrics", "unsupported"),
        ({"baseline": {"kp": 0}, "over": "day", "threshold": -0.05}, "threshold", "value"),
    ],
)
def test_a_mistake_gets_a_sentence(options, field, code):
    ds = make_result(("kp", "day"), rmse=np.zeros((2, 3)), learning_status=np.zeros((2, 3)))
    assert_refused(field, code, fc.compare, ds, **options)
    assert_refused("day", "shape", fc.compare, ds.isel(day=[]), baseline={"kp": 0}, over="day")


@pytest.mark.parametrize(("name", "unit"), [("rmse", "mK"), ("kp", "percent")])
def test_numbers_in_other_units_are_refused_and_labels_in_another_order_are_the_same(name, unit):
    ds = make_result(("kp", "day"), rmse=np.random.default_rng(3).random((2, 3)))
    comparison = fc.compare(ds.isel(kp=[1, 0], day=[2, 0, 1]), baseline={"kp": 0}, over="day")
    xr.testing.assert_allclose(comparison.rmse.sel(kp=[0, 1]), fc.compare(ds, baseline={"kp": 0}, over="day").rmse)
    ds[name].attrs["units"] = unit
    assert_refused(f"ds.{name}", "unit", fc.compare, ds, baseline={"kp": 0}, over="day")
    assert_refused(f"ds.{name}", "unit", fc.sobol_indices, ds)


def test_a_metric_of_the_study_s_own_is_compared_like_ours():
    ds = make_result(("kp", "day"), rmse=[[1.0, 2.0], [1.5, 2.5]])
    with_peak = ds.assign(peak=(10 * ds.rmse).assign_attrs(units="degC", long_name="highest temperature"))
    comparison = fc.compare(with_peak, baseline={"kp": 0}, over="day")
    assert comparison.peak.sel(kp=1, statistic="mean") == pytest.approx(5.0)
    assert comparison.to_table().loc["highest temperature [°C]", "1"]["difference (95 %)"].startswith("+5")
    with refuses(("metrics", "unsupported")):
        fc.compare(
            with_peak.assign(T_sup=ds.rmse.expand_dims(elapsed_time=2)), baseline={"kp": 0}, over="day", metrics="T_sup"
        )


def test_relative_differences_are_those_of_shares_of_the_partner():
    values = np.random.default_rng(8).uniform(0.5, 2.0, (3, 6))
    ds = make_result(("kp", "day"), rmse=values)
    comparison = fc.compare(ds, baseline={"kp": 0}, over="day", relative=True)
    by_hand = fc.compare(make_result(("kp", "day"), rmse=values / values[0]), baseline={"kp": 0}, over="day")
    kept = [s for s in STATISTICS if s not in ("baseline", "value")]
    np.testing.assert_allclose(
        comparison.rmse.sel(statistic=kept), by_hand.rmse.sel(statistic=kept), rtol=1e-12, atol=1e-14
    )
    assert statistics_at(comparison.rmse.sel(kp=1), "baseline", "value") == statistics_at(
        against_0(ds), "baseline", "value"
    )
    assert comparison.attrs["relative"] == 1
    assert comparison.rmse.attrs["units"] == "1"
    assert "units_metadata" not in comparison.rmse.attrs  # a share is no difference of temperatures


NEVER = np.nan


@pytest.mark.parametrize(
    ("metric", "baseline", "values", "expected"),
    [
        ("reversals", [0.0, 0.0, 4.0], [0.0, 0.0, 2.0], [-0.5, 0.0, 0.0, -0.5 / 3]),
        ("reversals", [0.0, 0.0, 4.0], [0.0, 3.0, 2.0], [-0.5, 0.0, np.inf, np.nan]),
        ("size_error", [-0.02, -0.02], [-0.01, -0.03], [-0.5, -0.5, 0.5, 0.0]),
        ("learn_time_reached", [NEVER, NEVER, 100.0], [50.0, NEVER, NEVER], [-1.0, 0.0, np.inf, np.nan]),
    ],
    ids=["equal to 0", "above 0", "of a negative baseline", "a time that never came"],
)
def test_relative_to_baselines_that_cannot_divide(metric, baseline, values, expected):
    statistics = against_0(make_result(("kp", "day"), **{metric: [baseline, values]}), metrics=metric, relative=True)
    assert statistics_at(statistics, "q05", "median", "q95", "mean") == pytest.approx(expected, nan_ok=True)


# Shares of pairs that differ by a threshold, with intervals over valves and days


def share_of_pairs(differences, over, threshold, side="below"):
    """Share of differences from a baseline of zeros, lower and upper end."""
    values = np.asarray(differences)
    ds = make_result(("kp", *over), rmse=np.stack([np.zeros(values.shape), values]))
    metric = against_0(ds, over=list(over), threshold=threshold)
    return statistics_at(metric, *(f"share_{side}{edge}" for edge in ("", "_low", "_high")))


def simulate_studies(n, valves, days, spread_of_valves, spread_of_days, seed):
    """Differences of ``n`` studies whose valves and days have effects of their own; their scatter by itself is 1."""
    rng = np.random.default_rng(seed)
    effects = spread_of_valves * rng.normal(size=(n, valves, 1)) + spread_of_days * rng.normal(size=(n, 1, days))
    return effects + rng.normal(size=(n, valves, days))


@pytest.mark.parametrize(
    ("differences", "threshold", "below", "above"),
    [([-0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.3, 0.4], 0.1, 2 / 8, 3 / 8), ([-1e-9, 0.0, 0.0, 2.0], 0.0, 0.25, 0.25)],
)
def test_the_shares_count_the_pairs_that_differ_by_at_least_as_much(differences, threshold, below, above):
    """At 0 an equal value is neither lower nor higher."""
    assert [share_of_pairs(differences, ("day",), threshold, side)[0] for side in ("below", "above")] == [below, above]


@pytest.mark.parametrize(
    ("metric", "values", "options", "share"),
    [
        ("rmse", [[2.0, 2.0, 2.0, 2.0], [1.8, 1.91, 2.1, 2.0]], {"relative": True, "threshold": 0.05}, 1 / 4),
        ("learn_time_reached", [[100.0, NEVER, NEVER], [NEVER, 50.0, NEVER]], {"threshold": 1e6}, 1 / 3),
    ],
)
def test_a_threshold_may_be_a_share_and_what_never_came_is_higher_by_any(metric, values, options, share):
    statistics = against_0(make_result(("kp", "day"), **{metric: values}), metrics=metric, **options)
    assert statistics_at(statistics, "share_below", "share_above") == pytest.approx([share, share])


def wilson(k, n):
    return [k / n, *stats.binomtest(k, n).proportion_ci(method="wilson")]


def test_of_independent_pairs_the_interval_is_wilsons():
    holds = np.random.default_rng(3).random(400) < 0.03
    share = share_of_pairs(np.where(holds, -1.0, 0.0), ("sample",), 0.5)
    assert share == pytest.approx(wilson(int(holds.sum()), 400), abs=2e-3)


@pytest.mark.parametrize(
    ("valves", "days", "of_valves", "of_days", "least", "most"),
    [
        (128, 10, 1.0, 1.0, 0.92, 1.0),
        (20, 20, 0.0, 0.0, 0.92, 1.0),
        (40, 3, 0.5, 0.2, 0.92, 1.0),
        (40, 2, 0.2, 2.0, 0.92, 1.0),
    ],
)
def test_the_interval_holds_the_true_share_as_often_as_it_says(valves, days, of_valves, of_days, least, most):
    values = simulate_studies(300, valves, days, of_valves, of_days, seed=6)
    true = stats.norm.cdf(-0.5 / np.sqrt(1.0 + of_valves**2 + of_days**2))
    ds = make_result(("kp", "tuning", "sample", "day"), rmse=np.stack([np.zeros(values.shape), values]))
    statistics = against_0(ds, over=["sample", "day"], threshold=0.5)
    low, high = (statistics.sel(statistic=f"share_below_{edge}") for edge in ("low", "high"))
    assert least < float(((low <= true) & (true <= high)).mean()) <= most


def test_noise_of_the_same_day_does_not_count_as_independent():
    of_day = np.repeat(np.random.default_rng(8).normal(size=(12, 1)), 50, axis=1)
    alone = share_of_pairs(of_day[:, 0], ("day",), 0.3)
    assert share_of_pairs(of_day, ("day", "replicate"), 0.3) == pytest.approx(alone)
    assert share_of_pairs(np.full((12, 50), -1.0), ("day", "replicate"), 0.3) == pytest.approx(wilson(12, 12))


# The table says to people what the Dataset says


def numbers(text):
    return [float(n.replace("−", "-").replace(",", "")) for n in re.findall(r"[+−]?[\d.,]+", text)]


@pytest.fixture(scope="module")
def ratios():
    rng = np.random.default_rng(1)
    rmse = np.array([1.0, 0.8, 0.79])[:, None, None] * rng.uniform(0.5, 1.5, (1, 12, 6)) + 0.02 * rng.random((3, 12, 6))
    return make_result(
        ("estimate_ratio", "sample", "day"), {"estimate_ratio": [0.0, 0.5, 1.0]}, rmse=rmse, share_off=0.1 * rmse,
        learn_time_reached=np.full(rmse.shape, np.nan), half_periods=np.full(rmse.shape, np.nan),
    )  # fmt: skip


def compare_ratios(ratios, **options):
    return fc.compare(ratios, baseline={"estimate_ratio": 0.0}, over=["sample", "day"], **options)


def test_every_label_but_that_of_the_baseline_has_a_row_with_its_unit(ratios):
    table = compare_ratios(ratios, metrics=["rmse", "share_off"]).to_table()
    assert table.index.names == ["metric", "estimate / backlash [%]"]
    assert table.index.to_list() == [
        (metric, label) for metric in ("RMS error [K]", "share of time with |e| > 0.5 K [%]") for label in ("50", "100")
    ]
    assert list(table) == ["baseline", "value", "difference (95 %)", "lower in", "pairs"]
    comparison = compare_ratios(ratios, metrics="share_off", threshold=0.01)
    assert "lower by 1 % in (95 %)" in comparison.to_table()
    mean = 100 * float(comparison.share_off.sel(estimate_ratio=0.5, statistic="mean"))
    assert numbers(comparison.to_table().iloc[0]["difference (95 %)"])[0] == pytest.approx(mean, rel=0.05)


def test_the_numbers_are_those_of_the_dataset_to_the_digits_shown(ratios):
    comparison = compare_ratios(ratios, metrics="rmse", relative=True, threshold=0.05, level=0.9)
    row, of = comparison.to_table().loc["RMS error [K]", "100"], comparison.rmse.sel(estimate_ratio=1.0)
    expected = 100 * np.array(statistics_at(of, "mean", "low", "high"))
    assert numbers(row["difference (90 %)"]) == pytest.approx(expected, abs=0.5)
    assert re.fullmatch(r"−[\d.]+ % \(−[\d.]+ to −[\d.]+\)", row["difference (90 %)"])
    below = statistics_at(of, "share_below", "share_below_low", "share_below_high")
    assert numbers(row["lower by 5 % in (90 %)"]) == [round(100 * share) for share in below]
    assert numbers(row["baseline"]) == pytest.approx(statistics_at(of, "baseline"), rel=5e-3)
    assert row["pairs"] == "72"


# Many values


@pytest.mark.parametrize("n", [33, 64])  # an odd number leaves half a random number over
@pytest.mark.parametrize("missing", [False, True])
def test_resamples_are_the_same_drawn_one_by_one(n, missing, monkeypatch):
    values = xr.DataArray(np.random.default_rng(3).normal(size=(n, 2)), dims=("sample", "kp"))
    values = values.where(values > -1.0) if missing else values
    expected = paired.summarise_median(values)
    monkeypatch.setattr(paired, "_MANY_VALUES", 0)
    assert paired.summarise_median(values) == expected
    assert expected.low < expected.median < expected.high


@pytest.mark.parametrize("large", [0, 2**20])
def test_masked_results_are_those_of_xarray_with_their_labels_and_attributes(large, monkeypatch):
    monkeypatch.setattr(arrays, "MEMMAP_MIN_BYTES", large)
    rng = np.random.default_rng(4)
    ds = make_result(("kp", "day"), rmse=rng.normal(size=(3, 5)), hunts=rng.integers(0, 2, (3, 5)))
    ds = ds.assign(own=ds["rmse"].T.assign_attrs(units="K")).assign_attrs(title="t")
    for mask in (ds["rmse"] > 0.0, ds["kp"] > 0):
        masked, expected = (each.transpose("kp", "day") for each in (mask_dataset(ds, mask), ds.where(mask)))
        xr.testing.assert_identical(masked, expected)


@pytest.mark.parametrize("dim", ["day", "replicate"])
def test_labels_that_stand_twice_are_refused_and_not_counted_as_independent(dim):
    ds = make_result(("kp", "day", "replicate"), rmse=np.arange(12.0).reshape(2, 3, 2))
    twice = ds.assign_coords({dim: np.arange(ds.sizes[dim])}).isel({dim: [0, 1, 1]})
    assert_refused(dim, "duplicate", against_0, twice, over=["day", "replicate"])
    assert_refused(dim, "shape", against_0, ds.isel({dim: []}), over=["day", "replicate"])
