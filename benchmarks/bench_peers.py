"""The peers on the same work.  Each must first give fastcoil's metrics.

They run one after the other, so a ratio of these times includes whatever the machine did in between.  The ratios
of the report come from alternating runs, see ``report.py``.
"""

from __future__ import annotations

import pytest
from conftest import Timed
from peers import c_peer, common
from suite import ALL, LANES, QUICK, SAMPLE_TIMES, contenders

LANES_IN_ALL = 2 * LANES if QUICK else 1024
SECONDS = 2400 if QUICK else 7200
ROUNDS = 5
CONTENDERS = {f"{c.name}, {c.threads} threads": c for c in contenders()}


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
    """Skip with a message where JAX is missing.  XLA decides how many cores it uses."""
    pytest.importorskip("jax")
    assert any(c.name == "JAX" and c.threads == ALL for c in CONTENDERS.values())
