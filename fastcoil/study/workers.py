"""Shards on workers: threads, processes of this machine or a dask cluster, and what happens when one dies.

A pool takes shards as ``concurrent.futures`` do, and names in ``worker_errors`` the exceptions that say that the worker
of a shard is gone; pools differ only in what happens then.
"""

from __future__ import annotations

import asyncio
import concurrent.futures as cf
import contextlib
import os
import pickle
import queue
import shutil
import signal
import tempfile
import threading
import warnings
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base import errors
from fastcoil.base.arguments import require_choice
from fastcoil.base.files import convert_os_errors
from fastcoil.base.machine import wait_for_parent_exit
from fastcoil.loops.plan import Plan, Shard
from fastcoil.loops.scenarios import flat_dataset
from fastcoil.loops.simulate import call_with_timeout, run_shard
from fastcoil.model.metric_table import METRICS, STATUS_CRASHED, TRACES
from fastcoil.model.numerics.jit import fingerprint, model_sha256
from fastcoil.model.user_rules import RuleHashes, hash_user_code
from fastcoil.study.file.user_code import UserCode, load_code, reduce_traces

BACKENDS = ("threads", "loky", "dask")
_TEMPORARY_FOLDER = Path("the folder for temporary files")  # its name in messages
_SCHEDULER_TIMEOUT_S = 10.0
_WORKERS_TIMEOUT_S = 60.0
_MAX_DEATHS_WITHOUT_RESULT = 40  # one bad scenario in a shard of a million takes 20


class PoolOptions(NamedTuple):
    """Who runs a study: the backend, the number of workers, the address of the scheduler of a cluster."""

    backend: str
    n_workers: int
    scheduler: str | None = None


# --- a worker ---------------------------------------------------------------------------------------------------------


class Interrupt(Exception):
    """The user's code raised ``KeyboardInterrupt``: it would end the worker alone, and is to end the run."""


class Job(NamedTuple):
    """What a worker needs to know of a study; sent once to each, so that a shard is only its indices."""

    plan: Plan
    reduction: UserCode | None
    rules: Mapping[str, UserCode] = {}
    user_code: RuleHashes = {}


def environment_id() -> tuple[str, str]:
    """Return the hashes that decide the bits of a result: of the model's sources; of CPU, Python and libraries."""
    return model_sha256(), fingerprint()


def run_scenarios(job: Job, shard: Shard) -> xr.Dataset:
    """Run a shard, and reduce its traces if the study says so.  Returns a flat Dataset, see ``run_shard``."""
    part = run_shard(job.plan, shard)
    if job.reduction is None:
        return part
    columns = job.plan.layout.columns(shard.index)
    swept = {name: ("scenario", columns[name]) for name in job.plan.layout.loop.swept}
    traces = part[list(job.plan.traces.names)].assign_coords(swept)
    metrics = part[[*METRICS, "status"]].drop_vars(["elapsed_time", "volume"], errors="ignore")
    return metrics.merge(reduce_traces(job.reduction, traces))


def run_received_job(job: Job, shard: Shard, expected_id: tuple[str, str] | None = None) -> xr.Dataset:
    """Run a shard of a job from another process, which has the code of its rules only as text."""
    if expected_id is not None and environment_id() != expected_id:
        sentence = "a worker that joined the dask cluster differs from the others in its version of fastcoil"
        cure = "use workers of one kind; finished scenarios are kept, run the same command again to resume"
        raise errors.InputError(f"{sentence}, CPU, Python or libraries: {cure}", "scheduler", "unsupported")
    rules = job.plan.layout.loop.rules
    try:
        load_code(rules, job.rules)
        hash_user_code(rules.values(), job.user_code)  # refuses another rule
        return run_scenarios(job, shard)
    except KeyboardInterrupt:
        raise Interrupt from None
    except errors.InputError as error:
        problems = error.problems
    # without the exception of the user's code behind it, which the other process may be unable to read
    raise errors.InputError(problems)


_jobs: list[Job] = []
"""The job of this process, if it is a worker."""


def initialise_worker(job: Path, parent: int) -> None:
    """Keep the job in a file in a process that lives no longer than its parent and leaves Ctrl-C to it."""
    if threading.current_thread() is threading.main_thread():  # no other thread may set signals
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def exit_with_parent() -> None:
        wait_for_parent_exit(parent)
        shutil.rmtree(job.parent, ignore_errors=True)  # a parent that was killed has left it
        os._exit(1)

    threading.Thread(target=exit_with_parent, daemon=True).start()
    _jobs.append(pickle.loads(job.read_bytes()))


def run_shard_file(path: Path) -> xr.Dataset:
    """Run the shard in a file, which is removed, of the job of this process."""
    shard = pickle.loads(path.read_bytes())
    path.unlink(missing_ok=True)
    return run_received_job(_jobs[0], shard)


