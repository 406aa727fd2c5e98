"""``simulate``: loops × days × replicates → Dataset.  Runs shards on threads, and estimates run times."""

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

from fastcoil.base.arguments import argument_checks, require_flag, require_instance, require_integer
from fastcoil.base.machine import count_processors
from fastcoil.base.progress import Advance, display_for_call
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clashes import warn_saturated
from fastcoil.loops.loop import Loop
from fastcoil.loops.netcdf import compressed_share
from fastcoil.loops.plan import SCENARIOS_AT_ONCE, Plan, Shard, cut_into_shards, plan_simulation, simulation_attributes
from fastcoil.loops.provenance import content_sha256, provenance
from fastcoil.loops.scenarios import flat_dataset, unflatten
from fastcoil.loops.valve_test import ValveTest
from fastcoil.model.engine.emulator import Day
from fastcoil.model.metric_table import METRICS, TRACES, WARM_UP_S
from fastcoil.model.numerics.jit import numeric_environment
from fastcoil.model.user_rules import rules_for_kernels

from fastcoil.model.engine.lanes import (  # isort: skip
    Block, TraceRequest, WorkSpace, cut_into_blocks, parameter_matrix, run_block, work_space,
)  # fmt: skip

S = TypeVar("S")
T = TypeVar("T")


def call_with_timeout(seconds: float | None, call: Callable[[], T]) -> T:
    """Make a call in a daemon thread, and raise TimeoutError if it takes longer; None: no limit."""
    future = _start_in_thread(call)
    if seconds is None:
        _wait_for_futures([future])
    return future.result(seconds)


@contextmanager
def run_on_threads(n_threads: int, call: Callable[[S], None], items: Sequence[S]) -> Iterator[None]:
    """Call with each item on threads during a ``with`` block, whose end waits; after an error no more calls begin."""
    queue = deque(items)

    def work() -> None:
        while True:
            try:
                item = queue.popleft()
            except IndexError:
                return
            call(item)

    try:
        threads = [_start_in_thread(work) for _ in range(min(n_threads, len(items)))]
        yield
        for thread in _wait_for_futures(threads):
            thread.result()
    finally:
        queue.clear()


def _start_in_thread(call: Callable[[], T]) -> cf.Future[T]:
    """Return the future result of a call in a daemon thread."""
    future: cf.Future[T] = cf.Future()

    def run() -> None:
        try:
            future.set_result(call())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future


def _wait_for_futures(futures: Sequence[cf.Future[T]]) -> Collection[cf.Future[T]]:
    """Wait for all futures, or for the first error; return those that are done."""
    while True:
        # half a second at a time: a Ctrl-C just before a wait is handled after it
        done, running = cf.wait(futures, timeout=0.5, return_when=cf.FIRST_EXCEPTION)
        if not running or any(future.exception() for future in done):
            return done


