"""``wear.py`` and its parts: gaps that grow as given, a bank that finds its gap, tables of a made-up result."""

import math
import statistics

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies.days import STEPPED
from studies.wear import detect, logs, wear
from studies.wear import runs as wear_runs
from studies.wear.runs import Run

NAMES = list(wear_runs.controllers())


@pytest.mark.kernel
def test_the_gap_grows_with_the_travel_and_by_what_it_was_given_where_that_stays(monkeypatch):
    two_controllers, days_of = {name: wear_runs.controllers()[name] for name in NAMES[:2]}, wear_runs.sequence_days
    monkeypatch.setattr(wear_runs, "controllers", lambda: two_controllers)
    monkeypatch.setattr(wear_runs, "sequence_days", lambda sequence: days_of(sequence, 3))
    monkeypatch.setattr(wear_runs, "GROWTHS", (0.0, 0.001, 0.002, 0.003))
    run = wear_runs.simulate_sequence(wear_runs.Sequence("", STEPPED, False, False, False, 7301), 8)
    is_worn = run.growth > 0.0
    assert int(is_worn.sum()) == 6
    growth = wear_runs.actual_growth(run, wear_runs.PI)
    rate = run.growth / run.plain.stem_travel.sum("day")
    warm_up_travel = growth / rate - run.ds.stem_travel.sel(controller=wear_runs.PI).sum("day")
    assert ((warm_up_travel > 0.1) & (warm_up_travel < 2.0)).where(is_worn, True).all()
    assert 0.9 < float((growth / run.growth).where(is_worn).median()) < 1.1
    assert float(abs(wear_runs.actual_growth(run, wear_runs.PI)).where(~is_worn).max()) == 0.0
    assert (run.plain.backlash_final == run.first_gap).all()


def python_probabilities(new, noise, leave):
    """The probabilities of the gaps, one after the other."""
    n = len(new[0])
    probability, history = [1.0 / n] * n, []
    for row in new:
        predicted = [probability[j] * (1.0 - leave) for j in range(n)]
        for j in range(n):
            neighbours = [k for k in (j - 1, j + 1) if 0 <= k < n]
            for k in neighbours:
                predicted[k] += probability[j] * leave / len(neighbours)
        weight = [p * math.exp(-0.5 * (e / noise) ** 2) for p, e in zip(predicted, row, strict=True)]
        probability = [max(w / sum(weight), detect.LEAST_PROBABILITY) for w in weight]
        probability = [p / sum(probability) for p in probability]
        history.append(probability)
    return history


def test_probabilities_follow_the_chain_and_the_likelihoods():
    new = np.random.default_rng(3).normal(0.0, 0.1, (20, 4))
    expected = python_probabilities(new.tolist(), 0.08, detect.MODEL_INTERVAL / detect.SOJOURN_SECONDS)
    np.testing.assert_allclose(detect.gap_probabilities(new[None], np.array([0.08]))[0], expected, rtol=1e-9)


