"""The dispatcher with days in sequence: each stretch once, after the one before it, whatever happens to the workers."""

import os

import numpy as np
import pytest
from helpers.dying_pool import Pool, found
from hypothesis import given, settings
from hypothesis import strategies as st

from fastcoil.loops.plan import Shard
from fastcoil.model.metric_table import STATUS_CRASHED, STATUS_OK

pytestmark = pytest.mark.timeout(60)

FULL = bool(os.environ.get("FASTCOIL_FULL"))
OF, N_DAYS = 12, 9


def chains(n_groups, length):
    return [Shard.starting(0, lanes, OF, N_DAYS, length) for lanes in np.array_split(np.arange(OF), n_groups)]


@settings(max_examples=300 if FULL else 40)
@given(
    n_workers=st.integers(1, 4),
    falls_together=st.booleans(),
    culprits=st.sets(st.integers(0, OF * N_DAYS - 1), max_size=3),
    hangs=st.sets(st.integers(0, OF * N_DAYS - 1), max_size=1),
    n_groups=st.integers(1, OF),
    length=st.integers(1, N_DAYS),
    seed=st.integers(0, 99),
)
def test_a_lane_is_crashed_from_the_day_that_kills_and_no_other(
    job, n_workers, falls_together, culprits, hangs, n_groups, length, seed
):
    pool = Pool(n_workers, falls_together=falls_together, culprits=culprits, hangs=hangs, seed=seed)
    status = found(pool, job, chains(n_groups, length), time_limit=5.0)
    crashed = {k for bad in culprits | hangs for k in range(bad, OF * N_DAYS, OF)}
    assert sorted(status) == list(range(OF * N_DAYS))
    assert {k for k, flag in status.items() if flag != STATUS_OK} == crashed
    assert {flag for flag in status.values()} <= {STATUS_OK, STATUS_CRASHED}
    assert pool.most_flying <= n_workers + 1


@settings(max_examples=300 if FULL else 40)
@given(
    n_workers=st.integers(1, 4),
    falls_together=st.booleans(),
    n_groups=st.integers(1, OF),
    length=st.integers(1, N_DAYS),
    seed=st.integers(0, 999),
)
def test_workers_that_die_by_chance_break_no_chain(job, n_workers, falls_together, n_groups, length, seed):
    pool = Pool(n_workers, falls_together=falls_together, clumsy=0.05, seed=seed)
    status = found(pool, job, chains(n_groups, length))
    assert sorted(status) == list(range(OF * N_DAYS))


def test_the_next_stretch_flies_while_the_one_before_it_is_written(job):
    pool, flying = Pool(1, falls_together=False), []

    class Written(dict):
        def __setitem__(self, scenario, flag):
            flying.append(len(pool.flying))
            super().__setitem__(scenario, flag)

    found(pool, job, chains(1, 1), Written())
    assert flying == [1] * (OF * (N_DAYS - 1)) + [0] * OF


@pytest.mark.parametrize("seed", range(12))
def test_those_who_fly_with_a_culprit_are_run_again_once(job, seed):
    pool = Pool(2, falls_together=True, culprits=[7 * OF], seed=seed)
    submitted, submit = [], pool.submit
    pool.submit = lambda shard: submitted.append((shard.lanes[0], shard.days)) or submit(shard)
    found(pool, job, chains(6, 4))
    innocent = [one for one in submitted if one[0] > 1]
    assert max(innocent.count(one) for one in innocent) <= 2
    assert sum(innocent.count(one) > 1 for one in set(innocent)) <= 2
