"""Workers that are killed, hang or starve: the guilty scenario is found, the others lack nothing, no one survives."""

from __future__ import annotations

import os
import signal
import threading
import time

import numpy as np
import poison
import psutil
import pytest
from click.testing import CliRunner
from processes import N_SCENARIOS, STUDY, children, cluster, cut, ended, gone, started, wait_for

import fastcoil as fc
from fastcoil.cli import main
from fastcoil.errors import FastcoilError, InputError
from fastcoil.outputs import METRICS, STATUS_CRASHED, STATUS_OK
from fastcoil.study import pools, rounds, spec
from fastcoil.study.pools import make_pool
from fastcoil.study.rounds import Rounds
from fastcoil.study.runner import execute
from fastcoil.study.spec import read_study
from fastcoil.study.store import SHARDS
from fastcoil.study.worker import Job

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(180), pytest.mark.usefixtures("leaves_nothing")]


@pytest.fixture
def study(small_study):
    return read_study(small_study)


@pytest.fixture(scope="session")
def healthy(small_study, tmp_path_factory):
    return fc.run_study(small_study, tmp_path_factory.mktemp("healthy") / "out", n_jobs=1).load()


def check_crashed(found, healthy, culprits):
    """Exactly the culprits are crashed and empty, all others as in a healthy run."""
    crashed = np.flatnonzero(found["status"].values == STATUS_CRASHED)
    assert crashed.tolist() == sorted(culprits)
    others = np.setdiff1d(np.arange(N_SCENARIOS), crashed)
    for name in (*METRICS, "T_sup"):
        values = found[name].values.reshape(N_SCENARIOS, -1)
        expected = healthy[name].values.reshape(N_SCENARIOS, -1)
        assert np.isnan(values[crashed]).all(), name
        np.testing.assert_array_equal(values[others], expected[others], err_msg=name)
    assert (found["status"].values.ravel()[others] == STATUS_OK).all()


def harms(monkeypatch, *how, **options):
    """Have every study that is read harm its workers."""
    read = spec.read_study
    monkeypatch.setattr(spec, "read_study", lambda *words: poison.harmful(read(*words), *how, **options))


