"""A cluster whose workers are busy with the work of others: the run waits, says so, and blames nobody."""

from __future__ import annotations

import concurrent.futures as cf
import re
import time
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from helpers.processes import cut, wait_for

import fastcoil as fc
from fastcoil.cli.main import main
from fastcoil.study.workers import dispatch
from fastcoil.study.workers import pools as dask_cluster
from fastcoil.study.workers.pools import Dask

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(120), pytest.mark.usefixtures("leaves_nothing")]


@pytest.mark.full
@pytest.mark.alone
@pytest.mark.filterwarnings("default:the study has waited")
def test_a_run_waits_for_workers_that_are_busy_and_says_so(small_study, golden, tmp_path, monkeypatch, two_workers):
    cut(monkeypatch, 40)
    monkeypatch.setattr(dispatch, "_PATIENCE", 1.0)
    monkeypatch.setattr(dispatch, "_LOOK_EVERY", 0.2)
    monkeypatch.setattr(dispatch, "_FIRST_LIMIT", 10.0)
    words = ["run", str(small_study), "-o", str(tmp_path / "out"), "--backend", "dask", "--no-figures"]
    with two_workers.client() as other:
        other.wait_for_workers(2, timeout=30)
        others = [other.submit(time.sleep, 12.0, workers=[worker], pure=False) for worker in other.nthreads()]
        wait_for(lambda: sum(map(len, other.processing().values())) == 2)
        done = CliRunner().invoke(main, [*words, "--scheduler", two_workers.address])
        assert all(future.done() for future in others)
    assert done.exit_code == 0, done.output
    notes = [line for line in done.stderr.splitlines() if "has waited" in line]
    said = r"fastcoil: note: the study has waited \d+ s for workers, with 3 shards in flight: they are busy with .*"
    assert all(re.fullmatch(said, line) for line in notes)
    assert 1 <= len(notes) <= 4
    assert fc.open_study(tmp_path / "out").attrs["content_sha256"] == golden


def test_a_shard_waits_as_long_as_no_worker_runs_it():
    held = {
        "tcp://one": ("ours 1",),
        "tcp://two": ("another's", "ours 2", "ours 3"),
        "tcp://hangs": ("ours 4", "ours 5"),
    }

    def call_stack(keys):
        if "ours 4" in keys:
            raise TimeoutError
        return {"tcp://two": {"ours 3": ["a line"]}}

    pool = object.__new__(Dask)
    pool._client = SimpleNamespace(
        nthreads=lambda: dict.fromkeys(held, 1),
        processing=lambda: held,
        call_stack=call_stack,
        scheduler=SimpleNamespace(who_has=lambda keys: {key: ["tcp://one"] * (key == "ours 6") for key in keys}),
        sync=lambda function, **words: function(**words),
    )
    futures = [cf.Future() for _ in range(7)]
    pool._keys = {future: f"ours {k}" for k, future in enumerate(futures, 1)}
    # behind another's, and in no worker's hands; one that does not answer may be running anything
    assert pool.waiting(futures) == [futures[1], futures[6]]
    pool._client.processing = lambda: 1 / 0
    assert not pool.waiting(futures)


def test_a_cluster_that_does_not_end_in_time_costs_no_results():
    def slow(timeout):
        raise TimeoutError(f"timed out after {timeout} s")

    pool = object.__new__(Dask)
    pool._client, pool._cluster = SimpleNamespace(status="running", close=slow), SimpleNamespace(close=slow)
    pool.close()


def equipping(monkeypatch, deaths):
    """A pool whose workers die a number of times while they are asked for what they are."""
    left = [OSError("in <TCP local=…>: Stream is closed")] * deaths

    def check(pool):
        if left:
            raise left.pop()
        return "model", "cpu"

    monkeypatch.setattr(Dask, "_check_identity", check)
    monkeypatch.setattr(dask_cluster, "_BEFORE_NEXT_TRY", 0.01)
    monkeypatch.setattr(dask_cluster, "_make_plugin", lambda *_, **__: None)
    pool = object.__new__(Dask)
    pool._scheduler, pool._job = "tcp://a:1", None
    pool._client = SimpleNamespace(wait_for_workers=lambda n, timeout: None, register_plugin=lambda plugin: None)
    return pool


def test_workers_that_die_while_they_are_asked_are_asked_again(monkeypatch):
    pool = equipping(monkeypatch, 3)
    pool._equip_workers()
    assert pool._identity == ("model", "cpu")


def test_workers_that_die_again_and_again_are_a_sentence(monkeypatch):
    monkeypatch.setattr(dask_cluster, "_WAIT_FOR_WORKERS", 0.1)
    with pytest.raises(fc.InputError, match="at tcp://a:1 has no workers, or one that does not answer"):
        equipping(monkeypatch, 1000)._equip_workers()
