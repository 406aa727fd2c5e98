"""``learners.py`` and its parts: conditions that differ, estimators that act, and tables of what plain Python finds."""

import math
import re
import statistics

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies import days as kinds
from studies.learning import learners, learners_runs
from studies.learning.learners_runs import Condition, Run

NAMES = list(learners_runs.controllers())
X = [0.0, 0.02, 0.10]


def test_every_controller_has_a_name_and_the_figure_shows_those_that_the_study_has():
    assert NAMES[:2] == [learners_runs.PI, learners_runs.KNOWN]
    assert set(NAMES) <= set(learners.LABELS)
    assert set(learners.MARKS) <= set(learners.LABELS)


def values_of(loop):
    return {name: np.asarray(loop[name]).tolist() for name in fc.parameters() if loop[name] is not None}


def test_each_condition_changes_what_it_says(monkeypatch):
    monkeypatch.setattr(learners_runs, "kinds", lambda: (kinds.STEPPED, kinds.WEATHER, kinds.HEATING))
    found = {condition.name: condition for condition in learners_runs.conditions(6)}
    base = {of: values_of(found[f"{of}: set-point steps"].loop) for of in ("four loops", "valves")}
    changed = {
        name: {n for n, v in values_of(condition.loop).items() if base[of].get(n) != v}
        for name, condition in found.items()
        for of in base
        if of in name and "remedies" not in name
    }
    assert changed["four loops: larger coil"] == {"C_w", "C_c"}
    assert changed["four loops: gentler valve"] == {"valve_b"}
    assert changed["four loops: authority 0.05"] == {"rangeability", "authority", "m_full"}
    assert set(values_of(found["four loops: backlash 2 %"].loop)["backlash"]) == {0.02}
    assert changed["no backlash, valves: set-point steps"] == {"backlash"}
    assert changed["valves: heating"] == {"kp", "action"}
    assert changed["valves: authority 0.02 to 0.1"] == {"authority"}
    assert changed["valves: backlash 0.5 to 2 %"] == {"backlash"}
    morning = next(condition for name, condition in found.items() if "first four hours" in name).days().series["T_set"]
    steps = found["valves: set-point steps"].days().series["T_set"]
    assert (morning[:, : 4 * 3600] == steps[:, : 4 * 3600]).all()
    assert set(morning[:, 4 * 3600 :].ravel()) == {kinds.T_SET}
    outdoor = {name: condition.outdoor for name, condition in found.items() if condition.kind == kinds.WEATHER}
    assert [name for name, share in outdoor.items() if share == 1.0] == ["four loops: weather, 100 % outdoor air"]
    assert all(condition.loop.coordinates()["sample"].size == 6 for condition in found.values())
    monkeypatch.setattr(learners_runs, "kinds", lambda: (kinds.STEPPED, kinds.HEATING))
    assert not any(condition.kind == kinds.WEATHER for condition in learners_runs._of_loops())


def test_days_are_as_long_as_asked_for_and_weather_has_the_asked_share_of_outdoor_air(weather):
    mixed, outdoor = (kinds.of_kind(kinds.WEATHER, [1], weather, hours=3, outdoor=share) for share in (0.5, 1.0))
    assert mixed.n_steps == outdoor.n_steps == 3 * 3600
    # the other half is return air of 24 °C
    np.testing.assert_allclose(mixed.series["T_a_in"], 0.5 * (24.0 + outdoor.series["T_a_in"]), atol=0.05)
    assert kinds.of_kind(kinds.DESIGN, [1]).n_steps == kinds.HOURS * 3600


@pytest.mark.kernel
def test_every_controller_acts_on_the_same_days_and_the_same_noise(monkeypatch):
    monkeypatch.setattr(learners_runs, "simc_gains", lambda loop, kind: xr.Dataset({"plant_gain": 12.0}))
    loop = learners_runs.four_loops([0.07])
    loop = learners_runs.picked(loop, sample=[1])
    ds = learners_runs.tried(Condition("one", loop, kinds.STEPPED, [3, 4], hours=4))
    assert int(ds.status.max()) == 0
    rmse = {name: ds.rmse.sel(controller=name).values.ravel().tolist() for name in NAMES}
    idle = [name for name in NAMES[1:] if rmse[name] == rmse["pi"]]
    assert idle in ([], ["hagglund"]), "it may find nothing in four hours"
    alone = fc.simulate(
        loop.assign(learning_step=0.007, learning_interval=1800, learning_ratio=2.0),
        kinds.of_kind(kinds.STEPPED, [3, 4], hours=4),
    )
    given = loop.assign(**learners_runs.controllers()["identify"], plant_gain=12.0, identify_stroke_time=0.0)
    known = fc.simulate(given, kinds.of_kind(kinds.STEPPED, [3, 4], hours=4)).estimate_final
    assert ds.estimate_final.sel(controller="identify_stroke").values.ravel().tolist() == known.values.ravel().tolist()
    assert known.values.max() > 0.0
    assert rmse["paper"] == alone.rmse.values.ravel().tolist()


