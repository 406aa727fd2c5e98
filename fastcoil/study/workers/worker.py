"""What a worker runs, in a thread, a process of its own, or on another machine: one shard at a time."""

import os
import pickle
import shutil
import signal
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.loops.plan import Plan, Shard
from fastcoil.loops.scenarios import flat_dataset
from fastcoil.loops.simulate import run_shard
from fastcoil.model.metric_table import METRICS, STATUS_CRASHED, TRACES
from fastcoil.model.numerics.jit import fingerprint, model_sha256
from fastcoil.model.user_rules import RuleHashes, own_code_of, refuse_other_code
from fastcoil.study.file.own_code import Source, load_rules
from fastcoil.study.workers.reduce import reduce


class Interrupt(Exception):
    """The user's code raised ``KeyboardInterrupt``: it would end the worker alone, and is to end the run."""


class Job(NamedTuple):
    """What a worker needs of a study; sent once to each, so that a shard is only its indices."""

    plan: Plan
    reduction: Source | None
    rules: Mapping[str, Source] = {}
    own_code: RuleHashes = {}


def identity() -> tuple[str, str]:
    """Hashes of what the bits of a result depend on: the model's sources; CPU, Python and libraries."""
    return model_sha256(), fingerprint()


def itself(job: Job) -> Job:
    """The job, as a task of a cluster."""
    return job


def run_scenarios(job: Job, shard: Shard) -> xr.Dataset:
    """Run a shard, and reduce its traces if the study asks for it.  Returns a flat Dataset, see ``run_shard``."""
    part = run_shard(job.plan, shard)
    if job.reduction is None:
        return part
    columns = job.plan.layout.columns(shard.index)
    swept = {name: ("scenario", columns[name]) for name in job.plan.layout.loop.swept}
    traces = part[list(job.plan.traces.names)].assign_coords(swept)
    return (
        part[[*METRICS, "status"]]
        .drop_vars(["elapsed_time", "volume"], errors="ignore")
        .merge(reduce(job.reduction, traces))
    )


def run_elsewhere(job: Job, shard: Shard, expected: tuple[str, str] | None = None) -> xr.Dataset:
    """As ``run_scenarios``, for a job that came from another process, which has the code of its rules only as text.

    expected: the identity this worker must have; it may have joined after the others were checked.
    """
    if expected is not None and identity() != expected:
        raise InputError(
            "a worker that joined the dask cluster differs from the others in its version of fastcoil, CPU, Python or "
            "libraries: use workers of one kind; finished scenarios are kept, run the same command again to resume"
        )
    rules = job.plan.layout.loop.rules
    try:
        load_rules(rules, job.rules)
        refuse_other_code(own_code_of(rules.values()), job.own_code)
        return run_scenarios(job, shard)
    except KeyboardInterrupt:
        raise Interrupt from None
    except InputError as error:
        problems = error.problems
    # without the exception of the user's code behind it, which the other process may be unable to read
    raise InputError(problems)


_jobs: list[Job] = []
"""The job of this process, if it is a worker."""


def begin_process(job: Path, parent: int) -> None:
    """Keep the job in a file in a process that lives no longer than its parent and leaves Ctrl-C to it."""
    if threading.current_thread() is threading.main_thread():  # no other thread may set signals
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def follow() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        shutil.rmtree(job.parent, ignore_errors=True)  # a parent that was killed has left it
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
    _jobs.append(pickle.loads(job.read_bytes()))


def run_from_file(path: Path) -> xr.Dataset:
    """Run the shard in a file, which is removed, of the job of this process."""
    shard = pickle.loads(path.read_bytes())
    path.unlink(missing_ok=True)
    return run_elsewhere(_jobs[0], shard)


def crashed_part(job: Job, index: np.ndarray) -> xr.Dataset:
    """Results of scenarios that take every worker down: NaN, with the status ``crashed``."""
    nothing = np.full((len(METRICS), index.size), np.nan)
    points = job.plan.traces.n_points(job.plan.n_steps)
    names = job.plan.traces.names if job.reduction is None else ()
    traces = {
        n: np.full((index.size, *((job.plan.n_volumes,) if TRACES[n].per_volume else ()), points), np.nan)
        for n in names
    }
    part = flat_dataset(index, nothing, np.full(index.size, STATUS_CRASHED), traces, job.plan.traces.interval)
    return part.assign_attrs(computed_on="[]")
