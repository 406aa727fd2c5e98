"""The kernel alone, block after block on one thread: options, sample times, numbers of lanes."""

from __future__ import annotations

import pytest
from conftest import Timed
from suite import LANES, OPTIONS, QUICK, SAMPLE_TIMES, kernel, plan

SECONDS = 2400 if QUICK else 7200
ROUNDS = 15


@pytest.mark.parametrize("sample_time", SAMPLE_TIMES)
@pytest.mark.parametrize("option", OPTIONS)
def test_options(timed: Timed, option: str, sample_time: int) -> None:
    work = plan(LANES, SECONDS, sample_time, OPTIONS[option])
    timed(kernel(work), ROUNDS, lane_steps=LANES * SECONDS, lanes=LANES)


@pytest.mark.parametrize("sample_time", SAMPLE_TIMES)
@pytest.mark.parametrize("lanes", [LANES, 4 * LANES, 16 * LANES])
def test_lanes(timed: Timed, lanes: int, sample_time: int) -> None:
    work = plan(lanes, SECONDS, sample_time)
    timed(kernel(work), ROUNDS, lane_steps=lanes * SECONDS, lanes=lanes)
