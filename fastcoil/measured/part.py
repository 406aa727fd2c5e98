"""The part of a log that is fitted and the part held back for validation; unbroken pieces; reversals."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arguments import require_number
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs.log import CheckedLog, Log
from fastcoil.logs.own_values import find_own_values

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd
    import xarray as xr

LogSource: TypeAlias = "str | Path | pd.DataFrame | xr.Dataset | Log"
PART_FITTED = "fit"  # how a fit uses a sample
PART_VALIDATION = "validation"
PART_UNUSED = "unused"
LEAST_ABOVE_0 = math.nextafter(0.0, 1.0)  # lower bound of an argument that may not be 0


def require_split(split: Any) -> float:
    """Check the share of a log that is fitted, 0.7 by default."""
    cure = "give the share to fit, above 0 and at most 1"
    return 0.7 if split is None else require_number("split", split, cure, least=LEAST_ABOVE_0, most=1.0)


def fitting_mask(data: CheckedLog, share: float) -> Mask:
    """Whether each sample is fitted, (n,): whole batches of a log of at least four, and never the last."""
    if data.n_batches >= 4 and share < 1.0:
        share_up_to = np.cumsum(np.bincount(data.batch)) / data.batch.size  # end of each batch
        return np.asarray(data.batch <= min(int(np.argmax(share_up_to >= share - 1e-9)), data.n_batches - 2))
    return np.arange(data.time.size) < max(round(share * data.time.size), 1)


def leave_out_repeats(log: CheckedLog, names: Sequence[str]) -> CheckedLog:
    """Leave out of measured columns what only repeats their last poll, or joins two, so that each value counts once."""
    for name in log.values.keys() & set(names):
        values = log.values[name]
        if own := find_own_values(values, np.isfinite(values), holds=False):
            log.values[name] = np.full_like(values, np.nan)
            log.values[name][own.rows] = values[own.rows]
            log.notes.append(f"{name} has {own.describe(log.step)}: only these are compared")
    return log


def split_segments(numbers: NDArray[Any]) -> list[Index]:
    """Return the indices of the samples of each segment, within which the ``numbers``, (n,), do not change."""
    return np.split(np.arange(numbers.size), np.flatnonzero(np.diff(numbers)) + 1)


def true_runs(mask: Mask) -> Index:
    """Return the index of the first True of each run in a mask, and of the sample after its last one, (runs, 2)."""
    return np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int))).reshape(-1, 2)


def count_reversals(series: Array, least: float) -> int:
    """Count how often a series reverses and moves back by more than ``least``."""
    count, direction, extreme = 0, 0, float(series[0])
    for value in series.tolist():
        change = value - extreme
        if direction * change > 0.0:
            extreme = value
        elif abs(change) > least:
            count += direction != 0
            direction, extreme = 1 if change > 0.0 else -1, value
    return count
