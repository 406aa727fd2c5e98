"""``learning.py``: what it counts and chooses is what plain Python finds, and its tables and figures show it."""

import math
import statistics

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies.learning import learning

pytestmark = pytest.mark.kernel


def median_low(values):
    return statistics.median_low([math.inf if math.isnan(v) else v for v in np.asarray(values).ravel()])


def make_learners(**metrics):
    """Learners of 10 % backlash over days and starts: final size, hours until reached and confirmed."""
    dims = ("day", "backlash_estimate")
    ds = xr.Dataset({name: (dims, np.array(values, dtype=float)) for name, values in metrics.items()})
    return ds.assign_coords(backlash=0.1, day=range(ds.sizes["day"]))


def test_failures_errors_and_censored_times_are_counted_one_by_one():
    ds = make_learners(
        estimate_final=[[0.10, 0.12], [0.08, 0.0799], [0.121, np.nan], [0.11, 0.02]],
        learn_time_reached=3600 * np.array([[1.0, 2.0], [3.0, np.nan], [0.5, np.nan], [1.5, 1.0]]),
        learn_time_confirmed=3600 * np.array([[1.0, 2.0], [np.nan, np.nan], [0.5, np.nan], [np.nan, 1.0]]),
    )
    judgement = {n: float(v) for n, v in learning.judge_learners(ds, ["day", "backlash_estimate"]).items()}
    assert (judgement["low"], judgement["high"], judgement["failed"]) == (2 / 8, 1 / 8, 4 / 8)
    assert judgement["never"] == 4 / 8
    assert judgement["reached"] == median_low(ds.learn_time_reached) / 3600 == 1.5
    assert judgement["confirmed"] == median_low(ds.learn_time_confirmed) / 3600 == 2.0
    assert learning.judge_learners(ds, ["backlash_estimate"]).confirmed.values.tolist() == [1.0, np.inf, 0.5, 1.0]


@pytest.fixture
def quick_study(monkeypatch, run_small):
    """The learning script on small studies and few fresh days."""
    monkeypatch.setattr(learning, "results", run_small)
    monkeypatch.setattr(learning, "FRESH_DAYS", range(301, 303))
    monkeypatch.setattr(learning, "HOURS", 2)
    return run_small("learning_step")


@pytest.mark.full
def test_learning_writes_what_it_found_and_draws_its_figures(quick_study, read_table, monkeypatch, tmp_path):
    monkeypatch.setattr(learning, "RESULTS", tmp_path / "results")
    learning.main()
    _, (head, *choices) = read_table("learning_choice")
    assert [row[:2] for row in choices] == [["paper_like", "0"], ["paper_like", "0.1"], ["g36", "0"], ["g36", "0.1"],
                                         ["all", "all"]]  # fmt: skip
    for row in choices:
        assert (row[head.index("safe?")] == "yes") == (float(row[head.index("2 fresh days")].split(" %")[0]) <= 5.0)
        assert row[head.index("safe?")] in ("yes", "**none is safe**; the best:")
    assert {row[head.index("safe?")] for row in choices if row[1] == "0.1"} == {"**none is safe**; the best:"}
    title, cost = read_table("learning_cost")
    assert title == "Performance of the chosen learning rules on the 2 fresh days: medians"
    assert [row[:2] for row in cost[1:]] == [row[:2] for row in choices]
    assert len(read_table("learning_failures")[1]) == len(choices)
    assert [row[0] for row in read_table("learning_quiet")[1][1:]] == ["paper_like", "g36"]
    figures = tmp_path / "results" / "learning_step" / "figures"
    assert {p.name for p in figures.iterdir()} == {
        "learning_front.png", "learning_front_error.png", "learning_settings.png", "learning_failures.png"
    }  # fmt: skip


def test_a_choice_is_tried_on_fresh_days_against_the_plain_pi_and_a_known_backlash(quick_study):
    loop = {"tuning": "g36", "noise_std": 0.1}
    settings = {"learning_step": 0.028, "learning_interval": 900, "learning_ratio": 1.5, "buffer": 0.01}
    day = fc.paper_day(hours=2, seed=[301, 302])
    metrics = learning.try_choice(quick_study, {"rule": "growing"} | settings, loop, day)
    metrics = metrics.sel(backlash=0.12, backlash_estimate=0.014)
    preset_loop = fc.Loop.preset("g36").assign(backlash=0.12, noise_std=0.1)
    rule = settings | {
        "learning_min_switches": 1, "learning_max_reference": 0.4, "learning_early_trip": 1, "learning_growth": 2,
        "learning_shrink": 0.5, "backlash_estimate": 0.014,
    }  # fmt: skip
    learner, plain = fc.simulate(preset_loop.assign(**rule), day), fc.simulate(preset_loop, day)
    known = fc.simulate(preset_loop.assign(backlash_estimate=0.12, buffer=0.01), day)
    np.testing.assert_array_equal(metrics.estimate_final, learner.estimate_final)
    np.testing.assert_allclose(metrics.rmse, learner.rmse / plain.rmse - 1)
    np.testing.assert_allclose(metrics.rmse_known, learner.rmse / known.rmse - 1)
    np.testing.assert_allclose(metrics.travel, learner.motor_travel / plain.motor_travel)
    np.testing.assert_array_equal(metrics.plain_switches, plain.switch_frequency)
