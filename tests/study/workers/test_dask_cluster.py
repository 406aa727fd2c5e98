"""A cluster whose workers are busy, die or leave: the run waits and says so, or says what to do."""

import time
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from helpers.processes import cut, wait_for

import fastcoil as fc
from fastcoil.base.errors import FastcoilError
from fastcoil.cli.main import main
from fastcoil.study.workers import pools
from fastcoil.study.workers.pools import Dask

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(120), pytest.mark.usefixtures("leaves_nothing")]


@pytest.mark.full
@pytest.mark.alone
@pytest.mark.filterwarnings("default:no shard has finished")
def test_a_run_waits_for_workers_that_are_busy_and_says_so(small_study, golden, tmp_path, monkeypatch, two_workers):
    cut(monkeypatch, 40)
    monkeypatch.setattr(pools, "_WAIT_FOR_WORKERS", 1.0)
    words = ["run", str(small_study), "-o", str(tmp_path / "out"), "--backend", "dask", "--no-figures"]
    with two_workers.client() as other:
        other.wait_for_workers(2, timeout=30)
        others = [other.submit(time.sleep, 12.0, workers=[worker], pure=False) for worker in other.nthreads()]
        wait_for(lambda: sum(map(len, other.processing().values())) == 2)
        done = CliRunner().invoke(main, [*words, "--scheduler", two_workers.address])
        assert all(future.done() for future in others)
    assert done.exit_code == 0, done.output
    notes = [line for line in done.stderr.splitlines() if "no shard has finished" in line]
    assert 1 <= len(notes) <= 4
    assert fc.open_study(tmp_path / "out").attrs["content_sha256"] == golden


@pytest.fixture
def pool():
    """A pool on a cluster that does not exist."""
    pool = object.__new__(Dask)
    pool._scheduler, pool._said = "tcp://a:1", 0.0
    pool._client = SimpleNamespace(nthreads=lambda: {"tcp://one": 1}, wait_for_workers=lambda n, timeout: None)
    return pool


def test_a_wait_for_workers_is_reported_less_and_less_often(pool):
    said = []
    for seconds in [*range(700), *range(100)]:
        try:
            pool.stalled(float(seconds))
        except UserWarning as warning:
            said.append(str(warning))
    assert [words.split()[5] for words in said] == ["60", "180", "540", "60"]
    assert "the workers of the dask cluster are busy with other work, or hang" in said[0]
    pool._client.nthreads = lambda: 1 / 0
    with pytest.warns(UserWarning, match="busy with other work"):
        pool.stalled(300.0)


def test_a_cluster_without_workers_ends_the_run(pool):
    pool._client.nthreads = dict
    with pytest.raises(FastcoilError, match="at tcp://a:1 has no workers any more: start some and run the same"):
        pool.stalled(60.0)


def test_a_cluster_that_does_not_end_in_time_costs_no_results(pool):
    def slow(timeout):
        raise TimeoutError(f"timed out after {timeout} s")

    pool._client.close = slow
    pool.close()


@pytest.mark.parametrize("deaths", [3, 1000])
def test_workers_that_die_while_they_are_asked_are_asked_again(pool, monkeypatch, deaths):
    left = [OSError("in <TCP local=…>: Stream is closed")] * deaths

    def run(_):
        if left:
            raise left.pop()
        return {"tcp://one": (pools.model_sha256(), "cpu")}

    pool._client.run = run
    monkeypatch.setattr(pools, "_BEFORE_NEXT_TRY", 0.01)
    if deaths == 3:
        assert pool._find_identity() == (pools.model_sha256(), "cpu")
    else:
        monkeypatch.setattr(pools, "_WAIT_FOR_WORKERS", 0.1)
        with pytest.raises(fc.InputError, match="at tcp://a:1 has no workers, or one that does not answer"):
            pool._find_identity()
