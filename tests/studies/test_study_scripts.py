"""Scripts of single tables: they hold what plain Python finds."""

import math
import statistics

import pytest

import fastcoil as fc
from studies.inverse import conditions, population
from studies.learning import learning
from studies.paper import paper
from studies.robustness import robustness as answers
from studies.valve_test import optimised

pytestmark = pytest.mark.kernel


def test_population_writes_what_plain_python_finds(run_small, read_table, monkeypatch):
    monkeypatch.setattr(population, "results", run_small)
    population.main()
    ds = run_small("valve_population")
    names = [str(name) for name in ds.controller.values]
    rmse = {name: ds.rmse.sel(controller=name).transpose("sample", "day").values.tolist() for name in names}
    title, (head, *table) = read_table("population")
    assert title == (
        "A population of 16 valves and loops on 2 days, against the plain PI of the same valve (0 of 256 days failed)"
    )
    assert [row[0] for row in table] == names[1:]
    for row in table:
        pairs = [pair for a, b in zip(rmse[row[0]], rmse["pi"], strict=True) for pair in zip(a, b, strict=True)]
        assert row[1].split(" ")[0] == f"{100 * statistics.mean(a / b - 1 for a, b in pairs):+.1f}"
        assert row[head.index("lower RMSE on")] == f"{100 * sum(a < b for a, b in pairs) / len(pairs):.0f} %"
    assert len(read_table("population_learners")[1]) > 1
    assert len(read_table("sensitivity")[1]) == 12


def test_answers_write_what_plain_python_finds(run_small, read_table, monkeypatch):
    for study, run in ((answers, answers.main), (paper, paper.write_one_loop), (learning, learning.write_printed_rule)):
        monkeypatch.setattr(study, "results", run_small)
        run()
    ds = run_small("robustness")
    title, (_, *table) = read_table("robustness")
    assert title.startswith("Robustness: change against the plain PI, ")
    assert len(read_table("robustness_by_backlash")[1]) > 3
    ds = ds.isel(tuning=(ds.error_dead_band == 0.0).values)
    plain = ds.rmse.sel(estimate_ratio=0.0).values.ravel().tolist()
    for row in table:
        errors = ds.rmse.sel(estimate_ratio=float(row[0])).values.ravel().tolist()
        changes = [a / b - 1 for a, b in zip(errors, plain, strict=True)]
        assert row[1] == f"{100 * statistics.median(changes):+.0f} %"
        assert row[3] == f"{sum(c < 0 for c in changes) / len(changes):.1%}"
    assert [row[0] for row in read_table("robustness_baselines")[1][1:]] == list(answers.BASELINES)
    title, (_, *table) = read_table("paper_like")
    assert title.endswith("median of 2 days")
    of_sixty = run_small("paper_like").sel(backlash=0.07, estimate_ratio=0.6).rmse
    assert ["estimate 60%", f"{statistics.mean(map(float, of_sixty)):.3f}"] in [row[:2] for row in table]
    ds = run_small("learner")
    for rule, loop, _, _, confirmed, after, *_ in read_table("learner")[1][1:]:
        n = sum(not math.isnan(t) for t in ds.learn_time_confirmed.sel(rule=rule, loop=loop).values)
        assert confirmed == f"{n} of 2"
        assert (after == "—") == (n < 2)


def test_conditions_write_what_a_simulation_of_its_own_gives(read_table, monkeypatch):
    small_results = {
        "tunings": conditions.tunings(n=2),
        "overestimates": conditions.overestimates(n=2),
        "learned_when_quiet": conditions.learned_when_quiet(n=2),
        "good_valves": conditions.good_valves([1, 2]),
        "heating": conditions.heating([1]),
    }
    for name, ds in small_results.items():
        monkeypatch.setattr(conditions, name, lambda ds=ds: ds)
    conditions.main()
    assert len(read_table("conditions_hunting")[1]) > 2
    assert [row[0] for row in read_table("conditions_overestimates")[1][1:]] == ["1 s", "5 s", "15 s", "30 s", "60 s"]
    assert len(read_table("conditions_quiet")[1]) == 1 + 2 * 3
    loop = fc.Loop.preset("lbnl").assign(backlash=0.0, noise_std=0.05)
    days = conditions.make_days(conditions.STEPPED, [1, 2])
    plain, rule = (fc.simulate(variant, days).mean("day") for variant in (loop, loop.assign(**conditions.GROWING_RULE)))
    (row,) = (row for row in read_table("conditions_good_valve")[1] if row[:2] == ["`lbnl`", "0.05"])
    assert row[2:4] == [f"{float(plain.rmse_settled):.3f}", f"× {float(rule.rmse_settled / plain.rmse_settled):.1f}"]
    loop = fc.Loop.preset("lbnl").assign(kp=conditions.HEATING_KP, backlash=0.07, action="heating")
    alone = fc.simulate(loop.assign(estimate_ratio=0.95, buffer=0.01), conditions.make_days(conditions.HEATING, [1]))
    head, *table = read_table("conditions_heating")[1]
    (row,) = (row for row in table if row[0] == "7%")
    assert row[head.index("95 %, buffer 1 %")] == f"{float(alone.rmse_settled.mean('day')):.3f}"


def test_of_the_relays_that_keep_within_the_limit_those_that_tell_most_are_kept(monkeypatch):
    """Made-up bounds: one relay tells most and goes too far, one is aborted nearly always."""
    judged_tests = []

    def judge_relay(test):
        judged_tests.append(test)
        k = len(judged_tests)
        return optimised.RelayScore(test, math.inf if k == 2 else 0.01 * k, 1.6 if k == 1 else 1.4)

    monkeypatch.setattr(optimised, "judge_relay", judge_relay)
    assert optimised.search_relays() == judged_tests[2:5]
    assert len(judged_tests) == optimised.SEARCH_RELAYS
    for name, (lowest, highest) in (("rate", optimised.RATES), ("threshold", optimised.THRESHOLDS)):
        drawn_values = [getattr(test, name) for test in judged_tests]
        assert lowest <= min(drawn_values) < 2 * lowest < highest / 2 < max(drawn_values) <= highest
