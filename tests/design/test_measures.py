"""What a tuning is judged by: quantiles by order, means, limits."""

import math

import numpy as np
import pytest
from helpers.refusals import assert_refused

from fastcoil.design.measures import Limit, Measure, parse_goal, parse_limits, reported_measures, violation


@pytest.mark.parametrize("n", [1, 20])
@pytest.mark.parametrize("quantile", [0.05, 0.95, 1.0])
def test_a_quantile_is_the_least_value_that_so_many_do_not_exceed(n, quantile):
    values = np.random.default_rng(n).normal(size=(3, n))
    for row, value in zip(values, Measure("rmse", quantile).evaluate(values), strict=True):
        assert value in row
        assert (row <= value).mean() >= quantile - 1e-12
        assert all((row <= smaller).mean() < quantile - 1e-12 for smaller in row if smaller < value)


def test_what_failed_or_never_happened_is_worse_than_all():
    values = np.array([1.0, np.nan, 2.0, 3.0])
    assert Measure("rmse", 0.75).evaluate(values) == 3.0
    assert math.isinf(Measure("rmse", 0.95).evaluate(values))
    assert math.isinf(Measure("rmse", None).evaluate(values))


def test_limits_take_the_quantile_of_the_objective_or_their_own():
    parsed = parse_limits({"motor_travel": 20, "hunts": (0.05, "mean"), "reversals": ["now", 0.5]}, 0.9)
    of_their_own = Limit(Measure("hunts", None), 0.05), Limit(Measure("reversals", 0.5), math.inf, as_now=True)
    assert parsed == [Limit(Measure("motor_travel", 0.9), 20.0), *of_their_own]


def test_a_limit_counts_by_how_much_it_is_broken_of_itself():
    limits = [Limit(Measure("motor_travel", None), 20.0), Limit(Measure("hunts", None), 0.0)]
    values = {"motor_travel_mean": np.array([20.0, 30.0, 10.0]), "hunts_mean": np.array([0.0, 0.0, 0.25])}
    assert violation(limits, values).tolist() == [0.0, 0.5, 0.25]


def test_travel_and_hunting_are_always_reported_and_an_error_beside_the_travel():
    assert [m.name for m in reported_measures(Measure("iae", 0.9), [])] == ["iae_p90", "motor_travel_p90", "hunts_mean"]
    limited = [Limit(Measure("motor_travel", None), 3.0), Limit(Measure("hunts", 0.9), 0.0)]
    names = [m.name for m in reported_measures(Measure("iae", 0.9), limited)]
    assert names == ["iae_p90", "motor_travel_mean", "hunts_p90", "hunts_mean"]
    names = [m.name for m in reported_measures(Measure("motor_travel", 0.9), [])]
    assert names == ["motor_travel_p90", "rmse_p90", "hunts_mean"]


@pytest.mark.parametrize(
    ("objective", "code"), [("rmsee", "choice"), ("learning_status", "choice"), ("size_error", "choice"), (3, "type")]
)
def test_an_objective_must_be_a_metric_of_which_less_is_better(objective, code):
    assert_refused("objective", code, parse_goal, objective, 0.95)


@pytest.mark.parametrize(
    ("limits", "field", "code"),
    [
        ({"travel": 3}, "metric", "choice"),
        ({"motor_travel": "less"}, "motor_travel", "type"),
        ({"motor_travel": (3, 2.0)}, "motor_travel", "value"),
        ({"motor_travel": (3, "median")}, "motor_travel", "choice"),
        ({"motor_travel": (1, 2, 3)}, "motor_travel", "type"),
        ([3], "limits", "type"),
    ],
)
def test_a_wrong_limit_is_refused_in_a_sentence(limits, field, code):
    assert_refused(field, code, parse_limits, limits, 0.95)
