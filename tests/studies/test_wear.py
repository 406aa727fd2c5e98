"""``wear.py`` and its parts: gaps that grow as given, a bank that finds its gap, alarms and tables of plain Python."""

import math
import re
import statistics

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies.days import CONSTANT, STEPPED
from studies.wear import detect, wear
from studies.wear import runs as wear_runs
from studies.wear.runs import Run

NAMES = list(wear_runs.controllers())


def test_every_kind_of_days_has_valves_with_wear_and_good_ones_and_names_differ(monkeypatch):
    monkeypatch.setattr(wear_runs, "kinds_here", lambda: (STEPPED, CONSTANT, wear_runs.MONTHLY))
    found = wear_runs.sequences(7)
    assert len({sequence.name for sequence in found}) == len(found)
    for kind in (STEPPED, CONSTANT, wear_runs.MONTHLY):
        assert {s.is_good for s in found if s.kind == kind} == {True, False}
    assert {s.kind for s in found if s.in_steps} == {STEPPED, wear_runs.MONTHLY}


def test_a_linkage_comes_loose_after_a_third_of_the_days_and_is_repaired_after_two():
    sequence = wear_runs.Sequence("", STEPPED, False, True, False, 7301)
    days = wear_runs.days_of(sequence, 6)
    assert days.series["backlash_scale"][:, [0, -1]].tolist() == [[1.0] * 2] * 2 + [[2.0] * 2] * 2 + [[0.25] * 2] * 2


def test_growth_is_given_alike_to_all_and_none_has_more_than_another_gets():
    growth = wear_runs.growths(fc.Loop(backlash=("sample", np.linspace(0, 0.1, 64))))
    assert sorted(growth.values.tolist()) == sorted([*wear_runs.GROWTH] * 16)


@pytest.mark.kernel
def test_the_gap_grows_with_the_travel_and_by_what_it_was_given_where_that_stays(monkeypatch):
    some, days_of = {name: wear_runs.controllers()[name] for name in NAMES[:2]}, wear_runs.days_of
    monkeypatch.setattr(wear_runs, "controllers", lambda: some)
    monkeypatch.setattr(wear_runs, "days_of", lambda sequence: days_of(sequence, 3))
    monkeypatch.setattr(wear_runs, "GROWTH", (0.0, 0.001, 0.002, 0.003))
    run = wear_runs.lived(wear_runs.Sequence("", STEPPED, False, False, False, 7301), 8)
    worn = run.growth > 0.0
    assert int(worn.sum()) == 6
    grown = wear_runs.grown(run, wear_runs.PI)
    rate = run.growth / run.plain.stem_travel.sum("day")
    in_warm_up = (grown / rate - run.ds.stem_travel.sel(controller=wear_runs.PI).sum("day")).where(worn, drop=True)
    assert float(in_warm_up.min()) > 0.1
    assert float(in_warm_up.max()) < 2.0
    assert 0.9 < float((grown / run.growth).where(worn).median()) < 1.1
    assert float(abs(wear_runs.grown(run, wear_runs.PI)).where(~worn).max()) == 0.0
    assert (run.plain.backlash_final == run.first).all()


def in_plain_python(new, noise, leave):
    """The probabilities of the gaps, one after the other."""
    n = len(new[0])
    now, found = [1.0 / n] * n, []
    for row in new:
        after = [now[j] * (1.0 - leave) for j in range(n)]
        for j in range(n):
            beside = [k for k in (j - 1, j + 1) if 0 <= k < n]
            for k in beside:
                after[k] += now[j] * leave / len(beside)
        weight = [p * math.exp(-0.5 * (e / noise) ** 2) for p, e in zip(after, row, strict=True)]
        now = [max(w / sum(weight), detect.LEAST) for w in weight]
        now = [p / sum(now) for p in now]
        found.append(now)
    return found


def test_probabilities_follow_the_chain_and_the_likelihoods():
    new = np.random.default_rng(3).normal(0.0, 0.1, (20, 4))
    expected = in_plain_python(new.tolist(), 0.08, detect.INTERVAL / detect.SOJOURN)
    found = detect.probabilities(new[None], np.array([0.08]))
    np.testing.assert_allclose(found[0], expected, rtol=1e-9)


def test_a_disturbance_that_stays_is_nothing_new_and_a_step_of_it_is_new_once():
    error = np.where(np.arange(400) < 200, 0.0, 1.0)
    new = detect.innovations(error, np.zeros((400, 1)))[:, 0]
    assert new[200] == 1.0
    assert (new[:200] == 0.0).all()
    np.testing.assert_allclose(new[201:], 1.0 - math.exp(-detect.INTERVAL / detect.COLOUR), rtol=1e-12)