@pytest.fixture
def runs():
    """Results that nobody simulated: worn valves on two kinds of days, and good ones."""
    draw = np.random.default_rng(1)
    names = ["four loops: set-point steps", "valves: set-point steps", "valves: heating",
             learners_runs.MORNING, "no backlash, valves: heating"]  # fmt: skip
    days = {name: kinds.HEATING if "heating" in name else kinds.STEPPED for name in names}
    found = []
    for name in names:
        x = [0.0] * 3 if "no backlash" in name else X
        shape, dims = (len(NAMES), 3, 4), ("controller", "sample", "day")
        metrics = {m: (dims, draw.uniform(0.9, 1.1, shape)) for m in ("rmse", "rmse_settled", "motor_travel")}
        estimate = draw.uniform(0.0, 0.15, shape)
        estimate[2, 0, 0] = np.nan
        metrics["estimate_final"] = (dims, estimate)
        metrics["time_identified"] = (
            dims,
            np.where(draw.uniform(size=shape) < 0.3, np.nan, draw.uniform(0, 9e4, shape)),
        )
        metrics["status"] = (dims, np.zeros(shape))
        ds = xr.Dataset(metrics, coords={"controller": NAMES, "day": [5, 6, 7, 8]})
        condition = Condition(name, learners_runs.four_loops([0.07]), days[name], [5, 6, 7, 8])
        found.append(Run(condition, ds, xr.DataArray(x, dims="sample")))
    return found


def wrong(run, name, least):
    of = run.ds.estimate_final.sel(controller=name).values.tolist()
    found = []
    for x, of_valve in zip(run.backlash.values.tolist(), of, strict=True):
        found += [math.isnan(e) or abs(e - x) > max(0.2 * x, least) + 1e-9 for e in of_valve]
    return found


def rises(run, name, metric="rmse"):
    own, base = (run.ds[metric].sel(controller=n).values.tolist() for n in (name, "pi"))
    return [sum(a) / sum(b) - 1.0 for a, b in zip(own, base, strict=True)]


def percent(cell):
    return int(cell.split(" %")[0])


def rounded(values):
    return round(100 * statistics.mean(map(float, values)))


def test_tables_hold_what_plain_python_finds(runs, written):
    learners.write(runs)
    by_name = {run.condition.name: run for run in runs}
    labels = {text: name for name, text in learners.LABELS.items()}
    title, _ = written("learners_failures")
    assert "3 loops × 4 days and 3 valves × 4 days" in title
    assert f"(0 of {5 * len(NAMES) * 12} days failed)" in title
    for table, least in (("learners_failures", 0.01), ("learners_twenty", 0.0)):
        _, (head, *rows) = written(table)
        assert [labels[text] for text in head[1:]] == NAMES[2:]
        assert [row[0] for row in rows] == list(by_name)[:4]
        for condition, *cells in rows:
            expected = [rounded(wrong(by_name[condition], labels[text], least)) for text in head[1:]]
            assert [percent(cell) for cell in cells] == expected
    _, (head, *rows) = written("learners_worse")
    for condition, *cells in rows:
        expected = [rounded(r > 0.02 for r in rises(by_name[condition], labels[text])) for text in head[1:]]
        assert [percent(cell) for cell in cells] == expected
    _, (head, *rows) = written("learners_good")
    assert [row[0] for row in rows] == list(by_name)[4:]
    for text, cell in zip(head[1:], rows[0][1:], strict=True):
        of_loops = rises(runs[4], labels[text])
        share, middle, called = re.fullmatch(r"(\d+) % \(.*\), (\S+) %, (\d+) %", cell).groups()
        assert int(share) == rounded(r > 0.01 for r in of_loops)
        assert float(middle) == pytest.approx(100 * statistics.median(of_loops), abs=0.051)
        estimates = runs[4].ds.estimate_final.sel(controller=labels[text]).values.ravel().tolist()
        assert int(called) == rounded(e > 0.01 for e in estimates)


@pytest.mark.full
@pytest.mark.kernel
def test_the_command_writes_every_table_and_the_figure(written, monkeypatch, tmp_path):
    monkeypatch.setattr(learners_runs, "kinds", lambda: (kinds.STEPPED, kinds.HEATING))
    for days in ("LOOP_DAYS", "VALVE_DAYS"):
        monkeypatch.setattr(learners_runs, days, [1, 2])
    learners.main(2)
    names = ("failures", "twenty", "worse", "good", "cost", "cost_morning")
    assert all(len(written(f"learners_{name}")[1]) > 3 for name in names)
    assert (tmp_path / "studies" / "learning" / "learners.png").stat().st_size > 20_000
