"""Shards on a dask cluster: the one at an address, or one of this machine's processes."""

from __future__ import annotations

import concurrent.futures as cf
import contextlib
import time
import uuid
import weakref
from collections.abc import Collection, Sequence
from functools import partial
from typing import Any

from fastcoil.base.errors import FastcoilError, InputError, missing_extra
from fastcoil.loops.running import within
from fastcoil.loops.shards import Shard, Stretch
from fastcoil.model.numerics.jit import model_sha256
from fastcoil.study.workers.dask_connection import connect, start_local_cluster, workers_missing
from fastcoil.study.workers.worker import Job, forget, identity, leave_interrupts, receive, run_received

_WAIT_FOR_WORKERS, _WAIT_FOR_ANSWER, _WAIT_FOR_END, _BEFORE_NEXT_TRY = 60.0, 5.0, 30.0, 0.5
"""Seconds."""


class Dask:
    """A dask cluster: the one at ``scheduler``, or one of this machine's processes."""

    falls_together = False
    can_kill = True

    def __init__(self, job: Job, n_workers: int, scheduler: str | None) -> None:
        try:
            import distributed
        except ImportError:
            raise missing_extra("the backend dask", "dask and distributed", "dask") from None
        # when the scheduler is lost, futures are cancelled
        self.deaths: tuple[type[BaseException], ...] = (distributed.KilledWorker, cf.CancelledError, MemoryError)
        self._job = job._replace(key=f"{job.key}-{uuid.uuid4().hex}")  # two runs of a study may share a cluster
        self._scheduler, self._n_asked = scheduler, n_workers
        self.shared = scheduler is not None
        self._cluster: Any = None
        self._client: Any = None
        self._start()

    def _start(self) -> None:
        try:
            if self._scheduler is None:
                self._cluster = start_local_cluster(self._n_asked)
            self._client = connect(self._cluster or self._scheduler)
            self._equip_workers()
        except BaseException:
            self.close()
            raise
        self.n_workers = sum(self._client.nthreads().values())
        self.has_workers = True
        self._executor = self._client.get_executor(pure=False)
        self._keys: weakref.WeakKeyDictionary[cf.Future[Any], str] = weakref.WeakKeyDictionary()

    def _equip_workers(self) -> None:
        end = time.monotonic() + _WAIT_FOR_WORKERS
        while True:
            try:
                return self._equip_those_that_live()
            except FastcoilError:
                raise
            except Exception as error:  # the library raises many things where a worker dies meanwhile
                if isinstance(error, TimeoutError) or time.monotonic() > end:
                    raise workers_missing(self._scheduler, error) from None
            time.sleep(_BEFORE_NEXT_TRY)

    def _equip_those_that_live(self) -> None:
        plugin = _make_plugin(self._job, ours=self._cluster is not None)
        self._client.wait_for_workers(1 if self._scheduler else self._n_asked, timeout=_WAIT_FOR_WORKERS)
        self._identity = within(_WAIT_FOR_WORKERS, self._check_identity)
        within(_WAIT_FOR_WORKERS, lambda: self._client.register_plugin(plugin))

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

    def submit(self, shard: Shard | Stretch) -> cf.Future[Any]:
        if self._client.status != "running":
            raise FastcoilError("the dask scheduler is gone: start one and run the same command again to resume")
        key = f"fastcoil-{uuid.uuid4().hex}"
        future: cf.Future[Any] = self._executor.submit(run_received, self._job.key, shard, self._identity, key=key)
        self._keys[future] = key
        return future

    def waiting(self, futures: Sequence[cf.Future[Any]]) -> Collection[cf.Future[Any]]:
        keys = {future: self._keys[future] for future in futures}
        try:
            running = within(_WAIT_FOR_ANSWER, lambda: self._find_running(set(keys.values())))
        except Exception:  # whatever a cluster that breaks down raises: time goes on
            return ()
        return [future for future, key in keys.items() if key not in running]

    def _find_running(self, keys: set[str]) -> set[str]:
        """Those shards that a worker runs, or would run if it were alive."""
        threads = self._client.nthreads()
        self.has_workers = bool(threads)
        running = set()
        for worker, held in self._client.processing().items():
            ours = keys.intersection(held)
            if ours and len(held) > threads.get(worker, 1):  # some of them wait: the worker knows which
                with contextlib.suppress(TimeoutError):
                    ours &= set(within(_WAIT_FOR_ANSWER / 2, partial(self._ask, ours)))
            running |= ours
        # what is finished may still be on its way here
        finished = self._client.sync(self._client.scheduler.who_has, keys=list(keys - running))
        return running | {key for key, workers in finished.items() if workers}

    def _ask(self, keys: Collection[str]) -> list[str]:
        """Those shards that workers run, by what they say themselves."""
        stacks = self._client.call_stack(keys=list(keys))
        return [key for found in stacks.values() for key in found]

    def restart(self) -> None:
        if self._scheduler is not None:  # others use it too, and it replaces its workers itself if it can
            raise FastcoilError(
                f"the dask cluster at {self._scheduler} no longer answers: its workers are gone, busy with something "
                "else or hang; repair it and run the same command again to resume"
            )
        self.close()
        self._start()

    def close(self) -> None:
        # whatever is slow to end, or broken, ends with this process; what was computed must not be lost for it
        if self._client is not None:
            if self._cluster is None and self._client.status == "running":
                with contextlib.suppress(Exception):  # only memory is left there
                    within(_WAIT_FOR_ANSWER, lambda: self._client.unregister_worker_plugin(_plugin_name(self._job)))
            with contextlib.suppress(Exception):
                self._client.close(timeout=_WAIT_FOR_ANSWER)
        if self._cluster is not None:
            with contextlib.suppress(Exception):
                self._cluster.close(timeout=_WAIT_FOR_END)


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