def crashed_part(job: Job, index: np.ndarray) -> xr.Dataset:
    """Results of scenarios that take every worker down: NaN, with the status ``crashed``."""
    plan, n_points = job.plan, job.plan.traces.n_points(job.plan.n_steps)
    traces = {}
    for name in plan.traces.names if job.reduction is None else ():
        volumes = (plan.n_volumes,) if TRACES[name].per_volume else ()
        traces[name] = np.full((index.size, *volumes, n_points), np.nan)
    metrics, status = np.full((len(METRICS), index.size), np.nan), np.full(index.size, STATUS_CRASHED)
    return flat_dataset(index, metrics, status, traces, plan.traces.interval).assign_attrs(computed_on="[]")


# --- handing out ------------------------------------------------------------------------------------------------------


def run_shards(pool: Pool, job: Job, shards: Sequence[Shard]) -> Iterator[xr.Dataset]:
    """Run every shard and yield its flat results (see ``run_shard``).

    A shard that was in flight when a worker died is run again alone; one that takes its worker down once more is
    halved, down to single scenarios.  These get the status ``crashed``, but not before another result has shown that
    the workers are sound.  ``FastcoilError`` if workers die repeatedly without a result in between.
    """
    waiting, retry = deque(shards), deque[Shard]()
    crashed: list[np.ndarray] = []
    n_deaths = 0
    while waiting or retry:
        is_retry = bool(retry)
        for shard, outcome in _outcomes(pool, deque([retry.popleft()]) if is_retry else waiting):
            if isinstance(outcome, xr.Dataset):
                yield from (crashed_part(job, index) for index in crashed)
                yield outcome
                crashed, n_deaths = [], 0
                continue
            n_deaths += is_retry
            if n_deaths > _MAX_DEATHS_WITHOUT_RESULT:
                cure = "they may lack memory, use fewer with -j, or another --backend"
                cure += "; finished scenarios are kept, run the same command again to resume"
                sentence = f"{_MAX_DEATHS_WITHOUT_RESULT} workers died in a row without a result"
                raise errors.FastcoilError(f"{sentence}: {cure}")
            if not is_retry:
                retry.append(shard)
            elif shard.lanes.size > 1:
                retry.extendleft(reversed(shard.halves()))
            elif isinstance(outcome, MemoryError):
                raise errors.out_of_memory_error("not even a single scenario can be run") from outcome
            else:
                crashed.append(shard.index)
    yield from (crashed_part(job, index) for index in crashed)


def _outcomes(pool: Pool, waiting: deque[Shard]) -> Iterator[tuple[Shard, xr.Dataset | BaseException]]:
    """Run shards until a worker dies: each that was started, with its results or with the error of its worker."""
    in_flight: dict[cf.Future[xr.Dataset], Shard] = {}
    has_died = False
    while in_flight or (waiting and not has_died):
        # one more than there are workers, so that none waits for this thread to write
        while waiting and not has_died and len(in_flight) <= pool.n_workers:
            shard = waiting.popleft()
            in_flight[pool.submit(shard)] = shard
        done, _ = cf.wait(in_flight, return_when=cf.FIRST_COMPLETED)
        for future in done:
            shard = in_flight.pop(future)
            outcome: xr.Dataset | BaseException
            try:
                outcome = future.result()
            except Interrupt:
                raise KeyboardInterrupt from None
            except pool.worker_errors as error:
                outcome, has_died = error, True
            yield shard, outcome


class Threads:
    """Threads: the kernels release the interpreter's lock, and nothing is copied."""

    worker_errors: tuple[type[BaseException], ...] = (MemoryError,)

    def __init__(self, job: Job, n_workers: int) -> None:
        self.n_workers = n_workers
        self._job = job
        self._executor = cf.ThreadPoolExecutor(n_workers)

    def submit(self, shard: Shard) -> cf.Future[Any]:
        return self._executor.submit(run_scenarios, self._job, shard)

    def close(self) -> None:
        self._executor.shutdown(wait=False, cancel_futures=True)


class Loky:
    """Processes: a scenario, or a user's reduction, that crashes takes only its worker and what is in flight down.

    Job and shards go through files: the library's pipe waits for ever if a process dies before it has read all of it.
    """

    worker_errors: tuple[type[BaseException], ...] = (cf.BrokenExecutor, MemoryError)

    def __init__(self, job: Job, n_workers: int) -> None:
        self.n_workers = n_workers
        self._job = job
        self._executor = self._start()

    def _start(self) -> Any:
        from joblib.externals.loky import ProcessPoolExecutor

        with convert_os_errors(_TEMPORARY_FOLDER, "written"):
            self._folder = tempfile.TemporaryDirectory(prefix="fastcoil-", ignore_cleanup_errors=True)
        self._names = (Path(self._folder.name) / str(k) for k in count())
        arguments = self._write_to_file(self._job), os.getpid()
        with _process_start_errors():
            return ProcessPoolExecutor(self.n_workers, initializer=initialise_worker, initargs=arguments)

    def _write_to_file(self, content: object) -> Path:
        path = next(self._names)
        with convert_os_errors(_TEMPORARY_FOLDER, "written"):
            path.write_bytes(pickle.dumps(content))
        return path

    def submit(self, shard: Shard) -> cf.Future[Any]:
        with _process_start_errors():
            try:
                return self._executor.submit(run_shard_file, self._write_to_file(shard))  # type: ignore[no-any-return]
            except cf.BrokenExecutor:  # a worker died, and what was in flight has failed
                self.close()
                self._executor = self._start()
                return self._executor.submit(run_shard_file, self._write_to_file(shard))  # type: ignore[no-any-return]

    def close(self) -> None:
        # the library forgets pending work but keeps its numbers, and then looks for them in vain
        with contextlib.suppress(queue.Empty, AttributeError):
            while True:
                self._executor._work_ids.get_nowait()
        self._executor.shutdown(wait=True, kill_workers=True)
        self._folder.cleanup()


