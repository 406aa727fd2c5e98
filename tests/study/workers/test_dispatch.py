"""The dispatcher with workers that die on command: nothing lost, nothing twice, no one blamed for another."""

import concurrent.futures as cf
import os

import numpy as np
import pytest
from helpers import dying_pool
from helpers.dying_pool import DyingPool, WorkerDied, collect_status, cut_into_sizes, healthy_part
from helpers.processes import N_SCENARIOS as N
from hypothesis import given, settings
from hypothesis import strategies as st

from fastcoil.base.errors import FastcoilError, InputError, StorageError
from fastcoil.loops.plan import Shard
from fastcoil.model.metric_table import STATUS_CRASHED, STATUS_OK
from fastcoil.study.workers import Interrupt

pytestmark = pytest.mark.timeout(60)

FULL = bool(os.environ.get("FASTCOIL_FULL"))


@settings(max_examples=300 if FULL else 40)
@given(
    n_workers=st.integers(1, 4),
    falls_together=st.booleans(),
    culprits=st.sets(st.integers(0, N - 1), max_size=4),
    size=st.integers(1, N),
    seed=st.integers(0, 99),
)
def test_exactly_the_scenarios_that_kill_are_crashed(job, n_workers, falls_together, culprits, size, seed):
    pool = DyingPool(n_workers, fails_together=falls_together, culprits=culprits, seed=seed)
    status = collect_status(pool, job, cut_into_sizes(size))
    assert sorted(status) == list(range(N))
    assert {k for k, flag in status.items() if flag != STATUS_OK} == culprits
    assert {flag for flag in status.values()} <= {STATUS_OK, STATUS_CRASHED}
    assert pool.max_pending <= n_workers + 1


@settings(max_examples=300 if FULL else 40)
@given(
    n_workers=st.integers(1, 4),
    falls_together=st.booleans(),
    culprits=st.sets(st.integers(0, N - 1), max_size=3),
    n_groups=st.integers(1, N // 8),
    seed=st.integers(0, 99),
)
def test_a_lane_that_kills_on_some_of_its_days_is_crashed_on_all_and_no_other(
    job, n_workers, falls_together, culprits, n_groups, seed
):
    of = N // 8
    pool = DyingPool(n_workers, fails_together=falls_together, culprits=culprits, seed=seed)
    status = collect_status(pool, job, [Shard(lanes, of, 0, 8) for lanes in np.array_split(np.arange(of), n_groups)])
    assert sorted(status) == list(range(N))
    assert {k for k, flag in status.items() if flag != STATUS_OK} == {
        k for bad in culprits for k in range(bad % of, N, of)
    }


@settings(max_examples=300 if FULL else 40)
@given(n_workers=st.integers(1, 4), falls_together=st.booleans(), size=st.integers(2, N), seed=st.integers(0, 999))
def test_workers_that_die_by_chance_lose_no_scenario(job, n_workers, falls_together, size, seed):
    pool = DyingPool(n_workers, fails_together=falls_together, death_rate=0.05, seed=seed)
    status = collect_status(pool, job, cut_into_sizes(size))
    assert sorted(status) == list(range(N))
    assert pool.max_pending <= n_workers + 1


class Unlucky:
    """A scenario whose worker dies with it a number of times, and then no more."""

    def __init__(self, scenario, deaths):
        self.scenario, self.deaths = scenario, deaths

    def intersection(self, index):
        dies = self.scenario in index and self.deaths > 0
        self.deaths -= dies
        return {self.scenario} if dies else set()


@pytest.mark.parametrize(("deaths", "status"), [(1, STATUS_OK), (2, STATUS_CRASHED)])
def test_a_scenario_is_blamed_only_when_it_dies_alone_too(job, deaths, status):
    pool = DyingPool(1, fails_together=True)
    pool.culprits = Unlucky(5, deaths)
    found_status = collect_status(pool, job, cut_into_sizes(1))
    assert found_status[5] == status
    assert {flag for k, flag in found_status.items() if k != 5} == {STATUS_OK}


@pytest.mark.parametrize("falls_together", [True, False])
@pytest.mark.parametrize("size", [1, 7, N])
def test_workers_that_all_die_end_in_a_sentence_and_no_mark(job, falls_together, size):
    pool = DyingPool(2, fails_together=falls_together, culprits=range(N))
    yielded = {}
    with pytest.raises(FastcoilError, match="40 workers died in a row"):
        collect_status(pool, job, cut_into_sizes(size), yielded)
    assert not yielded
    assert not pool.runs


class Starved(MemoryError, WorkerDied):
    pass


@pytest.mark.parametrize("size", [1, 7, N])
@pytest.mark.parametrize("culprits", [range(N), range(N - 20, N)], ids=["always", "at last"])
def test_memory_that_runs_out_ends_in_a_sentence_and_no_mark(job, monkeypatch, size, culprits):
    monkeypatch.setattr(dying_pool, "WorkerDied", Starved)
    pool = DyingPool(2, fails_together=False, culprits=culprits)
    yielded = {}
    with pytest.raises(StorageError, match="the memory ran out; finished scenarios are kept") as ended:
        collect_status(pool, job, cut_into_sizes(size), yielded)
    assert ended.value.exit_code == 4
    assert yielded.keys() == set(pool.runs)
    assert set(yielded.values()) <= {STATUS_OK}


def test_one_bad_scenario_in_a_large_shard_takes_few_deaths(job):
    n = 2**20
    pool = DyingPool(1, fails_together=True, culprits=[777_777])
    pool.submit = lambda shard: DyingPool.submit(pool, shard) if shard.size < 9 else quick(pool, shard.index)

    def quick(pool, index):
        future = cf.Future()
        if index[0] <= 777_777 <= index[-1]:
            future.set_exception(WorkerDied())
        else:
            future.set_result(healthy_part(index))
        pool.pending[future] = []
        return future

    status = collect_status(pool, job, cut_into_sizes(n, n))
    assert [k for k, flag in status.items() if flag == STATUS_CRASHED] == [777_777]
    assert len(status) == n
    assert pool.n_deaths <= 24


def test_an_interrupt_of_a_worker_ends_the_run(job):
    pool = DyingPool(1, fails_together=False)

    def interrupted(futures, return_when):
        for future in futures:
            future.set_exception(Interrupt())
        return set(futures), set()

    pool.wait = interrupted
    with pytest.raises(KeyboardInterrupt):
        collect_status(pool, job, cut_into_sizes(16))


def test_an_error_that_is_no_death_ends_the_run_with_what_was_found_before(job):
    pool = DyingPool(1, fails_together=False)
    wait = pool.wait

    def with_an_error(futures, return_when):
        if len(pool.runs) >= 48:
            for future in futures:
                future.set_exception(InputError("no reduction"))
            return set(futures), set()
        return wait(futures, return_when)

    pool.wait = with_an_error
    with pytest.raises(InputError, match="no reduction"):
        collect_status(pool, job, cut_into_sizes(16))
    assert 48 <= len(pool.runs) <= 64
