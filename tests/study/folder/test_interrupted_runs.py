"""A run that is interrupted, ended or killed: no worker survives it, and it can be resumed."""

import os
import signal
import threading
import time

import psutil
import pytest
from helpers.processes import N_SCENARIOS, STUDY, children, ended, gone, started, wait_for

import fastcoil as fc
from fastcoil.study.file.spec import read_study
from fastcoil.study.folder.shards import SHARDS
from fastcoil.study.run import execute

pytestmark = [
    pytest.mark.kernel,
    pytest.mark.alone,
    pytest.mark.timeout(180),
    pytest.mark.usefixtures("leaves_nothing"),
]


@pytest.fixture
def slow_run(tmp_path):
    """Start the command line on a study whose shards take half a second each."""
    (tmp_path / "small.toml").write_text(STUDY, encoding="utf-8")
    script = (
        "import sys, pytest\n"
        "from helpers import failing_shards, processes\n"
        "patch = pytest.MonkeyPatch()\n"
        "processes.cut(patch, 10)\n"
        "failing_shards.harms(patch, failing_shards.works_slowly, range(160))\n"
        "from fastcoil.__main__ import run\n"
        "sys.argv[1:] = sys.argv[2:]\n"
        "if __name__ == '__main__':\n"
        "    run()\n"
    )
    (tmp_path / "slow.py").write_text(script)
    runs = []

    def start(backend, n_jobs=2):
        words = ("slow.py", "-", "run", "small.toml", "-o", "out", "--backend", backend, "-j", n_jobs, "--no-figures")
        runs.append(started(*words, cwd=tmp_path))
        wait_for(lambda: len(list((tmp_path / "out" / SHARDS).glob("*.nc"))) >= 2, within=60)
        return runs[-1]

    yield start
    for run in runs:
        ended(run, 1)


def resumed(folder, golden):
    finished = execute(read_study(folder / "small.toml"), folder / "out")
    assert 0 < finished.n_run < N_SCENARIOS
    assert finished.results.attrs["content_sha256"] == golden


# for threads, see the commands that are interrupted
@pytest.mark.parametrize("backend", ["loky", pytest.param("threads", marks=pytest.mark.full)])
def test_ctrl_c_ends_a_run_at_once_and_it_can_go_on(slow_run, golden, tmp_path, backend):
    run = slow_run(backend, n_jobs=1)  # two in the tests of other signals
    workers = children(run.pid)
    assert workers or backend == "threads"
    os.killpg(run.pid, signal.SIGINT)
    start = time.monotonic()
    code, _, err = ended(run, 20)
    assert time.monotonic() - start < 5
    assert code == 130
    last = err.splitlines()[-1]
    assert last.startswith("fastcoil: interrupted; finished scenarios are kept, to resume:")
    assert "Traceback" not in err
    assert gone(workers.values(), 2)
    resumed(tmp_path, golden)


@pytest.mark.full
def test_ctrl_c_twice_ends_a_run_at_once_too(slow_run, golden, tmp_path):
    run = slow_run("loky")
    workers = children(run.pid)
    for _ in range(2):
        os.killpg(run.pid, signal.SIGINT)
        time.sleep(0.1)
    assert ended(run, 10)[0] == 130
    assert gone(workers.values(), 3)
    resumed(tmp_path, golden)


@pytest.mark.full
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_batch_system_that_ends_a_run_leaves_no_worker(slow_run, golden, tmp_path, number):
    run = slow_run("loky")
    workers = children(run.pid)
    run.send_signal(number)
    code, _, err = ended(run, 20)
    assert code == 143
    assert "Traceback" not in err
    assert gone(workers.values(), 2)
    resumed(tmp_path, golden)


def test_no_worker_outlives_a_run_that_is_killed(slow_run, golden, tmp_path):
    run = slow_run("loky")
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
        found.append(fc.run_study(small_study, tmp_path / "out", backend="loky", n_jobs=1))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(100)
    assert found[0].attrs["content_sha256"] == golden
