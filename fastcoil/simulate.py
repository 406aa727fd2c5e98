"""``simulate``: loops × days × replicates → Dataset.

Scenarios are run in shards, contiguous ranges of the flat order: a shard is the unit of scheduling and of
progress, and its parameters exist only while it runs.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import xarray as xr

from fastcoil.boundary import Boundary
from fastcoil.engine.emulator import SERIES, Day, Traces, run_block
from fastcoil.engine.lanes import LANES, blocks
from fastcoil.engine.schedule import schedule
from fastcoil.errors import InputError, nearest
from fastcoil.layout import Layout
from fastcoil.numerics.noise import RNG
from fastcoil.outputs import METRICS, TRACES, WARM_UP
from fastcoil.results import content_sha256, provenance, wrap
from fastcoil.scenario import Loop
from fastcoil.stability import check_stability

_LANE_STEPS_PER_SHARD = 60e6
"""About 1 to 2 s of work on one core."""
_SHARDS_PER_WORKER = 4

Progress = Callable[[int], None]
"""Called with the number of scenarios finished since the last call."""


@dataclass(frozen=True)
class Plan:
    """A validated simulation: everything a shard needs, and the size of what will come out."""

    layout: Layout
    traces: Traces
    warm_up: int
    seed: int
    command: np.ndarray | None
    days: tuple[Day, ...] = field(repr=False)

    @property
    def n_scenarios(self) -> int:
        return self.layout.size

    @property
    def n_steps(self) -> int:
        return self.layout.boundary.n_steps

    @property
    def lane_steps(self) -> int:
        return self.n_scenarios * self.n_steps

    @property
    def result_bytes(self) -> int:
        """Size of the result in memory."""
        n_max = int(np.max(self.layout.loop["n_volumes"]))  # type: ignore[arg-type]
        rows = sum(n_max if TRACES[n].per_volume else 1 for n in self.traces.names)
        return self.n_scenarios * (8 * len(METRICS) + 8 + 8 * rows * self.traces.n_points(self.n_steps))

    def shards(self, n_jobs: int) -> list[range]:
        """Cut the flat order: a whole number of blocks each, enough of them to keep all workers busy."""
        by_work = _LANE_STEPS_PER_SHARD / self.n_steps
        by_workers = self.n_scenarios / (n_jobs * _SHARDS_PER_WORKER)
        size = max(1, round(min(by_work, by_workers) / LANES)) * LANES
        return [range(a, min(a + size, self.n_scenarios)) for a in range(0, self.n_scenarios, size)]


@dataclass(frozen=True)
class ShardResult:
    """What a shard found: metrics (len(METRICS), n), status (n,), traces name → (n, [N,] n_points)."""

    shard: range
    metrics: np.ndarray
    status: np.ndarray
    traces: dict[str, np.ndarray]


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


def prepare(
    loop: Loop,
    boundary: Boundary,
    *,
    command: Any = None,
    traces: Sequence[str] = (),
    trace_interval: int = 1,
    warm_up: int = WARM_UP,
    seed: int = 0,
    replicates: int = 1,
) -> Plan:
    """Validate the arguments of ``simulate``; nothing is allocated and nothing run.  All mistakes at once."""
    if not isinstance(loop, Loop):
        raise InputError(f"loop is a {type(loop).__name__}: give a fastcoil.Loop")
    if not isinstance(boundary, Boundary):
        raise InputError(f"boundary is a {type(boundary).__name__}: give a fastcoil.Boundary, such as fastcoil.paper_day()")
    problems = [
        *_whole_number_problems("trace_interval", trace_interval, 1, boundary.n_steps),
        *_whole_number_problems("warm_up", warm_up, 0, None),
        *_whole_number_problems("seed", seed, 0, 2**64 - 1),
        *_whole_number_problems("replicates", replicates, 1, 2**32),
    ]
    problems += [f"traces: {n!r} is not a trace{nearest(str(n), TRACES)}; known: {', '.join(TRACES)}" for n in traces if n not in TRACES]
    problems += [f"traces: {n} is listed twice" for n in sorted(set(traces)) if list(traces).count(n) > 1]
    if not problems and boundary.n_steps <= warm_up:
        problems.append(f"the boundary lasts {boundary.n_steps} s, the warm-up {warm_up} s: nothing is left to count, give a longer boundary")
    if problems:
        raise InputError(problems)
    layout = Layout(loop, boundary, replicates)
    commands = _commands(command, boundary)
    words = (seed & 0xFFFFFFFF, seed >> 32)
    days = tuple(
        Day(
            series=np.stack([boundary.series[n][d] for n in SERIES], axis=1),
            command=commands[d] if commands is not None else np.empty(0),
            schedule=schedule(boundary.series["T_set"][d], boundary.series["enabled"][d], warm_up),
            label=int(boundary.day[d]),
            seed=words,
        )
        for d in range(boundary.n_days)
    )
    plan = Plan(layout, Traces(tuple(traces), trace_interval), warm_up, seed, commands, days)
    _check_memory(plan)
    check_stability(layout)
    return plan


def run(plan: Plan, n_jobs: int, progress: Progress | None = None) -> xr.Dataset:
    """Run all shards of a plan and put the pieces together."""
    metrics = np.full((len(METRICS), plan.n_scenarios), np.nan)
    status = np.zeros(plan.n_scenarios, dtype=np.int8)
    traces: dict[str, np.ndarray] = {}
    for result in shard_results(plan, n_jobs):
        at = slice(result.shard.start, result.shard.stop)
        metrics[:, at], status[at] = result.metrics, result.status
        for name, values in result.traces.items():
            if name not in traces:
                traces[name] = np.full((plan.n_scenarios, *values.shape[1:]), np.nan)
            traces[name][at] = values
        if progress:
            progress(len(result.shard))
    ds = wrap(plan.layout, metrics, status, {n: traces[n] for n in plan.traces.names}, plan.traces.interval)
    ds.attrs = {"title": "fastcoil simulation", **provenance(), **settings(plan)}
    ds.attrs["content_sha256"] = content_sha256(ds)
    return ds


def settings(plan: Plan) -> dict[str, Any]:
    """The attributes that, with the coordinates, say what was simulated."""
    attrs = {
        "parameters": json.dumps(plan.layout.loop.constants),
        "boundary": plan.layout.boundary.describe(),
        "boundary_sha256": plan.layout.boundary.sha256,
        "warm_up_s": plan.warm_up,
        "seed": str(plan.seed),
        "rng": RNG,
    }
    if plan.command is not None:
        attrs["command_sha256"] = joblib.hash(plan.command, hash_name="sha1")
    return attrs


def shard_results(plan: Plan, n_jobs: int) -> Iterator[ShardResult]:
    """Results in the order in which they get ready."""
    tasks = (joblib.delayed(run_shard)(plan, shard) for shard in plan.shards(n_jobs))
    yield from joblib.Parallel(n_jobs=n_jobs, backend="threading", batch_size=1, return_as="generator_unordered")(tasks)


def run_shard(plan: Plan, shard: range) -> ShardResult:
    """Run the scenarios of one shard, in blocks of lanes that share a day."""
    index = np.arange(shard.start, shard.stop)
    columns = plan.layout.columns(index)
    metrics, status = np.empty((len(METRICS), index.size)), np.empty(index.size, dtype=np.int8)
    traces: dict[str, np.ndarray] = {}
    n_points, n_max = plan.traces.n_points(plan.n_steps), int(np.max(plan.layout.loop["n_volumes"]))  # type: ignore[arg-type]
    for name in plan.traces.names:
        shape = (index.size, n_max, n_points) if TRACES[name].per_volume else (index.size, n_points)
        traces[name] = np.full(shape, np.nan)
    for day in np.unique(columns["day"]):
        members = np.flatnonzero(columns["day"] == day)
        for lanes, block in blocks({name: values[members] for name, values in columns.items()}):
            found, flags, signals = run_block(block, plan.days[day], plan.traces)
            at = members[lanes]
            metrics[:, at], status[at] = found[:, : at.size], flags[: at.size]
            for name, signal in signals.items():
                if TRACES[name].per_volume:
                    traces[name][at, : block.n_volumes] = signal[:, :, : at.size].T
                else:
                    traces[name][at] = signal[:, : at.size].T
    return ShardResult(shard, metrics, status, traces)


def workers(n_jobs: int | None) -> int:
    """Return a number of threads: all cores by default."""
    if n_jobs is None:
        return joblib.cpu_count()
    problems = _whole_number_problems("n_jobs", n_jobs, 1, 1024)
    if problems:
        raise InputError(problems)
    return n_jobs


def available_memory() -> int:
    """Bytes of memory that can be used without swapping."""
    try:
        fields = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        return int(fields["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):  # not Linux: take what the machine has
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def check_disk(plan: Plan, folder: Path) -> None:
    """Refuse a result that cannot fit where it is to be written."""
    nearest_existing = next(p for p in [folder, *folder.absolute().parents] if p.exists())
    free = shutil.disk_usage(nearest_existing).free
    if plan.result_bytes > free:
        raise InputError(
            f"the result needs up to {gib(plan.result_bytes)} on disk, {gib(free)} are free in {nearest_existing}: choose "
            "another folder, or sweep fewer values, ask for fewer traces or a longer trace_interval"
        )


def gib(n_bytes: float) -> str:
    """Bytes in words."""
    return f"{n_bytes / 2**30:,.1f} GiB" if n_bytes >= 2**30 else f"{n_bytes / 2**20:,.1f} MiB"


def _check_memory(plan: Plan) -> None:
    available = available_memory()
    # the result, its image on the way to disk, and a copy while it is put together
    needed = 3 * plan.result_bytes
    if needed > available:
        raise InputError(
            f"{plan.n_scenarios:,} scenarios need {gib(needed)} of memory for their results, {gib(available)} are available: "
            "sweep fewer values, ask for fewer traces or a longer trace_interval"
        )


def _whole_number_problems(name: str, value: object, low: int, high: int | None) -> list[str]:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        return [f"{name} = {value!r}: give a whole number"]
    if value < low or (high is not None and value > high):
        return [f"{name} = {value}: must be at least {low}" + (f" and at most {high}" if high is not None else "")]
    return []


def _commands(command: Any, boundary: Boundary) -> np.ndarray | None:
    """The open-loop command as (n_days, n_steps), or None in closed loop."""
    if command is None:
        return None
    values = np.asarray(command, dtype=float)
    shape = (boundary.n_days, boundary.n_steps)
    if values.shape not in (shape, shape[1:]):
        raise InputError(f"command has shape {values.shape}: give 1-s samples, {shape[1:]} or (day, second) = {shape}")
    bad = np.argwhere(~((values >= 0.0) & (values <= 1.0)))
    if bad.size:
        raise InputError(f"command = {values[tuple(bad[0])]} at second {bad[0][-1]}: must be a fraction of stroke, 0 to 1")
    return np.array(np.broadcast_to(values, shape), order="C")
