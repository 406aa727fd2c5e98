"""The rows at which a point got a value of its own.

A gateway that polls a point more slowly than rows are written repeats its last value, and a join draws straight lines
between samples.  Both are found from the values: such rows come more evenly than equal values of a coarse sensor do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask

_LEAST_STEPS = 20  # between values of its own, to judge how they come
_STEPS_IN_SUM = 16  # whose sum shows polls: chance adds up, a clock does not
_MOST_SPREAD = 0.6  # of such sums, over that of values that are equal by chance
_LEAST_SHORT_STEP = 0.2  # of the mean step, that the short ones have of a measured point that is polled
_LEAST_SHORT_STEP_HELD = 0.5  # the same of a command or set-point, which rest by themselves
_LEAST_SPACING = 1.05  # rows; closer polls are one in each row
_ROUND_OFF = 1e-6  # in the unit of the series, that is no difference


class OwnValues(NamedTuple):
    """The rows at which a point got a value of its own, where that is not each row."""

    rows: Index
    spacing: float  # usual number of rows between two of them
    shortest: float
    longest: float

    def describe(self, interval: float) -> str:
        """Describe how often the values come, in a log with a row every ``interval`` s."""
        low, high = (rows * interval for rows in (self.shortest, self.longest))
        low, high, unit = (low / 60.0, high / 60.0, "min") if low >= 120.0 else (low, high, "s")
        ends = dict.fromkeys(f"{end:.3g}" for end in (low, high))
        return f"values of its own only every {'–'.join(ends)} {unit}"


def find_own_values(series: Array, is_usable: Mask, *, holds: bool) -> OwnValues | None:
    """Find the rows with values of their own among ``is_usable``; holds: whether the point rests between changes."""
    row_numbers = np.arange(series.size)
    with np.errstate(invalid="ignore"):
        is_new = np.abs(np.diff(series, prepend=series[0])) > _ROUND_OFF
        is_bend = np.abs(np.diff(series, 2, prepend=series[0], append=series[-1])) > _ROUND_OFF
    if not holds and is_bend[is_usable].sum() < 0.8 * is_new[is_usable].sum():  # straight lines between the samples
        # a sample between two rows bends the line at both
        is_first = is_bend & ~np.append(False, is_bend[:-1])
        is_new = is_bend & ((row_numbers - np.maximum.accumulate(np.where(is_first, row_numbers, 0))) % 2 == 0)
    rows = np.flatnonzero(is_new & is_usable)
    if rows.size <= _LEAST_STEPS:
        return None
    n_unusable = np.cumsum(~is_usable)
    steps = np.diff(rows)[n_unusable[rows[1:]] == n_unusable[rows[:-1]]].astype(float)
    if steps.size < _LEAST_STEPS:
        return None
    mean, short = float(steps.mean()), float(np.quantile(steps, 0.05))
    usual = steps[steps <= 1.5 * short + 0.5]
    chance_spread = np.sqrt(_STEPS_IN_SUM * mean * (mean - 1.0))
    is_even = np.convolve(steps, np.ones(_STEPS_IN_SUM), "valid").std() < _MOST_SPREAD * chance_spread
    is_apart = short >= max(2.0, mean * (_LEAST_SHORT_STEP_HELD if holds else _LEAST_SHORT_STEP))
    if usual.mean() < _LEAST_SPACING or not (is_even or is_apart):
        return None
    shortest, longest = np.quantile(usual, (0.05, 0.95), method="nearest")
    return OwnValues(rows, float(usual.mean()), float(shortest), float(longest))
