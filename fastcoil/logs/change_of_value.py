"""Logs of which a row is written when some value has changed, instead of every minute: their long steps are no gaps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fastcoil.arrays import Array, Mask

_REGULAR, _ABOUT = 0.6, 0.2
"""Steps are regular where more than this share of them is within so much of the median."""
_LONG = 0.05
"""Share of steps that would be gaps, at least."""
_CHANGES, _REPEATS = 0.9, 0.2
"""In so many of the rows something changes, while one series stays as it was in so many of them."""
_FEWEST = 20
"""Steps."""
_USUAL, _LONGER = 0.95, 10.0
"""A step so many times longer than this share of all steps is a gap of such a log, too."""


def longest_step(time: Array, within: Mask, values: Mapping[str, Array], long_step: float) -> float | None:
    """Longest step that is no gap [s], if this is a log of changes; else None.

    Parameters
    ----------
    time, values
        Time of the rows [s] and the series by name, each (n,).
    within
        Where two rows follow each other in time, (n - 1,).
    long_step
        Steps longer than so many median ones are gaps of other logs.
    """
    steps = np.diff(time)[within]
    if steps.size < _FEWEST:
        return None
    if is_regular(steps) or np.mean(steps > long_step * np.median(steps)) < _LONG:
        return None
    changed = {name: _changed(series)[within] for name, series in values.items() if name != "batch"}
    if not changed or np.mean(np.any(list(changed.values()), axis=0)) < _CHANGES:
        return None
    if not any(change.sum() > 2 and np.mean(~change) >= _REPEATS for change in changed.values()):
        return None
    return float(_LONGER * np.quantile(steps, _USUAL))


def is_regular(steps: Array) -> bool:
    """Whether most steps are about the usual one; ``steps``: [s], any number of them."""
    if not steps.size:
        return False
    median = float(np.median(steps))
    return bool(np.mean(np.abs(steps - median) <= _ABOUT * median) > _REGULAR)


def _changed(series: Array) -> Mask:
    """Where a series is not what it was in the row before, (n - 1,)."""
    same = (series[1:] == series[:-1]) | (np.isnan(series[1:]) & np.isnan(series[:-1]))
    return np.asarray(~same)
