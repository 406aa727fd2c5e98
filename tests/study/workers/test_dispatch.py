"""The dispatcher with workers that die on command: nothing lost, nothing twice, no one blamed for another."""

from __future__ import annotations

import concurrent.futures as cf
import re
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import dying_pool
from helpers.dying_pool import Died, Pool, healthy
from hypothesis import given, settings
from hypothesis import strategies as st

from fastcoil.errors import FastcoilError, InputError, StorageError
from fastcoil.outputs import STATUS_CRASHED, STATUS_OK
from fastcoil.study.file.spec import read_study
from fastcoil.study.workers import dispatch
from fastcoil.study.workers.dispatch import Dispatcher
from fastcoil.study.workers.worker import Interrupt, Job

pytestmark = pytest.mark.timeout(60)

N = 160


@pytest.fixture(scope="module")
def job(small_study):
    return Job("key", read_study(small_study).plan, None)


def found(pool, job, shards, status=None, **options):
    """Status of every scenario that was yielded, also put into ``status``; none is yielded twice."""
    status = {} if status is None else status
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dispatch, "cf", SimpleNamespace(wait=pool.wait, FIRST_COMPLETED=cf.FIRST_COMPLETED))
        patch.setattr(dispatch, "time", SimpleNamespace(monotonic=lambda: pool.now))
        for part in Dispatcher(pool, job, **options).run(shards):
            for k, flag in zip(part["scenario"].values.tolist(), part["status"].values.tolist(), strict=True):
                assert k not in status, "a scenario is found twice"
                status[k] = flag
    return status


def in_shards(size, n=N):
    return [np.arange(start, min(start + size, n)) for start in range(0, n, size)]


@settings(max_examples=100)
@given(
    n_workers=st.integers(1, 4),
    falls_together=st.booleans(),
    culprits=st.sets(st.integers(0, N - 1), max_size=4),
    hangs=st.sets(st.integers(0, N - 1), max_size=2),
    size=st.integers(1, N),
    seed=st.integers(0, 99),
    in_order=st.booleans(),
)
def test_exactly_the_scenarios_that_kill_or_hang_are_crashed(
    job, n_workers, falls_together, culprits, hangs, size, seed, in_order
):
    pool = Pool(n_workers, falls_together=falls_together, culprits=culprits, hangs=hangs, seed=seed)
    if in_order:
        pool.waiting = lambda futures: futures[n_workers:]
    status = found(pool, job, in_shards(size), time_limit=5.0)
    assert sorted(status) == list(range(N))
    assert {k for k, flag in status.items() if flag != STATUS_OK} == culprits | hangs
    assert {flag for flag in status.values()} <= {STATUS_OK, STATUS_CRASHED}
    assert pool.most_flying <= n_workers + 1


@settings(max_examples=60)
@given(
    n_workers=st.integers(1, 4),
    falls_together=st.booleans(),
    size=st.integers(2, N),
    seed=st.integers(0, 999),
)
def test_workers_that_die_by_chance_lose_no_scenario(job, n_workers, falls_together, size, seed):
    pool = Pool(n_workers, falls_together=falls_together, clumsy=0.05, seed=seed)
    status = found(pool, job, in_shards(size))
    assert sorted(status) == list(range(N))
    assert pool.most_flying <= n_workers + 1


class Unlucky:
    """A scenario whose worker dies with it a number of times, and then no more."""

    def __init__(self, scenario, deaths):
        self.scenario, self.deaths = scenario, deaths

    def intersection(self, index):
        dies = self.scenario in index and self.deaths > 0
        self.deaths -= dies
        return {self.scenario} if dies else set()


@pytest.mark.parametrize(("deaths", "status"), [(1, STATUS_OK), (2, STATUS_OK), (3, STATUS_CRASHED)])
def test_a_scenario_is_blamed_only_when_it_dies_alone_twice(job, deaths, status):
    pool = Pool(1, falls_together=True)
    pool.culprits = Unlucky(5, deaths)
    found_status = found(pool, job, in_shards(1))
    assert found_status[5] == status
    assert {flag for k, flag in found_status.items() if k != 5} == {STATUS_OK}


