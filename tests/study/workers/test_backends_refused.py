"""A backend that is not available, or workers whose results would not be bit-identical, are refused in a sentence."""

import shutil
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest
from helpers.commands import fastcoil
from helpers.processes import STUDY_TEXT, run_cluster, start_python, wait_for_end
from helpers.refusals import refuses
from helpers.sentences import assert_worded

import fastcoil as fc
from fastcoil.loops.plan import Shard
from fastcoil.study import workers as pools
from fastcoil.study.file.spec import read_study
from fastcoil.study.workers import Job, environment_id, run_received_job

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(120), pytest.mark.usefixtures("leaves_nothing")]


def refusal_text(folder, *words):
    """The sentences with which the command line refuses to run, and leaves no trace."""
    before = sorted(folder.rglob("*"))
    result = fastcoil("run", *words)
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
    (folder / "small.toml").write_text(STUDY_TEXT, encoding="utf-8")
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize(
    "options",
    [
        *("--backend mpi", "--backend Dask", "--backend dask", "--scheduler tcp://127.0.0.1:1"),
        *("--backend loky --scheduler tcp://127.0.0.1:1", "--backend dask --scheduler="),
        *("-j 0", "-j -1", "-j 10000 --backend loky"),
    ],
)
def test_a_backend_that_does_not_exist_is_refused(here, options):
    assert_worded(refusal_text(here, "small.toml", *options.split()))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "127.0.0.1:1", "nonsense://127.0.0.1:1", "tcp://127.0.0.1"])
def test_an_address_without_a_scheduler_is_refused(here, monkeypatch, address):
    monkeypatch.setattr(pools, "_SCHEDULER_TIMEOUT_S", 0.2)
    text = refusal_text(here, "small.toml", "--backend", "dask", "--scheduler", address)
    assert f"no dask cluster answers at '{address}'" in text


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 200 OK\r\n\r\nhello"])
def test_something_else_at_the_address_is_refused(here, monkeypatch, answer):
    monkeypatch.setattr(pools, "_SCHEDULER_TIMEOUT_S", 0.4)
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
        text = refusal_text(here, "small.toml", "--backend", "dask", "--scheduler", f"tcp://127.0.0.1:{port}")
        server.shutdown(socket.SHUT_RDWR)
        thread.join(5)
        for connection in talking:
            connection.close()
    assert "no dask cluster answers at" in text


def test_a_scheduler_without_workers_is_refused(here, monkeypatch, tmp_path):
    monkeypatch.setattr(pools, "_WORKERS_TIMEOUT_S", 0.3)
    with run_cluster(tmp_path / "cluster", 0) as alone:
        text = refusal_text(here, "small.toml", "--backend", "dask", "--scheduler", alone.address)
    assert f"fastcoil: no dask cluster answers at '{alone.address}'" in text
    assert "with at least one worker" in text


@pytest.mark.parametrize("missing", ["distributed", "dask"])
def test_without_dask_the_sentence_names_the_extra(here, monkeypatch, missing):
    for name in [n for n in sys.modules if n.split(".")[0] == "distributed"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    assert "pip install 'fastcoil[dask]'" in refusal_text(
        here, "small.toml", "--backend", "dask", "--scheduler", "tcp://127.0.0.1:1"
    )


def test_a_worker_that_joins_later_and_differs_refuses_to_work(small_study):
    plan = read_study(small_study).plan
    job = Job(plan, None)
    part = run_received_job(job, Shard(np.arange(3)), environment_id())
    assert part["status"].values.tolist() == [0, 0, 0]
    with refuses(("scheduler", "unsupported")):
        run_received_job(job, Shard(np.arange(3)), (environment_id()[0], "another machine"))


CERTIFICATE = "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=127.0.0.1 -keyout key.pem -out cert.pem"


@pytest.fixture
def certified(tmp_path):
    """Environment of dask programs that share a certificate, and speak to nobody else."""
    if shutil.which("openssl") is None:
        pytest.skip("there is no openssl to make certificates with")
    subprocess.run(CERTIFICATE.split(), cwd=tmp_path, check=True, capture_output=True)
    settings = {"CA_FILE": "cert"} | {
        f"{who}__{what}": what.lower() for who in ("SCHEDULER", "WORKER", "CLIENT") for what in ("CERT", "KEY")
    }
    env = {f"DASK_DISTRIBUTED__COMM__TLS__{name}": str(tmp_path / f"{file}.pem") for name, file in settings.items()}
    return env | {"DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "true"}


@pytest.mark.full
def test_a_cluster_with_certificates_gives_the_same_bits_and_refuses_all_others(
    small_study, golden, tmp_path, certified
):
    with run_cluster(tmp_path / "cluster", 1, "--no-nanny", protocol="tls", **certified) as tls_cluster:
        assert tls_cluster.address.startswith("tls://")
        words = ("-m", "fastcoil", "run", small_study, "--backend", "dask", "--scheduler", tls_cluster.address)
        code, _, err = wait_for_end(start_python(*words, "--no-figures", "-o", "out", cwd=tmp_path, **certified))
        assert code == 0, err
        code, _, err = wait_for_end(start_python(*words, "--no-figures", "-o", "other", cwd=tmp_path))
        assert code == 2
        assert "no dask cluster answers at 'tls://" in err
        assert "dask's settings of the certificates" in err
    assert fc.open_study(tmp_path / "out").attrs["content_sha256"] == golden


@pytest.mark.full
def test_too_few_open_files_for_processes_end_a_run_with_4(here):
    limited = "import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (12, 12))"
    script = f"{limited}; from fastcoil.__main__ import run; run()"
    words = ("run", "small.toml", "--backend", "loky", "-j", "1", "--no-figures")
    code, _, err = wait_for_end(start_python("-c", script, *words, cwd=here))
    assert code == 4
    messages = [line for line in err.splitlines() if line.startswith("fastcoil: ")]
    assert messages[-1].startswith("fastcoil: the processes of --backend loky cannot be started: Too many open files")
    assert "Traceback" not in err
