"""A pool whose workers die on command, without threads or processes."""

import concurrent.futures as cf
import random
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from fastcoil.loops.plan import Shard
from fastcoil.model.metric_table import STATUS_OK
from fastcoil.study import workers as pools
from fastcoil.study.workers import run_shards
from helpers.processes import N_SCENARIOS


class WorkerDied(Exception):
    pass


def healthy_part(index):
    status = np.full(len(index), STATUS_OK)
    return xr.Dataset({"status": ("scenario", status)}, {"scenario": np.array(index)})


class DyingPool:
    """A pool whose workers die of some scenarios, and at random."""

    worker_errors = (WorkerDied,)

    def __init__(self, n_workers, *, fails_together, culprits=(), death_rate=0.0, seed=0):
        self.n_workers, self.fails_together = n_workers, fails_together
        self.culprits, self.death_rate = set(culprits), death_rate
        self.dice = random.Random(seed)
        self.pending = {}
        self.runs, self.max_pending, self.n_deaths = [], 0, 0

    def submit(self, shard):
        index = shard.index
        assert all({*index}.isdisjoint(others) for others in self.pending.values()), "a scenario is run twice at a time"
        future = cf.Future()
        self.pending[future] = index.tolist()
        self.max_pending = max(self.max_pending, len(self.pending))
        if self.dice.random() < self.death_rate:
            self._kill(future)
        return future

    def _kill(self, future):
        for lost_future in list(self.pending) if self.fails_together else [future]:
            if not lost_future.done():
                lost_future.set_exception(WorkerDied())
        self.n_deaths += 1

    def wait(self, futures, return_when):
        """End some shards, with results or a death."""
        unfinished = [f for f in futures if not f.done()]
        for future in self.dice.sample(unfinished, min(len(unfinished), self.dice.randint(1, 2))):
            if future.done():
                continue
            index = self.pending[future]
            if self.culprits.intersection(index) or self.dice.random() < self.death_rate:
                self._kill(future)
            else:
                self.runs += index
                future.set_result(healthy_part(index))
        done = {f for f in futures if f.done()}
        for future in done:
            del self.pending[future]
        return done, set(futures) - done


def collect_status(pool, job, shards, status=None):
    """Collect the status of every scenario, also in ``status``; assert that none is yielded twice."""
    status = {} if status is None else status
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pools, "cf", SimpleNamespace(wait=pool.wait, FIRST_COMPLETED=cf.FIRST_COMPLETED))
        for part in run_shards(pool, job, shards):
            for k, flag in zip(part["scenario"].values.tolist(), part["status"].values.tolist(), strict=True):
                assert k not in status, "a scenario is found twice"
                status[k] = flag
    return status


def cut_into_sizes(size, n=N_SCENARIOS):
    """Cut the scenarios from 0 to ``n`` into shards of this size."""
    return [Shard(np.arange(start, min(start + size, n))) for start in range(0, n, size)]
