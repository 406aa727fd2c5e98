"""Intervals of the shares of ``fc.compare`` hold the true share on simulated valves and days.

A case counts where a normal number lies below the quantile of the true share; a valve's part and a day's part of its
variance are those of the case.  The settings of the interval were chosen with seed 1.
"""

import numpy as np
import pytest
from helpers.results import make_result
from scipy import stats

import fastcoil as fc

SHARES = (0.01, 0.03, 0.1, 0.3, 0.5, 0.9, 0.97, 0.99)
CORRELATIONS = ((0.0, 0.0), (0.9, 0.0), (0.0, 0.9), (0.45, 0.45), (0.3, 0.6), (0.0, 0.3))  # of valves, of days
STUDIES = 250


def simulate_cases(rng, valves, days, share, of_valves, of_days):
    """Whether each case counts, (studies, valves, days)."""
    parts = [(of_valves, (STUDIES, valves, 1)), (of_days, (STUDIES, 1, days))]
    parts.append((1.0 - of_valves - of_days, (STUDIES, valves, days)))
    return sum(np.sqrt(part) * rng.normal(size=shape) for part, shape in parts) < stats.norm.ppf(share)


def share_intervals(cases):
    """Share of the cases in each study, lower and upper end: (3, studies)."""
    ds = make_result(("kp", "tuning", "sample", "day"), rmse=np.stack([np.zeros(cases.shape), -1.0 * cases]))
    comparison = fc.compare(ds, baseline={"kp": 0}, over=["sample", "day"], metrics="rmse", threshold=0.5)
    statistics = [f"share_below{edge}" for edge in ("", "_low", "_high")]
    return comparison.rmse.sel(kp=1, statistic=statistics).transpose("statistic", "tuning").values


@pytest.mark.parametrize(("valves", "days"), [(24, 5), (96, 10), (12, 4)])
def test_the_interval_holds_the_true_share(valves, days):
    """250 studies tell a coverage to 1.4 points (standard deviation): 0.89 is 0.93 less three of them."""
    rng, coverage = np.random.default_rng(2), {}
    for share in SHARES:
        for correlations in CORRELATIONS:
            found, low, high = share_intervals(simulate_cases(rng, valves, days, share, *correlations))
            assert np.all((low <= found) & (found <= high))
            coverage[share, correlations] = np.mean((low <= share) & (share <= high))
    assert min(coverage.values()) >= 0.89, coverage
    assert np.mean(list(coverage.values())) >= 0.95


@pytest.mark.parametrize(("valves", "days", "widest"), [(24, 5, 0.30), (96, 10, 0.17), (12, 4, 0.36)])
def test_a_single_rare_case_leaves_a_third_of_all_open_at_most(valves, days, widest):
    cases = np.zeros((1, valves, days), dtype=bool)
    cases[0, 0, 0] = True
    for is_counted in (cases, ~cases):
        share, low, high = share_intervals(is_counted)[:, 0]
        assert low < share < high
        assert high - low < widest


def test_independent_cases_give_a_narrower_interval_than_those_of_alike_days():
    rng = np.random.default_rng(3)
    widths = []
    for of_days in (0.0, 0.3, 0.9):
        _, low, high = share_intervals(simulate_cases(rng, 24, 5, 0.3, 0.0, of_days))
        widths.append(np.median(high - low))
    assert widths[0] < 0.8 * widths[1] < 0.8 * widths[2]
