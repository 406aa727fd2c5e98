"""Studies whose days are a sequence: killed, damaged, cut in any way and extended, they come to the same hash."""

import numpy as np
import pytest
from helpers import failing_shards
from helpers.refusals import refuses
from helpers.studies import (
    quarantined_names,
    resume_to_end,
    run,
    run_until_interrupted,
    shard_files,
    undisturbed_hash,
    write_study,
)

import fastcoil as fc
from fastcoil.loops import netcdf, plan
from fastcoil.model.metric_table import STATUS_CRASHED, STATUS_OK
from fastcoil.study import maintenance
from fastcoil.study import run as runner
from fastcoil.study.file.spec import read_tuning
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.stored import Shards

pytestmark = pytest.mark.kernel

N_DAYS = 6
CARRIED = f"""
title = "carried"
[loop]
preset = "lbnl"
noise_std = 0.02
learning_interval = 600
[sweep]
backlash = {[round(0.02 * k, 2) for k in range(4)]}
[cases.way]
plain = {{ learning_step = 0.0, n_volumes = 4 }}
learner = {{ learning_step = 0.01 }}
[sample]
size = 3
method = "random"
seed = 1
kp = {{ uniform = [0.01, 0.03] }}
[boundary]
hours = 0.18
seed = {list(range(1, N_DAYS + 1))}
[run]
warm_up = 100
carry_over = true
"""
GROUPS = CARRIED.replace("size = 3", "size = 18")
"""Lanes of three blocks."""
TRACED = CARRIED + 'traces = ["T_sup", "mode"]\ntrace_interval = 60\n'


@pytest.fixture(autouse=True)
def one_block_each(monkeypatch):
    """Shards of as few lanes as the kernel takes together."""
    monkeypatch.setattr(plan, "_LANE_STEPS_PER_SEQUENCE", 1.0)
    monkeypatch.setattr(plan, "_MIN_SEQUENCE_BLOCKS", 1)


def test_the_results_are_those_of_simulate(tmp_path):
    study = write_study(CARRIED, tmp_path / "out")
    of_plan = study.plan.layout
    run(CARRIED, tmp_path / "out")
    stored = fc.open_study(tmp_path / "out")
    ds = fc.simulate(of_plan.loop, of_plan.boundary, carry_over=True, warm_up=100, n_jobs=1)
    assert stored.attrs["carry_over"] == 1
    for name in ds.data_vars:
        np.testing.assert_array_equal(stored[name].values, ds[name].values, err_msg=name)


@pytest.mark.parametrize("n_jobs", [pytest.param(1, marks=pytest.mark.full), 3])
def test_only_lanes_that_are_missing_are_run_again_whatever_the_number_of_workers(tmp_path, n_jobs):
    study = write_study(GROUPS, tmp_path / "out")
    run_until_interrupted(GROUPS, tmp_path / "out", 1)
    (first,) = (netcdf.load(path.read_bytes())["scenario"].size for path in shard_files(tmp_path / "out"))
    finished = runner.execute(study, tmp_path / "out", n_jobs=n_jobs)
    assert finished.n_run == study.plan.n_scenarios - first < study.plan.n_scenarios
    assert finished.results.attrs["content_sha256"] == undisturbed_hash(GROUPS)


def test_a_damaged_shard_is_computed_again(tmp_path):
    run_until_interrupted(GROUPS, tmp_path / "out", 1)
    shard_files(tmp_path / "out")[0].write_bytes(b"damaged")
    (warning,) = resume_to_end(tmp_path / "out", GROUPS)
    assert "its scenarios are computed again" in warning
    assert len(quarantined_names(tmp_path / "out")) == 1


