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
    n_groups=st.integers(1, OF),
    length=st.integers(1, N_DAYS),
    seed=st.integers(0, 99),
)
def test_a_lane_is_crashed_from_the_day_that_kills_and_no_other(
    job, n_workers, falls_together, culprits, n_groups, length, seed
):
    pool = Pool(n_workers, falls_together=falls_together, culprits=culprits, seed=seed)
    status = found(pool, job, chains(n_groups, length))
    crashed = {k for bad in culprits for k in range(bad, OF * N_DAYS, OF)}
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
