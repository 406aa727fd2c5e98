"""Shards on a dask cluster: the one at an address, or one of this machine's processes."""

from __future__ import annotations

import asyncio
import concurrent.futures as cf
import contextlib
import logging
import threading
import uuid
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from fastcoil.errors import FastcoilError, InputError
from fastcoil.numerics.jit import model_sha256
from fastcoil.study.workers.worker import Job, forget, identity, leave_interrupts, receive, run_received

_WAIT_FOR_SCHEDULER, _WAIT_FOR_WORKERS = 10.0, 60.0
"""Seconds."""


class Dask:
    """A dask cluster: the one at ``scheduler``, or one of this machine's processes."""

    falls_together = False
    can_kill = True

    def __init__(self, job: Job, n_workers: int, scheduler: str | None) -> None:
        try:
            import distributed
        except ImportError:
            raise InputError(
                "the backend dask needs the packages dask and distributed: pip install 'fastcoil[dask]'"
            ) from None
        # when the scheduler is lost, futures are cancelled
        self.deaths: tuple[type[BaseException], ...] = (distributed.KilledWorker, cf.CancelledError, MemoryError)
        self._job = job._replace(key=f"{job.key}-{uuid.uuid4().hex}")  # two runs of a study may share a cluster
        self._scheduler, self._n_asked = scheduler, n_workers
        self._cluster: Any = None
        self._client: Any = None
        self._start()

    def _start(self) -> None:
        try:
            if self._scheduler is None:
                self._cluster = _start_local_cluster(self._n_asked)
            self._client = _connect(self._cluster or self._scheduler)
            self._equip_workers()
        except BaseException:
            self.close()
            raise
        self.n_workers = sum(self._client.nthreads().values())
        self._executor = self._client.get_executor(pure=False)

    def _equip_workers(self) -> None:
        plugin = _make_plugin(self._job, ours=self._cluster is not None)
        try:
            self._client.wait_for_workers(1 if self._scheduler else self._n_asked, timeout=_WAIT_FOR_WORKERS)
            self._identity = _within(_WAIT_FOR_WORKERS, self._check_identity)
            _within(_WAIT_FOR_WORKERS, lambda: self._client.register_plugin(plugin))
        except TimeoutError:
            at = f" at {self._scheduler}" if self._scheduler else ""
            raise InputError(
                f"the dask scheduler{at} has no workers, or one that does not answer: start one with "
                f"`dask worker {self._scheduler or ''}`"
            ) from None

    def _check_identity(self) -> tuple[str, str]:
        """The identity of all workers; refuse them if their results would not be bit-identical."""
        found: set[tuple[str, str]] = set(self._client.run(identity).values())
        if {model for model, _ in found} != {model_sha256()}:
            raise InputError(
                "the workers of the dask cluster run another version of fastcoil: install this version there"
            )
        if len(found) > 1:
            raise InputError(
                "the workers of the dask cluster differ in CPU, Python or library versions: results would not be "
                "bit-identical, use workers of one kind"
            )
        return found.pop()

    def submit(self, index: np.ndarray) -> cf.Future[Any]:
        if self._client.status != "running":
            raise FastcoilError("the dask scheduler is gone: start one and run the same command again to resume")
        return self._executor.submit(run_received, self._job.key, index, self._identity)  # type: ignore[no-any-return]

    def restart(self) -> None:
        if self._scheduler is not None:  # others use it too, and it replaces its workers itself if it can
            raise FastcoilError(
                f"the dask cluster at {self._scheduler} no longer answers: its workers are gone, busy with something "
                "else or hang; repair it and run the same command again to resume"
            )
        self.close()
        self._start()

    def close(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if self._client is not None:
                if self._cluster is None and self._client.status == "running":
                    with contextlib.suppress(Exception):  # only memory is left there
                        _within(5.0, lambda: self._client.unregister_worker_plugin(_plugin_name(self._job)))
                self._client.close(timeout=5)
            if self._cluster is not None:
                self._cluster.close(timeout=5)


def _start_local_cluster(n_workers: int) -> Any:
    import distributed

    # the dispatcher retries shards that kill, for it can halve them; no port that another cluster may have
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
            "if __name__ == '__main__', or use the backend loky, which needs no such line"
        ) from None


def _connect(address: Any) -> Any:
    import distributed

    try:
        if isinstance(address, str):
            with cf.ThreadPoolExecutor(1) as thread:  # in a notebook this thread has an event loop of its own
                thread.submit(lambda: asyncio.run(_check_answers(address))).result()
        return distributed.Client(address, timeout=_WAIT_FOR_SCHEDULER, set_as_default=False)
    except Exception as error:  # the library may raise anything at a stranger's answer
        reason = str(error) or type(error).__name__
        raise InputError(
            f"no dask scheduler answers at {address!r} ({reason}): give the address it printed when it started, "
            "such as tcp://host:8786"
        ) from None


def _within(seconds: float, call: Callable[[], Any]) -> Any:
    """Make a call, or raise TimeoutError if it takes longer, as one to a stopped worker does."""
    found: cf.Future[Any] = cf.Future()

    def run() -> None:
        try:
            found.set_result(call())
        except BaseException as error:
            found.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return found.result(seconds)


async def _check_answers(address: str) -> None:
    """Raise an exception if nobody speaks dask there; the client would wait forever for a silent partner."""
    from distributed.comm import connect

    comm = await asyncio.wait_for(connect(address, timeout=_WAIT_FOR_SCHEDULER), _WAIT_FOR_SCHEDULER)
    comm.abort()


def _plugin_name(job: Job) -> str:
    return f"fastcoil-{job.key}"


def _make_plugin(job: Job, *, ours: bool) -> Any:
    """A plugin that hands the job to every worker of a cluster, also to those that join later.

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
