"""Where shards are run: threads of this process, processes of this machine, or a dask cluster.

A pool takes shards as ``concurrent.futures`` do; what it does when a worker dies is all that differs.
"""

from __future__ import annotations

import asyncio
import concurrent.futures as cf
import contextlib
import logging
import os
import queue
import threading
import uuid
import warnings
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from fastcoil.errors import FastcoilError, InputError
from fastcoil.numerics.jit import model_sha256
from fastcoil.study.workers.worker import (
    Job,
    computed,
    forget,
    identity,
    leave_interrupts,
    receive,
    receive_in_child,
    work,
)

ENGINES = ("threads", "loky", "dask")
_WAIT_FOR_SCHEDULER, _WAIT_FOR_WORKERS = 10.0, 60.0


class Pool(Protocol):
    """Workers that run shards of one job.

    deaths: exceptions that say that the worker of a shard is gone.  falls_together: whether the shards in flight
    are lost with it.  can_kill: whether a shard that hangs can be stopped.
    """

    n_workers: int
    deaths: tuple[type[BaseException], ...]
    falls_together: bool
    can_kill: bool

    def submit(self, index: np.ndarray) -> cf.Future[Any]:
        """Start the scenarios ``index``; the future gives their flat Dataset."""

    def restart(self) -> None:
        """Replace workers that died or hang."""

    def close(self) -> None:
        """Stop all workers; what is in flight is lost."""


class Threads:
    """Threads: the kernels release the interpreter's lock, and nothing is copied."""

    deaths: tuple[type[BaseException], ...] = (MemoryError,)
    falls_together = False
    can_kill = False

    def __init__(self, job: Job, n_workers: int) -> None:
        self.n_workers = n_workers
        self._job = job
        self._executor = cf.ThreadPoolExecutor(n_workers)

    def submit(self, index: np.ndarray) -> cf.Future[Any]:
        return self._executor.submit(computed, self._job, index)

    def restart(self) -> None:
        pass

    def close(self) -> None:
        self._executor.shutdown(wait=False, cancel_futures=True)


class Loky:
    """Processes: a scenario, or a user's reduction, that crashes takes only its worker down."""

    deaths: tuple[type[BaseException], ...] = (cf.BrokenExecutor, MemoryError)
    falls_together = True
    can_kill = True

    def __init__(self, job: Job, n_workers: int) -> None:
        self.n_workers = n_workers
        self._job = job
        self._executor = self._started()

    def _started(self) -> Any:
        from joblib.externals.loky import ProcessPoolExecutor

        return ProcessPoolExecutor(self.n_workers, initializer=receive_in_child, initargs=(self._job, os.getpid()))

    def submit(self, index: np.ndarray) -> cf.Future[Any]:
        return self._executor.submit(work, self._job.key, index)  # type: ignore[no-any-return]

    def restart(self) -> None:
        self.close()
        self._executor = self._started()

    def close(self) -> None:
        # it forgets what is pending, but not the numbers of it, which it then looks for in vain
        with contextlib.suppress(queue.Empty, AttributeError):
            while True:
                self._executor._work_ids.get_nowait()
        self._executor.shutdown(wait=True, kill_workers=True)


