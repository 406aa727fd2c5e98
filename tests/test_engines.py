"""Threads, processes, a dask cluster: the same bits from each, and a sentence where one cannot be had."""

from __future__ import annotations

import signal
import socket
import sys
import threading

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from processes import N_SCENARIOS, STUDY, cluster, cut, ended, started, wait_for

import fastcoil as fc
import fastcoil.plan
from fastcoil.cli import main
from fastcoil.errors import InputError
from fastcoil.study import pools
from fastcoil.study.runner import execute
from fastcoil.study.spec import read_study
from fastcoil.study.worker import Job, forget, identity, receive, work

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(120), pytest.mark.usefixtures("leaves_nothing")]


def hash_of(results):
    return results.attrs["content_sha256"]


@pytest.mark.parametrize(
    ("engine", "n_jobs"),
    [
        ("threads", 1),
        ("threads", 2),
        ("threads", 3),
        ("loky", 1),
        pytest.param("loky", 2, marks=pytest.mark.full),
        ("loky", 3),
        pytest.param("dask", 1, marks=pytest.mark.full),
        ("dask", 2),
        pytest.param("dask", 3, marks=pytest.mark.full),
    ],
)
def test_every_engine_with_any_number_of_workers_gives_the_same_bits(small_study, golden, tmp_path, engine, n_jobs):
    assert hash_of(fc.run_study(small_study, tmp_path / "out", engine=engine, n_jobs=n_jobs)) == golden
    assert hash_of(fc.open_study(tmp_path / "out")) == golden


@pytest.mark.parametrize("lane_steps", [1.0, 64 * 900.0, 1e12])
def test_the_size_of_shards_does_not_show(small_study, golden, tmp_path, monkeypatch, lane_steps):
    monkeypatch.setattr(fastcoil.plan, "_LANE_STEPS_PER_SHARD", lane_steps)
    assert hash_of(fc.run_study(small_study, tmp_path / "out", n_jobs=2)) == golden


@pytest.mark.parametrize(
    ("largest", "seed"), [pytest.param(1, 1, marks=pytest.mark.full), (9, 2), (40, 3), (64, 4), (80, 5)]
)
def test_the_order_and_cut_of_shards_does_not_show(small_study, golden, tmp_path, monkeypatch, largest, seed):
    cut(monkeypatch, largest, seed)
    assert hash_of(fc.run_study(small_study, tmp_path / "out", n_jobs=2)) == golden


def test_a_study_without_traces_has_one_hash_too(small_study, tmp_path, monkeypatch, two_workers):
    text = small_study.read_text(encoding="utf-8")
    path = tmp_path / "plain.toml"
    path.write_text("\n".join(line for line in text.splitlines() if not line.startswith("trace")), encoding="utf-8")
    expected = hash_of(fc.run_study(path, tmp_path / "threads", n_jobs=1))
    cut(monkeypatch, 40, seed=6)
    assert hash_of(fc.run_study(path, tmp_path / "dask", engine="dask", scheduler=two_workers.address)) == expected


def test_a_cluster_that_a_user_started_gives_the_same_bits(small_study, golden, tmp_path, two_workers, monkeypatch):
    cut(monkeypatch, 40, seed=7)
    results = fc.run_study(small_study, tmp_path / "out", engine="dask", scheduler=two_workers.address)
    assert hash_of(results) == golden
    assert results.attrs["engine"] == "dask"


def test_the_command_line_runs_on_a_cluster(small_study, golden, tmp_path, two_workers):
    words = ("-m", "fastcoil", "run", small_study, "--engine", "dask", "--scheduler", two_workers.address)
    code, out, err = ended(started(*words, "--no-figures", cwd=tmp_path))
    assert code == 0, err
    assert hash_of(fc.open_study(tmp_path / "results" / "small")) == golden
    assert "results/small/results.nc" in out
    assert "Traceback" not in err
    assert "distributed" not in err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["results"]


def what_a_cluster_keeps(client):
    """Tasks, plugins and jobs of ours on a cluster."""

    def on_scheduler(dask_scheduler):
        return len(dask_scheduler.tasks), [n for n in dask_scheduler.worker_plugins if n.startswith("fastcoil")]

    def on_worker():
        from fastcoil.study import worker

        return len(worker._jobs)

    return *client.run_on_scheduler(on_scheduler), sum(client.run(on_worker).values())


