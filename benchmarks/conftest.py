"""Rounds, warm-up, and what every benchmark records."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from suite import QUICK

import fastcoil as fc
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.model.numerics.jit import fingerprint, numeric_environment

Timed = Callable[..., Any]


def pytest_benchmark_update_machine_info(config: pytest.Config, machine_info: dict[str, Any]) -> None:
    """Store with every result the version, the kernel, and what its bits and times depend on."""
    machine_info["fastcoil"] = {"version": fc.__version__, "kernel": fingerprint(), **numeric_environment()}


@pytest.fixture(scope="session", autouse=True)
def kernel_compiled() -> None:
    """Load the kernel, or compile it, before anything is timed."""
    compile_kernel()


@pytest.fixture
def timed(benchmark: Any) -> Timed:
    """Time ``run`` after one call to warm up: ``timed(run, rounds, lane_steps=…, lanes=…, threads=…)``."""

    def time(
        run: Callable[..., Any],
        rounds: int,
        *,
        lane_steps: int = 0,
        lanes: int = 0,
        threads: int = 1,
        setup: Callable[[], Any] | None = None,
        warm_up: bool = True,
        **extra: Any,
    ) -> Any:
        benchmark.extra_info.update(lane_steps=lane_steps, lanes=lanes, threads=threads, **extra)
        if warm_up and not QUICK:
            run(*(setup()[0] if setup else ()))
        return benchmark.pedantic(run, setup=setup, rounds=1 if QUICK else rounds, iterations=1)

    return time
