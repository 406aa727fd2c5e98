"""One shard through the kernels: parameters in, flat results out."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.loops.dataset import flat_dataset
from fastcoil.loops.plan import Plan
from fastcoil.loops.shards import END_STATE, Shard, Stretch
from fastcoil.loops.threads import run_interruptibly
from fastcoil.model.engine.carried import state_of, work_space_from
from fastcoil.model.engine.emulator import Day
from fastcoil.model.engine.lanes import Block, WorkSpace, blocks, parameter_matrix, work_space
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.numerics.jit import compiled_for
from fastcoil.model.user_rules.rule import rules_for_kernels


def run_shard(plan: Plan, shard: Shard | Stretch) -> xr.Dataset:
    """Run the scenarios of a shard, day by day and block by block.

    Returns a flat Dataset, see ``flat_dataset``; of a stretch that others come after it has ``END_STATE``, too.
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
    return end if shard.days.stop < shard.chain.end else None


def _run_days_apart(found: Results, plan: Plan, shard: Shard, places: np.ndarray) -> None:
    columns = plan.layout.columns(shard.index)
    rules = rules_for_kernels(plan.layout.loop.rules)
    matrix = parameter_matrix(columns, rules)
    for k in np.unique(columns["day"]):
        day, of_day = plan.days[int(k)], np.flatnonzero(columns["day"] == k)
        for lanes, block in blocks(matrix[:, of_day], rules):
            found.run(block, day, places[of_day[lanes]])


class _Running(NamedTuple):
    """A block of a stretch, with the places of its lanes in the group."""

    members: np.ndarray
    block: Block
    work: WorkSpace


def _run_days_in_sequence(found: Results, plan: Plan, stretch: Stretch, places: np.ndarray) -> np.ndarray:
    """Returns the state of every lane at the end, (n_lanes, n)."""
    rules = rules_for_kernels(plan.layout.loop.rules)
    n = stretch.chain.lanes.size
    # parameters do not change from day to day
    matrix = parameter_matrix(plan.layout.columns(stretch.index[:n]), rules)
    begins = stretch.begins
    running = [
        _Running(lanes, block, work_space(block) if begins is None else work_space_from(block, begins[lanes]))
        for lanes, block in blocks(matrix, rules)
    ]
    for k, number in enumerate(stretch.days):
        day = plan.days[number]
        for each in running:
            found.run(each.block, day, places[k * n + each.members], each.work)
    states = [state_of(each.block, each.work) for each in running]
    end = np.zeros((n, max(state.shape[1] for state in states)))
    for each, state in zip(running, states, strict=True):
        end[each.members, : state.shape[1]] = state[: each.members.size]
    return end