@pytest.mark.parametrize("falls_together", [True, False])
@pytest.mark.parametrize("size", [1, 7, N])
def test_workers_that_all_die_end_in_a_sentence_and_no_mark(job, falls_together, size):
    pool = Pool(2, falls_together=falls_together, culprits=range(N))
    yielded = {}
    with pytest.raises(FastcoilError, match="40 workers died in a row"):
        found(pool, job, in_shards(size), yielded)
    assert not yielded
    assert not pool.runs


class Starved(MemoryError, Died):
    pass


@pytest.mark.parametrize("size", [1, 7, N])
@pytest.mark.parametrize("culprits", [range(N), range(N - 20, N)], ids=["always", "at last"])
def test_memory_that_runs_out_ends_in_a_sentence_and_no_mark(job, monkeypatch, size, culprits):
    monkeypatch.setattr(dying_pool, "Died", Starved)
    pool = Pool(2, falls_together=False, culprits=culprits)
    yielded = {}
    with pytest.raises(StorageError, match="the memory ran out; finished scenarios are kept") as ended:
        found(pool, job, in_shards(size), yielded)
    assert ended.value.exit_code == 4
    assert yielded.keys() == set(pool.runs)
    assert set(yielded.values()) <= {STATUS_OK}


def test_the_first_single_scenario_without_memory_ends_the_run(job, monkeypatch):
    monkeypatch.setattr(dying_pool, "Died", Starved)
    pool = Pool(1, falls_together=False, culprits=range(N))
    submitted, submit = [], pool.submit
    pool.submit = lambda index: submitted.append(index.size) or submit(index)
    with pytest.raises(StorageError, match="not even a single scenario"):
        found(pool, job, [np.arange(4), np.arange(4, 8)])
    assert submitted == [4, 4, 4, 2, 1, 1]


def test_the_only_scenarios_that_are_left_may_all_be_crashed(job):
    pool = Pool(2, falls_together=True, culprits=range(N))
    assert found(pool, job, [np.array([3]), np.array([7])]) == {3: STATUS_CRASHED, 7: STATUS_CRASHED}


def test_one_bad_scenario_in_a_large_shard_takes_few_deaths(job):
    n = 2**20
    pool = Pool(1, falls_together=True, culprits=[777_777])
    pool.submit = lambda index: Pool.submit(pool, index) if index.size < 9 else quick(pool, index)

    def quick(pool, index):
        future = cf.Future()
        if index[0] <= 777_777 <= index[-1]:
            future.set_exception(Died())
        else:
            future.set_result(healthy(index))
        pool.flying[future] = []
        return future

    status = found(pool, job, in_shards(n, n))
    assert [k for k, flag in status.items() if flag == STATUS_CRASHED] == [777_777]
    assert len(status) == n
    assert pool.n_restarts <= 24


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
    assert set(found(pool, job, [np.array([k]) for k in range(4)], time_limit=5.0).values()) == {STATUS_OK}
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
    pool.submit = lambda index: submitted.append(index.tolist()) or submit(index)
    assert found(pool, job, [np.array([0]), np.array([1])], time_limit=5.0) == {0: STATUS_CRASHED, 1: STATUS_OK}
    assert submitted[:4] == [[0], [1], [1], [0]], "it is run again with the others, and the culprit alone"


def test_an_interrupt_of_a_worker_ends_the_run(job):
    pool = Pool(1, falls_together=False)

    def interrupted(futures, timeout, return_when):
        for future in futures:
            future.set_exception(Interrupt())
        return set(futures), set()

    pool.wait = interrupted
    with pytest.raises(KeyboardInterrupt):
        found(pool, job, in_shards(16))


def test_the_limit_of_time_grows_with_the_longest_shard(job):
    found_limits = Dispatcher(Pool(1, falls_together=True), job)
    assert found_limits._limit == 600.0
    found_limits._longest = 0.1
    assert found_limits._limit == 60.0
    found_limits._longest = 10.0
    assert found_limits._limit == 200.0


def test_an_error_that_is_no_death_ends_the_run_with_what_was_found_before(job):
    pool = Pool(1, falls_together=False)
    wait = pool.wait

    def with_an_error(futures, timeout, return_when):
        if len(pool.runs) >= 48:
            for future in futures:
                future.set_exception(InputError("no reduction"))
            return set(futures), set()
        return wait(futures, timeout, return_when)

    pool.wait = with_an_error
    with pytest.raises(InputError, match="no reduction"):
        found(pool, job, in_shards(16))
    assert 48 <= len(pool.runs) <= 64
