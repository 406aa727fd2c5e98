"""``fc.tune``: it finds what a grid finds, and its numbers are those of simulations on either side of the hold-out."""

import dataclasses

import numpy as np
import pytest
from helpers.advice_checks import makes_its_swing

import fastcoil as fc
from fastcoil.design.tuning_plan import plan_tuning
from fastcoil.study.file.loop import read_includes

pytestmark = pytest.mark.kernel

N = 9
X = np.linspace(0.0, 0.12, N)
SEARCH = {"kp": (0.005, 0.2), "ti": (5, 200)}
LIMITS = {"motor_travel": 0.17, "reversals": ("now", "mean")}
HOW = {"warm_up": 300}
LOOP = fc.Loop(backlash=("sample", X), noise_std=0.02)
DAYS = fc.paper_day(hours=0.4, seed=[1, 2, 3])


@pytest.fixture(scope="module")
def result():
    return fc.tune(LOOP, DAYS, search=SEARCH, limits=LIMITS, evaluations=64, n_jobs=1, **HOW)


def p95(values):
    return np.sort(np.ravel(values))[int(np.ceil(0.95 * values.size - 1e-9)) - 1]


def test_it_finds_what_a_grid_of_gains_finds():
    search = {"kp": (0.005, 0.3)}
    group = plan_tuning(LOOP, DAYS, search=search, **HOW).training
    grid = fc.simulate(group.loop.assign(kp=np.geomspace(0.005, 0.3, 60)), group.boundary, n_jobs=1, **HOW).rmse
    errors = grid.mean(["sample", "day"]).values
    tuned = fc.tune(LOOP, DAYS, search=search, quantile="mean", evaluations=48, n_jobs=1, **HOW)
    assert float(tuned.trained.rmse_mean.sel(tuning="chosen", edge="value")) <= errors.min() * 1.01
    assert tuned.parameters["kp"] == pytest.approx(float(grid.kp[errors.argmin()]), rel=0.2)
    assert errors.min() < 0.8 * errors.max(), "or any gain would do"


def test_its_numbers_are_those_of_simulations_of_valves_and_days_on_either_side(result):
    request = plan_tuning(LOOP, DAYS, search=SEARCH, **HOW)
    for ds, group in ((result.trained, request.training), (result.held_out, request.holdout)):
        valves = [k for k in range(N) if X[k] in np.asarray(group.loop["backlash"])]
        assert tuple(valves) == group.members
        chosen = fc.Loop(backlash=("sample", X[valves]), noise_std=0.02, **result.parameters)
        for tuning, tuned_loop in (("now", chosen.assign(kp=0.03, ti=8.0)), ("chosen", chosen)):
            simulated = fc.simulate(tuned_loop, group.boundary, n_jobs=1, **HOW)
            at = ds.sel(tuning=tuning, edge="value")
            assert float(at.rmse_p95) == p95(simulated.rmse.values)
            assert float(at.motor_travel_p95) == p95(simulated.motor_travel.values)
            assert float(at.reversals_mean) == pytest.approx(float(simulated.reversals.mean()), rel=1e-12)
            assert float(at.hunts_mean) == makes_its_swing(tuned_loop, group.boundary, **HOW).mean()
        now, chosen_there = (float(ds.rmse_p95.sel(tuning=t, edge="value")) for t in ("now", "chosen"))
        assert float(ds.change.sel(tuning="chosen", edge="value")) == pytest.approx(chosen_there / now - 1.0)


def test_no_tuning_that_keeps_the_limits_and_was_tried_is_better(result):
    tried = result.evaluations
    now = result.trained.sel(tuning="now", edge="value")
    keeps = (tried.motor_travel_p95 <= 0.17) & (tried.reversals_mean <= float(now.reversals_mean))
    chosen = result.trained.sel(tuning="chosen", edge="value")
    assert result.meets_limits
    assert float(chosen.rmse_p95) == float(tried.rmse_p95.where(keeps).min())
    assert float(tried.rmse_p95.min()) < float(chosen.rmse_p95), "or the limits would not have mattered"
    best = tried.isel(evaluation=int(np.nanargmin(tried.rmse_p95.where(keeps).values)))
    assert {name: float(best[name]) for name in SEARCH} == result.parameters


def test_intervals_hold_the_value_and_vary_with_the_valves(result):
    for ds in (result.trained, result.held_out):
        low, value, high = (ds.rmse_p95.sel(edge=edge) for edge in ("low", "value", "high"))
        assert ((low <= value) & (value <= high)).all()
        assert (low < high).all()


def test_simc_stands_beside_with_the_gains_of_every_valve(result):
    group = plan_tuning(LOOP, DAYS, search=SEARCH, **HOW).training
    means = {name: values[:, 300:].mean(axis=1) for name, values in group.boundary.series.items()}
    steady = {name: np.repeat(values[:, None], 2000, axis=1) for name, values in means.items()}
    gains = fc.linearise(group.loop, fc.Boundary(**steady, day=group.boundary.day))
    simc_loop = group.loop.assign(kp=gains.kp_simc.median("day"), ti=gains.ti_simc.median("day"))
    first, second = (result.evaluations.isel(evaluation=k) for k in (0, 1))
    assert (float(first.kp), float(first.ti)) == (0.03, 8.0), "the search begins with the loop's own gains"
    assert float(second.kp) == pytest.approx(float(np.median(simc_loop["kp"])), rel=1e-3), "then SIMC's"
    simulated = fc.simulate(simc_loop, group.boundary, n_jobs=1, **HOW)
    trained = float(result.trained.rmse_p95.sel(tuning="simc", edge="value"))
    assert trained == pytest.approx(p95(simulated.rmse.values), rel=1e-6)


