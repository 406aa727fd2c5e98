"""A run that is interrupted, ended or killed: no worker survives it, and it can be resumed."""

import os
import re
import signal
import threading
import time

import psutil
import pytest
from helpers.processes import (
    N_SCENARIOS,
    STUDY_TEXT,
    have_ended,
    living_descendants,
    start_python,
    wait_for,
    wait_for_end,
)

import fastcoil as fc
from fastcoil.study.file.spec import read_study
from fastcoil.study.folder.stored import SHARDS_FOLDER
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
    (tmp_path / "small.toml").write_text(STUDY_TEXT, encoding="utf-8")
    script = (
        "import sys, pytest\n"
        "from helpers import failing_shards, processes\n"
        "patch = pytest.MonkeyPatch()\n"
        "processes.cut_studies(patch, 10)\n"
        "failing_shards.harm_every_study(patch, failing_shards.sleep_briefly, range(160))\n"
        "from fastcoil.__main__ import run\n"
        "sys.argv[1:] = sys.argv[2:]\n"
        "if __name__ == '__main__':\n"
        "    run()\n"
    )
    (tmp_path / "slow.py").write_text(script)
    runs = []

    def start():
        words = ("slow.py", "-", "run", "small.toml", "-o", "out", "--backend", "loky", "-j", 1, "--no-figures")
        runs.append(start_python(*words, cwd=tmp_path))
        wait_for(lambda: len(list((tmp_path / "out" / SHARDS_FOLDER).glob("*.nc"))) >= 1, seconds=60)
        return runs[-1]

    yield start
    for run in runs:
        wait_for_end(run, 1)


def finish(folder, golden):
    finished = execute(read_study(folder / "small.toml"), folder / "out")
    assert 0 < finished.n_run < N_SCENARIOS
    assert finished.results.attrs["content_sha256"] == golden


@pytest.mark.parametrize(
    ("number", "times", "code"),
    [
        (signal.SIGINT, 1, 130),
        pytest.param(signal.SIGINT, 2, 130, marks=pytest.mark.full),
        pytest.param(signal.SIGTERM, 1, 143, marks=pytest.mark.full),
    ],
)
def test_a_signal_ends_a_run_and_its_workers_at_once_and_it_can_go_on(slow_run, golden, tmp_path, number, times, code):
    run = slow_run()
    workers = living_descendants(run.pid)
    assert workers
    start = time.monotonic()
    for _ in range(times):
        os.killpg(run.pid, number)
        time.sleep(0.1)
    ended_with, _, err = wait_for_end(run, 20)
    assert time.monotonic() - start < 5
    assert ended_with == code
    kept = r"[1-9]\d* of \d+ scenario-days|finished scenarios"
    assert re.search(f"interrupted; ({kept}) are kept, to resume: ", err.splitlines()[-1])
    assert "Traceback" not in err
    assert have_ended(workers.values(), 2)
    finish(tmp_path, golden)


@pytest.mark.full
def test_no_worker_outlives_a_run_that_is_killed(slow_run, golden, tmp_path):
    run = slow_run()
    workers = [p for p in psutil.Process(run.pid).children(recursive=True)]
    assert len(workers) >= 2
    run.kill()
    assert have_ended(workers, 2), [p.cmdline() for p in workers if p.is_running()]
    written = sorted((tmp_path / "out").rglob("*"))
    time.sleep(0.6)
    assert sorted((tmp_path / "out").rglob("*")) == written
    finish(tmp_path, golden)


def test_a_run_in_a_thread_works(small_study, golden, tmp_path):
    # as a notebook or a graphical interface does; signals are only for the main thread
    results = []

    def run():
        results.append(fc.run_study(small_study, tmp_path / "out", n_jobs=1))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(100)
    assert results[0].attrs["content_sha256"] == golden
