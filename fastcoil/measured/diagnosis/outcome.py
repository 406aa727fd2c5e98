"""What a day of a loop was like: control error, hunting and travel, by the meanings of the metrics of a simulation."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.measured.diagnosis.replayed_loop import Day, Played
from fastcoil.model.metric_table import HUNTING_PERIODS, HUNTING_SAMPLE, HUNTING_SWING, SETTLING_TIME, WARM_UP

LARGEST_WARM_UP = 0.125
"""Share of a short log that is left out at its start in place of ``WARM_UP``."""
MOVED = 1e-9
"""Change of opening that counts as a movement, fraction of stroke."""
DAY = 86400.0


class Outcome(NamedTuple):
    """A day of a loop.

    rmse: of the true temperature against the set-point, K.  amplitude: half of the mean peak to peak of the settled
    windows, K.  period: settled seconds per upward crossing of the set-point, NaN below two.  travel_per_day: of the
    motor, strokes.  reversals_per_day: of the stem.  hunts: as the metric of that name.
    A day is 24 h of operation.
    """

    rmse: float
    amplitude: float
    period: float
    travel_per_day: float
    reversals_per_day: float
    hunts: bool


def counted_steps(day: Day, step: float) -> Mask:
    """Steps that count, (n_steps,): the loop works, and the warm-up is over."""
    counted = day.works.copy()
    counted[: int(min(WARM_UP, LARGEST_WARM_UP * counted.size * step) / step)] = False
    return counted


def outcome_of(played: Played, day: Day, step: float) -> Outcome:
    """What a replayed day was like; step: s."""
    n = day.T_set.size
    counted = counted_steps(day, step)
    error = played.temperature - day.T_set
    changed = np.diff(day.T_set, prepend=day.T_set[:1]) != 0.0
    changed |= ~day.works
    last = np.maximum.accumulate(np.where(changed, np.arange(n), 0))
    settled = counted & ((np.arange(n) - last) * step >= SETTLING_TIME)
    starts = np.flatnonzero(settled & ~np.concatenate([[False], settled[:-1]]))
    ends = np.flatnonzero(settled & ~np.concatenate([settled[1:], [False]])) + 1
    windows = [slice(a, b) for a, b in zip(starts.tolist(), ends.tolist(), strict=True)]
    swing = float(np.mean([np.ptp(played.temperature[w]) for w in windows])) if windows else math.nan
    periods = _periods([error[w] for w in windows], step)
    alike = np.sum(5.0 * np.abs(np.diff(periods)) <= np.maximum(periods[1:], periods[:-1]))
    crossings = sum(_upward(error[w]).size for w in windows)
    days = max(int(counted.sum()), 1) * step / DAY
    both = counted[1:] & counted[:-1]
    turns = np.sign(np.diff(played.opening)[both & (np.abs(np.diff(played.opening)) > MOVED)])
    return Outcome(
        rmse=float(np.sqrt(np.mean(error[counted] ** 2))) if counted.any() else math.nan,
        amplitude=0.5 * swing,
        period=float(settled.sum()) * step / crossings if crossings >= 2 else math.nan,
        travel_per_day=float(np.sum(np.abs(np.diff(played.position))[both])) / days,
        reversals_per_day=float(np.sum(np.diff(turns) != 0.0)) / days,
        hunts=bool(swing > HUNTING_SWING and periods.size >= HUNTING_PERIODS and 3 * alike >= 2 * periods.size),
    )


def _upward(error: Array) -> Index:
    """Where the error comes up through 0."""
    return np.asarray(np.flatnonzero((error[:-1] < 0.0) & (error[1:] >= 0.0)) + 1)


def _periods(errors: list[Array], step: float) -> Array:
    """Seconds between upward crossings within each window, seen every ``HUNTING_SAMPLE`` s."""
    every = max(1, round(HUNTING_SAMPLE / step))
    return np.concatenate([np.zeros(0), *(np.diff(_upward(error[::every])) * every * step for error in errors)])
