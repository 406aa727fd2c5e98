"""How long a run takes: blocks of the study are timed, what is done to each shard and byte was measured once."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from fastcoil.loops.cut import first_shards
from fastcoil.loops.plan import Plan
from fastcoil.loops.shards import Shard, Stretch
from fastcoil.loops.threads import run_interruptibly
from fastcoil.model.engine.emulator import Day
from fastcoil.model.engine.lanes import Block, blocks, parameter_matrix
from fastcoil.model.user_rules.rule import rules_for_kernels

_SHARDS_TIMED, _STEPS_TIMED = 3, 28_800
_PER_SHARD = 0.06
"""Seconds to write a shard and to read it in the merge, on a server with two cores."""
_PER_TRACE_BYTE, _PER_METRIC_BYTE, _PER_BOUNDARY_BYTE = 32e-9, 12e-9, 1e-9
"""Seconds to write, merge and compress, or to hash, there."""


def estimate_seconds(plan: Plan, n_jobs: int) -> float:
    """Seconds from the first scenario to the results on the disk, with ``n_jobs`` threads; runs some blocks."""
    first = first_shards(plan, n_jobs)
    # of a sequence of days the first of each group
    pieces = [shard.chain.index(range(1)) if isinstance(shard, Stretch) else shard.index for shard in first]
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
    blocks(parameter_matrix(plan.layout.columns(shard)))  # compiles, once, what its blocks call
    start = time.perf_counter()
    columns = plan.layout.columns(shard)
    rules = rules_for_kernels(plan.layout.loop.rules)
    matrix = parameter_matrix(columns, rules)
    of_days = [matrix[:, columns["day"] == k] for k in np.unique(columns["day"])]
    made = [block for of_day in of_days for _, block in blocks(of_day, rules)]
    seconds = time.perf_counter() - start
    start = time.perf_counter()
    day = plan.days[int(columns["day"][0])]
    seconds += (time.perf_counter() - start) * np.unique(columns["day"]).size
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
