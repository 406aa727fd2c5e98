"""A cluster speaks TLS if asked to, or is noted."""

import shutil
import subprocess
import warnings

import pytest
from helpers.processes import cluster, ended, started

import fastcoil as fc
from fastcoil.study.workers import pools

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(120), pytest.mark.usefixtures("leaves_nothing")]


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

    monkeypatch.setattr(pools, "_check_answers", answers)
    monkeypatch.setattr(distributed, "Client", lambda *_, **__: "client")
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        assert pools.connect(address) == "client"
    notes = [
        f"anyone who can reach the dask scheduler at {address}, or its workers, can run code as you: use tls:// on a "
    ]
    notes[0] += "network that you do not trust"
    assert [str(w.message) for w in warned] == ([] if guarded else notes)
