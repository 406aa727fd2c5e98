"""``answers.py``, ``population.py``, ``conditions.py``: their tables hold what plain Python finds."""

from __future__ import annotations

import math
import re
import statistics

import answers
import conditions
import numpy as np
import population
import pytest
import xarray as xr

pytestmark = pytest.mark.kernel


def test_population_writes_what_plain_python_finds(small, written, monkeypatch):
    monkeypatch.setattr(population, "results", small)
    population.main()
    ds = small("valve_population")
    names = [str(name) for name in ds.controller.values]
    rmse = {name: [float(x) for x in ds.rmse.sel(controller=name)] for name in names}
    title, (head, *table) = written("population")
    assert title == "A population of 16 valves and loops (0 of 128 days failed)"
    assert [row[0] for row in table] == names[1:]
    for row in table:
        pairs = list(zip(rmse[row[0]], rmse["pi"], strict=True))
        assert row[1].split(" ")[0] == f"{statistics.mean(a - b for a, b in pairs):+.4f}"
        changes = [a / b - 1 for a, b in pairs]
        assert row[2].split(", ")[1] == f"{100 * statistics.median(changes):+.0f} %"
        assert row[head.index("lower RMSE in")] == f"{100 * sum(c < 0 for c in changes) / len(changes):.0f} %"
    _, (_, *ended) = written("population_learners")
    for name, valves, _, within in ended:
        assert sum(int(n.replace(",", "")) for n in re.findall(r"[\d,]*\d", valves)) == 16
        learned = [float(x) for x in (ds.estimate_final / ds.backlash).sel(controller=name)]
        assert within == f"{100 * sum(0.8 <= x <= 1.2 for x in learned) / 16:.0f} %"
    _, (_, *indices) = written("sensitivity")
    assert len(indices) == 11


def test_answers_write_what_plain_python_finds(small, written, monkeypatch):
    monkeypatch.setattr(answers, "results", small)
    answers.main()
    ds = small("robustness")
    title, (_, *table) = written("robustness")
    assert title.endswith("11,160 days")
    for row in table:
        pairs = zip(ds.rmse.sel(estimate_ratio=float(row[0])).values.ravel(),
                    ds.rmse.sel(estimate_ratio=0.0).values.ravel(), strict=True)  # fmt: skip
        changes = [a / b - 1 for a, b in pairs]
        assert row[1] == f"{100 * statistics.median(changes):+.0f} %"
        assert row[3] == f"{sum(c < 0 for c in changes) / len(changes):.1%}"
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
    assert answers.hours(xr.DataArray([3600.0, np.nan, 7200.0])) == "2.00 h"
    assert answers.hours(xr.DataArray([3600.0, np.nan, np.nan])) == "—"


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
    for name, few in (("tunings", ds), ("overestimates", above), ("learned_when_quiet", end)):
        monkeypatch.setattr(conditions, name, lambda few=few: few)
    conditions.main()
    mild = [float(x) < 0.2 for x in ds.overshoot.values.ravel()]
    alone, hunts = (ds[name].values.ravel().tolist() for name in ("alone", "hunts"))
    counted = [bool(h) for m, a, h in zip(mild, alone, hunts, strict=True) if m and not a]
    title, _ = written("conditions_hunting")
    assert title.endswith(f"of the {len(counted)} with less than 20 % overshoot {sum(counted)} hunt")
    assert [row[0] for row in written("conditions_overestimates")[1][1:]] == ["1 s", "5 s", "15 s", "30 s", "60 s"]
    assert len(written("conditions_quiet")[1]) == 1 + 2 * 3