@pytest.mark.kernel
def test_the_bank_finds_the_gap_of_a_loop_whose_plant_it_knows():
    days = detect.days_of(STEPPED, 7501).isel(day=slice(0, 2))
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, rangeability=30.0, authority=0.5, C_w=10.0)
    loop = loop.assign(backlash=("sample", [0.0, 0.03]))
    seen = detect._lived(loop.assign(noise_std=0.01), days, ["T_measured", "command"], 5)
    for k, gap in enumerate((0.0, 0.03)):
        command = np.repeat(seen.command.values[k], 5, axis=-1)
        models = detect.predicted(detect.picked(loop, sample=k), days, command)
        measured = seen.T_measured.values[k, :, :: detect.INTERVAL // 5].ravel()
        new = detect.innovations(measured, models.sel(plant="known").values.reshape(measured.size, -1))
        mean = detect.probabilities(new[None], detect.noise_of(new[None]))[0, -60:] @ detect.CANDIDATES
        assert abs(mean.mean() - gap) < 0.005


@pytest.mark.kernel
def test_a_model_of_another_gap_opens_the_valve_as_it_was_commissioned():
    """With twice the gap since, the model of that gap is the loop."""
    days = detect.days_of(CONSTANT, 7501).isel(day=slice(0, 1))
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, rangeability=30.0, authority=0.5, C_w=10.0, backlash=0.035)
    command = np.interp(np.arange(days.n_steps) % 1200, [0, 600, 1200], [0.2, 0.6, 0.2])
    worn = days.assign(backlash_scale=2.0)
    true = fc.simulate(loop, worn, command=command, traces=["T_measured"], trace_interval=detect.INTERVAL).T_measured
    found = detect.predicted(loop, days, command[None]).sel(plant="known")
    error = abs(found.values[0] - true.values.reshape(-1, 1)).max(axis=0)
    assert error[detect.CANDIDATES.index(0.07)] < 1e-9
    assert error[detect.CANDIDATES.index(0.05)] > 0.1


def test_the_gap_is_constant_for_three_days_and_then_does_what_the_case_says():
    n = 10
    one = {case: detect.scale_of(case, n).ravel() for case in wear_detect_cases()}
    assert set(one[detect.STEADY]) == {1.0}
    assert one[detect.AT_ONCE].tolist() == [1.0] * 30 + [3.0] * 50
    np.testing.assert_allclose(one[detect.SLOWLY], [1.0] * 30 + [1.0 + 2.0 * k / 50 for k in range(50)])


def wear_detect_cases():
    return detect.STEADY, detect.GOOD, detect.AT_ONCE, detect.SLOWLY


def test_an_alarm_is_the_first_time_that_an_estimate_rises_above_that_of_the_third_day():
    per_day = 4
    rises = np.full(8 * per_day, 0.03)
    rises[4 * per_day + 1 :] = 0.06
    falls_first = rises + 0.05 * (np.arange(rises.size) < 2 * per_day)
    estimates = xr.DataArray([rises, falls_first, rises * 0 + 0.09], dims=("sample", "elapsed_time"))
    found = detect.alarms(estimates, 0.02)
    assert found.values.tolist() == [(per_day + 2) * detect.EVERY / 3600.0] * 2 + [math.inf]


def test_the_threshold_is_the_least_with_few_false_alarms():
    estimate = np.zeros((20, 32))
    estimate[0, 20:], estimate[1, 20:] = 0.02, 0.012  # two of twenty would be too many
    found = xr.DataArray(estimate[None], dims=("detector", "sample", "elapsed_time"), coords={"detector": ["it"]})
    cases = {(case, kind): found for case in (detect.STEADY, detect.GOOD) for kind in detect.KINDS}
    assert detect.threshold_of(cases, "it") == 0.015
    never = {key: values * 0.0 + np.arange(32) for key, values in cases.items()}
    assert math.isnan(detect.threshold_of(never, "it"))


