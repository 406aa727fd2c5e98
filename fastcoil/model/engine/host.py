"""Run one block through the kernel: arrays out, traces by name."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fastcoil.model.engine.emulator import DAY_COLUMNS, C, Day, emulate
from fastcoil.model.engine.lanes import Block, WorkSpace, blocks, memory_of, parameter_matrix, trace_rows, work_space
from fastcoil.model.engine.metrics import N_METRICS, OF_ESTIMATORS
from fastcoil.model.engine.rows import LANES, VOLUME_ROWS
from fastcoil.model.engine.schedule import schedule
from fastcoil.model.metric_table import LEARNING_STATUS, METRICS, STATUS_OK
from fastcoil.model.parameter_table import PARAMETERS

KNOWN_AFTER_MARCH = ("wet_volumes",)
"""Traces of step t that are known only after the march of step t."""


class TraceRequest(NamedTuple):
    """Which traces to record, every how many seconds."""

    names: tuple[str, ...] = ()
    interval: int = 1

    def n_points(self, n_steps: int) -> int:
        """Samples of a run of ``n_steps``: one at every ``interval``, from second 0 on."""
        return -(-n_steps // self.interval) if self.names else 0


def run_block(
    block: Block, day: Day, wanted: TraceRequest, work: WorkSpace | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Run one block.

    work: its state, taken from there by a day that does not start at 0, and left there.  Returns metrics
    (N_METRICS, LANES), status (LANES,) and traces by name.  A trace is (n_points, LANES), or (n_points, N, LANES) if it
    has volumes; those of failed lanes are NaN.
    """
    before = [n for n in wanted.names if n not in KNOWN_AFTER_MARCH]
    after = [n for n in wanted.names if n in KNOWN_AFTER_MARCH]
    rows, rows_after = trace_rows(before, block.common.n_volumes), trace_rows(after, block.common.n_volumes)
    n_points = wanted.n_points(day.series.shape[0])
    traces = np.empty((n_points, rows.size + rows_after.size, LANES))
    metrics, status = np.empty((N_METRICS, LANES)), np.empty(LANES, dtype=np.int64)
    work = work_space(block) if work is None else work
    emulate(block.rows, block.common, day, *work, metrics, status, rows, rows_after, wanted.interval, traces)
    for name, values in _of_estimator(block, work.own, day.command.size > 0).items():
        metrics[list(METRICS).index(name)] = np.where(status == STATUS_OK, values, np.nan)

    traces[:, :, status != STATUS_OK] = np.nan
    named, k = {}, 0
    for name in before + after:
        if name in VOLUME_ROWS:
            named[name] = traces[:, k : k + block.common.n_volumes]
            k += block.common.n_volumes
        else:
            named[name] = traces[:, k]
            k += 1
    return metrics, status, named


def _of_estimator(block: Block, own: np.ndarray, open_loop: bool) -> dict[str, Any]:
    """The metrics that only an estimator brings; NaN, or off, where the block has another one."""
    found: dict[str, Any] = {name: np.nan for name in OF_ESTIMATORS} | {"learning_status": LEARNING_STATUS.index("off")}
    estimator = block.estimator
    if estimator is not None and estimator.results is not None and not open_loop:
        found |= estimator.results(memory_of(block, own))
    return found


def compile_kernel() -> None:
    """Compile the kernel, or load it from the cache, by running the default loop for one second."""
    second = {"m_a": 1.0, "T_a_in": 25.0, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": 14.0, "noise": 0.0, "enabled": 1.0}
    second["backlash_scale"] = 1.0
    series = np.array([[second[name] for name in DAY_COLUMNS]])
    day = Day(series, np.empty(0), schedule(series[:, C.T_set], series[:, C.enabled], 0), 0, (0, 0))
    defaults = {p.name: np.array([np.nan if p.default is None else p.default]) for p in PARAMETERS.values()}
    ((_, block),) = blocks(parameter_matrix(defaults | {"replicate": np.zeros(1), "estimator": np.array(["none"])}))
    run_block(block, day, TraceRequest())
