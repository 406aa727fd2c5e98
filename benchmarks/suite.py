"""What the benchmarks share: sizes, contenders, and blocks prepare for the kernel."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np
from peers import c_peer, common, jax_peer, numpy_lanes, scalar_numba

import fastcoil as fc
from fastcoil.loops.plan import Plan, plan_simulation
from fastcoil.model.engine.lanes import cut_into_blocks, parameter_matrix, run_block
from fastcoil.model.engine.rows import LANES
from fastcoil.model.metric_table import METRICS

MODE = os.environ.get("FASTCOIL_BENCH", "")
"""``quick``: everything once and tiny, to see that it runs; ``full``: also 10⁶ scenarios."""
QUICK = MODE == "quick"
ALL = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""Cores this process may use."""
THREADS = sorted({1, ALL})
SAMPLE_TIMES = (30, 1)
"""Of the controller, s."""


class Options(NamedTuple):
    """What sets a kernel benchmark apart from the bare loop of ``common``."""

    loop: dict[str, Any] = {}
    series: dict[str, float] = {}
    traces: tuple[str, ...] = ()


OPTIONS = {
    "bare": Options(),
    "all four": Options({"noise_std": 0.05, "stroke_time": 90.0, "sensor_time_constant": 20.0, "learning_step": 0.007}),
    "dry": Options(series={"W_a_in": 0.003}),
    "wet": Options(series={"W_a_in": 0.018}),
    "quasistatic": Options({"air_march": "quasistatic"}),
    "own air side": Options({"beta3": ("case", (0.38, 0.42))}),
    "hagglund": Options({"estimator": "hagglund", "plant_gain": 25.0, "estimate_share": 0.0}),
    "gradient": Options({"estimator": "gradient"}),
    "identify": Options({"estimator": "identify"}),
    "traces": Options(traces=("T_sup", "u", "command", "opening", "m_w", "power")),
}
"""``all four``: noise, stroke time, sensor lag and learning.  ``own air side``: lanes that differ in beta3.
``traces``: six signals, every second."""


def plan(lanes: int, seconds: int, sample_time: float, options: Options = OPTIONS["bare"]) -> Plan:
    """Make the common work, changed by ``options``, prepare to run."""
    scenarios, series = common.work(lanes, seconds, sample_time)
    changes = {
        name: (value[0], np.linspace(*value[1], lanes)) if isinstance(value, tuple) else value
        for name, value in options.loop.items()
    }
    series |= {name: np.full(seconds, value) for name, value in options.series.items()}
    loop = common.make_loop(scenarios).assign(**changes)
    return plan_simulation(loop, fc.Boundary(**series), warm_up=common.WARM_UP, traces=options.traces)


def kernel(work: Plan, threads: int = 1) -> Callable[[], common.Arrays]:
    """Return a function that runs all blocks of ``work`` through the kernel, and nothing else."""
    lane_blocks = cut_into_blocks(parameter_matrix(work.layout.columns(np.arange(work.n_scenarios))))

    def run_one(entry: tuple[np.ndarray, Any]) -> tuple[np.ndarray, np.ndarray]:
        return entry[0], run_block(entry[1], work.days[0], work.traces)[0]

    def run() -> common.Arrays:
        if threads == 1:
            block_results = list(map(run_one, lane_blocks))
        else:
            with ThreadPoolExecutor(threads) as pool:
                block_results = list(pool.map(run_one, lane_blocks))
        all_metrics = np.empty((len(METRICS), work.n_scenarios))
        for members, metrics in block_results:
            all_metrics[:, members] = metrics[:, : members.size]
        return dict(zip(METRICS, all_metrics, strict=True))

    return run


class Contender(NamedTuple):
    """A program that does the common work: ``prepare(scenarios, series)`` returns what is timed."""

    name: str
    threads: int
    converged: bool
    prepare: Callable[[common.Arrays, common.Arrays], Callable[[], common.Arrays]]

    def check(self, sample_time: float) -> common.Agreement:
        """Raise ``AssertionError`` unless the metrics are fastcoil's."""
        n, seconds = (LANES, 3600) if QUICK else (200, 7200)

        def run(scenarios: common.Arrays, series: common.Arrays, _: int) -> common.Arrays:
            return self.prepare(scenarios, series)()

        return common.check(run, n, seconds, sample_time, self.converged)


def _make_peer(run: Callable[..., common.Arrays], **options: int) -> Callable[..., Callable[[], common.Arrays]]:
    return lambda scenarios, series: partial(run, scenarios, series, common.WARM_UP, **options)


def _make_kernel(threads: int, converged: bool) -> Callable[..., Callable[[], common.Arrays]]:
    def prepare(scenarios: common.Arrays, series: common.Arrays) -> Callable[[], common.Arrays]:
        loop = common.make_loop(scenarios, converged)
        return kernel(plan_simulation(loop, fc.Boundary(**series), warm_up=common.WARM_UP), threads)

    return prepare


def contenders(converged: bool = False) -> Iterator[Contender]:
    """Every program that can do the work here; those with the same number of threads follow one another."""
    has_c = True
    try:
        c_peer.load_library()
    except c_peer.Unavailable:
        has_c = False
    for n in THREADS:
        runs: dict[str, Any] = {"C": c_peer.run} if has_c else {}
        runs |= {"fastcoil, simulate": common.fastcoil_run}
        runs |= {"JAX": jax_peer.run} if jax_peer.is_installed() else {}
        yield Contender("fastcoil, kernel", n, converged, _make_kernel(n, converged))
        for name, run in runs.items():
            yield Contender(name, n, converged, _make_peer(run, threads=n, converged=converged))
        if not converged:
            numba_threads = min(n, numba.config.NUMBA_NUM_THREADS)
            yield Contender("scalar Numba", n, False, _make_peer(scalar_numba.run, threads=numba_threads))
    if not converged:
        yield Contender("NumPy", 1, False, _make_peer(numpy_lanes.run))
