"""Small studies, child processes and dask clusters for the tests of the backends."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from fastcoil.loops.plan import Shard, cut_into_shards
from fastcoil.model.metric_table import METRICS, STATUS_CRASHED, STATUS_OK

ROOT = Path(__file__).parents[2]

STUDY_TEXT = """
title = "Getriebespiel – Größe Δ"
[loop]
noise_std = 0.02
[sweep]
backlash = { linspace = [0.0, 0.15, 16] }
estimate_ratio = { linspace = [0.0, 1.4, 5] }
[boundary]
hours = 0.25
seed = [1, 2]
[run]
warm_up = 100
traces = ["T_sup", "mode"]
trace_interval = 100
"""
N_SCENARIOS = 160

IGNORED_HELPER = "resource_tracker"
"""Process of the standard library and of loky that ends with the process that uses them."""


def living_descendants(process=None):
    """Return living descendants by process id, without those that end with this process."""
    import psutil

    processes = {}
    for child in psutil.Process(process).children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # ended meanwhile
            if child.status() != psutil.STATUS_ZOMBIE and IGNORED_HELPER not in " ".join(child.cmdline()):
                processes[child.pid] = child
    return processes


def have_ended(processes, seconds):
    """Whether all processes end within some seconds."""
    import psutil

    _, alive = psutil.wait_procs(list(processes), timeout=seconds)
    return not [p for p in alive if p.status() != psutil.STATUS_ZOMBIE]


def wait_for(condition, seconds=30.0, interval=0.02):
    """Wait until a condition holds, and return its value."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if answer := condition():
            return answer
        time.sleep(interval)
    raise AssertionError("waited in vain")


def cut_studies(monkeypatch, size, seed=None, alone=None):
    """Cut studies into shards of ``size`` scenarios, or of random sizes up to it in random order.

    alone: a scenario that is a shard of its own.
    """

    def shards(plan, n_jobs, todo=None):
        if plan.carry_over:
            return cut_into_shards(plan, n_jobs, todo)
        todo = np.arange(plan.n_scenarios) if todo is None else todo
        dice = random.Random(seed)
        per_day = plan.n_scenarios // len(plan.days)
        index_arrays = []
        for day in range(len(plan.days)):
            remaining = todo[(todo >= day * per_day) & (todo < (day + 1) * per_day)]
            if alone in remaining:
                index_arrays.append(np.array([alone]))
                remaining = remaining[remaining != alone]
            while remaining.size:
                n = size if seed is None else dice.randint(1, size)
                index_arrays.append(remaining[:n])
                remaining = remaining[n:]
        if seed is not None:
            dice.shuffle(index_arrays)
        return [Shard(index) for index in index_arrays]

    for module in ("loops.simulate", "study.run"):
        monkeypatch.setattr(f"fastcoil.{module}.cut_into_shards", shards)


def assert_crashed(results, healthy, culprits):
    """Assert that exactly the culprits are crashed and empty, and all others as in a healthy run."""
    crashed = np.flatnonzero(results["status"].values == STATUS_CRASHED)
    assert crashed.tolist() == sorted(culprits)
    others = np.setdiff1d(np.arange(N_SCENARIOS), crashed)
    for name in (*METRICS, "T_sup"):
        values = results[name].values.reshape(N_SCENARIOS, -1)
        expected = healthy[name].values.reshape(N_SCENARIOS, -1)
        assert np.isnan(values[crashed]).all(), name
        np.testing.assert_array_equal(values[others], expected[others], err_msg=name)
    assert (results["status"].values.ravel()[others] == STATUS_OK).all()


def child_environment(**variables):
    """Return the environment of a child process that imports this package and these tests."""
    places = [str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")]
    path = os.pathsep.join(place for place in places if place)  # an empty one is the current folder
    return {**os.environ, "PYTHONPATH": path, **variables}


def start_python(*words, cwd, output=subprocess.PIPE, **env):
    """Start Python in a new process group, as a terminal does; ``output``: of what it prints and of its errors."""
    streams = {"stdin": subprocess.DEVNULL, "stdout": output, "stderr": output, "text": True, "errors": "replace"}
    command = [sys.executable, *map(str, words)]
    return subprocess.Popen(command, cwd=cwd, env=child_environment(**env), start_new_session=True, **streams)


def wait_for_end(process, seconds=60):
    """Return exit code, stdout and stderr of a process; kill it and its group if they do not end."""
    try:
        out, err = process.communicate(timeout=seconds)
    finally:
        kill_group(process)
    return process.returncode, out, err


def kill_group(process):
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait(10)
    for stream in (process.stdout, process.stderr):
        if stream:
            stream.close()


class Cluster:
    """A dask scheduler and its workers as processes on loopback, as a user starts them.

    env: variables of the environment of all of them.
    """

    def __init__(self, folder, protocol="tcp", **env):
        self.folder, self.env = folder, env
        self.processes = []
        file, words = folder / "scheduler.json", ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        self.scheduler = self._start("scheduler", *words, "--protocol", protocol, "--scheduler-file", file)
        self.address = wait_for(lambda: file.exists() and self._address(file))

    @staticmethod
    def _address(file):
        try:
            return json.loads(file.read_text())["address"]
        except ValueError:  # not all of it is written yet
            return None

    def worker(self, *words, **env):
        """Start a worker."""
        return self._start("worker", self.address, "--host", "127.0.0.1", "--nthreads", "1", "--no-dashboard",
                           "--local-directory", self.folder, *words, **env)  # fmt: skip

    def _start(self, *words, **env):
        with (self.folder / f"{words[0]}.log").open("a") as log:
            self.processes.append(start_python("-m", "dask", *words, cwd=self.folder, output=log, **self.env, **env))
        return self.processes[-1]

    @contextmanager
    def client(self):
        """Connect to it as a client."""
        from distributed import Client

        with Client(self.address, set_as_default=False, timeout=20) as client:
            yield client

    def close(self):
        for process in reversed(self.processes):
            kill_group(process)


@contextmanager
def run_cluster(folder, n_workers, *words, **options):
    """Run a cluster with some workers."""
    folder.mkdir(exist_ok=True)
    started_cluster = Cluster(folder, **options)
    try:
        for _ in range(n_workers):
            started_cluster.worker(*words)
        yield started_cluster
    finally:
        started_cluster.close()
