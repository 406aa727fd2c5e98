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
from fastcoil.study.workers.worker import Job, crashed_part

_MOST_DEATHS = 40
"""Without a result in between: one bad scenario in a shard of a million takes 20."""
_FIRST_LIMIT, _LEAST_LIMIT, _LIMIT_FACTOR = 600.0, 60.0, 20.0


class Dispatcher:
    """Runs the shards of a job.

    Shards that were in flight when a worker died are suspects: each is run again alone, and one that takes its
    worker down once more is halved, until single scenarios are found guilty.  These get the status ``crashed``, but
    not before another result has shown that the workers are not to blame.

    time_limit: seconds after which a shard counts as hanging; by default 20 times the longest so far, at least 60 s.
    """

    def __init__(self, pool: Pool, job: Job, time_limit: float | None = None) -> None:
        self._pool, self._job = pool, job
        self._given_limit, self._longest = time_limit, 0.0
        self._deaths = 0
        self._guilty: list[np.ndarray] = []

    def run(self, shards: Sequence[np.ndarray]) -> Iterator[xr.Dataset]:
        """Run every shard and yield its flat results (see ``flat_dataset``), first finished first.

        Raises
        ------
        FastcoilError
            If workers die again and again without a result in between.
        """
        for part in self._run_with_suspects(shards):
            yield from self._take_crashed()
            yield part
        yield from self._take_crashed()

    def _run_with_suspects(self, shards: Sequence[np.ndarray]) -> Iterator[xr.Dataset]:
        suspects: list[np.ndarray] = []
        yield from self._run_all(shards, suspects)
        for index in suspects:
            yield from self._run_alone(index)

    def _take_crashed(self) -> Iterator[xr.Dataset]:
        while self._guilty:
            yield crashed_part(self._job, self._guilty.pop(0))

    def _run_alone(self, index: np.ndarray, attempts: int = 1) -> Iterator[xr.Dataset]:
        suspects: list[np.ndarray] = []
        yield from self._run_all([index], suspects)
        if not suspects:
            return
        if index.size > 1:
            for half in np.array_split(index, 2):
                yield from self._run_alone(half)
        elif attempts > 1:
            self._guilty.append(index)
        else:
            yield from self._run_alone(index, attempts + 1)

    def _run_all(self, shards: Sequence[np.ndarray], suspects: list[np.ndarray]) -> Iterator[xr.Dataset]:
        """Yield the results of the shards that survive; add the others to ``suspects``."""
        waiting, pool = deque(shards), self._pool
        in_flight: dict[cf.Future[xr.Dataset], tuple[np.ndarray, float]] = {}
        while waiting or in_flight:
            died = False
            # one more than there are workers, so that none waits for this thread to write
            while waiting and len(in_flight) <= pool.n_workers and not died:
                try:
                    in_flight[pool.submit(waiting[0])] = waiting[0], time.monotonic()
                    waiting.popleft()
                except pool.deaths:  # since this thread last looked
                    died = True
            done, _ = cf.wait(in_flight, timeout=1.0, return_when=cf.FIRST_COMPLETED)
            for future in done:
                index, start = in_flight.pop(future)
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
            overdue = pool.can_kill and any(not f.done() and now - s > self._limit for f, (_, s) in in_flight.items())
            if died or overdue:
                self._count_death()
                if pool.falls_together or overdue:
                    suspects += [index for index, _ in in_flight.values()]
                    in_flight.clear()
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
                "another --backend; finished scenarios are kept, run the same command again to resume"
            )