def run_interruptibly(
    block: Block, day: Day, traces: TraceRequest, work: WorkSpace | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """As ``run_block``: Ctrl-C ends the wait for a rule of the user that loops for ever."""
    has_user_rule = block.law is not None or (block.estimator is not None and block.estimator.fingerprint)
    if has_user_rule and threading.current_thread() is threading.main_thread():
        return call_with_timeout(None, lambda: run_block(block, day, traces, work))
    return run_block(block, day, traces, work)


def run_shard(plan: Plan, shard: Shard) -> xr.Dataset:
    """Run the scenarios of a shard, day by day and block by block.  Returns a flat Dataset, see ``flat_dataset``."""
    results = Results(plan, shard.size)
    fill_results(results, plan, shard, np.arange(shard.size))
    part = flat_dataset(shard.index, results.metrics, results.status, results.traces, plan.traces.interval)
    part.attrs["computed_on"] = json.dumps([numeric_environment()])
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
        metrics, flags, signals = run_interruptibly(block, day, self._plan.traces, work)
        self.metrics[:, members], self.status[members] = metrics[:, : members.size], flags[: members.size]
        for name, signal in signals.items():
            volumes = (slice(block.config.n_volumes),) if TRACES[name].per_volume else ()
            self.traces[name][members, *volumes] = signal[..., : members.size].T


def fill_results(results: Results, plan: Plan, shard: Shard, places: np.ndarray) -> None:
    """Run the scenarios of a shard.  places: (n,), where their results go; other threads may fill other places."""
    rules = rules_for_kernels(plan.layout.loop.rules)
    if shard.n_per_day:
        _run_days_in_sequence(results, plan, shard, places, rules)
        return
    for start in range(0, shard.size, SCENARIOS_AT_ONCE):
        columns = plan.layout.columns(shard.lanes[start : start + SCENARIOS_AT_ONCE])
        matrix = parameter_matrix(columns, rules)
        for k in np.unique(columns["day"]):
            day, lanes_of_day = plan.days[int(k)], np.flatnonzero(columns["day"] == k)
            for lanes, block in cut_into_blocks(matrix[:, lanes_of_day], rules):
                results.run(block, day, places[start + lanes_of_day[lanes]])


def _run_days_in_sequence(results: Results, plan: Plan, shard: Shard, places: np.ndarray, rules: Any) -> None:
    """Days before the first whose results are kept are run without traces."""
    # parameters do not change from day to day
    matrix = parameter_matrix(plan.layout.columns(shard.lanes), rules)
    lane_blocks = [(lanes, block, work_space(block)) for lanes, block in cut_into_blocks(matrix, rules)]
    for number in range(shard.end_day):
        day = plan.days[number]
        day_places = places[(number - shard.first_day) * shard.lanes.size :]
        for lanes, block, work in lane_blocks:
            if number < shard.first_day:
                run_interruptibly(block, day, TraceRequest(), work)
            else:
                results.run(block, day, day_places[lanes], work)


def estimate_run_time(plan: Plan, n_jobs: int) -> tuple[float, float, float]:
    """Estimate the seconds of a run on ``n_jobs`` threads by running blocks, and the shares that compression leaves."""
    shards = cut_into_shards(plan, n_jobs)
    timed_shards = [shards[k] for k in np.unique(np.linspace(0, len(shards) - 1, 3).astype(int))]
    # of a sequence the first day stands for all
    index_pieces = [shard.lanes[:SCENARIOS_AT_ONCE] for shard in timed_shards]
    seconds, metrics, traces = zip(*(_time_block(plan, index) for index in index_pieces), strict=True)
    work_seconds = sum(seconds) * plan.n_scenarios / sum(map(len, index_pieces))
    # measured on a server with two cores: to write and merge a shard; to write, merge and compress or hash a byte
    io_seconds = 0.06 * len(shards) + 32e-9 * plan.trace_bytes + 12e-9 * plan.metric_bytes + 1e-9 * plan.boundary_bytes
    shares = compressed_share(np.concatenate(metrics, axis=1)), compressed_share(chain.from_iterable(traces))
    return work_seconds / min(n_jobs, len(shards)) + io_seconds, *shares


def _time_block(plan: Plan, index: np.ndarray) -> tuple[float, np.ndarray, list[np.ndarray]]:
    """Estimate the seconds of a thread for scenarios on days like their first, by one block; also some results."""
    columns, rules = plan.layout.columns(index), rules_for_kernels(plan.layout.loop.rules)
    is_first_day = columns["day"] == columns["day"][0]
    matrix = parameter_matrix(columns, rules)[:, is_first_day]
    cut_into_blocks(matrix, rules)  # compiles, once, what its blocks call
    start = time.perf_counter()
    lane_blocks = cut_into_blocks(matrix, rules)
    members, block = lane_blocks[len(lane_blocks) // 2]
    day, n_steps = plan.days[int(columns["day"][0])], min(plan.n_steps, 28_800)
    seconds, block_seconds = time.perf_counter() - start, np.inf
    part_schedule = day.schedule._replace(flags=day.schedule.flags[:n_steps])
    day_part = day._replace(series=day.series[:n_steps], command=day.command[:n_steps], schedule=part_schedule)
    for _ in range(2):
        start = time.perf_counter()
        metrics, _, traces = run_interruptibly(block, day_part, plan.traces)
        block_seconds = min(block_seconds, time.perf_counter() - start)
    seconds += len(lane_blocks) * block_seconds * plan.n_steps / n_steps
    stored_traces = [np.nan_to_num(v).astype(np.int8) if n == "mode" else v for n, v in traces.items()]
    sampled_traces = [values[..., : members.size][..., :8].T for values in stored_traces]
    return seconds * index.size / int(np.count_nonzero(is_first_day)), metrics[:, : members.size], sampled_traces


def simulate(
    loop: Loop, boundary: Boundary, *, command: Any = None, test: ValveTest | None = None, traces: Sequence[str] = (),
    trace_interval: int = 1, warm_up: int = WARM_UP_S, seed: int = 0, replicates: int = 1, carry_over: bool = False,
    n_jobs: int | None = None, progress: bool | None = None,
) -> xr.Dataset:  # fmt: skip
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
        A valve test of every loop, in place of their parameters ``test_...``; see ``fc.ValveTest``.
    traces
        Names of the signals to keep: T_sup, T_measured, u, integral, command, position, opening, m_w, estimate, mode,
        test, T_w_out, W_sup, wet_volumes, power and, with dim ``volume``, T_w, T_c, T_a, W_a.
    trace_interval
        Seconds between the samples of a trace; a sample is the value at that second, not a mean.
    warm_up
        Seconds at the start that are excluded from all metrics.
    seed
        Seed of the measurement noise, 0 … 2**64 - 1.
    replicates
        Noise realisations; more than one become the dim ``replicate``.
    carry_over
        Whether the days are a sequence: each begins in the final state of the one before (coil, controller, estimator,
        actuator), and has its own metrics.  The warm-up applies to the first day only; times since the start, such as
        ``learn_time_reached``, count from the first day on.
    n_jobs
        Threads; all cores by default.  The result does not depend on it.
    progress
        Whether to show the number of finished scenario-days on stderr; by default on a terminal, after 2 s.

    Returns
    -------
    xarray.Dataset
        Metrics and ``status`` over the dims of the sweep; traces over these dims and ``elapsed_time``.

    Raises
    ------
    InputError
        With one sentence for each mistake in the arguments; for an unstable coil, or too large a result.

    References
    ----------
    Cai, J. and Braun, J. E. (2016), Purdue, paper 1801, Eqs (1) to (4), https://docs.lib.purdue.edu/iracc/1801

    Examples
    --------
    >>> import fastcoil as fc
    >>> ds = fc.simulate(fc.Loop(backlash=[0.0, 0.07]), fc.paper_day(hours=2), traces=["T_sup"], trace_interval=60)
    >>> ds.rmse.round(2).values.tolist(), dict(ds.T_sup.sizes)
    ([0.16, 0.39], {'backlash': 2, 'elapsed_time': 120})
    """
    with argument_checks() as check:
        n_threads = check(number_of_threads, n_jobs)
        progress = check.unless_none(require_flag, "progress", progress)
        test = check.unless_none(require_instance, "test", test, ValveTest, "give a fastcoil.ValveTest")
        if test is not None and isinstance(loop, Loop):
            loop = loop.assign(**test.parameters())
        plan = check(
            plan_simulation, loop, boundary, command=command, traces=traces, trace_interval=trace_interval,
            warm_up=warm_up, seed=seed, replicates=replicates, carry_over=carry_over,
        )  # fmt: skip
    with display_for_call(progress) as display:
        return run_plan(plan, n_threads, display.start(plan.n_scenarios))


def run_plan(plan: Plan, n_jobs: int, advance: Advance) -> xr.Dataset:
    """Run all shards of a plan on threads; ``advance`` receives the size of each finished one."""
    results = Results(plan, plan.n_scenarios)

    def run(shard: Shard) -> None:
        fill_results(results, plan, shard, shard.index)
        advance(shard.size)

    shards = cut_into_shards(plan, n_jobs)
    is_parallel = min(n_jobs, len(shards)) > 1
    with run_on_threads(n_jobs, run, shards) if is_parallel else nullcontext():
        attrs = {"title": "fastcoil simulation", **provenance(), **simulation_attributes(plan)}
    for shard in () if is_parallel else shards:
        run(shard)
    index = np.arange(plan.n_scenarios)
    flat = flat_dataset(index, results.metrics, results.status, results.traces, plan.traces.interval)
    ds = unflatten(flat, plan.layout)
    ds.attrs = attrs
    ds.attrs["content_sha256"] = content_sha256(ds)
    warn_saturated(plan.layout.loop, ds)
    return ds


def number_of_threads(n_jobs: int | None) -> int:
    """Return the number of threads, by default that of all cores."""
    return count_processors() if n_jobs is None else require_integer("n_jobs", n_jobs, 1, 1024)