def test_the_front_is_retried_on_the_hold_out(result):
    group = plan_tuning(LOOP, DAYS, search=SEARCH, **HOW).holdout
    front = result.front.isel(point=-1)
    simulated = fc.simulate(group.loop.assign(kp=float(front.kp), ti=float(front.ti)), group.boundary, n_jobs=1, **HOW)
    assert float(front.held_out_rmse_p95) == p95(simulated.rmse.values)
    assert (np.diff(result.front.motor_travel_p95) > 0).all()
    assert (np.diff(result.front.rmse_p95) < 0).all()


def test_threads_decide_nothing(result):
    again = fc.tune(LOOP, DAYS, search=SEARCH, limits=LIMITS, evaluations=64, n_jobs=2, **HOW)
    for name in ("trained", "held_out", "front", "evaluations"):
        assert getattr(again, name).identical(getattr(result, name))


def test_limits_that_nothing_keeps_are_said_and_nothing_is_recommended(tmp_path):
    tuned = fc.tune(LOOP, DAYS, search={"kp": (0.5, 2.0)}, limits={"rmse": 1e-3}, evaluations=8, n_jobs=1, **HOW)
    assert not tuned.meets_limits
    assert "No tuning keeps the limits" in tuned.summary()[0]
    assert any(note.startswith("No tuning in these ranges") for note in tuned.notes)
    assert tuned.advice.startswith("Leave it: no tuning in these ranges keeps every limit")
    assert any(note.startswith("The hold-out breaks a limit") for note in tuned.notes)
    assert any("lies at the lower end of its range: the best may lie beyond" in note for note in tuned.notes)
    tuned.to_toml(tmp_path / "tuning.toml")
    assert read_includes({"include": ["tuning.toml"]}, tmp_path) == {}


def test_the_advice_is_to_change_only_what_is_better_and_keeps_its_limits_on_the_hold_out(result):
    settings = f"kp = {result.parameters['kp']!r} 1/K, ti = {result.parameters['ti']!r} s"
    change = float(result.held_out.change.sel(tuning="chosen", edge="value"))
    error = float(result.held_out.rmse_p95.sel(tuning="chosen", edge="value"))
    words = f"RMS error [K], 95 % quantile {error:.3g} K ({100 * change:+.0f} %), motor travel × "
    assert f": {settings}: {words}" in result.advice
    assert result.advice in result.summary()
    travel = float(result.held_out.motor_travel_p95.sel(tuning="chosen", edge="value"))
    tight = dataclasses.replace(result, limits=(result.limits[0]._replace(most=0.99 * travel),))
    worse = dataclasses.replace(result, held_out=result.held_out.assign(change=result.held_out.change + 2.0))
    for rejected in (tight, worse, dataclasses.replace(result, meets_limits=False)):
        assert rejected.advice.startswith("Leave it: ")
        assert settings not in rejected.advice


def test_settings_beside_the_gains_are_tuned_and_whole_ones_stay_whole():
    loop = fc.Loop(backlash=("sample", X[3:6]), noise_std=0.02, kp=("sample", [0.02, 0.03, 0.04]))
    search = {"sample_time": (5, 60), "error_dead_band": (0.0, 0.3), "kp": (0.01, 0.1)}
    tuned = fc.tune(loop, DAYS, search=search, quantile="mean", evaluations=12, n_jobs=1, **HOW)
    assert tuned.parameters["sample_time"] == int(tuned.parameters["sample_time"])
    assert f"sample_time = {int(tuned.parameters['sample_time'])}\n" in tuned.to_toml()
    assert list(tuned.held_out.tuning.values) == ["now", "chosen"]


def test_the_table_of_either_side_has_what_the_loop_does_there_now_as_its_limit(result):
    limits = [line.split()[-1] for line in result.summary() if line.strip().startswith("stem reversals")]
    current_values = [ds.reversals_mean.sel(tuning="now", edge="value") for ds in (result.held_out, result.trained)]
    assert limits == [f"{float(value):.3g}" for value in current_values]
    assert limits[0] != limits[1]


def test_it_says_where_the_converged_march_turns_the_advice_round():
    loop = fc.Loop.preset("paper_like_fast").assign(kp=0.033, backlash=("sample", [0.05, 0.06, 0.07]))
    day, holdout = fc.constant_day(hours=3), fc.constant_day(hours=3, T_a_in=25.8)
    how = {"holdout": holdout, "search": {"kp": (0.031, 0.033)}, "evaluations": 8, "n_jobs": 1}
    tuning = fc.tune(loop, day, **how)
    tuned = loop.assign(**tuning.parameters, air_march=["lagged", "quasistatic"])
    assert fc.simulate(tuned, holdout).hunts.mean("sample").values.tolist() == [1.0, 0.0]
    assert "more than 5 % of the cases hunt no longer" in tuning.contradiction
    assert tuning.advice.endswith(tuning.contradiction)
    assert not fc.tune(loop.assign(converged=True), day, **how).contradiction
