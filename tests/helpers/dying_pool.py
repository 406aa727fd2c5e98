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


class Died(Exception):
    pass


def healthy(index):
    status = np.full(len(index), STATUS_OK)
    return xr.Dataset({"status": ("scenario", status)}, {"scenario": np.array(index)})


class Pool:
    """A pool whose workers die of some scenarios, and now and then of nothing."""

    deaths = (Died,)

    def __init__(self, n_workers, *, falls_together, culprits=(), clumsy=0.0, seed=0):
        self.n_workers, self.falls_together = n_workers, falls_together
        self.culprits, self.clumsy = set(culprits), clumsy
        self.dice = random.Random(seed)
        self.flying = {}
        self.runs, self.most_flying, self.n_deaths = [], 0, 0

    def submit(self, shard):
        index = shard.index
        assert not any(set(index) & set(other) for other in self.flying.values()), "a scenario is run twice at once"
        future = cf.Future()
        self.flying[future] = index.tolist()
        self.most_flying = max(self.most_flying, len(self.flying))
        if self.dice.random() < self.clumsy:
            self._let_die(future)
        return future

    def _let_die(self, future):
        lost = list(self.flying) if self.falls_together else [future]
        for one in lost:
            if not one.done():
                one.set_exception(Died())
        self.n_deaths += 1

    def wait(self, futures, return_when):
        """Some shard ends, one way or the other."""
        able = [f for f in futures if not f.done()]
        for future in self.dice.sample(able, min(len(able), self.dice.randint(1, 2))):
            if future.done():
                continue
            index = self.flying[future]
            if self.culprits.intersection(index) or self.dice.random() < self.clumsy:
                self._let_die(future)
            else:
                self.runs += index
                future.set_result(healthy(index))
        done = {f for f in futures if f.done()}
        for future in done:
            del self.flying[future]
        return done, set(futures) - done


def found(pool, job, shards, status=None):
    """Status of every scenario that was yielded, also put into ``status``; none is yielded twice."""
    status = {} if status is None else status
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pools, "cf", SimpleNamespace(wait=pool.wait, FIRST_COMPLETED=cf.FIRST_COMPLETED))
        for part in run_shards(pool, job, shards):
            for k, flag in zip(part["scenario"].values.tolist(), part["status"].values.tolist(), strict=True):
                assert k not in status, "a scenario is found twice"
                status[k] = flag
    return status


def in_shards(size, n=N_SCENARIOS):
    """The scenarios from 0 to ``n`` in shards of this size."""
    return [Shard(np.arange(start, min(start + size, n))) for start in range(0, n, size)]
