"""A cluster that a user started and that loses workers or its scheduler: the run continues, or says what to do."""

import signal
import time

import pytest
from click.testing import CliRunner
from helpers import failing_shards
from helpers.processes import N_SCENARIOS, check_crashed, cluster, cut

from fastcoil.cli.main import main
from fastcoil.study.file.spec import read_study
from fastcoil.study.run import execute

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(180), pytest.mark.usefixtures("leaves_nothing")]


@pytest.mark.alone
def test_a_cluster_that_loses_a_worker_goes_on(study, golden, tmp_path, monkeypatch):
    cut(monkeypatch, 10)
    with cluster(tmp_path / "cluster", 2, "--no-nanny") as found:
        with found.client() as client:
            client.wait_for_workers(2, timeout=30)
        harmed = failing_shards.harmful(study, failing_shards.killed, [35], once=tmp_path / "once")
        finished = execute(harmed, tmp_path / "one", backend="dask", scheduler=found.address)
        assert [p.poll() for p in found.processes].count(-signal.SIGKILL) == 1
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.parametrize("n_before", [pytest.param(3, marks=pytest.mark.full), 9])
def test_a_scheduler_that_is_killed_ends_the_run_with_a_sentence(small_study, golden, tmp_path, monkeypatch, n_before):
    cut(monkeypatch, 16)
    with cluster(tmp_path / "cluster", 1, "--no-nanny") as found:
        words = ["run", str(small_study), "-o", str(tmp_path / "out"), "--backend", "dask"]
        n_done = []

        def kill_later(_):
            def tell(k):
                n_done.append(k)
                if len(n_done) == n_before:
                    found.scheduler.kill()

            return tell

        start = time.monotonic()
        with monkeypatch.context() as patch:
            patch.setattr("fastcoil.base.progress.Shown.start", lambda _, n, *__: kill_later(n))
            failing_shards.harms(patch, failing_shards.works_slowly, range(128, 160))
            result = CliRunner().invoke(main, [*words, "--scheduler", found.address, "--no-figures"])
        assert time.monotonic() - start < 60
    assert result.exit_code == 1
    said = [line for line in result.stderr.splitlines() if line.startswith("fastcoil: ")]
    assert said[-1] == "fastcoil: the dask scheduler is gone: start one and run the same command again to resume"
    assert "Traceback" not in result.output
    finished = execute(read_study(small_study), tmp_path / "out")
    assert 0 < finished.n_run <= N_SCENARIOS - 16 * n_before
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.full
def test_a_scenario_that_kills_the_workers_of_a_cluster_is_crashed(study, healthy, tmp_path, monkeypatch):
    cut(monkeypatch, 4)
    with cluster(tmp_path / "cluster", 2) as found:
        harmed = failing_shards.harmful(study, failing_shards.killed, [70])
        finished = execute(harmed, tmp_path / "out", backend="dask", scheduler=found.address)
    check_crashed(finished.results, healthy, [70])
