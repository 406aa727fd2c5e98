"""The dispatcher and time: what hangs is found, what only waits for a worker is not blamed and is reported."""

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


def test_the_neighbour_of_a_shard_that_hangs_is_not_suspected_before_it_ran(job):
    pool = Pool(1, falls_together=True, hangs=[0])
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
