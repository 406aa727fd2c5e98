"""The peers on the same work.  Each must first give fastcoil's metrics.

They run one after the other, so a ratio of these times includes whatever the machine did in between.  The ratios
of the report come from alternating runs, see ``report.py``.
"""

from __future__ import annotations

import pytest
from conftest import Timed
from peers import c_peer, common, jax_peer
from suite import LANES, QUICK, SAMPLE_TIMES, contenders

LANES_IN_ALL = 2 * LANES if QUICK else 1024
SECONDS = 2400 if QUICK else 7200
ROUNDS = 5
CONTENDERS = {
    f"{c.name}{', converged' * c.converged}, {c.threads} threads": c
    for converged in (False, True)
    for c in contenders(converged)
}


@pytest.mark.parametrize("sample_time", SAMPLE_TIMES)
@pytest.mark.parametrize("name", CONTENDERS)
def test_peer(timed: Timed, name: str, sample_time: int) -> None:
    contender = CONTENDERS[name]
    contender.check(sample_time)
    run = contender.prepare(*common.work(LANES_IN_ALL, SECONDS, sample_time))
    timed(run, ROUNDS, lane_steps=LANES_IN_ALL * SECONDS, lanes=LANES_IN_ALL, threads=contender.threads)


def test_c_is_here() -> None:
    """Skip with a message where the yardstick is missing."""
    try:
        c_peer.load_library()
    except c_peer.Unavailable as reason:
        pytest.skip(str(reason))


def test_jax_is_here() -> None:
    """Skip with a message where JAX is missing."""
    if not jax_peer.is_installed():
        pytest.skip("the JAX peer needs `make .venv-jax/.installed`")
