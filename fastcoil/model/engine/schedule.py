"""Which metrics a second of a day counts towards.

All lanes of a block share the day, so which seconds count, are settled, or start or end a block of the metrics is
known before the loop runs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.model.metric_table import (
    ESTIMATE_WINDOW,
    HUNTING_SAMPLE,
    PEAK_BLOCK,
    SET_POINT_STEP,
    SETTLING_TIME,
    SWITCH_BLOCK,
)

COUNTED = 1
SETTLED = 2
WINDOW_STARTS = 4
WINDOW_ENDS = 8
IN_SWITCH_BLOCK = 16
IN_PEAK_BLOCK = 32
PEAK_BLOCK_ENDS = 64
IN_ESTIMATE_WINDOW = 128
HUNTING_SEEN = 256


class Before(NamedTuple):
    """What the first second of a day follows: set-point, °C, whether the loop was on, and when it was last disturbed.

    disturbed_at: second of this day, 0 or negative, of the last step of the set-point or start of the loop.
    """

    T_set: float = np.nan
    enabled: bool = True
    disturbed_at: int = 0


NOTHING_BEFORE = Before()


class Schedule(NamedTuple):
    """``flags``, (n_steps,) int64, are sums of the constants above; the others count flagged seconds or blocks."""

    flags: np.ndarray
    n_counted: int
    n_settled: int
    n_windows: int
    n_switch_blocks: int
    n_peak_blocks: int
    n_estimate: int


def disturbances(T_set: np.ndarray, enabled: np.ndarray, before: Before) -> np.ndarray:
    """Second of the last step of the set-point or start of the loop, at every second of a day, (n_steps,)."""
    steps = np.abs(np.diff(T_set, prepend=before.T_set)) > SET_POINT_STEP
    starts = (enabled != 0.0) & ~np.concatenate([[before.enabled], enabled[:-1] != 0.0])
    return np.maximum.accumulate(np.where(steps | starts, np.arange(T_set.size), before.disturbed_at))


def after(T_set: np.ndarray, enabled: np.ndarray, before: Before = NOTHING_BEFORE) -> Before:
    """What the day after a day follows."""
    last = int(disturbances(T_set, enabled, before)[-1])
    return Before(float(T_set[-1]), bool(enabled[-1] != 0.0), last - T_set.size)


def whole_blocks(counted: np.ndarray, warm_up: int, length: int) -> np.ndarray:
    """Which seconds lie in blocks of ``length`` s, aligned at ``warm_up``, that are counted throughout."""
    inside = np.zeros(counted.size, bool)
    n_blocks = max((counted.size - warm_up) // length, 0)
    whole = counted[warm_up : warm_up + n_blocks * length].reshape(n_blocks, length).all(axis=1)
    inside[warm_up : warm_up + n_blocks * length] = np.repeat(whole, length)
    return inside


def schedule(T_set: np.ndarray, enabled: np.ndarray, warm_up: int, before: Before = NOTHING_BEFORE) -> Schedule:
    """Flags of every second of a day.  T_set, °C, and enabled, 0/1: (n_steps,); warm_up: s."""
    t = np.arange(T_set.size)
    counted = (t >= warm_up) & (enabled != 0.0)
    settled = counted & (t - disturbances(T_set, enabled, before) >= SETTLING_TIME)
    starts = settled & ~np.concatenate([[False], settled[:-1]])
    ends = settled & ~np.concatenate([settled[1:], [False]])
    in_switch_block = whole_blocks(counted, warm_up, SWITCH_BLOCK)
    in_peak_block = whole_blocks(counted, warm_up, PEAK_BLOCK)
    peak_ends = in_peak_block & ((t - warm_up) % PEAK_BLOCK == PEAK_BLOCK - 1)
    in_estimate = counted & (t >= T_set.size - ESTIMATE_WINDOW)
    hunting_seen = settled & (t % HUNTING_SAMPLE == 0)
    flags = (
        COUNTED * counted + SETTLED * settled + WINDOW_STARTS * starts + WINDOW_ENDS * ends
        + IN_SWITCH_BLOCK * in_switch_block + IN_PEAK_BLOCK * in_peak_block + PEAK_BLOCK_ENDS * peak_ends
        + IN_ESTIMATE_WINDOW * in_estimate + HUNTING_SEEN * hunting_seen
    )  # fmt: skip
    return Schedule(
        flags=flags.astype(np.int64),
        n_counted=int(counted.sum()),
        n_settled=int(settled.sum()),
        n_windows=int(starts.sum()),
        n_switch_blocks=int(in_switch_block.sum()) // SWITCH_BLOCK,
        n_peak_blocks=int(peak_ends.sum()),
        n_estimate=int(in_estimate.sum()),
    )
