"""The dispatcher and time: what hangs is found, what only waits for a worker is not blamed and is reported."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
from helpers.dying_pool import Pool, found, healthy, in_shards
from helpers.processes import N_SCENARIOS as N

from fastcoil.model.metric_table import STATUS_CRASHED, STATUS_OK
from fastcoil.study.workers.dispatch import Dispatcher

pytestmark = pytest.mark.timeout(60)


def test_a_shard_that_got_ready_while_another_was_written_is_not_overdue(job):
    pool = Pool(2, falls_together=True)

    def slow_to_look(futures, timeout, return_when):
        for future in [f for f in futures if not f.done()]:
            future.set_result(healthy(pool.flying[future]))
        pool.now += 100.0
        first = next(iter(futures))
        del pool.flying[first]
        return {first}, set(futures) - {first}

    pool.wait = slow_to_look
    assert len(found(pool, job, in_shards(16), time_limit=5.0)) == N
    assert pool.n_restarts == 0


def test_without_the_means_to_kill_nothing_is_overdue(job):
    pool = Pool(2, falls_together=False)
    pool.can_kill = False
    wait = pool.wait

    def slowly(futures, timeout, return_when):
        pool.now += 1e6
        return wait(futures, timeout, return_when)

    pool.wait = slowly
    assert len(found(pool, job, in_shards(16), time_limit=5.0)) == N


def kept_busy(pool, until):
    """Have others keep the workers of a pool busy for some seconds."""
    wait = pool.wait
    pool.shared, pool.waits = True, lambda future: pool.now < until

    def idly(futures, timeout, return_when):
        if pool.waits(None):
            pool.now += timeout
            return set(), set(futures)
        return wait(futures, timeout, return_when)

    pool.wait = idly


def test_a_shard_that_has_not_started_is_not_overdue_and_the_wait_is_reported_now_and_then(job):
    pool = Pool(2, falls_together=False, seed=1)
    kept_busy(pool, until=3000.0)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        assert set(found(pool, job, in_shards(16), time_limit=5.0).values()) == {STATUS_OK}
    assert pool.n_restarts == 0
    said = [str(w.message) for w in warned]
    assert all(s.endswith("for workers, with 3 shards in flight: they are busy with other work") for s in said)
    assert [int(re.search(r"(\d+) s", s)[1]) for s in said] == pytest.approx(
        [10, 30, 90, 270, 810, 1410, 2010, 2610], abs=12
    )


def test_a_wait_for_workers_that_nobody_else_uses_is_not_reported(job):
    pool = Pool(2, falls_together=False)
    kept_busy(pool, until=100.0)
    pool.shared = False
    assert len(found(pool, job, in_shards(16), time_limit=5.0)) == N  # a warning would be an error


def test_shards_are_not_blamed_for_workers_that_never_come(job):
    pool = Pool(2, falls_together=False)
    kept_busy(pool, until=np.inf)
    restart = pool.restart

    def start_at_last():
        restart()
        if pool.n_restarts == 3:
            pool.has_workers, pool.waits = True, lambda future: False

    pool.shared, pool.has_workers, pool.restart = False, False, start_at_last
    assert set(found(pool, job, in_shards(1, 4), time_limit=5.0).values()) == {STATUS_OK}
    assert sorted(pool.runs) == [0, 1, 2, 3]
    assert pool.n_restarts == 3


def test_the_neighbour_of_a_shard_that_hangs_is_not_suspected_before_it_ran(job):
    pool = Pool(1, falls_together=True, hangs=[0])
    pool.waiting = lambda futures: futures[1:]
    wait, submitted = pool.wait, []

    def in_order(futures, timeout, return_when):
        done, _ = wait(list(futures)[:1], timeout, return_when)
        return done, set(futures) - done

    pool.wait = in_order
    submit = pool.submit
    pool.submit = lambda shard: submitted.append(shard.index.tolist()) or submit(shard)
    assert found(pool, job, in_shards(1, 2), time_limit=5.0) == {0: STATUS_CRASHED, 1: STATUS_OK}
    assert submitted[:4] == [[0], [1], [1], [0]], "it is run again with the others, and the culprit alone"


def test_the_limit_of_time_grows_with_the_longest_shard(job):
    found_limits = Dispatcher(Pool(1, falls_together=True), job)
    assert found_limits._limit == 600.0
    found_limits._longest = 0.1
    assert found_limits._limit == 60.0
    found_limits._longest = 10.0
    assert found_limits._limit == 200.0