@pytest.mark.kernel
def test_the_bank_finds_the_gap_of_a_loop_whose_plant_it_knows():
    days = detect.sequence_days(STEPPED, 7501).isel(day=slice(0, 2))
    loop = fc.Loop.preset("lbnl").assign(m_full=1.7, rangeability=30.0, authority=0.5, C_w=10.0)
    loop = loop.assign(backlash=("sample", [0.0, 0.03]))
    traces = detect._simulate_sequence(loop.assign(noise_std=0.01), days, ["T_measured", "command"], 5)
    for k, gap in enumerate((0.0, 0.03)):
        command = np.repeat(traces.command.values[k], 5, axis=-1)
        models = detect.predict_temperatures(detect.select_loop(loop, sample=k), days, command)
        measured = traces.T_measured.values[k, :, :: detect.MODEL_INTERVAL // 5].ravel()
        innovation = detect.innovations(measured, models.sel(model="known").values.reshape(measured.size, -1))
        probabilities = detect.gap_probabilities(innovation[None], detect.innovation_std(innovation[None]))
        assert abs((probabilities[0, -60:] @ detect.CANDIDATES).mean() - gap) < 0.005


@pytest.fixture
def runs():
    """Made-up results of 6 valves and 24 days."""
    rng = np.random.default_rng(8)
    shape = (len(NAMES), 6, 24)

    def make_run(name, kind, in_steps=False, is_good=False):
        dims = ("controller", "sample", "day")
        values = {metric: (dims, rng.uniform(0.01, 0.1, shape)) for metric in wear_runs.METRICS}
        values["status"] = dims, np.zeros(shape)
        ds = xr.Dataset(values, coords={"controller": NAMES, "day": np.arange(24)})
        of_valve = xr.DataArray(rng.uniform(0.01, 0.05, 6), dims="sample")
        plain = ds.isel(controller=0, drop=True)
        plain["hunts"] = plain["hunts"] * 0.0
        return Run(wear_runs.Sequence(name, kind, False, in_steps, is_good, 1), ds, plain, of_valve * 0.5, of_valve)

    return [
        make_run(STEPPED, STEPPED),
        make_run(f"{STEPPED}, loose and repaired", STEPPED, in_steps=True),
        make_run(f"{STEPPED}, no gap", STEPPED, is_good=True),
    ]


@pytest.fixture
def made_up_estimates():
    rng = np.random.default_rng(9)
    detectors = list(wear.DETECTOR_LABELS)
    shape = (len(detectors), 2, 5, 8 * 36)
    return {
        (case, kind): xr.DataArray(
            rng.uniform(0.0, 0.004, shape) + 0.05 * np.maximum(0, np.arange(shape[-1]) - 110) / shape[-1] * growing,
            dims=("detector", "day", "sample", "elapsed_time"),
            coords={"detector": detectors},
        )
        for kind in detect.KINDS
        for case, growing in ((detect.STEADY, 0), (detect.NO_GAP, 0), (detect.AT_ONCE, 1), (detect.SLOWLY, 1))
    }


def test_the_tables_hold_what_plain_python_finds(runs, made_up_estimates, read_table, tmp_path):
    wear.write_tables(runs, made_up_estimates, made_up_estimates)
    _, (head, *follow) = read_table("wear_follow")
    assert [row[0] for row in follow] == [STEPPED, f"{STEPPED}: loose", f"{STEPPED}: repaired"]
    assert head[1:] == [wear.CONTROLLER_LABELS[name] for name in NAMES[1:]]
    _, (_, *cost) = read_table("wear_cost")
    travel = {name: runs[0].ds.motor_travel.sel(controller=name).values.sum(-1).tolist() for name in NAMES}
    ratio = statistics.median(a / b for a, b in zip(travel["identify"], travel["pi"], strict=True))
    assert cost[NAMES.index("identify") - 1][1].split(", ")[1] == f"× {ratio:.2f}"
    assert all(len(read_table(f"wear_{name}")[1]) > 1 for name in ("life", "feedback", "good"))
    _, (_, *noticed_rows) = read_table("wear_noticed")
    assert [row[0] for row in noticed_rows] == list(wear.DETECTOR_LABELS.values())
    assert all(row[2].startswith("0 %") and row[4].startswith("100 %") for row in noticed_rows)
    wear.draw(runs, made_up_estimates, made_up_estimates)
    assert (tmp_path / "studies" / "wear" / "wear.png").stat().st_size > 10_000


def make_readings(rows, growth):
    """Intervals of valves, (low, high) a reading, None where none is claimed."""
    intervals = [[(0.0, 0.25, False) if interval is None else (*interval, True) for interval in row] for row in rows]
    values = np.array(intervals, dtype=float)[:, np.newaxis]
    readings = xr.DataArray(values, dims=("sample", "way", "reading", "field"), coords={"way": [logs.LOGS]})
    low, high, claimed = readings.transpose("field", ...)
    return logs.Readings(low, high, claimed > 0.0, xr.DataArray(growth, dims="sample"))


def test_an_alarm_is_the_first_claim_above_the_first_claim():
    rows = [
        [(0.02, 0.03), (0.025, 0.035), (0.031, 0.04), (0.05, 0.06), None, None],
        [None, (0.02, 0.04), None, (0.03, 0.05), None, (0.041, 0.05)],
        [None] * 6,
        [(0.05, 0.06), (0.01, 0.02), (0.055, 0.07), None, None, None],
    ]
    grown_readings = make_readings(rows, [0.04, 0.02, 0.0, 0.0])
    assert logs.first_alarms(grown_readings).squeeze().values.tolist() == [2.0, 5.0, math.inf, math.inf]
    rows = [[(0.02, 0.03)] * 2 + [after] * 4 for after in ((0.04, 0.06), (0.02, 0.03), None, (0.05, 0.06))]
    loose_readings = make_readings(rows, [0] * 4)
    row = logs.alarm_row({logs.GROWS: grown_readings, logs.LOOSE: loose_readings}, logs.LOGS)
    cells = dict(zip(logs.HEAD[2:], row, strict=True))
    assert cells["claims at first"].startswith("50 %")
    assert cells["false alarms, constant gap"].startswith("0 %")
    assert cells["false alarms, no gap"] == "—"
    assert [cells[f"growth by {by} % noticed"][:5] for by in (2, 4)] == ["100 %", "100 %"]
    assert cells["after months, median"] == f"{12 / 6 * 3.5:.0f}"
    assert cells["loose linkage noticed"].startswith("50 %")
    assert cells["after months"] == "0"
