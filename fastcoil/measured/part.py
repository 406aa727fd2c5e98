"""The log of a fit: which part of it is fitted and which is held back, its unbroken pieces, turns of a command."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arguments import Checks, require_number
from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.logs import CheckedLog, ReadingOptions, read_checked_log
from fastcoil.logs.columns import ColumnSpec, require_log

FITTING, VALIDATION, UNUSED = "fit", "validation", "unused"
DEFAULT_SPLIT = 0.7  # share of a log that is fitted by default
_BATCHES_TO_SPLIT_BY = 4
ABOVE_0 = math.nextafter(0.0, 1.0)


class LogSplit(NamedTuple):
    """The part of a log to fit: a ``split`` (share) of it; ``validation``: another log, then all of the first."""

    split: float | None = None
    validation: Any = None

    def read(
        self, log: Any, columns: ColumnSpec, reading: ReadingOptions, prepare: Callable[[CheckedLog], CheckedLog]
    ) -> CheckedLog:
        """The log as ``prepare``, followed by the one that validates the fit, if there is one."""
        data = prepare(read_checked_log(log, columns, reading))
        return (
            data
            if self.validation is None
            else data.with_validation_log(prepare(read_checked_log(self.validation, columns, reading)))
        )

    def fitting_mask(self, data: CheckedLog) -> Mask:
        """Which samples are fitted, (n,): whole batches of a log of at least four, and never the last of these."""
        if len(data.names) > 1:
            return np.asarray(data.source == 0)
        share = DEFAULT_SPLIT if self.split is None else self.split
        if data.n_batches >= _BATCHES_TO_SPLIT_BY and share < 1.0:
            ends = np.cumsum(np.bincount(data.batch)) / data.batch.size
            last = min(int(np.argmax(ends >= share - 1e-9)), data.n_batches - 2)
            return np.asarray(data.batch <= last)
        return np.arange(data.time.size) < max(round(share * data.time.size), 1)


def check_split(check: Checks, split: Any, validation: Any) -> LogSplit:
    """The part of a log to fit, from the arguments of a fit."""
    share = "give the share to fit, above 0 and at most 1"
    part = LogSplit(
        check.unless_none(require_number, "split", split, share, least=ABOVE_0, most=1.0),
        check.unless_none(require_log, "validation", validation),
    )
    if part.split is not None and part.validation is not None:
        check.problems.append("split and validation both say what is held back: give one of them")
    return part


def split_segments(*numbers: NDArray[Any]) -> list[Index]:
    """Indices of the samples of each unbroken piece: a new one begins where one of the ``numbers`` (n,) changes."""
    ends = np.any([np.diff(number.astype(float)) != 0.0 for number in numbers], axis=0)
    return np.split(np.arange(numbers[0].size), np.flatnonzero(ends) + 1)


def true_runs(where: Mask) -> Index:
    """First sample of each unbroken stretch, and the one behind its last, (stretches, 2)."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
    return ends.reshape(-1, 2)


def count_reversals(series: Array, least: float) -> int:
    """How often a series turns and then comes back by more than ``least``."""
    count, direction, extreme = 0, 0, float(series[0])
    for value in series.tolist():
        change = value - extreme
        if direction * change > 0.0:
            extreme = value
        elif abs(change) > least:
            count += direction != 0
            direction, extreme = 1 if change > 0.0 else -1, value
    return count
