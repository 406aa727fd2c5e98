"""Where shards are run: threads of this process, processes of this machine, or a dask cluster.

A pool takes shards as ``concurrent.futures`` do; pools differ only in what happens when a worker dies.
"""

from __future__ import annotations

import concurrent.futures as cf
import contextlib
import os
import pickle
import queue
import tempfile
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fastcoil.base.errors import InputError, shown
from fastcoil.base.files import storage_errors
from fastcoil.loops.shards import Shard, Stretch
from fastcoil.study.workers.dask_cluster import Dask
from fastcoil.study.workers.worker import Job, receive_in_child, run_from_file, run_received, run_scenarios

BACKENDS = ("threads", "loky", "dask")
_TEMPORARY = Path("the folder for temporary files")


class Pool(Protocol):
    """Workers that run shards of one job.

    deaths: exceptions that say that the worker of a shard is gone.  falls_together: whether the shards in flight
    are lost with it.  can_kill: whether a shard that hangs can be stopped.  shared: whether others may keep the workers
    busy.  has_workers: whether there were any when it was last asked what waits.
    """

    n_workers: int
    has_workers: bool
    deaths: tuple[type[BaseException], ...]
    falls_together: bool
    can_kill: bool
    shared: bool

    def submit(self, shard: Shard | Stretch) -> cf.Future[Any]:
        """Start a shard; the future gives its flat Dataset."""

    def waiting(self, futures: Sequence[cf.Future[Any]]) -> Collection[cf.Future[Any]]:
        """Of unfinished shards, in the order in which they were submitted, those that no worker runs yet."""

    def restart(self) -> None:
        """Replace workers that died or hang."""

    def close(self) -> None:
        """Stop all workers; shards in flight are lost."""


class Threads:
    """Threads: the kernels release the interpreter's lock, and nothing is copied."""

    deaths: tuple[type[BaseException], ...] = (MemoryError,)
    falls_together = False
    can_kill = False
    shared = False
    has_workers = True

    def __init__(self, job: Job, n_workers: int) -> None:
        self.n_workers = n_workers
        self._job = job
        self._executor = cf.ThreadPoolExecutor(n_workers)

    def submit(self, shard: Shard | Stretch) -> cf.Future[Any]:
        return self._executor.submit(run_scenarios, self._job, shard)

    def waiting(self, futures: Sequence[cf.Future[Any]]) -> Collection[cf.Future[Any]]:
        return futures[self.n_workers :]

    def restart(self) -> None:
        pass

    def close(self) -> None:
        self._executor.shutdown(wait=False, cancel_futures=True)


class Loky:
    """Processes: a scenario, or a user's reduction, that crashes takes only its worker down."""

    deaths: tuple[type[BaseException], ...] = (cf.BrokenExecutor, MemoryError)
    falls_together = True
    can_kill = True
    shared = False
    has_workers = True

    def __init__(self, job: Job, n_workers: int) -> None:
        self.n_workers = n_workers
        self._job = job
        self._executor = self._start()

    def _start(self) -> Any:
        from joblib.externals.loky import ProcessPoolExecutor

        # the library writes what a process starts with into a pipe, and waits for ever if that process is dead before
        # it has read all of it
        with storage_errors(_TEMPORARY, "written"):
            self._folder = tempfile.TemporaryDirectory(prefix="fastcoil-")
            started_with = (Path(self._folder.name) / "job", os.getpid())
            with started_with[0].open("wb") as file:
                pickle.dump(self._job, file)
        return ProcessPoolExecutor(self.n_workers, initializer=receive_in_child, initargs=started_with)

    def submit(self, shard: Shard | Stretch) -> cf.Future[Any]:
        if not isinstance(shard, Stretch) or shard.begins is None:
            return self._executor.submit(run_received, self._job.key, shard)  # type: ignore[no-any-return]
        path = Path(self._folder.name) / f"{shard.index[0]}.npy"
        with storage_errors(_TEMPORARY, "written"):
            np.save(path, shard.begins)
        task = run_from_file, self._job.key, replace(shard, begins=None), path
        return self._executor.submit(*task)  # type: ignore[no-any-return]

    def waiting(self, futures: Sequence[cf.Future[Any]]) -> Collection[cf.Future[Any]]:
        return futures[self.n_workers :]  # first come, first served

    def restart(self) -> None:
        self.close()
        self._executor = self._start()

    def close(self) -> None:
        # the library forgets pending work but keeps its numbers, and then looks for them in vain
        with contextlib.suppress(queue.Empty, AttributeError):
            while True:
                self._executor._work_ids.get_nowait()
        self._executor.shutdown(wait=True, kill_workers=True)
        with contextlib.suppress(OSError):  # others clean up there, too
            self._folder.cleanup()


def make_pool(backend: str, job: Job, n_workers: int, scheduler: str | None) -> Pool:
    """Start the workers of a backend."""
    if backend == "dask":
        return Dask(job, n_workers, scheduler)
    return Loky(job, n_workers) if backend == "loky" else Threads(job, n_workers)


def resolve_backend(backend: str | None, engine: str | None) -> str:
    """The backend to use, ``threads`` by default; ``engine`` is its earlier name.

    Raises
    ------
    InputError
        If the two differ.
    """
    if backend is not None and engine is not None and backend != engine:
        raise InputError(
            f"backend = {backend!r} and engine = {engine!r} differ: engine is the earlier name of backend, give "
            "backend alone"
        )
    return next((given for given in (backend, engine) if given is not None), "threads")


def backend_problems(backend: str, scheduler: str | None) -> list[str]:
    """What is wrong with the choice of a backend."""
    if backend not in BACKENDS:
        return [f"backend = {shown(backend)}: choose one of {', '.join(BACKENDS)}"]
    if scheduler == "":
        return ["scheduler is empty: give an address such as tcp://host:8786, or leave it out"]
    if scheduler is not None and backend != "dask":
        return [f"scheduler = {shown(scheduler)}: only the backend dask has one, choose it or leave scheduler out"]
    return []
