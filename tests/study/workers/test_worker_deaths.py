"""Workers that are killed, hang or starve: the guilty scenario is found, the others lack nothing."""

import os
import pickle
import shutil
import signal
import stat
import sys
import tempfile

import numpy as np
import pytest
from helpers import failing_shards
from helpers.commands import fastcoil
from helpers.processes import N_SCENARIOS, assert_crashed, cut_studies, living_descendants
from joblib.externals.loky.backend import resource_tracker

import fastcoil as fc
from fastcoil.base.errors import FastcoilError, StorageError
from fastcoil.loops.plan import Shard
from fastcoil.study import workers as pools
from fastcoil.study.file.spec import read_study
from fastcoil.study.folder.stored import SHARDS_FOLDER
from fastcoil.study.run import execute
from fastcoil.study.workers import Job, PoolOptions, make_pool

_PIPE_BYTES = 2**16
"""Bytes that a pipe takes before somebody reads."""
pytestmark = [pytest.mark.kernel, pytest.mark.timeout(180), pytest.mark.usefixtures("leaves_nothing")]


@pytest.mark.parametrize(
    ("backend", "harm"),
    [
        ("loky", failing_shards.kill_worker),
        pytest.param("loky", failing_shards.exit_worker, marks=pytest.mark.full),
        pytest.param("loky", failing_shards.crash_worker, marks=pytest.mark.full),
    ],
)
def test_a_scenario_that_kills_is_crashed_and_no_other(
    small_study, healthy, tmp_path, monkeypatch, capfd, backend, harm
):
    failing_shards.harm_every_study(monkeypatch, harm, [70])
    cut_studies(monkeypatch, 20, alone=70)
    words = ["run", small_study, "-o", tmp_path / "out", "--backend", backend, "-j", "1", "--no-figures"]
    result = fastcoil(*words)
    assert result.exit_code == 3, result.output
    assert harm is failing_shards.crash_worker or not capfd.readouterr().err
    results = fc.open_study(tmp_path / "out")
    assert_crashed(results.stack(flat=results["status"].dims).transpose("flat", ...), healthy, [70])
    results.close()
    assert "1 crashed" in fastcoil("status", tmp_path / "out").output


def test_a_scenario_for_which_the_memory_does_not_suffice_ends_the_run_and_is_not_blamed(
    study, golden, tmp_path, monkeypatch
):
    cut_studies(monkeypatch, 40)
    harmed = failing_shards.with_harmful_layout(study, failing_shards.raise_memory_error, [77])
    with pytest.raises(StorageError, match="not even a single scenario can be run: the memory ran out"):
        execute(harmed, tmp_path / "out", n_jobs=1)
    finished = execute(study, tmp_path / "out", n_jobs=1)
    assert 0 < finished.n_run < N_SCENARIOS
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.full
@pytest.mark.full
def test_a_process_that_someone_kills_costs_nothing_but_time(study, golden, tmp_path, monkeypatch):
    cut_studies(monkeypatch, 20)
    killed = []

    def kill_one(_):
        alive = [pid for pid in living_descendants() if pid not in before]
        if not killed and alive:
            killed.append(alive[0])
            os.kill(alive[0], signal.SIGKILL)

    before = living_descendants()
    finished = execute(study, tmp_path / "out", backend="loky", n_jobs=1, progress=lambda *_: kill_one)
    assert killed
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.full
def test_workers_that_always_die_end_in_a_sentence_and_leave_nothing(study, tmp_path, monkeypatch):
    monkeypatch.setattr(pools, "_MAX_DEATHS_WITHOUT_RESULT", 1)
    cut_studies(monkeypatch, 10)
    harmed = failing_shards.with_harmful_layout(study, failing_shards.kill_worker, range(N_SCENARIOS))
    with pytest.raises(FastcoilError, match="1 workers died in a row without a result") as caught:
        execute(harmed, tmp_path / "out", backend="loky", n_jobs=1)
    assert len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.full
def test_workers_that_cannot_even_start_end_in_a_sentence(study, tmp_path, monkeypatch):
    monkeypatch.setattr(pools, "_MAX_DEATHS_WITHOUT_RESULT", 1)
    monkeypatch.setattr(pools, "initialise_worker", failing_shards.exit_at_start)
    with pytest.raises(FastcoilError, match="workers died in a row without a result"):
        execute(study, tmp_path / "out", backend="loky", n_jobs=1)
    assert not (tmp_path / "out").exists()


@pytest.mark.timeout(60)
def test_a_process_that_dies_before_it_reads_anything_is_waited_for_by_nobody(study, tmp_path, monkeypatch):
    job = Job(study.plan, None)
    assert len(pickle.dumps(job)) > _PIPE_BYTES
    resource_tracker.ensure_running()
    monkeypatch.setattr(sys, "executable", shutil.which("false"))
    pool = make_pool(job, PoolOptions("loky", 2))
    try:
        with pytest.raises(pool.worker_errors):
            pool.submit(Shard(np.arange(10**6))).result(timeout=40)
    finally:
        pool.close()


def test_the_folder_with_the_job_is_for_this_user_alone_and_is_removed(study, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    pool = make_pool(Job(study.plan, None), PoolOptions("loky", 1))
    (folder,) = tmp_path.iterdir()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    pool.close()
    assert not list(tmp_path.iterdir())


@pytest.mark.full
@pytest.mark.full
def test_a_process_that_is_short_of_memory_is_replaced(study, golden, tmp_path, monkeypatch):
    cut_studies(monkeypatch, 40)
    harmed = failing_shards.with_harmful_layout(study, failing_shards.exhaust_memory, [35], once=tmp_path / "once")
    finished = execute(harmed, tmp_path / "out", backend="loky", n_jobs=1)
    assert (tmp_path / "once").exists()
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.parametrize(
    "backend", ["threads", *(pytest.param(name, marks=pytest.mark.full) for name in ("loky", "dask"))]
)
def test_an_error_of_the_user_comes_through_and_what_is_finished_is_kept(
    small_study, golden, tmp_path, monkeypatch, backend, request
):
    cut_studies(monkeypatch, 16)
    scheduler = request.getfixturevalue("two_workers").address if backend == "dask" else None
    words = ["run", small_study, "-o", tmp_path / "out", "--backend", backend, "-j", "1", "--no-figures"]
    with monkeypatch.context() as patch:
        failing_shards.harm_every_study(patch, failing_shards.refuse_input, [100])
        result = fastcoil(*words, *(["--scheduler", scheduler] if scheduler else []))
    assert result.exit_code == 2, result.output
    assert "fastcoil: this reduction cannot be applied: give another" in result.output
    assert len(list((tmp_path / "out" / SHARDS_FOLDER).iterdir())) >= 5
    finished = execute(read_study(small_study), tmp_path / "out")
    assert 0 < finished.n_run <= N_SCENARIOS - 80
    assert finished.results.attrs["content_sha256"] == golden
