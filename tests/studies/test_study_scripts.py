"""Scripts of single tables: they hold what plain Python finds."""

import math
import re
import statistics

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies.inverse import conditions, population
from studies.learning import learning
from studies.paper import paper
from studies.robustness import robustness as answers

pytestmark = pytest.mark.kernel


def test_population_writes_what_plain_python_finds(small, written, monkeypatch):
    monkeypatch.setattr(population, "results", small)
    population.main()
    ds = small("valve_population")
    names = [str(name) for name in ds.controller.values]
    rmse = {name: ds.rmse.sel(controller=name).transpose("sample", "day").values.tolist() for name in names}
    title, (head, *table) = written("population")
    assert title == (
        "A population of 16 valves and loops on 2 days, against the plain PI of the same valve (0 of 256 days failed)"
    )
    assert [row[0] for row in table] == names[1:]
    for row in table:
        pairs = [pair for a, b in zip(rmse[row[0]], rmse["pi"], strict=True) for pair in zip(a, b, strict=True)]
        assert row[1].split(" ")[0] == f"{100 * statistics.mean(a / b - 1 for a, b in pairs):+.1f}"
        of_valve = [sum(a) / sum(b) - 1 for a, b in zip(rmse[row[0]], rmse["pi"], strict=True)]
        assert row[2].split(", ")[1] == f"{100 * statistics.median(of_valve):+.0f} %"
        assert row[head.index("lower RMSE on")] == f"{100 * sum(a < b for a, b in pairs) / len(pairs):.0f} %"
    _, (_, *ended) = written("population_learners")
    for name, valves, _, within in ended:
        assert sum(int(n.replace(",", "")) for n in re.findall(r"[\d,]*\d", valves)) == 32
        learned = [float(x) for x in (ds.estimate_final / ds.backlash).sel(controller=name).values.ravel()]
        assert within.split(" (")[0] == f"{100 * sum(0.8 <= x <= 1.2 for x in learned) / 32:.0f} %"
    _, (_, *indices) = written("sensitivity")
    assert len(indices) == 11


def test_the_interval_of_a_share_is_that_of_compare():
    holds = xr.DataArray(np.random.default_rng(4).random((40, 3)) < [0.3, 0.5, 0.45], dims=("sample", "day"))
    ds = xr.Dataset({"rmse": xr.concat([0.0 * holds, 1.0 * holds], "controller"), "status": 0 * holds})
    ds = ds.assign_coords(controller=["pi", "learner"]).broadcast_like(ds.rmse)
    found = population.fc.compare(ds, baseline={"controller": "pi"}, over=["sample", "day"], metrics="rmse").rmse
    mean, low, high = (100 * float(found.sel(controller="learner", statistic=s)) for s in ("mean", "low", "high"))
    assert population.share(holds) == f"{mean:.0f} % ({max(low, 0):.0f} to {min(high, 100):.0f})"


def test_answers_write_what_plain_python_finds(small, written, monkeypatch):
    for script, of in ((answers, answers.main), (paper, paper.one_loop), (learning, learning.printed_rule)):
        monkeypatch.setattr(script, "results", small)
        of()
    ds = small("robustness")
    title, (_, *table) = written("robustness")
    everything, ds = ds, ds.isel(tuning=(ds.error_dead_band == 0.0).values)
    assert title.startswith(f"Robustness: change against the plain PI, {ds.rmse.size:,} days; the best plain PI of ")
    plain = ds.rmse.sel(estimate_ratio=0.0).transpose("tuning", "backlash").values.tolist()
    least = [min(column) for column in zip(*plain, strict=True)]
    best = min(plain, key=lambda row: sum(a / b for a, b in zip(row, least, strict=True)))
    assert title.endswith(f"of {len(plain)} tunings is `{ds.tuning.values[plain.index(best)]}`")
    for row in table:
        own = ds.rmse.sel(estimate_ratio=float(row[0])).transpose("tuning", "backlash").values.tolist()
        changes = [a / b - 1 for one, other in zip(own, plain, strict=True) for a, b in zip(one, other, strict=True)]
        assert row[1] == f"{100 * statistics.median(changes):+.0f} %"
        assert row[3] == f"{sum(c < 0 for c in changes) / len(changes):.1%}"
        below = [a < b for one in own for a, b in zip(one, best, strict=True)]
        assert row[4] == f"{sum(below) / len(below):.1%}"
    _, (head, *table) = written("robustness_baselines")
    of_loop = everything.sel(tuning="paper_like", estimate_ratio=0.0)
    assert [row[0] for row in table] == list(answers.BASELINES)
    for name, *cells in table:
        tuning, ratio = answers.BASELINES[name]
        d = everything.sel(tuning=tuning, estimate_ratio=ratio)
        pairs = list(zip(d.rmse.values, of_loop.rmse.values, strict=True))
        assert cells[0] == f"{100 * statistics.median(a / b - 1 for a, b in pairs):+.0f} %"
        assert cells[3] == f"{100 * (float(d.rmse.sel(backlash=0.07) / of_loop.rmse.sel(backlash=0.07)) - 1):+.0f} %"
        pairs = zip(d.motor_travel.values, of_loop.motor_travel.values, strict=True)
        assert cells[5] == f"× {statistics.median(a / b for a, b in pairs):.1f}"
        assert cells[6] == f"{sum(d.hunts.values > 0)} of 15"
    _, (_, *table) = written("robustness_by_backlash")
    for row in table:
        at = ds.sel(backlash=float(row[0].rstrip("%")) / 100).rmse
        pairs = zip(at.sel(estimate_ratio=0.95).values, at.sel(estimate_ratio=0.0).values, strict=True)
        assert row[2] == f"{100 * statistics.median(a / b - 1 for a, b in pairs):+.0f} %"
    ds = small("paper_like")
    title, (_, *table) = written("paper_like")
    assert title.endswith("median of 2 days")
    of_sixty = ds.sel(backlash=0.07, estimate_ratio=0.6).rmse
    assert ["estimate 60%", f"{statistics.mean(map(float, of_sixty)):.3f}"] in [row[:2] for row in table]
    ds = small("learner")
    _, (_, *table) = written("learner")
    for rule, loop, _, _, confirmed, after, *_ in table:
        times = ds.learn_time_confirmed.sel(rule=rule, loop=loop).values
        n = sum(not math.isnan(t) for t in times)
        assert confirmed == f"{n} of 2"
        assert (after == "—") == (n < 2)