@pytest.mark.parametrize(
    ("engine", "harm"),
    [
        ("threads", poison.out_of_memory),
        ("loky", poison.killed),
        pytest.param("loky", poison.exits, marks=pytest.mark.full),
        pytest.param("loky", poison.segfaults, marks=pytest.mark.full),
        pytest.param("loky", poison.out_of_memory, marks=pytest.mark.full),
        ("dask", poison.killed),
        pytest.param("dask", poison.exits, marks=pytest.mark.full),
        pytest.param("dask", poison.segfaults, marks=pytest.mark.full),
        pytest.param("dask", poison.out_of_memory, marks=pytest.mark.full),
    ],
)
def test_a_scenario_that_kills_is_crashed_and_no_other(
    small_study, healthy, tmp_path, monkeypatch, capfd, engine, harm
):
    harms(monkeypatch, harm, [70])
    cut(monkeypatch, 20, alone=70)
    words = ["run", str(small_study), "-o", str(tmp_path / "out"), "--engine", engine, "-j", "1", "--no-figures"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 3, result.output
    assert harm is poison.segfaults or not capfd.readouterr().err
    found = fc.open_study(tmp_path / "out")
    check_crashed(found.stack(flat=found["status"].dims).transpose("flat", ...), healthy, [70])
    found.close()
    assert "1 crashed" in CliRunner().invoke(main, ["status", str(tmp_path / "out")]).output


def check_poisoned(study, healthy, folder, culprits, **options):
    finished = execute(study, folder, **options)
    assert finished.n_run == N_SCENARIOS
    check_crashed(finished.results, healthy, culprits)
    # they are not tried again and again
    assert execute(study, folder, **options).n_run == 0


@pytest.mark.full
@pytest.mark.parametrize("engine", ["threads", "loky", "dask"])
@pytest.mark.parametrize("size", [4, 20])
def test_several_scenarios_that_kill_are_crashed_and_no_other(study, healthy, tmp_path, monkeypatch, engine, size):
    cut(monkeypatch, size)
    culprits = [0, 1, 5, 77, N_SCENARIOS - 1]
    harm = poison.out_of_memory if engine == "threads" else poison.killed
    check_poisoned(poison.harmful(study, harm, culprits), healthy, tmp_path / "out", culprits, engine=engine, n_jobs=2)


def test_several_scenarios_without_memory_are_crashed_and_no_other(study, healthy, tmp_path, monkeypatch):
    cut(monkeypatch, 40)
    culprits = [0, 1, 5, 77, N_SCENARIOS - 1]
    check_poisoned(poison.harmful(study, poison.out_of_memory, culprits), healthy, tmp_path / "out", culprits, n_jobs=2)


@pytest.mark.full
@pytest.mark.parametrize("engine", ["loky", "dask"])
def test_a_worker_that_is_killed_once_costs_nothing_but_time(study, golden, tmp_path, monkeypatch, engine):
    cut(monkeypatch, 10)
    once = tmp_path / "once"
    harmed = poison.harmful(study, poison.killed, [35], once=once)
    finished = execute(harmed, tmp_path / "out", engine=engine, n_jobs=2)
    assert once.exists()
    assert finished.results.attrs["content_sha256"] == golden


def test_a_process_that_someone_kills_costs_nothing_but_time(study, golden, tmp_path, monkeypatch):
    cut(monkeypatch, 4)
    killed = []

    def kill_one(_):
        alive = [pid for pid in children() if pid not in before]
        if not killed and alive:
            killed.append(alive[0])
            os.kill(alive[0], signal.SIGKILL)

    before = children()
    finished = execute(study, tmp_path / "out", engine="loky", n_jobs=2, progress=lambda _: kill_one)
    assert killed
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.parametrize(
    ("engine", "harm"),
    [
        ("loky", poison.stops),
        pytest.param("loky", poison.hangs, marks=pytest.mark.full),
        pytest.param("dask", poison.stops, marks=pytest.mark.full),
        pytest.param("dask", poison.hangs, marks=pytest.mark.full),
    ],
)
def test_a_worker_that_hangs_once_is_replaced(study, golden, tmp_path, monkeypatch, engine, harm):
    cut(monkeypatch, 20)
    monkeypatch.setattr(rounds, "_FIRST_LIMIT", 10.0)
    monkeypatch.setattr(rounds, "_LEAST_LIMIT", 3.0)
    monkeypatch.setattr(rounds, "_LIMIT_FACTOR", 1.0)
    harmed = poison.harmful(study, harm, [35], once=tmp_path / "once")
    finished = execute(harmed, tmp_path / "out", engine=engine, n_jobs=2)
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.full
@pytest.mark.parametrize("engine", ["loky", "dask"])
def test_a_scenario_that_always_hangs_is_crashed_and_no_other(study, tmp_path, monkeypatch, engine):
    job = Job("hangs", poison.harmful(study, poison.hangs, [2]).plan, None)
    pool = make_pool(engine, job, 1, None)
    try:
        start = time.monotonic()
        parts = list(Rounds(pool, job, time_limit=8.0).results([np.arange(2), np.arange(2, 4)]))
    finally:
        pool.close()
    status = {k: s for p in parts for k, s in zip(p["scenario"].values, p["status"].values, strict=True)}
    assert status == {0: STATUS_OK, 1: STATUS_OK, 2: STATUS_CRASHED, 3: STATUS_OK}
    assert time.monotonic() - start < 100


@pytest.mark.parametrize("engine", ["loky", pytest.param("dask", marks=pytest.mark.full)])
def test_workers_that_always_die_end_in_a_sentence_and_leave_nothing(study, tmp_path, monkeypatch, engine):
    monkeypatch.setattr(rounds, "_MOST_DEATHS", 3)
    cut(monkeypatch, 10)
    harmed = poison.harmful(study, poison.killed, range(N_SCENARIOS))
    with pytest.raises(FastcoilError, match="3 workers died in a row without a result") as caught:
        execute(harmed, tmp_path / "out", engine=engine, n_jobs=1)
    assert len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_workers_that_cannot_even_start_end_in_a_sentence(study, tmp_path, monkeypatch):
    monkeypatch.setattr(rounds, "_MOST_DEATHS", 1)
    monkeypatch.setattr(pools, "receive_in_child", poison.does_not_start)
    with pytest.raises(FastcoilError, match="workers died in a row without a result"):
        execute(study, tmp_path / "out", engine="loky", n_jobs=1)
    assert not (tmp_path / "out").exists()


def test_a_process_that_is_short_of_memory_is_replaced(study, golden, tmp_path, monkeypatch):
    cut(monkeypatch, 40)
    harmed = poison.harmful(study, poison.starves, [35], once=tmp_path / "once")
    finished = execute(harmed, tmp_path / "out", engine="loky", n_jobs=1)
    assert (tmp_path / "once").exists()
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.parametrize("engine", ["threads", "loky", "dask"])
def test_an_error_of_the_user_comes_through_and_what_is_finished_is_kept(
    small_study, golden, tmp_path, monkeypatch, engine, two_workers
):
    cut(monkeypatch, 4)
    scheduler = two_workers.address if engine == "dask" else None
    words = ["run", str(small_study), "-o", str(tmp_path / "out"), "--engine", engine, "-j", "1", "--no-figures"]
    with monkeypatch.context() as patch:
        harms(patch, poison.refuses, [100])
        result = CliRunner().invoke(main, words + (["--scheduler", scheduler] if scheduler else []))
    assert result.exit_code == 2, result.output
    assert "fastcoil: this reduction cannot be applied: give another" in result.output
    assert len(list((tmp_path / "out" / SHARDS).iterdir())) >= 20
    finished = execute(read_study(small_study), tmp_path / "out")
    assert 0 < finished.n_run <= N_SCENARIOS - 80
    assert finished.results.attrs["content_sha256"] == golden


def test_the_error_of_a_thread_is_that_of_the_user(study, tmp_path):
    with pytest.raises(InputError, match="give another"):
        execute(poison.harmful(study, poison.refuses, [0]), tmp_path / "out", n_jobs=2)


# ---- a cluster that a user started


def test_a_cluster_that_loses_a_worker_goes_on(study, golden, tmp_path, monkeypatch):
    cut(monkeypatch, 10)
    with cluster(tmp_path / "cluster", 2, "--no-nanny") as found:
        with found.client() as client:
            client.wait_for_workers(2, timeout=30)
        harmed = poison.harmful(study, poison.killed, [35], once=tmp_path / "once")
        finished = execute(harmed, tmp_path / "out", engine="dask", scheduler=found.address)
        assert [p.poll() for p in found.processes].count(-signal.SIGKILL) == 1
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.parametrize("harm", [poison.killed, pytest.param(poison.stops, marks=pytest.mark.full)])
def test_a_cluster_that_loses_all_its_workers_is_told_and_no_scenario_blamed(
    study, golden, tmp_path, monkeypatch, harm
):
    cut(monkeypatch, 10)
    monkeypatch.setattr(rounds, "_LEAST_LIMIT", 2.0)
    monkeypatch.setattr(rounds, "_LIMIT_FACTOR", 1.0)
    with cluster(tmp_path / "cluster", 1, "--no-nanny") as found:
        harmed = poison.harmful(study, harm, [135])
        with pytest.raises(FastcoilError, match="its workers are gone, busy with something else or hang"):
            execute(harmed, tmp_path / "out", engine="dask", scheduler=found.address)
    finished = execute(study, tmp_path / "out")
    assert finished.n_run <= 60
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.parametrize("n_before", [pytest.param(10, marks=pytest.mark.full), 38])
def test_a_scheduler_that_is_killed_ends_the_run_with_a_sentence(small_study, golden, tmp_path, monkeypatch, n_before):
    cut(monkeypatch, 4)
    with cluster(tmp_path / "cluster", 1, "--no-nanny") as found:
        words = ["run", str(small_study), "-o", str(tmp_path / "out"), "--engine", "dask"]
        n_done = []

        def kill_later(n, _=0):
            def tell(k):
                n_done.append(k)
                if len(n_done) == n_before:
                    found.scheduler.kill()

            return tell

        start = time.monotonic()
        with monkeypatch.context() as patch:
            patch.setattr("fastcoil.cli.told", kill_later)
            harms(patch, poison.works_slowly, range(152, 160))
            result = CliRunner().invoke(main, [*words, "--scheduler", found.address, "--no-figures"])
        assert time.monotonic() - start < 60
    assert result.exit_code == 1
    said = [line for line in result.stderr.splitlines() if line.startswith("fastcoil: ")]
    assert said[-1] == "fastcoil: the dask scheduler is gone: start one and run the same command again to go on"
    assert "Traceback" not in result.output
    finished = execute(read_study(small_study), tmp_path / "out")
    assert 0 < finished.n_run <= N_SCENARIOS - 4 * n_before
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.full
def test_a_scenario_that_kills_the_workers_of_a_cluster_is_crashed(study, healthy, tmp_path, monkeypatch):
    cut(monkeypatch, 4)
    with cluster(tmp_path / "cluster", 2) as found:
        harmed = poison.harmful(study, poison.killed, [70])
        finished = execute(harmed, tmp_path / "out", engine="dask", scheduler=found.address)
    check_crashed(finished.results, healthy, [70])


# ---- a run that is interrupted or killed


@pytest.fixture
def slow_run(tmp_path):
    """Start the command line on a study whose shards take half a second each."""
    (tmp_path / "small.toml").write_text(STUDY, encoding="utf-8")
    script = (
        "import sys, poison, processes, pytest\n"
        "from fastcoil.study import spec\n"
        "patch = pytest.MonkeyPatch()\n"
        "processes.cut(patch, 4)\n"
        "read = spec.read_study\n"
        "spec.read_study = lambda *words: poison.harmful(read(*words), poison.works_slowly, range(160))\n"
        "from fastcoil.__main__ import run\n"
        "sys.argv[1:] = sys.argv[2:]\n"
        "if __name__ == '__main__':\n"
        "    run()\n"
    )
    (tmp_path / "slow.py").write_text(script)
    runs = []

    def begun(engine):
        words = ("slow.py", "-", "run", "small.toml", "-o", "out", "--engine", engine, "-j", "2", "--no-figures")
        runs.append(started(*words, cwd=tmp_path, DASK_TEMPORARY_DIRECTORY=str(tmp_path / "dask")))
        wait_for(lambda: len(list((tmp_path / "out" / SHARDS).glob("*.nc"))) >= 3, within=60)
        return runs[-1]

    yield begun
    for run in runs:
        ended(run, 1)


def resumed(folder, golden):
    finished = execute(read_study(folder / "small.toml"), folder / "out")
    assert 0 < finished.n_run < N_SCENARIOS
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.parametrize("engine", ["threads", "loky", "dask"])
def test_ctrl_c_ends_a_run_at_once_and_it_can_go_on(slow_run, golden, tmp_path, engine):
    run = slow_run(engine)
    workers = children(run.pid)
    os.killpg(run.pid, signal.SIGINT)
    start = time.monotonic()
    code, _, err = ended(run, 20)
    assert time.monotonic() - start < 5
    assert code == 130
    assert err.strip().splitlines()[-1].startswith("fastcoil: interrupted; what was finished is kept, to go on:")
    assert "Traceback" not in err
    assert gone(workers.values(), 2)
    resumed(tmp_path, golden)


@pytest.mark.full
@pytest.mark.parametrize("engine", ["loky", "dask"])
def test_ctrl_c_twice_ends_a_run_at_once_too(slow_run, golden, tmp_path, engine):
    run = slow_run(engine)
    workers = children(run.pid)
    for _ in range(2):
        os.killpg(run.pid, signal.SIGINT)
        time.sleep(0.1)
    assert ended(run, 10)[0] == 130
    assert gone(workers.values(), 3)
    resumed(tmp_path, golden)


@pytest.mark.full
@pytest.mark.parametrize("engine", ["loky", "dask"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_batch_system_that_ends_a_run_leaves_no_worker(slow_run, golden, tmp_path, engine, number):
    run = slow_run(engine)
    workers = children(run.pid)
    run.send_signal(number)
    code, _, err = ended(run, 20)
    assert code == 143
    assert "Traceback" not in err
    assert gone(workers.values(), 2)
    resumed(tmp_path, golden)


@pytest.mark.parametrize("engine", ["loky", pytest.param("dask", marks=pytest.mark.full)])
def test_no_worker_outlives_a_run_that_is_killed(slow_run, golden, tmp_path, engine):
    run = slow_run(engine)
    workers = [p for p in psutil.Process(run.pid).children(recursive=True)]
    assert len(workers) >= 2
    run.kill()
    assert gone(workers, 2), [p.cmdline() for p in workers if p.is_running()]
    written = sorted((tmp_path / "out").rglob("*"))
    time.sleep(1)
    assert sorted((tmp_path / "out").rglob("*")) == written
    resumed(tmp_path, golden)


def test_a_run_in_a_thread_works(small_study, golden, tmp_path):
    # as a notebook or a graphical interface does; signals are only for the main thread
    found = []

    def run():
        found.append(fc.run_study(small_study, tmp_path / "out", engine="loky", n_jobs=1))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(100)
    assert found[0].attrs["content_sha256"] == golden
