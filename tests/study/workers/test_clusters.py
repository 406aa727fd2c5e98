"""A dask cluster that a user started: the same bits, and nothing is lost with a worker or the scheduler.

The tests of one cluster come in the order in which they need it: the last two take it apart.
"""

import time

import pytest
from helpers import failing_shards
from helpers.commands import fastcoil
from helpers.processes import N_SCENARIOS, assert_crashed, cut_studies, run_cluster, wait_for
from helpers.refusals import refuses

import fastcoil as fc
from fastcoil.study import workers as pools
from fastcoil.study.file.spec import read_study
from fastcoil.study.run import execute

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(180), pytest.mark.usefixtures("leaves_nothing")]


def test_the_command_line_on_a_cluster_gives_the_same_bits(small_study, golden, tmp_path, two_workers, monkeypatch):
    cut_studies(monkeypatch, 40, seed=7)
    words = ["run", small_study, "-o", tmp_path / "out", "--backend", "dask"]
    done = fastcoil(*words, "--scheduler", two_workers.address, "--no-figures")
    assert done.exit_code == 0, done.output
    results = fc.open_study(tmp_path / "out")
    assert results.attrs["content_sha256"] == golden
    assert results.attrs["engine"] == "dask"
    assert f"{tmp_path / 'out'}/results.nc" in done.stdout


def tasks_on(client):
    return client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))


@pytest.mark.full
def test_a_cluster_keeps_nothing_of_a_finished_shard(small_study, tmp_path, two_workers, monkeypatch):
    cut_studies(monkeypatch, 20)
    on_scheduler = []
    with two_workers.client() as client:
        execute(
            read_study(small_study),
            tmp_path / "out",
            backend="dask",
            scheduler=two_workers.address,
            progress=lambda *_: lambda _: on_scheduler.append(tasks_on(client)),
        )
    assert len(on_scheduler) == N_SCENARIOS / 20
    # the job, three in flight, three whose results were fetched together
    assert max(on_scheduler) <= 7


def test_workers_of_another_version_are_refused(small_study, tmp_path, monkeypatch, two_workers):
    monkeypatch.setattr(pools, "model_sha256", lambda: "another model")
    with refuses(("scheduler", "unsupported")):
        fc.run_study(small_study, tmp_path / "out", backend="dask", scheduler=two_workers.address)
    assert not (tmp_path / "out").exists()


def test_workers_that_differ_are_refused(small_study, tmp_path, two_workers):
    # the compiler's settings belong to the fingerprint
    odd = two_workers.worker("--no-nanny", NUMBA_OPT="2")
    try:
        with two_workers.client() as client:
            client.wait_for_workers(3, timeout=30)
        with refuses(("scheduler", "unsupported")):
            fc.run_study(small_study, tmp_path / "out", backend="dask", scheduler=two_workers.address)
    finally:
        odd.kill()
        odd.wait(10)
    with two_workers.client() as client:
        wait_for(lambda: len(client.scheduler_info(n_workers=-1)["workers"]) == 2)


@pytest.mark.full
def test_a_scenario_that_kills_the_workers_of_a_cluster_is_crashed(study, healthy, tmp_path, monkeypatch):
    cut_studies(monkeypatch, 4)
    with run_cluster(tmp_path / "cluster", 2) as two_workers:
        harmed = failing_shards.with_harmful_layout(study, failing_shards.kill_worker, [70])
        finished = execute(harmed, tmp_path / "out", backend="dask", scheduler=two_workers.address)
    assert_crashed(finished.results, healthy, [70])


@pytest.mark.full
@pytest.mark.alone
def test_a_cluster_that_loses_a_worker_goes_on(study, golden, tmp_path, two_workers, monkeypatch):
    cut_studies(monkeypatch, 20)
    before = [p.poll() for p in two_workers.processes].count(None)
    harmed = failing_shards.with_harmful_layout(study, failing_shards.kill_worker, [35], once=tmp_path / "once")
    finished = execute(harmed, tmp_path / "one", backend="dask", scheduler=two_workers.address)
    assert [p.poll() for p in two_workers.processes].count(None) == before - 1
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.full
def test_a_scheduler_that_is_killed_ends_the_run_with_a_sentence(
    small_study, golden, tmp_path, two_workers, monkeypatch
):
    cut_studies(monkeypatch, 16)
    n_before, n_done = 8, []

    def tell(k):
        n_done.append(k)
        if len(n_done) == n_before:
            two_workers.scheduler.kill()

    words = ["run", small_study, "-o", tmp_path / "out", "--backend", "dask"]
    start = time.monotonic()
    with monkeypatch.context() as patch:
        patch.setattr("fastcoil.base.progress.ProgressDisplay.start", lambda *_: tell)
        failing_shards.harm_every_study(patch, failing_shards.sleep_briefly, range(128, 160))
        result = fastcoil(*words, "--scheduler", two_workers.address, "--no-figures")
    assert time.monotonic() - start < 60
    assert result.exit_code == 1
    messages = [line for line in result.stderr.splitlines() if line.startswith("fastcoil: ")]
    assert messages[-1] == "fastcoil: the dask scheduler is gone: start one and run the same command again to resume"
    assert "Traceback" not in result.output
    finished = execute(read_study(small_study), tmp_path / "out")
    assert 0 < finished.n_run <= N_SCENARIOS - 16 * n_before
    assert finished.results.attrs["content_sha256"] == golden