def test_shards_with_some_of_the_days_are_taken(tmp_path):
    out = tmp_path / "out"
    run_until_interrupted(GROUPS, out, 1)
    (path,) = shard_files(out)
    part = netcdf.load(path.read_bytes())
    path.unlink()
    half = part.isel(scenario=slice(part.sizes["scenario"] // N_DAYS * 2))  # the first two days
    store = StudyFolder(out)
    Shards(out, store.require_manifest().key).commit(half)
    assert resume_to_end(out, GROUPS) == []


@pytest.mark.parametrize("n_jobs", [2, pytest.param(3, marks=pytest.mark.full)])
def test_nothing_depends_on_the_number_of_workers(tmp_path, n_jobs):
    assert run(GROUPS, tmp_path / "out", n_jobs=n_jobs) == undisturbed_hash(GROUPS)


@pytest.mark.full
def test_a_lane_that_kills_its_worker_is_crashed_on_all_days_and_no_other(tmp_path):
    study = write_study(GROUPS, tmp_path / "out")
    harmed = failing_shards.with_harmful_layout(study, failing_shards.kill_worker, [3])
    crashed = runner.execute(harmed, tmp_path / "out", n_jobs=2, backend="loky").results
    run(GROUPS, tmp_path / "sound")
    lanes = crashed["status"].values.reshape(N_DAYS, -1)
    assert (lanes[:, 3] == STATUS_CRASHED).all()
    assert (np.delete(lanes, 3, axis=1) == STATUS_OK).all()
    sound = fc.open_study(tmp_path / "sound")
    ran = (crashed["status"] == STATUS_OK).values
    np.testing.assert_array_equal(crashed["rmse"].values[ran], sound["rmse"].values[ran])


def test_lanes_and_later_days_can_be_added(tmp_path):
    larger = CARRIED.replace("0.04, 0.06]", "0.04, 0.06, 0.1]").replace("5, 6]", "5, 6, 7]")
    run(CARRIED, tmp_path / "out")
    assert run(larger, tmp_path / "out", extend=True) == undisturbed_hash(larger)


@pytest.mark.parametrize(
    ("old", "new"), [("[1, 2,", "[12, 1, 2,"), pytest.param("4, 5", "5, 4", marks=pytest.mark.full)]
)
def test_days_before_others_are_the_cause_of_them(tmp_path, old, new):
    run(CARRIED, tmp_path / "out")
    with refuses(("--extend", "conflict")):
        run(CARRIED.replace(old, new), tmp_path / "out", extend=True)


def test_days_that_begin_to_follow_one_another_keep_nothing(tmp_path):
    apart = CARRIED.replace("carry_over = true", "carry_over = false")
    run(apart, tmp_path / "out")
    with refuses(("--extend", "conflict")):
        run(CARRIED.replace("5, 6]", "5, 6, 7]"), tmp_path / "out", extend=True)


def test_one_day_is_run_again_with_those_before_it(tmp_path):
    run(CARRIED, tmp_path / "out")
    for day in ("1", "5"):
        at = {"day": day, "backlash": "0.06", "way": "learner", "sample": "2"}
        path, outcome = maintenance.rerun(tmp_path / "out", at)
        assert "Equal to the study's result to the last bit." in outcome
        assert netcdf.load(str(path))["T_sup"].shape == (648,)


def test_a_reduction_gets_the_traces_of_each_day(tmp_path):
    (tmp_path / "own.py").write_text(
        "def highest(traces):\n    return traces[['T_sup']].max('elapsed_time').rename(T_sup='T_highest')\n"
    )
    text = TRACED + 'reduce = "own:highest"\n'
    run(TRACED, tmp_path / "traced")
    run(text, tmp_path / "out")
    whole, reduced = fc.open_study(tmp_path / "traced"), fc.open_study(tmp_path / "out")
    np.testing.assert_array_equal(reduced["T_highest"], whole["T_sup"].max("elapsed_time"))


def test_a_tuning_of_days_in_sequence_is_refused(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(CARRIED + "[tune]\nsearch = { kp = [0.01, 0.02] }\n")
    with refuses(("carry_over", "unsupported")):
        read_tuning(path)
