"""``simulate``: loops × days × replicates → Dataset; shards through the kernels, on threads, and how long that takes.

A shard is the unit of scheduling and of progress; parameters exist only while the blocks that have them run.
"""

import concurrent.futures as cf
import json
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from itertools import chain
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from fastcoil.base.arguments import checking, flag_of, instance_of, whole_of
from fastcoil.base.progress import Advance, progress_of_call
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clashes import tell_limited
from fastcoil.loops.loop import Loop
from fastcoil.loops.netcdf import compressed_share
from fastcoil.loops.plan import PARAMETERS_AT_ONCE, Plan, Shard, plan_simulation, shards_of, simulation_attributes
from fastcoil.loops.provenance import content_sha256, provenance
from fastcoil.loops.scenarios import flat_dataset, unflatten
from fastcoil.loops.valve_test import ValveTest
from fastcoil.model.engine.emulator import Day
from fastcoil.model.engine.lanes import Block, TraceRequest, WorkSpace, blocks, parameter_matrix, run_block, work_space
from fastcoil.model.metric_table import METRICS, TRACES, WARM_UP
from fastcoil.model.numerics.jit import compiled_for
from fastcoil.model.user_rules import rules_for_kernels

S = TypeVar("S")
T = TypeVar("T")
_PIECE = 0.5  # seconds; a long wait is cut into pieces


def within(seconds: float | None, call: Callable[[], T]) -> T:
    """Make a call, or raise TimeoutError and leave it to a daemon thread if it takes longer; None: no limit."""
    found = _started(call)
    if seconds is None:
        _await([found])
    return found.result(seconds)


@contextmanager
def on_threads(n_threads: int, call: Callable[[S], None], items: Sequence[S]) -> Iterator[None]:
    """Call with each item on threads during the body of ``with``, whose end waits; after an error no more begin."""
    todo = deque(items)

    def work() -> None:
        while True:
            try:
                item = todo.popleft()
            except IndexError:
                return
            call(item)

    try:
        threads = [_started(work) for _ in range(min(n_threads, len(items)))]
        yield
        for thread in _await(threads):
            thread.result()
    finally:
        todo.clear()


def _started(call: Callable[[], T]) -> cf.Future[T]:
    """The future result of a call in a daemon thread."""
    found: cf.Future[T] = cf.Future()

    def run() -> None:
        try:
            found.set_result(call())
        except BaseException as error:
            found.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return found


def _await(futures: Sequence[cf.Future[T]]) -> Collection[cf.Future[T]]:
    """Wait for all of them, or for the first error; returns those that are done."""
    while True:
        # in pieces: a Ctrl-C just before a wait is handled after it
        done, running = cf.wait(futures, timeout=_PIECE, return_when=cf.FIRST_EXCEPTION)
        if not running or any(future.exception() for future in done):
            return done


