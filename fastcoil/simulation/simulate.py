"""``simulate``: loops × days × replicates → Dataset.

Scenarios run in shards, contiguous ranges of the flat order.  A shard is the unit of scheduling and of
progress, and its parameters exist only while it runs.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import joblib
import numpy as np
import xarray as xr

from fastcoil.arguments import checking, flag_of, whole_of
from fastcoil.boundary import Boundary
from fastcoil.engine.lanes import blocks, parameter_matrix
from fastcoil.numerics.jit import compiled_for
from fastcoil.outputs import METRICS, TRACES, WARM_UP
from fastcoil.progress.shown import Advance, progress_of_call
from fastcoil.rules.rule import rules_for_kernels
from fastcoil.simulation.dataset import content_sha256, flat_dataset, join_flat, provenance, unflatten
from fastcoil.simulation.in_thread import run_interruptibly
from fastcoil.simulation.loop import Loop
from fastcoil.simulation.plan import Plan, plan_simulation, simulation_attributes


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
    progress: bool | None = None,
) -> xr.Dataset:
    """Simulate every loop of ``loop`` on every day of ``boundary``.

    Parameters
    ----------
    loop
        One loop or a sweep; its dimensions become those of the result.
    boundary
        Entering air and water and the set-point, second by second; several days become the dim ``day``.
    command
        For an open loop: the command to the actuator, 0–1, (n_steps,) or (day, n_steps) in 1-s samples.  The
        controller is then off: ``u``, ``integral``, ``estimate`` are NaN, ``mode`` is 0.
    traces
        Names of the signals to keep: T_sup, T_measured, u, integral, command, position, opening, m_w, estimate, mode,
        T_w_out, W_sup, wet_volumes, power and, with dim ``volume``, T_w, T_c, T_a, W_a.
    trace_interval
        Seconds between the samples of a trace; a sample is the value at that second, not a mean.
    warm_up
        Seconds at the start that no metric counts.
    seed
        Seed of the measurement noise, 0 … 2**64 - 1.
    replicates
        Noise realisations; more than one become the dim ``replicate``.
    n_jobs
        Threads; all cores by default.  The result does not depend on it.
    progress
        Whether to show how many scenario-days are done, on stderr or in the notebook: True always, False never; None
        where someone looks, a terminal or a notebook, and only of work that takes more than 2 s.

    Returns
    -------
    xarray.Dataset
        Metrics and ``status`` over the dims of the sweep; traces over these dims and ``elapsed_time``.

    Raises
    ------
    InputError
        With one sentence for each mistake in the arguments; for an unstable coil; for a result that does not fit in
        memory.
    """
    with checking() as check:
        n_threads = check(workers, n_jobs)
        progress = check.unless_none(flag_of, "progress", progress)
        plan = check(
            plan_simulation, loop, boundary, command=command, traces=traces, trace_interval=trace_interval,
            warm_up=warm_up, seed=seed, replicates=replicates,
        )  # fmt: skip
    with progress_of_call(progress) as shown:
        return run_plan(plan, n_threads, shown.start(plan.n_scenarios))


def run_plan(plan: Plan, n_jobs: int, advance: Advance) -> xr.Dataset:
    """Run all shards of a plan on threads and join their results; ``advance`` is told of the finished ones."""
    tasks = (joblib.delayed(run_shard)(plan, shard) for shard in plan.shards(n_jobs))
    found = joblib.Parallel(n_jobs=n_jobs, backend="threading", batch_size=1, return_as="generator_unordered")(tasks)
    ds = unflatten(join_flat(plan.n_scenarios, _told(found, advance)), plan.layout)
    ds.attrs = {"title": "fastcoil simulation", **provenance(), **simulation_attributes(plan)}
    ds.attrs["content_sha256"] = content_sha256(ds)
    return ds


def _told(parts: Iterable[xr.Dataset], advance: Advance) -> Iterator[xr.Dataset]:
    for part in parts:
        advance(part.sizes["scenario"])
        yield part


def run_shard(plan: Plan, index: np.ndarray) -> xr.Dataset:
    """Run the scenarios ``index``, day by day and block by block.  Returns a flat Dataset, see ``flat_dataset``."""
    columns = plan.layout.columns(index)
    rules = rules_for_kernels(plan.layout.loop.rules)
    matrix = parameter_matrix(columns, rules)
    metrics, status = np.empty((len(METRICS), index.size)), np.empty(index.size, dtype=np.int8)
    traces: dict[str, np.ndarray] = {}
    n_points = plan.traces.n_points(plan.n_steps)
    for name in plan.traces.names:
        shape = (index.size, plan.n_volumes, n_points) if TRACES[name].per_volume else (index.size, n_points)
        traces[name] = np.full(shape, np.nan)
    for k in np.unique(columns["day"]):
        day, of_day = plan.days[int(k)], np.flatnonzero(columns["day"] == k)
        for lanes, block in blocks(matrix[:, of_day], rules):
            found, flags, signals = run_interruptibly(block, day, plan.traces)
            members = of_day[lanes]
            metrics[:, members], status[members] = found[:, : members.size], flags[: members.size]
            for name, signal in signals.items():
                volumes = (slice(block.common.n_volumes),) if TRACES[name].per_volume else ()
                traces[name][members, *volumes] = signal[..., : members.size].T
    part = flat_dataset(index, metrics, status, traces, plan.traces.interval)
    return part.assign_attrs(computed_on=json.dumps([compiled_for()]))


def workers(n_jobs: int | None) -> int:
    """Number of threads: all cores by default."""
    if n_jobs is None:
        return int(joblib.cpu_count())
    return whole_of("n_jobs", n_jobs, 1, 1024)
