"""A cluster of this machine is for this machine alone; one at an address speaks TLS if asked to, or is noted."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
from types import ModuleType

import pytest
from helpers.processes import children, cluster, ended, started, wait_for

import fastcoil as fc
from fastcoil.study.workers import pools as dask_connection
from fastcoil.study.workers.pools import connect, start_local_cluster

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(120), pytest.mark.usefixtures("leaves_nothing")]


def listeners():
    """Where this process and its children wait for others: process, address, port."""
    import psutil

    processes = [psutil.Process(), *children().values()]
    found = [(p.pid, *c.laddr) for p in processes for c in p.net_connections("inet") if c.status == "LISTEN"]
    return set(found)


@pytest.fixture
def local():
    """A cluster with one worker, and its client."""
    before = listeners()
    found = start_local_cluster(1)
    client = connect(found)
    assert {address for _, address, _ in listeners() - before} == {"127.0.0.1"}
    yield client
    client.close()
    found.close()


@pytest.fixture
def impatient():
    """Have the library give up lost workers sooner than they come back."""
    import dask
    import distributed  # noqa: F401 — its settings, before they are changed

    with dask.config.set({"distributed.deploy.lost-worker-timeout": "50ms"}):
        yield


def test_a_local_cluster_replaces_dead_workers_and_only_this_machine_can_reach_it(impatient, local):
    before = set(local.nthreads())
    assert len(before) == 1
    (pid,) = local.run(os.getpid).values()
    os.kill(pid, signal.SIGKILL)
    wait_for(lambda: not before & set(local.nthreads()))
    # nor is what the next worker runs lost
    local.submit(time.sleep, 1.0).result(timeout=30)


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
    with cluster(tmp_path / "cluster", 1, "--no-nanny", protocol="tls", **certified) as found:
        assert found.address.startswith("tls://")
        words = ("-m", "fastcoil", "run", small_study, "--backend", "dask", "--scheduler", found.address)
        code, _, err = ended(started(*words, "--no-figures", "-o", "out", cwd=tmp_path, **certified))
        assert code == 0, err
        assert "can run code as you" not in err
        code, _, err = ended(started(*words, "--no-figures", "-o", "other", cwd=tmp_path))
        assert code == 2
        assert "no dask scheduler answers at 'tls://" in err
        assert "dask's settings of the certificates" in err
    assert fc.open_study(tmp_path / "out").attrs["content_sha256"] == golden


@pytest.mark.parametrize(
    ("address", "guarded"),
    [
        ("tcp://127.0.0.1:8786", True),
        ("tcp://[::1]:8786", True),
        ("localhost:8786", True),
        ("tls://cluster.example:8786", True),
        ("tcp://cluster.example:8786", False),
        ("10.0.0.7:8786", False),
        ("tcp://0.0.0.0:8786", False),
        ("tcp://[fe80::1]:8786", False),
        ("ws://cluster.example:8786", False),
    ],
)
def test_a_scheduler_that_others_can_reach_without_a_certificate_is_noted_once(monkeypatch, address, guarded):
    import distributed

    async def answers(_):
        pass

    monkeypatch.setattr(dask_connection, "_check_answers", answers)
    monkeypatch.setattr(distributed, "Client", lambda *_, **__: "client")
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        assert connect(address) == "client"
    notes = [
        f"anyone who can reach the dask scheduler at {address}, or its workers, can run code as you: use tls:// on a "
    ]
    notes[0] += "network that you do not trust"
    assert [str(w.message) for w in warned] == ([] if guarded else notes)


@pytest.mark.parametrize(
    ("text", "kind", "cure"),
    [
        ("start()", fc.InputError, "only under if __name__ == '__main__'"),
        ("if __name__ == '__main__':\n    start()", fc.FastcoilError, "they were killed, or lack memory"),
        (None, fc.FastcoilError, "they were killed, or lack memory"),
    ],
)
def test_workers_that_do_not_start_are_explained_by_the_program(tmp_path, monkeypatch, text, kind, cure):
    import distributed

    def refuse(*_, **__):
        raise RuntimeError("Nanny failed to start.")

    program = ModuleType("__main__")
    if text is not None:
        (tmp_path / "program.py").write_text(text)
        program.__file__ = str(tmp_path / "program.py")
    monkeypatch.setitem(sys.modules, "__main__", program)
    monkeypatch.setattr(distributed.LocalCluster, "__init__", refuse)
    with pytest.raises(fc.FastcoilError, match=re.escape("(Nanny failed to start.): ")) as refused:
        start_local_cluster(1)
    assert type(refused.value) is kind
    assert cure in str(refused.value)


def test_a_start_that_is_interrupted_ends_at_once_and_its_workers_never_hear_of_it(monkeypatch):
    import distributed

    masks, goes_on = [], threading.Event()

    def start(*_, **__):
        masks.append(signal.pthread_sigmask(signal.SIG_BLOCK, []))
        os.kill(os.getpid(), signal.SIGINT)
        goes_on.wait(30)
        raise RuntimeError("too late")

    monkeypatch.setattr(distributed.LocalCluster, "__init__", start)
    before = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        start_local_cluster(1)
    goes_on.set()
    assert time.monotonic() - before < 10
    assert signal.SIGINT in masks[0]
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
