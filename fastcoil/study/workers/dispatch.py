"""Shards through a pool, whatever happens to the workers."""

import concurrent.futures as cf
from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from fastcoil.base.errors import FastcoilError, out_of_memory
from fastcoil.loops.plan import Shard
from fastcoil.study.workers.pools import Pool
from fastcoil.study.workers.worker import Interrupt, Job, crashed_part

_MOST_DEATHS = 40  # without a result in between: one bad scenario in a shard of a million takes 20


def run_shards(pool: Pool, job: Job, shards: Sequence[Shard]) -> Iterator[xr.Dataset]:
    """Run every shard, and all that come after them, and yield their flat results (see ``run_shard``).

    Shards that were in flight when a worker died are suspects: each is run again alone, and one that takes its worker
    down once more is halved, until single scenarios are found guilty.  These, and the days that would follow from
    theirs, get the status ``crashed``, but not before another result has shown that the workers are not to blame.

    Raises
    ------
    StorageError
        If the memory does not suffice, not even for a single scenario.
    FastcoilError
        If workers die again and again without a result in between.
    """
    waiting, suspects = deque(shards), deque[Shard]()
    guilty: list[np.ndarray] = []
    n_deaths = 0
    while waiting or suspects:
        alone = bool(suspects)
        for shard, outcome in _outcomes(pool, deque([suspects.popleft()]) if alone else waiting):
            if isinstance(outcome, xr.Dataset):
                following = shard.after(outcome)
                if following is not None:
                    waiting.append(following)
                yield from (crashed_part(job, index) for index in guilty)
                yield outcome
                guilty, n_deaths = [], 0
                continue
            n_deaths += alone
            if n_deaths > _MOST_DEATHS:
                raise FastcoilError(
                    f"{_MOST_DEATHS} workers died in a row without a result: they may lack memory, use fewer with -j, "
                    "or another --backend; finished scenarios are kept, run the same command again to resume"
                )
            if not alone:
                suspects.append(shard)
            elif shard.size > 1:
                suspects.extendleft(reversed(shard.halves()))
            elif isinstance(outcome, MemoryError):
                raise out_of_memory("not even a single scenario can be run") from outcome
            else:
                guilty.append(shard.lost)
    yield from (crashed_part(job, index) for index in guilty)


def _outcomes(pool: Pool, waiting: deque[Shard]) -> Iterator[tuple[Shard, xr.Dataset | BaseException]]:
    """Run shards until a worker dies: each that was started, with its results or with the death that it met."""
    in_flight: dict[cf.Future[xr.Dataset], Shard] = {}
    died = False
    while in_flight or (waiting and not died):
        # one more than there are workers, so that none waits for this thread to write
        while waiting and not died and len(in_flight) <= pool.n_workers:
            shard = waiting.popleft()
            in_flight[pool.submit(shard)] = shard
        done, _ = cf.wait(in_flight, return_when=cf.FIRST_COMPLETED)
        for future in done:
            shard = in_flight.pop(future)
            outcome: xr.Dataset | BaseException
            try:
                outcome = future.result()
            except Interrupt:
                raise KeyboardInterrupt from None
            except pool.deaths as death:
                outcome, died = death, True
            yield shard, outcome
