"""Shards through the kernels, on threads: parameters in, flat results out; and how long that takes."""

from __future__ import annotations

import concurrent.futures as cf
import json
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from fastcoil.loops.dataset import flat_dataset
from fastcoil.loops.plan import Plan
from fastcoil.loops.shards import END_STATE, Shard, Stretch, first_shards
from fastcoil.model.engine.emulator import Day
from fastcoil.model.engine.lanes import (
    Block,
    TraceRequest,
    WorkSpace,
    blocks,
    parameter_matrix,
    run_block,
    state_of,
    work_space,
    work_space_from,
)
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.numerics.jit import compiled_for
from fastcoil.model.user_rules import rules_for_kernels

S = TypeVar("S")
T = TypeVar("T")
_PIECE = 0.5
"""Seconds; a long wait is cut into pieces."""


def within(seconds: float | None, call: Callable[[], T]) -> T:
    """Make a call, or raise TimeoutError if it takes longer; ``None``: wait for ever.

    An abandoned call continues in a daemon thread.
    """
    found = _started(call)
    if seconds is None:
        _await([found])
    return found.result(seconds)


@contextmanager
def on_threads(n_threads: int, call: Callable[[S], None], items: Sequence[S]) -> Iterator[None]:
    """Call a function with each item on threads, while the caller runs the body of ``with``; wait for all at its end.

    After the first error or Ctrl-C no more calls begin; those that run continue, as in ``within``.
    """
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


def run_shard(plan: Plan, shard: Shard | Stretch) -> xr.Dataset:
    """Run the scenarios of a shard, day by day and block by block.

    Returns a flat Dataset, see ``flat_dataset``; of a stretch that others follow it also has ``END_STATE``.
    """
    found = Results(plan, shard.size)
    end = run_into(found, plan, shard, np.arange(shard.size))
    part = flat_dataset(shard.index, found.metrics, found.status, found.traces, plan.traces.interval)
    part.attrs["computed_on"] = json.dumps([compiled_for()])
    return part if end is None else part.assign({END_STATE: (("lane", "number"), end)})


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


def run_into(found: Results, plan: Plan, shard: Shard | Stretch, places: np.ndarray) -> np.ndarray | None:
    """Run the scenarios of a shard.  places: (n,), where their results go; other threads may fill other places.

    Returns the states at the end of a stretch that others come after, (n_lanes, n_numbers).
    """
    if isinstance(shard, Shard):
        _run_days_apart(found, plan, shard, places)
        return None
    end = _run_days_in_sequence(found, plan, shard, places)
    return end if shard.days.stop < shard.end else None


def _run_days_apart(found: Results, plan: Plan, shard: Shard, places: np.ndarray) -> None:
    columns = plan.layout.columns(shard.index)
    rules = rules_for_kernels(plan.layout.loop.rules)
    matrix = parameter_matrix(columns, rules)
    for k in np.unique(columns["day"]):
        day, of_day = plan.days[int(k)], np.flatnonzero(columns["day"] == k)
        for lanes, block in blocks(matrix[:, of_day], rules):
            found.run(block, day, places[of_day[lanes]])


def _run_days_in_sequence(found: Results, plan: Plan, stretch: Stretch, places: np.ndarray) -> np.ndarray:
    """Returns the state of every lane at the end, (n_lanes, n)."""
    rules = rules_for_kernels(plan.layout.loop.rules)
    n = stretch.lanes.size
    # parameters do not change from day to day
    matrix = parameter_matrix(plan.layout.columns(stretch.index[:n]), rules)
    begins = stretch.begins
    running = [
        (lanes, block, work_space(block) if begins is None else work_space_from(block, begins[lanes]))
        for lanes, block in blocks(matrix, rules)
    ]
    for k, number in enumerate(stretch.days):
        day = plan.days[number]
        for lanes, block, work in running:
            found.run(block, day, places[k * n + lanes], work)
    states = [(lanes, state_of(block, work)) for lanes, block, work in running]
    end = np.zeros((n, max(state.shape[1] for _, state in states)))
    for lanes, state in states:
        end[lanes, : state.shape[1]] = state[: lanes.size]
    return end


_SHARDS_TIMED, _STEPS_TIMED = 3, 28_800
_PER_SHARD = 0.06
"""Seconds to write a shard and to read it in the merge, on a server with two cores."""
_PER_TRACE_BYTE, _PER_METRIC_BYTE, _PER_BOUNDARY_BYTE = 32e-9, 12e-9, 1e-9
"""Seconds to write, merge and compress, or to hash, there."""


def estimate_seconds(plan: Plan, n_jobs: int) -> float:
    """Seconds from the first scenario to the results on the disk, with ``n_jobs`` threads; runs some blocks."""
    first = first_shards(plan, n_jobs)
    # of a sequence of days the first of each group
    pieces = [shard.on(range(1)) if isinstance(shard, Stretch) else shard.index for shard in first]
    timed = [pieces[k] for k in np.unique(np.linspace(0, len(pieces) - 1, _SHARDS_TIMED).astype(int))]
    work = sum(_seconds_of(plan, shard) for shard in timed) * plan.n_scenarios / sum(map(len, timed))
    bytes_written = plan.trace_bytes * _PER_TRACE_BYTE + plan.metric_bytes * _PER_METRIC_BYTE
    afterwards = count_shards(first) * _PER_SHARD + bytes_written + plan.boundary_bytes * _PER_BOUNDARY_BYTE
    return work / min(n_jobs, len(first)) + afterwards


def count_shards(first: Sequence[Shard | Stretch]) -> int:
    """How many shards there are in all, with those that come after the ``first``."""
    return sum(shard.n_in_chain if isinstance(shard, Stretch) else 1 for shard in first)


def _seconds_of(plan: Plan, shard: np.ndarray) -> float:
    """Seconds that a thread takes for a shard: all its blocks are made, one of them is run."""
    columns = plan.layout.columns(shard)
    rules = rules_for_kernels(plan.layout.loop.rules)
    blocks(parameter_matrix(columns, rules), rules)  # compiles, once, what its blocks call
    start = time.perf_counter()
    matrix = parameter_matrix(plan.layout.columns(shard), rules)
    days = np.unique(columns["day"])
    made = [block for k in days for _, block in blocks(matrix[:, columns["day"] == k], rules)]
    seconds = time.perf_counter() - start
    start = time.perf_counter()
    day = plan.days[int(columns["day"][0])]
    seconds += (time.perf_counter() - start) * days.size
    return seconds + len(made) * _seconds_of_block(plan, made[len(made) // 2], day)


def _seconds_of_block(plan: Plan, block: Block, day: Day) -> float:
    n_steps = min(plan.n_steps, _STEPS_TIMED)
    flags = day.schedule._replace(flags=day.schedule.flags[:n_steps])
    part = day._replace(series=day.series[:n_steps], command=day.command[:n_steps], schedule=flags)
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        run_interruptibly(block, part, plan.traces)
        seconds.append(time.perf_counter() - start)
    return min(seconds) * plan.n_steps / n_steps