@contextlib.contextmanager
def _process_start_errors() -> Iterator[None]:
    try:
        yield
    except errors.StorageError:
        raise
    except OSError as error:
        raise errors.StorageError(
            f"the processes of --backend loky cannot be started: {error.strerror or error}; raise the limits of open "
            "files and processes (ulimit -n, -u), use fewer workers with -j, or the backend threads"
        ) from error


class Dask:
    """The dask cluster at ``scheduler``, which replaces its workers itself if it can."""

    def __init__(self, job: Job, scheduler: str) -> None:
        try:
            import distributed
        except ImportError:
            raise errors.missing_extra_error("the backend dask", "dask and distributed", "dask") from None
        # when the scheduler is lost, futures are cancelled
        self.worker_errors: tuple[type[BaseException], ...] = (distributed.KilledWorker, cf.CancelledError, MemoryError)
        try:
            # in a notebook this thread has an event loop
            call_with_timeout(None, lambda: asyncio.run(_probe_scheduler(scheduler)))
            self._client = distributed.Client(scheduler, timeout=_SCHEDULER_TIMEOUT_S, set_as_default=False)
            self._client.wait_for_workers(1, timeout=_WORKERS_TIMEOUT_S)
            answers = call_with_timeout(_WORKERS_TIMEOUT_S, lambda: self._client.run(environment_id))
            environments: set[tuple[str, str]] = set(answers.values())
            self._environment_id = min(environments)
        except Exception as error:  # the library may raise anything at an unexpected answer
            self.close()
            sentence = f"no dask cluster answers at {scheduler!r} ({str(error) or type(error).__name__})"
            cure = "give the address that the scheduler printed when it started, such as tcp://host:8786, with at least"
            cure += " one worker, and for tls:// dask's settings of the certificates"
            raise errors.InputError(f"{sentence}: {cure}", "scheduler", "value") from None
        try:
            if len(environments) > 1 or self._environment_id[0] != model_sha256():
                differences = "run another version of fastcoil, or differ in CPU, Python or library versions"
                cure = "results would not be bit-identical, use workers of one kind with this version"
                sentence = f"the workers of the dask cluster {differences}: {cure}"
                raise errors.InputError(sentence, "scheduler", "unsupported")
            self.n_workers = sum(self._client.nthreads().values())
            self._executor = self._client.get_executor(pure=False)
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Sending large graph")
                self._job = self._client.submit(lambda job: job, job, pure=False)  # made again if a worker dies with it
        except BaseException:
            self.close()
            raise

    def submit(self, shard: Shard) -> cf.Future[Any]:
        if self._client.status != "running":
            raise errors.FastcoilError("the dask scheduler is gone: start one and run the same command again to resume")
        return self._executor.submit(run_received_job, self._job, shard, self._environment_id)  # type: ignore[no-any-return]

    def close(self) -> None:
        with contextlib.suppress(Exception):  # what was computed must not be lost for a cluster that is slow to end
            self._client.close(timeout=5.0)


async def _probe_scheduler(address: str) -> None:
    """Raise an exception if no dask answers there: a client would wait for ever for a server that says nothing."""
    from distributed import Security
    from distributed.comm import connect

    certificates = Security().get_connection_args("client")
    comm = await asyncio.wait_for(connect(address, _SCHEDULER_TIMEOUT_S, **certificates), _SCHEDULER_TIMEOUT_S)
    comm.abort()


Pool = Threads | Loky | Dask


def make_pool(job: Job, options: PoolOptions) -> Pool:
    """Start the workers of a backend."""
    if options.scheduler is not None:
        return Dask(job, options.scheduler)
    return (Loky if options.backend == "loky" else Threads)(job, options.n_workers)


def check_backend(backend: str, scheduler: str | None) -> None:
    """Refuse a backend that does not exist, and dask without the address of its scheduler."""
    require_choice("backend", backend, BACKENDS)
    if backend == "dask" and not scheduler:
        cure = "give its address, such as tcp://host:8786; on this machine alone, loky does the same"
        raise errors.InputError(f"backend = 'dask' without scheduler: {cure}", "scheduler", "missing")
    if backend != "dask" and scheduler is not None:
        sentence = f"scheduler = {errors.short_repr(scheduler)}: only the backend dask has one"
        raise errors.InputError(f"{sentence}, choose it or leave it out", "scheduler", "conflict")