def run_interruptibly(
    block: Block, day: Day, wanted: TraceRequest, work: WorkSpace | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """As ``run_block``: Ctrl-C ends the wait for a rule of the user that loops for ever."""
    of_user = block.law is not None or (block.estimator is not None and block.estimator.identity)
    if of_user and threading.current_thread() is threading.main_thread():
        return within(None, lambda: run_block(block, day, wanted, work))
    return run_block(block, day, wanted, work)


def run_shard(plan: Plan, shard: Shard) -> xr.Dataset:
    """Run the scenarios of a shard, day by day and block by block.  Returns a flat Dataset, see ``flat_dataset``."""
    found = Results(plan, shard.size)
    run_into(found, plan, shard, np.arange(shard.size))
    part = flat_dataset(shard.index, found.metrics, found.status, found.traces, plan.traces.interval)
    part.attrs["computed_on"] = json.dumps([compiled_for()])
    return part


class Results:
    """Room for the results of ``n`` scenarios, filled block by block."""

    def __init__(self, plan: Plan, n: int) -> None:
        self._plan = plan
        self.metrics, self.status = np.empty((len(METRICS), n)), np.empty(n, dtype=np.int8)
        self.traces: dict[str, np.ndarray] = {}
        n_points = plan.traces.n_points(plan.n_steps)
        for name in plan.traces.names:
            shape = (n, plan.n_volumes, n_points) if TRACES[name].per_volume else (n, n_points)
            self.traces[name] = np.full(shape, np.nan)

    def run(self, block: Block, day: Day, members: np.ndarray, work: WorkSpace | None = None) -> None:
        """Run a block through a day.  members: the places of its lanes among the scenarios."""
        found, flags, signals = run_interruptibly(block, day, self._plan.traces, work)
        self.metrics[:, members], self.status[members] = found[:, : members.size], flags[: members.size]
        for name, signal in signals.items():
            volumes = (slice(block.common.n_volumes),) if TRACES[name].per_volume else ()
            self.traces[name][members, *volumes] = signal[..., : members.size].T


def run_into(found: Results, plan: Plan, shard: Shard, places: np.ndarray) -> None:
    """Run the scenarios of a shard.  places: (n,), where their results go; other threads may fill other places."""
    rules = rules_for_kernels(plan.layout.loop.rules)
    if shard.is_sequence:
        _run_days_in_sequence(found, plan, shard, places, rules)
        return
    for start in range(0, shard.size, PARAMETERS_AT_ONCE):
        columns = plan.layout.columns(shard.lanes[start : start + PARAMETERS_AT_ONCE])
        matrix = parameter_matrix(columns, rules)
        for k in np.unique(columns["day"]):
            day, of_day = plan.days[int(k)], np.flatnonzero(columns["day"] == k)
            for lanes, block in blocks(matrix[:, of_day], rules):
                found.run(block, day, places[start + of_day[lanes]])


def _run_days_in_sequence(found: Results, plan: Plan, shard: Shard, places: np.ndarray, rules: Any) -> None:
    """Days before the first whose results are kept are run without traces."""
    # parameters do not change from day to day
    matrix = parameter_matrix(plan.layout.columns(shard.lanes), rules)
    running = [(lanes, block, work_space(block)) for lanes, block in blocks(matrix, rules)]
    for number in range(shard.end):
        day = plan.days[number]
        of_day = places[(number - shard.first) * shard.lanes.size :]
        for lanes, block, work in running:
            if number < shard.first:
                run_interruptibly(block, day, TraceRequest(), work)
            else:
                found.run(block, day, of_day[lanes], work)


_SHARDS_TIMED, _STEPS_TIMED, _LANES_TRIED = 3, 28_800, 8
_PER_SHARD = 0.06  # seconds to write a shard and to read it in the merge, on a server with two cores
_PER_TRACE_BYTE, _PER_METRIC_BYTE, _PER_BOUNDARY_BYTE = 32e-9, 12e-9, 1e-9
"""Seconds to write, merge and compress, or to hash, there."""


def estimate(plan: Plan, n_jobs: int) -> tuple[float, float, float]:
    """Seconds from the first scenario to the results on the disk, with ``n_jobs`` threads; runs some blocks.

    Also the shares of the bytes of metrics, and of traces, that are left when these are compressed.
    """
    shards = shards_of(plan, n_jobs)
    timed = [shards[k] for k in np.unique(np.linspace(0, len(shards) - 1, _SHARDS_TIMED).astype(int))]
    # of a sequence the first day stands for all
    pieces = [shard.lanes[:PARAMETERS_AT_ONCE] for shard in timed]
    seconds, metrics, traces = zip(*(_tried(plan, piece) for piece in pieces), strict=True)
    work = sum(seconds) * plan.n_scenarios / sum(map(len, pieces))
    shares = compressed_share(np.concatenate(metrics, axis=1)), compressed_share(chain.from_iterable(traces))
    bytes_written = plan.trace_bytes * _PER_TRACE_BYTE + plan.metric_bytes * _PER_METRIC_BYTE
    afterwards = len(shards) * _PER_SHARD + bytes_written + plan.boundary_bytes * _PER_BOUNDARY_BYTE
    return work / min(n_jobs, len(shards)) + afterwards, *shares


def _tried(plan: Plan, piece: np.ndarray) -> tuple[float, np.ndarray, list[np.ndarray]]:
    """Seconds that a thread takes for scenarios on days like their first, by one block; some of its results."""
    columns, rules = plan.layout.columns(piece), rules_for_kernels(plan.layout.loop.rules)
    of_day = columns["day"] == columns["day"][0]
    matrix = parameter_matrix(columns, rules)[:, of_day]
    blocks(matrix, rules)  # compiles, once, what its blocks call
    start = time.perf_counter()
    made = blocks(matrix, rules)
    members, block = made[len(made) // 2]
    day, n_steps = plan.days[int(columns["day"][0])], min(plan.n_steps, _STEPS_TIMED)
    seconds, of_block = time.perf_counter() - start, np.inf
    flags = day.schedule._replace(flags=day.schedule.flags[:n_steps])
    part = day._replace(series=day.series[:n_steps], command=day.command[:n_steps], schedule=flags)
    for _ in range(2):
        start = time.perf_counter()
        metrics, _, traces = run_interruptibly(block, part, plan.traces)
        of_block = min(of_block, time.perf_counter() - start)
    seconds += len(made) * of_block * plan.n_steps / n_steps
    stored = [np.nan_to_num(v).astype(np.int8) if n == "mode" else v for n, v in traces.items()]
    some = [values[..., : members.size][..., :_LANES_TRIED].T for values in stored]
    return seconds * piece.size / int(np.count_nonzero(of_day)), metrics[:, : members.size], some


def simulate(
    loop: Loop,
    boundary: Boundary,
    *,
    command: Any = None,
    test: ValveTest | None = None,
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
    test
        A valve test of every loop, in place of what these say of one; see ``fc.ValveTest``.
    traces
        Names of the signals to keep: T_sup, T_measured, u, integral, command, position, opening, m_w, estimate, mode,
        test, T_w_out, W_sup, wet_volumes, power and, with dim ``volume``, T_w, T_c, T_a, W_a.
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
        Whether to show how many scenario-days are done, on stderr: True always, False never; None on a terminal, after
        2 s.

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
        test = check.unless_none(instance_of, "test", test, ValveTest, "give a fastcoil.ValveTest")
        if test is not None and isinstance(loop, Loop):
            loop = loop.assign(**test.parameters())
        plan = check(
            plan_simulation, loop, boundary, command=command, traces=traces, trace_interval=trace_interval,
            warm_up=warm_up, seed=seed, replicates=replicates, carry_over=carry_over,
        )  # fmt: skip
    with progress_of_call(progress) as shown:
        return run_plan(plan, n_threads, shown.start(plan.n_scenarios))


def run_plan(plan: Plan, n_jobs: int, advance: Advance) -> xr.Dataset:
    """Run all shards of a plan on threads; ``advance`` receives the size of each finished one."""
    found = Results(plan, plan.n_scenarios)

    def run(shard: Shard) -> None:
        run_into(found, plan, shard, shard.index)
        advance(shard.size)

    shards = shards_of(plan, n_jobs)
    several = min(n_jobs, len(shards)) > 1
    with on_threads(n_jobs, run, shards) if several else nullcontext():
        attrs = {"title": "fastcoil simulation", **provenance(), **simulation_attributes(plan)}
    for shard in () if several else shards:
        run(shard)
    index = np.arange(plan.n_scenarios)
    ds = unflatten(flat_dataset(index, found.metrics, found.status, found.traces, plan.traces.interval), plan.layout)
    ds.attrs = attrs
    ds.attrs["content_sha256"] = content_sha256(ds)
    tell_limited(plan.layout.loop, ds)
    return ds


def workers(n_jobs: int | None) -> int:
    """Number of threads: all cores by default."""
    if n_jobs is None:
        import joblib  # takes 0.1 s, which a study that is only looked at need not wait

        return int(joblib.cpu_count())
    return whole_of("n_jobs", n_jobs, 1, 1024)
