"""``simulate``: loops × days × replicates → Dataset.

Scenarios run in shards.  A shard is the unit of scheduling and of progress, and its parameters exist only while it
runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import joblib
import xarray as xr

from fastcoil.base.arguments import checking, flag_of, whole_of
from fastcoil.base.progress import Advance, progress_of_call
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.dataset import shaped, trace_coordinates, variables_of
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import Plan, plan_simulation, simulation_attributes
from fastcoil.loops.provenance import content_sha256, provenance
from fastcoil.loops.running import Results, on_threads, run_into
from fastcoil.loops.shards import Shard, Stretch, first_shards
from fastcoil.model.metric_table import WARM_UP


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
    carry_over: bool = False,
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
    carry_over
        Whether the days are a sequence: each begins in the state in which the last ended (coil, controller, estimator,
        actuator), and its metrics are its own.  The warm-up counts on the first day alone; times since the start, such
        as ``learn_time_reached``, count from the first day on.
    n_jobs
        Threads; all cores by default.  The result does not depend on it.
    progress
        Whether to show how many scenario-days are done, on stderr or in the notebook: True always, False never; None
        on a terminal and in a notebook, after 2 s.

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
            warm_up=warm_up, seed=seed, replicates=replicates, carry_over=carry_over,
        )  # fmt: skip
    with progress_of_call(progress) as shown:
        return run_plan(plan, n_threads, shown.start(plan.n_scenarios))


def run_plan(plan: Plan, n_jobs: int, advance: Advance) -> xr.Dataset:
    """Run all shards of a plan on threads; ``advance`` receives the size of each finished one."""
    found = Results(plan, plan.n_scenarios)

    def run(shard: Shard | Stretch) -> None:
        while (state := run_into(found, plan, shard, shard.index)) is not None and isinstance(shard, Stretch):
            advance(shard.size)
            shard = shard.begun(state)
        advance(shard.size)

    shards = first_shards(plan, n_jobs)
    several = min(n_jobs, len(shards)) > 1
    with on_threads(n_jobs, run, shards) if several else nullcontext():
        attrs = {"title": "fastcoil simulation", **provenance(), **simulation_attributes(plan)}
    for shard in () if several else shards:
        run(shard)
    variables = variables_of(found.metrics, found.status, found.traces)
    ds = shaped(variables, trace_coordinates(found.traces, plan.traces.interval), plan.layout)
    ds.attrs = attrs
    ds.attrs["content_sha256"] = content_sha256(ds)
    return ds


def workers(n_jobs: int | None) -> int:
    """Number of threads: all cores by default."""
    if n_jobs is None:
        return int(joblib.cpu_count())
    return whole_of("n_jobs", n_jobs, 1, 1024)