def test_times_that_never_came_count_as_later_than_all_others():
    assert learning.hours(xr.DataArray([3600.0, np.nan, 7200.0])) == "2.00 h"
    assert learning.hours(xr.DataArray([3600.0, np.nan, np.nan])) == "—"


def test_conditions_count_what_plain_python_counts(written, monkeypatch):
    ds = conditions.tunings(n=2)
    counted = [cells for _, *cells in conditions.hunting_rows(ds)]
    for column, plant in enumerate(conditions.PLANTS):
        *classes, alone = [[int(n) for n in re.findall(r"\d+", row[column])] for row in counted]
        assert sum(n for _, n in classes) + alone[0] == ds.sel(plant=plant).overshoot.size == 16
        hunt = zip(ds.hunts.sel(plant=plant).values.ravel(), ds.alone.sel(plant=plant).values.ravel(), strict=True)
        assert sum(k for k, _ in classes) == sum(bool(h and not a) for h, a in hunt)
    above = conditions.overestimates(n=2)
    for row, Ts in zip(conditions.overestimate_rows(above), above.sample_time.values, strict=True):
        rmse = above.rmse_settled.sel(sample_time=Ts)
        exact, larger = (rmse.sel(estimate_ratio=r).values.ravel().tolist() for r in (1.0, 1.5))
        rises = [b > a for a, b in zip(exact, larger, strict=True)]
        assert row[-1] == f"{sum(rises) / 4:.0%}"
    end = conditions.learned_when_quiet(n=2)
    lines = ((p, b) for p in conditions.PLANTS for b in end.buffer.values)
    for row, (plant, buffer) in zip(conditions.quiet_rows(end), lines, strict=True):
        sizes = end.sel(plant=plant, buffer=buffer).values.ravel().tolist()
        found = sum(0.063 - 1e-4 <= x <= 0.077 + 1e-4 for x in sizes) / len(sizes)
        assert row[2:] == [f"{found:.0%}", f"{sum(x > 0.2 for x in sizes) / len(sizes):.0%}"]
    good, warm = conditions.good_valves([1, 2]), conditions.heating([1])
    for name, few in (
        ("tunings", ds),
        ("overestimates", above),
        ("learned_when_quiet", end),
        ("good_valves", good),
        ("heating", warm),
    ):
        monkeypatch.setattr(conditions, name, lambda few=few: few)
    conditions.main()
    mild = [float(x) < 0.2 for x in ds.overshoot.values.ravel()]
    alone, hunts = (ds[name].values.ravel().tolist() for name in ("alone", "hunts"))
    counted = [bool(h) for m, a, h in zip(mild, alone, hunts, strict=True) if m and not a]
    title, _ = written("conditions_hunting")
    assert title.endswith(f"of the {len(counted)} with less than 20 % overshoot {sum(counted)} hunt")
    assert [row[0] for row in written("conditions_overestimates")[1][1:]] == ["1 s", "5 s", "15 s", "30 s", "60 s"]
    assert len(written("conditions_quiet")[1]) == 1 + 2 * 3
    _, (_, *table) = written("conditions_good_valve")
    loop = fc.Loop.preset("lbnl").assign(backlash=0.0, noise_std=0.05)
    days = conditions.of_kind(conditions.STEPPED, [1, 2])
    plain, rule = (fc.simulate(one, days).mean("day") for one in (loop, loop.assign(**conditions.GROWING)))
    (row,) = (row for row in table if row[:2] == ["`lbnl`", "0.05"])
    assert row[2:4] == [f"{float(plain.rmse_settled):.3f}", f"× {float(rule.rmse_settled / plain.rmse_settled):.1f}"]
    assert row[4:6] == [f"{float(plain.motor_travel):.1f}", f"× {float(rule.motor_travel / plain.motor_travel):.1f}"]
    _, (head, *table) = written("conditions_heating")
    loop = fc.Loop.preset("lbnl").assign(kp=conditions.HEATING_KP, backlash=0.07, action="heating")
    alone = fc.simulate(loop.assign(estimate_ratio=0.95, buffer=0.01), conditions.of_kind(conditions.HEATING, [1]))
    (row,) = (row for row in table if row[0] == "7%")
    assert row[head.index("95 %, buffer 1 %")] == f"{float(alone.rmse_settled.mean('day')):.3f}"
