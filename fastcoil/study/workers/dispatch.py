"""Shards through a pool, whatever happens to the workers."""

import concurrent.futures as cf
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from fastcoil.base.errors import FastcoilError, out_of_memory
from fastcoil.loops.plan import Shard
from fastcoil.study.workers.pools import Pool
from fastcoil.study.workers.worker import Interrupt, Job, crashed_part

_MOST_DEATHS = 40  # without a result in between: one bad scenario in a shard of a million takes 20
_FIRST_LIMIT, _LEAST_LIMIT, _LIMIT_FACTOR = 600.0, 60.0, 20.0


@dataclass
class _Flight:
    """A shard in flight.  since: when it was last known not to run yet."""

    shard: Shard
    since: float


class Dispatcher:
    """Runs the shards of a job.

    Shards that were in flight when a worker died are suspects: each is run again alone, and one that takes its
    worker down once more is halved, until single scenarios are found guilty.  These, and the days that would follow
    from theirs, get the status ``crashed``, but not before another result has shown that the workers are not to blame.
    If the memory does not suffice for any of them, the run ends instead: none is to blame.

    time_limit: seconds that a shard may run, in a pool that can stop it, before it counts as hanging; by default 20
    times the longest so far, at least 60 s.
    """

    def __init__(self, pool: Pool, job: Job, time_limit: float | None = None) -> None:
        self._pool, self._job = pool, job
        self._given_limit, self._longest = time_limit, 0.0
        self._deaths = 0
        self._last_death: BaseException | None = None
        self._anything_ran = False
        self._guilty: list[np.ndarray] = []

    def run(self, shards: Sequence[Shard]) -> Iterator[xr.Dataset]:
        """Run every shard, and all that come after them, and yield their flat results (see ``run_shard``).

        Raises
        ------
        StorageError
            If the memory does not suffice, not even for a single scenario.
        FastcoilError
            If workers die again and again without a result in between.
        """
        for part in self._run_with_suspects(shards):
            self._anything_ran = True
            yield from self._take_crashed()
            yield part
        if len(self._guilty) > 1:
            self._require_memory("not even single scenarios can be run any more")
        yield from self._take_crashed()

    def _run_with_suspects(self, shards: Sequence[Shard]) -> Iterator[xr.Dataset]:
        waiting = deque(shards)
        while waiting:
            suspects: list[Shard] = []
            yield from self._run_all(waiting, suspects, waiting)
            for shard in suspects:
                yield from self._run_alone(shard, waiting)

    def _take_crashed(self) -> Iterator[xr.Dataset]:
        while self._guilty:
            yield crashed_part(self._job, self._guilty.pop(0))

    def _run_alone(self, shard: Shard, after: deque[Shard], attempts: int = 1) -> Iterator[xr.Dataset]:
        """Run a suspect, or what can be run of it; ``after`` gets what comes after it."""
        suspects: list[Shard] = []
        yield from self._run_all(deque([shard]), suspects, after)
        if not suspects:
            return
        if shard.size > 1:
            for half in shard.halves():
                later: deque[Shard] = deque()
                yield from self._run_alone(half, later)
                for rest in later:
                    if shard.includes(rest):
                        yield from self._run_alone(rest, after)
                    else:
                        after.append(rest)
        elif attempts > 1:
            if not self._anything_ran:
                self._require_memory("not even a single scenario can be run")
            self._guilty.append(shard.lost)
        else:
            yield from self._run_alone(shard, after, attempts + 1)

    def _run_all(self, waiting: deque[Shard], suspects: list[Shard], after: deque[Shard]) -> Iterator[xr.Dataset]:
        """Yield the results of the shards that survive; add the others to ``suspects``.

        after: gets what comes after those that are done; it may be ``waiting``.
        """
        pool = self._pool
        in_flight: dict[cf.Future[xr.Dataset], _Flight] = {}
        last_result = time.monotonic()
        while waiting or in_flight:
            died = self._submit(waiting, in_flight)
            done, _ = cf.wait(in_flight, timeout=1.0, return_when=cf.FIRST_COMPLETED)
            for future in done:
                flight = in_flight.pop(future)
                try:
                    part = future.result()
                except pool.deaths as death:
                    suspects.append(flight.shard)
                    self._last_death, died = death, True
                except Interrupt:
                    raise KeyboardInterrupt from None
                else:
                    self._deaths = 0
                    self._longest = max(self._longest, time.monotonic() - flight.since)
                    following = flight.shard.after(part)
                    if following is not None:
                        after.append(following)
                        died = died or self._submit(waiting, in_flight)  # no worker waits until the part is written
                    yield part
                last_result = time.monotonic()
            pool.stalled(time.monotonic() - last_result)
            hangs = self._hangs(in_flight)
            if hangs:
                self._last_death = None
                # first come, first served: one that never ran is not to blame
                never_ran = list(in_flight)[pool.n_workers :]
                waiting.extendleft(in_flight.pop(future).shard for future in never_ran)
            if died or hangs:
                self._count_death()
            if hangs or (died and pool.falls_together):
                suspects += [flight.shard for flight in in_flight.values()]
                in_flight.clear()
                pool.restart()

    def _submit(self, waiting: deque[Shard], in_flight: dict[cf.Future[xr.Dataset], _Flight]) -> bool:
        """Start as many shards as there are workers, and one more; returns whether a worker was found dead."""
        # one more, so that none waits for this thread to write
        while waiting and len(in_flight) <= self._pool.n_workers:
            try:
                in_flight[self._pool.submit(waiting[0])] = _Flight(waiting[0], time.monotonic())
                waiting.popleft()
            except self._pool.deaths as death:  # since this thread last looked
                self._last_death = death
                return True
        return False

    def _hangs(self, in_flight: dict[cf.Future[xr.Dataset], _Flight]) -> bool:
        """Whether a shard has taken too long, and can be stopped."""
        now = time.monotonic()
        for flight in list(in_flight.values())[self._pool.n_workers :]:
            flight.since = now  # all workers have others
        late = (future for future, flight in in_flight.items() if now - flight.since > self._limit)
        return self._pool.can_kill and any(not future.done() for future in late)

    @property
    def _limit(self) -> float:
        if self._given_limit is not None:
            return self._given_limit
        return max(_LEAST_LIMIT, _LIMIT_FACTOR * self._longest) if self._longest else _FIRST_LIMIT

    def _require_memory(self, what: str) -> None:
        """End the run if the memory ran out last."""
        if isinstance(self._last_death, MemoryError):
            raise out_of_memory(what) from self._last_death

    def _count_death(self) -> None:
        self._deaths += 1
        if self._deaths > _MOST_DEATHS:
            self._require_memory(f"{_MOST_DEATHS} attempts in a row gave no result")
            raise FastcoilError(
                f"{_MOST_DEATHS} workers died in a row without a result: they may lack memory, use fewer with -j, or "
                "another --backend; finished scenarios are kept, run the same command again to resume"
            )
