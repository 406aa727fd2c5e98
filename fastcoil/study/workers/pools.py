"""Where shards are run: threads of this process, processes of this machine, or a dask cluster.

A pool takes shards as ``concurrent.futures`` do; pools differ only in what happens when a worker dies.
"""

from __future__ import annotations

import asyncio
import concurrent.futures as cf
import contextlib
import ipaddress
import os
import pickle
import queue
import tempfile
import time
import uuid
import warnings
import weakref
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fastcoil.base.errors import FastcoilError, InputError, missing_extra, shown
from fastcoil.base.files import storage_errors
from fastcoil.loops.plan import Shard, Stretch
from fastcoil.loops.simulate import within
from fastcoil.model.numerics.jit import model_sha256
from fastcoil.study.workers.worker import (
    Job,
    forget,
    identity,
    receive,
    receive_in_child,
    run_from_file,
    run_received,
    run_scenarios,
)

_WAIT_FOR_SCHEDULER = 10.0  # seconds


def connect(address: str) -> Any:
    """A client of the scheduler at an address; ``InputError`` if none answers there."""
    import distributed

    try:
        with cf.ThreadPoolExecutor(1) as thread:  # in a notebook this thread has an event loop of its own
            thread.submit(lambda: asyncio.run(_check_answers(address))).result()
        client = distributed.Client(address, timeout=_WAIT_FOR_SCHEDULER, set_as_default=False)
    except Exception as error:  # the library may raise anything at an unexpected answer
        reason = str(error) or type(error).__name__
        raise InputError(
            f"no dask scheduler answers at {address!r} ({reason}): give the address it printed when it started, "
            "such as tcp://host:8786, and for tls:// dask's settings of the certificates"
        ) from None
    if not _is_guarded(address):
        warnings.warn(
            f"anyone who can reach the dask scheduler at {address}, or its workers, can run code as you: use tls:// on "
            "a network that you do not trust",
            stacklevel=2,
        )
    return client


def _is_guarded(address: str) -> bool:
    """Whether foreign connections are refused, by certificates or because only this machine can reach the address."""
    protocol, _, place = address.rpartition("://")
    host = place.rpartition(":")[0].strip("[]")
    with contextlib.suppress(ValueError):
        return protocol == "tls" or host == "localhost" or ipaddress.ip_address(host).is_loopback
    return False


async def _check_answers(address: str) -> None:
    """Raise an exception if no dask answers there; the client would wait forever."""
    from distributed import Security
    from distributed.comm import connect

    # certificates, from dask's own configuration
    options = Security().get_connection_args("client")
    comm = await asyncio.wait_for(connect(address, timeout=_WAIT_FOR_SCHEDULER, **options), _WAIT_FOR_SCHEDULER)
    comm.abort()


_WAIT_FOR_WORKERS, _WAIT_FOR_ANSWER, _BEFORE_NEXT_TRY = 60.0, 5.0, 0.5  # seconds


class Dask:
    """The dask cluster at ``scheduler``."""

    falls_together = False
    can_kill = True
    shared = True

    def __init__(self, job: Job, scheduler: str) -> None:
        try:
            import distributed
        except ImportError:
            raise missing_extra("the backend dask", "dask and distributed", "dask") from None
        # when the scheduler is lost, futures are cancelled
        self.deaths: tuple[type[BaseException], ...] = (distributed.KilledWorker, cf.CancelledError, MemoryError)
        self._job = job._replace(key=f"{job.key}-{uuid.uuid4().hex}")  # two runs of a study may share a cluster
        self._scheduler = scheduler
        self._client = connect(scheduler)
        try:
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
                    raise InputError(
                        f"the dask scheduler at {self._scheduler} has no workers, or one that does not answer: start "
                        f"one with `dask worker {self._scheduler}`"
                    ) from None
            time.sleep(_BEFORE_NEXT_TRY)

    def _equip_those_that_live(self) -> None:
        plugin = _make_plugin(self._job)
        self._client.wait_for_workers(1, timeout=_WAIT_FOR_WORKERS)
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
        # others use it too, and it replaces its workers itself if it can
        raise FastcoilError(
            f"the dask cluster at {self._scheduler} no longer answers: its workers are gone, busy with something else "
            "or hang; repair it and run the same command again to resume"
        )

    def close(self) -> None:
        # whatever is slow to end, or broken, ends with this process; what was computed must not be lost for it
        if self._client.status == "running":
            with contextlib.suppress(Exception):  # only memory is left there
                within(_WAIT_FOR_ANSWER, lambda: self._client.unregister_worker_plugin(_plugin_name(self._job)))
        with contextlib.suppress(Exception):
            self._client.close(timeout=_WAIT_FOR_ANSWER)


def _plugin_name(job: Job) -> str:
    return f"fastcoil-{job.key}"


def _make_plugin(job: Job) -> Any:
    """A plugin that hands the job to every worker of a cluster, also to those that join later."""
    from distributed import WorkerPlugin

    class Receive(WorkerPlugin):  # type: ignore[misc]
        name = _plugin_name(job)

        def setup(self, worker: object) -> None:
            receive(job)

        def teardown(self, worker: object) -> None:
            forget(job.key)

    return Receive()


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
        with contextlib.suppress(OSError):  # others also clean up there
            self._folder.cleanup()


def make_pool(backend: str, job: Job, n_workers: int, scheduler: str | None) -> Pool:
    """Start the workers of a backend."""
    if scheduler is not None:
        return Dask(job, scheduler)
    return Loky(job, n_workers) if backend == "loky" else Threads(job, n_workers)


def backend_problems(backend: str, scheduler: str | None) -> list[str]:
    """What is wrong with the choice of a backend."""
    if backend not in BACKENDS:
        return [f"backend = {shown(backend)}: choose one of {', '.join(BACKENDS)}"]
    if scheduler == "":
        return ["scheduler is empty: give an address such as tcp://host:8786, or leave it out"]
    if backend == "dask" and scheduler is None:
        return ["backend = 'dask' without scheduler: give its address; on this machine alone, loky does the same"]
    if scheduler is not None and backend != "dask":
        return [f"scheduler = {shown(scheduler)}: only the backend dask has one, choose it or leave scheduler out"]
    return []
