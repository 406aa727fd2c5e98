"""One block through the kernel, seen from the host: arrays out, traces by name."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.engine.emulator import SERIES, Day, emulate
from fastcoil.engine.lanes import LANES, PARAMETER_ROWS, VOLUME_ROWS, VOLUME_STRIDE, Block, R, trace_rows
from fastcoil.engine.metrics import N_METRICS
from fastcoil.engine.schedule import schedule
from fastcoil.outputs import STATUS_OK

_CACHE_LINE = 8
"""Doubles in a cache line of 64 bytes."""
KNOWN_AFTER_MARCH = ("wet_volumes",)
"""Traces of step t that only the march of step t finds out."""


class Traces(NamedTuple):
    """Which traces to record, every how many seconds."""

    names: tuple[str, ...] = ()
    interval: int = 1

    def n_points(self, n_steps: int) -> int:
        """Samples of a run of ``n_steps``: one at every ``interval``, from second 0 on."""
        return -(-n_steps // self.interval) if self.names else 0


def run_block(block: Block, day: Day, wanted: Traces) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Run one block.  Returns metrics (N_METRICS, LANES), status (LANES,) and traces by name.

    A trace is (n_points, LANES), or (n_points, N, LANES) if it has volumes; those of failed lanes are NaN.
    """
    before = [n for n in wanted.names if n not in KNOWN_AFTER_MARCH]
    after = [n for n in wanted.names if n in KNOWN_AFTER_MARCH]
    rows, rows_after = trace_rows(before, block.n_volumes), trace_rows(after, block.n_volumes)
    n_points = wanted.n_points(day.series.shape[0])
    traces = np.empty((n_points, rows.size + rows_after.size, LANES))
    metrics, status = np.empty((N_METRICS, LANES)), np.empty(LANES, dtype=np.int64)
    S, V = aligned(len(R) * LANES), aligned((block.n_volumes + 2) * VOLUME_STRIDE)
    emulate(block, day, S, V, metrics, status, rows, rows_after, wanted.interval, traces)

    traces[:, :, status != STATUS_OK] = np.nan
    named, k = {}, 0
    for name in before + after:
        if name in VOLUME_ROWS:
            named[name] = traces[:, k : k + block.n_volumes]
            k += block.n_volumes
        else:
            named[name] = traces[:, k]
            k += 1
    return metrics, status, named


def aligned(size: int) -> np.ndarray:
    """Work space from a cache line's edge on: a vector across two lines costs twice."""
    space = np.empty(size + _CACHE_LINE)
    start = -space.ctypes.data // space.itemsize % _CACHE_LINE
    return space[start : start + size]


def compile_kernel() -> None:
    """Compile the kernel, or load it from the cache, by running it for no time at all."""
    nothing = np.empty((0, len(SERIES)))
    day = Day(nothing, np.empty(0), schedule(np.empty(0), np.empty(0), 0), 0, (0, 0))
    block = Block(np.ones((len(PARAMETER_ROWS), LANES)), 1, True, 1, True, 0, False, True)
    run_block(block, day, Traces())
