"""Shards through a pool, whatever happens to the workers."""

from __future__ import annotations

import concurrent.futures as cf
import time
from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from fastcoil.errors import FastcoilError
from fastcoil.study.workers.pools import Pool
from fastcoil.study.workers.worker import Job, crashed

_MOST_DEATHS = 40
"""Without a result in between: one bad scenario in a shard of a million takes 20."""
_FIRST_LIMIT, _LEAST_LIMIT, _LIMIT_FACTOR = 600.0, 60.0, 20.0


class Rounds:
    """Runs the shards of a job.

    Shards that were in flight when a worker died are suspects: each is run again alone, and one that takes its
    worker down once more is halved, until single scenarios are found guilty; these get the status ``crashed``, but
    not before another result has shown that the workers are not to blame.

    time_limit: seconds after which a shard counts as hanging; by default 20 times the longest so far, at least 60 s.
    """

    def __init__(self, pool: Pool, job: Job, time_limit: float | None = None) -> None:
        self._pool, self._job = pool, job
        self._given_limit, self._longest = time_limit, 0.0
        self._deaths = 0
        self._guilty: list[np.ndarray] = []

    def results(self, shards: Sequence[np.ndarray]) -> Iterator[xr.Dataset]:
        """Flat results of every shard (see ``results.flat``), in the order in which they get ready.

        Raises
        ------
        FastcoilError
            If workers die again and again without a result in between.
        """
        for part in self._survivors(shards):
            yield from self._crashed()
            yield part
        yield from self._crashed()

    def _survivors(self, shards: Sequence[np.ndarray]) -> Iterator[xr.Dataset]:
        suspects: list[np.ndarray] = []
        yield from self._flown(shards, suspects)
        for index in suspects:
            yield from self._alone(index)

    def _crashed(self) -> Iterator[xr.Dataset]:
        while self._guilty:
            yield crashed(self._job, self._guilty.pop(0))

    def _alone(self, index: np.ndarray, attempts: int = 1) -> Iterator[xr.Dataset]:
        suspects: list[np.ndarray] = []
        yield from self._flown([index], suspects)
        if not suspects:
            return
        if index.size > 1:
            for half in np.array_split(index, 2):
                yield from self._alone(half)
        elif attempts > 1:
            self._guilty.append(index)
        else:
            yield from self._alone(index, attempts + 1)

    def _flown(self, shards: Sequence[np.ndarray], suspects: list[np.ndarray]) -> Iterator[xr.Dataset]:
        """Results of the shards that survive; the others are added to ``suspects``."""
        waiting, pool = deque(shards), self._pool
        flying: dict[cf.Future[xr.Dataset], tuple[np.ndarray, float]] = {}
        while waiting or flying:
            died = False
            # one more than there are workers, so that none waits for this thread to write
            while waiting and len(flying) <= pool.n_workers and not died:
                try:
                    flying[pool.submit(waiting[0])] = waiting[0], time.monotonic()
                    waiting.popleft()
                except pool.deaths:  # since this thread last looked
                    died = True
            done, _ = cf.wait(flying, timeout=1.0, return_when=cf.FIRST_COMPLETED)
            for future in done:
                index, start = flying.pop(future)
                try:
                    part = future.result()
                except pool.deaths:
                    suspects.append(index)
                    died = True
                else:
                    self._deaths = 0
                    self._longest = max(self._longest, time.monotonic() - start)
                    yield part
            now = time.monotonic()
            overdue = pool.can_kill and any(not f.done() and now - s > self._limit for f, (_, s) in flying.items())
            if died or overdue:
                self._count_death()
                if pool.falls_together or overdue:
                    suspects += [index for index, _ in flying.values()]
                    flying.clear()
                    pool.restart()

    @property
    def _limit(self) -> float:
        if self._given_limit is not None:
            return self._given_limit
        return max(_LEAST_LIMIT, _LIMIT_FACTOR * self._longest) if self._longest else _FIRST_LIMIT

    def _count_death(self) -> None:
        self._deaths += 1
        if self._deaths > _MOST_DEATHS:
            raise FastcoilError(
                f"{_MOST_DEATHS} workers died in a row without a result: they may lack memory, use fewer with -j, or "
                "another --engine; what was computed is kept, run the same command again to go on"
            )
