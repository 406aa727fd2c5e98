"""Logs of which a row is written when some value has changed, instead of every minute: their long steps are no gaps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fastcoil.base.arrays import Array, Mask

LONG_STEP = 3.0
"""Steps longer than this many median steps are gaps, but in a log of changes."""
_REGULAR, _ABOUT = 0.6, 0.2
"""Steps are regular where more than this share of them is within so much of the median."""
_SHORT_AND_LONG, _SPREAD = (0.1, 0.9), 4.0
"""They are uneven where they are not regular and these quantiles are so far apart: further than lost rows make them."""
_LONG = 0.05
"""Share of steps that would be gaps, at least."""
_CHANGES, _REPEATS = 0.9, 0.2
"""In so many of the rows something changes, while one series stays as it was in so many of them."""
_FEWEST = 20
"""Steps."""
_USUAL, _LONGER = 0.95, 10.0
"""A step so many times longer than this share of all steps is a gap of such a log, too."""


def longest_step(time: Array, within: Mask, values: Mapping[str, Array]) -> float | None:
    """Longest step that is no gap [s], if this is a log of changes; else None.

    Parameters
    ----------
    time, values
        Time of the rows [s] and the series by name, each (n,).
    within
        Where two rows follow each other in time, (n - 1,).
    """
    steps = np.diff(time)[within]
    if steps.size < _FEWEST:
        return None
    if not may_be_of_changes(steps) or np.mean(steps > LONG_STEP * np.median(steps)) < _LONG:
        return None
    changed = {name: _changed(series)[within] for name, series in values.items() if name != "batch"}
    if not changed or np.mean(np.any(list(changed.values()), axis=0)) < _CHANGES:
        return None
    if not any(change.sum() > 2 and np.mean(~change) >= _REPEATS for change in changed.values()):
        return None
    return float(_LONGER * np.quantile(steps, _USUAL))


def may_be_of_changes(steps: Array) -> bool:
    """Whether steps are uneven; a single sample has none, and may be of changes, too."""
    if not steps.size:
        return True
    median = float(np.median(steps))
    regular = np.mean(np.abs(steps - median) <= _ABOUT * median) > _REGULAR
    short, long = np.quantile(steps, _SHORT_AND_LONG)
    return bool(not regular and long >= _SPREAD * short)


def _changed(series: Array) -> Mask:
    """Where a series is not what it was in the row before, (n - 1,)."""
    same = (series[1:] == series[:-1]) | (np.isnan(series[1:]) & np.isnan(series[:-1]))
    return np.asarray(~same)