@pytest.fixture
def runs():
    """Made-up results of 6 valves and 24 days."""
    dice = np.random.default_rng(8)
    shape = (len(NAMES), 6, 24)

    def made(name, kind, in_steps=False, is_good=False):
        dims = ("controller", "sample", "day")
        values = {metric: (dims, dice.uniform(0.01, 0.1, shape)) for metric in wear_runs.METRICS}
        ds = xr.Dataset(values, coords={"controller": NAMES, "day": np.arange(24)}).assign(
            status=(dims, np.zeros(shape))
        )
        of_valve = xr.DataArray(dice.uniform(0.01, 0.05, 6), dims="sample")
        plain = ds.isel(controller=0, drop=True)
        plain["hunts"] = plain["hunts"] * 0.0
        return Run(wear_runs.Sequence(name, kind, False, in_steps, is_good, 1), ds, plain, of_valve * 0.5, of_valve)

    return [
        made(STEPPED, STEPPED),
        made(f"{STEPPED}, loose and repaired", STEPPED, in_steps=True),
        made(f"{STEPPED}, no gap", STEPPED, is_good=True),
    ]


def test_an_estimate_is_wrong_beyond_a_fifth_of_the_gap_and_a_hundredth_of_the_stroke(runs):
    ds = runs[0].ds
    gaps, found = [0.01, 0.02, 0.1, 0.1, 0.1, 0.0], [0.0, 0.0, 0.085, 0.075, math.nan, 0.02]
    for name, values in (("backlash_final", gaps), ("estimate_final", found)):
        ds[name].loc[{"controller": "identify"}] = np.array(values)[:, None]
    wrong = wear_runs.wrong(runs[0], "identify")
    assert wrong.isel(day=0).values.tolist() == [False, True, False, True, True, True]


@pytest.fixture
def noticed():
    dice = np.random.default_rng(9)
    detectors = list(wear.DETECTORS)
    shape = (len(detectors), 2, 5, 8 * 36)
    return {
        (case, kind): xr.DataArray(
            dice.uniform(0.0, 0.004, shape) + 0.05 * np.maximum(0, np.arange(shape[-1]) - 110) / shape[-1] * growing,
            dims=("detector", "day", "sample", "elapsed_time"),
            coords={"detector": detectors},
        )
        for kind in detect.KINDS
        for case, growing in zip(wear_detect_cases(), (0, 0, 1, 1), strict=True)
    }


def test_the_tables_hold_what_plain_python_finds(runs, noticed, written, monkeypatch, tmp_path):
    wear.write(runs, noticed, noticed)
    run = runs[0]
    ds = run.ds
    _, (head, *follow) = written("wear_follow")
    assert [row[0] for row in follow] == [STEPPED, f"{STEPPED}: loose", f"{STEPPED}: repaired"]
    assert head[1:] == [wear.LABELS[name] for name in NAMES[1:]]
    last = ds.sel(controller="identify").isel(day=slice(20, 24))
    pairs = zip(last.estimate_final.values.ravel(), last.backlash_final.values.ravel(), strict=True)
    wrong = [abs(estimate - gap) > max(0.2 * gap, 0.01) for estimate, gap in pairs]
    assert follow[0][head.index("identify")].split(" (")[0] == f"{100 * sum(wrong) / len(wrong):.0f} %"
    _, (_, *cost) = written("wear_cost")
    travel = {name: ds.motor_travel.sel(controller=name).values.sum(-1).tolist() for name in NAMES}
    ratio = statistics.median(a / b for a, b in zip(travel["identify"], travel["pi"], strict=True))
    assert cost[NAMES.index("identify") - 1][1].split(", ")[1] == f"× {ratio:.2f}"
    _, (_, *life) = written("wear_life")
    strokes = statistics.median(travel["pi"]) * 365 / 24
    assert life[0][3].split(", ")[0] == f"{strokes:,.0f}"
    assert life[0][5].startswith(f"{100 * strokes / 20_000:.1f}, ")
    _, (_, *feedback) = written("wear_feedback")
    end = ds.backlash_final.sel(controller="pi").isel(day=-1)
    grown = statistics.median(((end - run.first) / run.growth).values.tolist())
    assert re.match(rf"× {grown:.2f} \(.*, 6 valves", feedback[0][1])
    assert feedback[0][2] == "—"
    _, (_, *good) = written("wear_good")
    assert [row[0] for row in good] == [STEPPED]
    _, (head, *found) = written("wear_noticed")
    assert [row[0] for row in found] == list(wear.DETECTORS.values())
    assert {row[1] for row in found} == {"0.5 %"}
    assert all(row[2].startswith("0 %") and row[4].startswith("100 %") for row in found)
    wear.draw(runs, noticed, noticed)
    assert (tmp_path / "studies" / "wear" / "wear.png").stat().st_size > 10_000