class Dask:
    """A dask cluster: the one at ``scheduler``, or one of this machine's processes."""

    falls_together = False
    can_kill = True

    def __init__(self, job: Job, n_workers: int, scheduler: str | None) -> None:
        try:
            import distributed
        except ImportError:
            raise InputError(
                "the engine dask needs the packages dask and distributed: pip install 'fastcoil[dask]'"
            ) from None
        # a future is cancelled when the scheduler is lost
        self.deaths: tuple[type[BaseException], ...] = (distributed.KilledWorker, cf.CancelledError, MemoryError)
        self._job = job._replace(key=f"{job.key}-{uuid.uuid4().hex}")  # two runs of a study may share a cluster
        self._scheduler, self._n_asked = scheduler, n_workers
        self._cluster: Any = None
        self._client: Any = None
        self._start()

    def _start(self) -> None:
        try:
            if self._scheduler is None:
                self._cluster = _cluster_here(self._n_asked)
            self._client = _connected(self._cluster or self._scheduler)
            self._equip_workers()
        except BaseException:
            self.close()
            raise
        self.n_workers = sum(self._client.nthreads().values())
        self._executor = self._client.get_executor(pure=False)

    def _equip_workers(self) -> None:
        plugin = _plugin(self._job, ours=self._cluster is not None)
        try:
            self._client.wait_for_workers(1 if self._scheduler else self._n_asked, timeout=_WAIT_FOR_WORKERS)
            self._identity = _within(_WAIT_FOR_WORKERS, self._checked_identity)
            _within(_WAIT_FOR_WORKERS, lambda: self._client.register_plugin(plugin))
        except TimeoutError:
            at = f" at {self._scheduler}" if self._scheduler else ""
            raise InputError(
                f"the dask scheduler{at} has no workers, or one that does not answer: start one with "
                f"`dask worker {self._scheduler or ''}`"
            ) from None

    def _checked_identity(self) -> tuple[str, str]:
        """What all workers are; those that would not find the same bits are refused."""
        found: set[tuple[str, str]] = set(self._client.run(identity).values())
        if {model for model, _ in found} != {model_sha256()}:
            raise InputError(
                "the workers of the dask cluster run another version of fastcoil: install the one of this process there"
            )
        if len(found) > 1:
            raise InputError(
                "the workers of the dask cluster differ in CPU, Python or library versions, so that results would "
                "depend on who computes them: use workers of one kind"
            )
        return found.pop()

    def submit(self, index: np.ndarray) -> cf.Future[Any]:
        if self._client.status != "running":
            raise FastcoilError("the dask scheduler is gone: start one and run the same command again to go on")
        return self._executor.submit(work, self._job.key, index, self._identity)  # type: ignore[no-any-return]

    def restart(self) -> None:
        if self._scheduler is not None:  # it has other users, and replaces its workers itself if it can
            raise FastcoilError(
                f"the dask cluster at {self._scheduler} gives no answer any more: its workers are gone, busy with "
                "something else or hang; mend it and run the same command again to go on"
            )
        self.close()
        self._start()

    def close(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if self._client is not None:
                if self._cluster is None and self._client.status == "running":
                    with contextlib.suppress(Exception):  # what is left there is only memory
                        _within(5.0, lambda: self._client.unregister_worker_plugin(_plugin_name(self._job)))
                self._client.close(timeout=5)
            if self._cluster is not None:
                self._cluster.close(timeout=5)


def _cluster_here(n_workers: int) -> Any:
    import distributed

    # shards that kill are tried again by who knows how to halve them; no port that another cluster may have
    quiet = {"allowed_failures": 0, "dashboard": False, "dashboard_address": "127.0.0.1:0"}
    try:
        return distributed.LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            scheduler_kwargs=quiet,
        )
    except RuntimeError as error:
        raise InputError(
            f"the workers of a dask cluster on this machine do not start ({error}): call it in a script only under "
            "if __name__ == '__main__', or use the engine loky, which needs no such line"
        ) from None


def _connected(address: Any) -> Any:
    import distributed

    try:
        if isinstance(address, str):
            with cf.ThreadPoolExecutor(1) as thread:  # in a notebook this one has a loop of its own
                thread.submit(lambda: asyncio.run(_answers(address))).result()
        return distributed.Client(address, timeout=_WAIT_FOR_SCHEDULER, set_as_default=False)
    except Exception as error:  # whatever the library makes of what a stranger says
        reason = str(error) or type(error).__name__
        raise InputError(
            f"no dask scheduler answers at {address!r} ({reason}): give the address it printed when it started, "
            "such as tcp://host:8786"
        ) from None


def _within(seconds: float, call: Callable[[], Any]) -> Any:
    """What a call gives; a TimeoutError if it takes longer, as one to a worker that was stopped."""
    found: cf.Future[Any] = cf.Future()

    def run() -> None:
        try:
            found.set_result(call())
        except BaseException as error:
            found.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return found.result(seconds)


async def _answers(address: str) -> None:
    """Raise an exception if nobody speaks dask there; the client would wait without end for one who is silent."""
    from distributed.comm import connect

    comm = await asyncio.wait_for(connect(address, timeout=_WAIT_FOR_SCHEDULER), _WAIT_FOR_SCHEDULER)
    comm.abort()


def make_pool(engine: str, job: Job, n_workers: int, scheduler: str | None) -> Pool:
    """Start the workers of an engine."""
    if engine == "dask":
        return Dask(job, n_workers, scheduler)
    return Loky(job, n_workers) if engine == "loky" else Threads(job, n_workers)


def engine_problems(engine: str, scheduler: str | None) -> list[str]:
    """What is wrong with the choice of an engine."""
    if engine not in ENGINES:
        return [f"engine = {engine!r}: choose one of {', '.join(ENGINES)}"]
    if scheduler == "":
        return ["scheduler is empty: give an address such as tcp://host:8786, or leave it out"]
    if scheduler is not None and engine != "dask":
        return [f"scheduler = {scheduler!r}: only the engine dask has one, choose it or leave scheduler out"]
    return []


def _plugin_name(job: Job) -> str:
    return f"fastcoil-{job.key}"


def _plugin(job: Job, *, ours: bool) -> Any:
    """Hands the job to every worker of a cluster, also to those that join later.

    ours: whether the workers are children of this process, and in the foreground of the same terminal.
    """
    from distributed import WorkerPlugin

    class Receive(WorkerPlugin):  # type: ignore[misc]
        name = _plugin_name(job)

        def setup(self, worker: object) -> None:
            if ours:
                leave_interrupts()
            receive(job)

        def teardown(self, worker: object) -> None:
            forget(job.key)

    return Receive()
