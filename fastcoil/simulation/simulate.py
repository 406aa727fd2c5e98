"""``simulate``: loops × days × replicates → Dataset.

Scenarios are run in shards, contiguous ranges of the flat order: a shard is the unit of scheduling and of
progress, and its parameters exist only while it runs.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import joblib
import numpy as np
import xarray as xr

from fastcoil.boundary import Boundary
from fastcoil.engine.host import run_block
from fastcoil.engine.lanes import blocks, parameter_matrix
from fastcoil.engine.rows import LANES
from fastcoil.errors import InputError
from fastcoil.outputs import METRICS, TRACES, WARM_UP
from fastcoil.simulation.dataset import content_sha256, flat, gather, provenance, unflattened
from fastcoil.simulation.loop import Loop
from fastcoil.simulation.plan import Plan, prepare, settings, whole_number_problems


def simulate(
    loop: Loop,
    boundary: Boundary,
    *,
    command: Any = None,
    traces: Sequence[str] = (),
    trace_interval: int = 1,
    warm_up: int = WARM_UP,
    seed: int = 0,
    replicates: int = 1,
    n_jobs: int | None = None,
) -> xr.Dataset:
    """Simulate every loop of ``loop`` on every day of ``boundary``.

    Parameters
    ----------
    loop
        One loop or a sweep of them; its dimensions become those of the result.
    boundary
        What acts on the loop; several days become the dim ``day``.
    command
        Open loop: the command to the actuator, 0–1, (n_steps,) or (day, n_steps) in 1-s samples.  The controller is
        then off: ``u``, ``integral``, ``estimate`` are NaN, ``mode`` is 0.
    traces
        Names of the signals to keep (see ``fastcoil.outputs.TRACES``), the sample at every ``trace_interval`` s.
    warm_up
        Seconds left out of every metric.
    seed
        Of the measurement noise, 0 … 2**64 - 1.
    replicates
        Noise realisations; more than one become the dim ``replicate``.
    n_jobs
        Threads; all cores by default.  The result does not depend on it.

    Returns
    -------
    xarray.Dataset
        Metrics and ``status`` over the dims of the sweep, traces with ``elapsed_time`` besides.

    Raises
    ------
    InputError
        For any mistake in the arguments, an unstable coil, or a result that does not fit in memory.
    """
    plan = prepare(loop, boundary, command=command, traces=traces, trace_interval=trace_interval, warm_up=warm_up,
                   seed=seed, replicates=replicates)  # fmt: skip
    return run(plan, workers(n_jobs))


def run(plan: Plan, n_jobs: int) -> xr.Dataset:
    """Run all shards of a plan on threads and put the pieces together."""
    tasks = (joblib.delayed(run_shard)(plan, shard) for shard in plan.shards(n_jobs))
    found = joblib.Parallel(n_jobs=n_jobs, backend="threading", batch_size=1, return_as="generator_unordered")(tasks)
    ds = unflattened(gather(plan.n_scenarios, found), plan.layout)
    ds.attrs = {"title": "fastcoil simulation", **provenance(), **settings(plan)}
    ds.attrs["content_sha256"] = content_sha256(ds)
    return ds


def run_shard(plan: Plan, index: np.ndarray) -> xr.Dataset:
    """Run the scenarios ``index``, which share a day, block by block.  Returns a flat Dataset, see ``results.flat``."""
    columns = plan.layout.columns(index)
    metrics, status = np.empty((len(METRICS), index.size)), np.empty(index.size, dtype=np.int8)
    traces: dict[str, np.ndarray] = {}
    n_points = plan.traces.n_points(plan.n_steps)
    for name in plan.traces.names:
        shape = (index.size, plan.n_volumes, n_points) if TRACES[name].per_volume else (index.size, n_points)
        traces[name] = np.full(shape, np.nan)
    day = plan.days[columns["day"][0]]
    for members, block in blocks(parameter_matrix(columns)):
        found, flags, signals = run_block(block, day, plan.traces)
        metrics[:, members], status[members] = found[:, : members.size], flags[: members.size]
        for name, signal in signals.items():
            volumes = (slice(block.n_volumes),) if TRACES[name].per_volume else ()
            traces[name][members, *volumes] = signal[..., : members.size].T
    return flat(index, metrics, status, traces, plan.traces.interval)


def workers(n_jobs: int | None) -> int:
    """Return a number of threads: all cores by default."""
    if n_jobs is None:
        return int(joblib.cpu_count())
    problems = whole_number_problems("n_jobs", n_jobs, 1, 1024)
    if problems:
        raise InputError(problems)
    return n_jobs


def probe(plan: Plan) -> float:
    """Seconds per lane and step on one thread, measured on one block from the middle of the plan, compiled before."""
    shards = plan.shards(1)
    middle = shards[len(shards) // 2]
    columns = plan.layout.columns(middle[:LANES])
    _, block = blocks(parameter_matrix(columns))[0]
    day = plan.days[columns["day"][0]]
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        run_block(block, day, plan.traces)
        seconds.append(time.perf_counter() - start)
    return min(seconds) / plan.n_steps / LANES
