"""Where shards are run: threads of this process, processes of this machine, or a dask cluster.

A pool takes shards as ``concurrent.futures`` do; what it does when a worker dies is all that differs.
"""

from __future__ import annotations

import concurrent.futures as cf
import logging
import warnings
from typing import Any, Protocol

import numpy as np

from fastcoil.errors import FastcoilError, InputError
from fastcoil.numerics.jit import fingerprint, model_sha256
from fastcoil.study.worker import Job, computed, receive, receive_in_child, work

ENGINES = ("threads", "loky", "dask")
_WAIT_FOR_WORKERS = 60.0


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

        return ProcessPoolExecutor(self.n_workers, initializer=receive_in_child, initargs=(self._job,))

    def submit(self, index: np.ndarray) -> cf.Future[Any]:
        return self._executor.submit(work, self._job.key, index)  # type: ignore[no-any-return]

    def restart(self) -> None:
        self.close()
        self._executor = self._started()

    def close(self) -> None:
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
        self.deaths: tuple[type[BaseException], ...] = (distributed.KilledWorker, MemoryError)
        self._cluster = None
        try:
            if scheduler is None:
                self._cluster = distributed.LocalCluster(
                    n_workers=n_workers, threads_per_worker=1, dashboard_address=None, silence_logs=logging.CRITICAL
                )
            self._client = distributed.Client(scheduler or self._cluster, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"no dask scheduler answers at {scheduler!r} ({error}): give the address it printed when it started, "
                "such as tcp://host:8786"
            ) from None
        try:
            self._client.wait_for_workers(1 if scheduler else n_workers, timeout=_WAIT_FOR_WORKERS)
            self._check_workers()
            self._client.register_plugin(_plugin(job))
        except (TimeoutError, cf.TimeoutError):
            self.close()
            raise InputError(
                f"the dask scheduler at {scheduler} has no workers: start one with `dask worker {scheduler}`"
            ) from None
        except BaseException:
            self.close()
            raise
        self.n_workers = sum(self._client.nthreads().values())
        self._executor = self._client.get_executor(pure=False)
        self._key = job.key

    def _check_workers(self) -> None:
        """Refuse workers that would not find the same bits."""
        found = self._client.run(_identity)
        models, machines = ({identity[k] for identity in found.values()} for k in (0, 1))
        if models != {model_sha256()}:
            raise InputError(
                "the workers of the dask cluster run another version of fastcoil: install the one of this process there"
            )
        if len(machines) > 1:
            raise InputError(
                "the workers of the dask cluster differ in CPU, Python or library versions, so that results would "
                "depend on who computes them: use workers of one kind"
            )

    def submit(self, index: np.ndarray) -> cf.Future[Any]:
        if self._client.status != "running":
            raise FastcoilError("the dask scheduler is gone: start one and run the same command again to go on")
        return self._executor.submit(work, self._key, index)  # type: ignore[no-any-return]

    def restart(self) -> None:
        if self._cluster is not None:  # a foreign cluster has other users, and replaces its workers itself
            self._client.restart(wait_for_workers=True, timeout=_WAIT_FOR_WORKERS)

    def close(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._client.close(timeout=5)
            if self._cluster is not None:
                self._cluster.close(timeout=5)


def make_pool(engine: str, job: Job, n_workers: int, scheduler: str | None) -> Pool:
    """Start the workers of an engine."""
    if engine == "dask":
        return Dask(job, n_workers, scheduler)
    return Loky(job, n_workers) if engine == "loky" else Threads(job, n_workers)


def engine_problems(engine: str, scheduler: str | None) -> list[str]:
    """What is wrong with the choice of an engine."""
    if engine not in ENGINES:
        return [f"engine = {engine!r}: choose one of {', '.join(ENGINES)}"]
    if scheduler is not None and engine != "dask":
        return [f"scheduler = {scheduler!r}: only the engine dask has one, choose it or leave scheduler out"]
    return []


def _identity() -> tuple[str, str]:
    return model_sha256(), fingerprint()


def _plugin(job: Job) -> Any:
    """Hands the job to every worker of a cluster, also to those that join later."""
    from distributed import WorkerPlugin

    class Receive(WorkerPlugin):  # type: ignore[misc]
        name = f"fastcoil-{job.key}"

        def setup(self, worker: object) -> None:
            receive(job)

    return Receive()