def test_a_cluster_keeps_nothing_of_a_finished_study(small_study, tmp_path, two_workers):
    fc.run_study(small_study, tmp_path / "out", engine="dask", scheduler=two_workers.address)
    with two_workers.client() as client:
        wait_for(lambda: what_a_cluster_keeps(client) == (0, [], 0), within=5)


def test_a_cluster_keeps_nothing_of_a_finished_shard(small_study, tmp_path, two_workers, monkeypatch):
    cut(monkeypatch, 4)
    on_scheduler = []
    with two_workers.client() as client:
        execute(
            read_study(small_study),
            tmp_path / "out",
            engine="dask",
            scheduler=two_workers.address,
            progress=lambda _: lambda _: on_scheduler.append(what_a_cluster_keeps(client)[0]),
        )
    assert len(on_scheduler) == N_SCENARIOS / 4
    # three in flight, three whose results were fetched together
    assert max(on_scheduler) <= 6


def refused(folder, *words):
    """The sentences with which the command line refuses to run, and leaves no trace."""
    before = sorted(folder.rglob("*"))
    result = CliRunner().invoke(main, ["run", *map(str, words)])
    assert result.exit_code == 2, result.output
    assert sorted(folder.rglob("*")) == before
    assert "Traceback" not in result.output
    lines = [line for line in result.stderr.splitlines() if not line.startswith("Compiling")]
    assert all(line.startswith("fastcoil: ") for line in lines), lines
    return " ".join(lines)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with nothing but a study, in which the command line runs."""
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "small.toml").write_text(STUDY, encoding="utf-8")
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--engine", "mpi"], "engine = 'mpi': choose one of threads, loky, dask"),
        (["--engine", "Dask"], "choose one of threads, loky, dask"),
        (["--scheduler", "tcp://127.0.0.1:1"], "only the engine dask has one"),
        (["--engine", "loky", "--scheduler", "tcp://127.0.0.1:1"], "only the engine dask has one"),
        (["--engine", "dask", "--scheduler", ""], "scheduler is empty"),
        (["-j", "0"], "n_jobs = 0: must be at least 1"),
        (["-j", "-1"], "n_jobs = -1: must be at least 1"),
        (["-j", "10000", "--engine", "loky"], "n_jobs = 10000: must be at least 1 and at most 1024"),
        (["-j", "10000", "--engine", "dask"], "n_jobs = 10000: must be at least 1 and at most 1024"),
    ],
)
def test_an_engine_that_cannot_be_is_refused(here, words, sentence):
    assert sentence in refused(here, "small.toml", *words)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "127.0.0.1:1", "nonsense://127.0.0.1:1", "tcp://127.0.0.1"])
def test_an_address_without_a_scheduler_is_refused(here, monkeypatch, address):
    monkeypatch.setattr(pools, "_WAIT_FOR_SCHEDULER", 0.5)
    said = refused(here, "small.toml", "--engine", "dask", "--scheduler", address)
    assert f"no dask scheduler answers at '{address}'" in said


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 200 OK\r\n\r\nhello"])
def test_something_else_at_the_address_is_refused(here, monkeypatch, answer):
    monkeypatch.setattr(pools, "_WAIT_FOR_SCHEDULER", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as server:
        talking = []

        def serve():
            try:
                while True:
                    talking.append(server.accept()[0])
                    talking[-1].sendall(answer)
            except OSError:  # the test is over
                pass

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        port = server.getsockname()[1]
        said = refused(here, "small.toml", "--engine", "dask", "--scheduler", f"tcp://127.0.0.1:{port}")
        server.shutdown(socket.SHUT_RDWR)
        thread.join(5)
        for connection in talking:
            connection.close()
    assert "no dask scheduler answers at" in said


def test_a_scheduler_without_workers_is_refused(here, monkeypatch, tmp_path):
    monkeypatch.setattr(pools, "_WAIT_FOR_WORKERS", 1.0)
    with cluster(tmp_path / "cluster", 0) as alone:
        said = refused(here, "small.toml", "--engine", "dask", "--scheduler", alone.address)
    assert f"fastcoil: the dask scheduler at {alone.address} has no workers" in said
    assert said.endswith(f"start one with `dask worker {alone.address}`")


@pytest.mark.full
def test_workers_that_do_not_answer_are_refused(here, monkeypatch, tmp_path):
    with cluster(tmp_path / "cluster", 1, "--no-nanny") as frozen:
        with frozen.client() as client:
            client.wait_for_workers(1, timeout=30)
        frozen.processes[-1].send_signal(signal.SIGSTOP)
        monkeypatch.setattr(pools, "_WAIT_FOR_WORKERS", 1.0)
        said = refused(here, "small.toml", "--engine", "dask", "--scheduler", frozen.address)
    assert "has no workers, or one that does not answer" in said


@pytest.mark.parametrize("missing", ["distributed", "dask"])
def test_without_dask_the_sentence_names_the_extra(here, monkeypatch, missing):
    for name in [n for n in sys.modules if n.split(".")[0] == "distributed"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    assert "pip install 'fastcoil[dask]'" in refused(here, "small.toml", "--engine", "dask")


def test_workers_of_another_version_are_refused(here, monkeypatch, two_workers):
    monkeypatch.setattr(pools, "model_sha256", lambda: "another model")
    said = refused(here, "small.toml", "--engine", "dask", "--scheduler", two_workers.address)
    assert "run another version of fastcoil" in said


def test_workers_that_differ_are_refused(here, two_workers):
    # the compiler's settings belong to the fingerprint
    odd = two_workers.worker("--no-nanny", NUMBA_OPT="2")
    try:
        with two_workers.client() as client:
            client.wait_for_workers(3, timeout=30)
            said = refused(here, "small.toml", "--engine", "dask", "--scheduler", two_workers.address)
    finally:
        odd.kill()
        odd.wait(10)
    assert "the workers of the dask cluster differ" in said
    with two_workers.client() as client:
        wait_for(lambda: len(client.scheduler_info(n_workers=-1)["workers"]) == 2)


def test_a_worker_that_joins_later_and_differs_refuses_to_work(small_study):
    plan = read_study(small_study).plan
    job = Job("late", plan, None)
    receive(job)
    try:
        found = work("late", np.arange(3), identity())
        assert found["status"].values.tolist() == [0, 0, 0]
        with pytest.raises(InputError, match="use workers of one kind"):
            work("late", np.arange(3), (identity()[0], "another machine"))
    finally:
        forget("late")


@pytest.mark.parametrize(
    ("engine", "env"),
    [
        ("threads", {"PYTHONHASHSEED": "1"}),
        pytest.param("threads", {"PYTHONHASHSEED": "2", "NUMBA_NUM_THREADS": "1"}, marks=pytest.mark.full),
        pytest.param("loky", {"PYTHONHASHSEED": "3"}, marks=pytest.mark.full),
        pytest.param("dask", {"PYTHONHASHSEED": "4"}, marks=pytest.mark.full),
    ],
)
def test_the_environment_does_not_show(small_study, golden, tmp_path, engine, env):
    words = ("-m", "fastcoil", "run", small_study, "-o", "out", "--engine", engine, "-j", "2", "--no-figures")
    env |= {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    env |= {"OMP_NUM_THREADS": "99", "TZ": "Asia/Kathmandu", "DASK_TEMPORARY_DIRECTORY": str(tmp_path)}
    code, _, err = ended(started(*words, cwd=tmp_path, **env))
    assert code == 0, err
    assert (tmp_path / "out" / "study.toml").read_bytes() == small_study.read_bytes()
    with xr.open_dataset(tmp_path / "out" / "results.nc") as ds:
        assert hash_of(ds) == golden


def script_without_a_guard(folder, study, engine):
    script = folder / "script.py"
    script.write_text(
        "import fastcoil as fc\n"
        f"ds = fc.run_study({str(study)!r}, 'out', engine={engine!r}, n_jobs=1)\n"
        "print(ds.attrs['content_sha256'])\n"
    )
    return ended(started(script, cwd=folder, DASK_TEMPORARY_DIRECTORY=str(folder)))


@pytest.mark.full
def test_a_script_with_processes_needs_no_guard_around_its_main_part(small_study, golden, tmp_path):
    code, out, err = script_without_a_guard(tmp_path, small_study, "loky")
    assert code == 0, err
    assert out.split() == [golden]


@pytest.mark.full
def test_a_script_with_dask_is_told_that_it_needs_one(small_study, tmp_path):
    code, _, err = script_without_a_guard(tmp_path, small_study, "dask")
    assert code == 1
    last = err.strip().splitlines()[-1]
    assert "only under if __name__ == '__main__'" in last
    assert not (tmp_path / "out").exists()


def test_modules_of_dask_are_loaded_only_for_dask(tmp_path):
    script = "import sys, fastcoil, fastcoil.cli, fastcoil.study.runner\nsys.exit('distributed' in sys.modules)"
    assert ended(started("-c", script, cwd=tmp_path))[0] == 0
