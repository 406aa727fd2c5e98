"""The PI controller that wrote a log, found again from its error and its command."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask

HELD = 1e-9
"""A command that changes by less is held."""
LEAST_CHANGES, LEAST_ROWS = 20, 30
BUSY = 20
"""Changes of the command in a row whose mean distance is the sample time, where it is shortest."""
EXACT = 1e-3
"""Residual, as a share of the changes, below which the log holds every sample of the controller."""
LAGS = (1, 2, 4)
"""Changes that a row of the fit spans."""
USUAL = 10.0
"""Seconds between samples of a controller that a coarser log does not tell."""
LESS = 0.9
"""Share of what one sample leaves unexplained that the sample before may leave at most to be taken in its place."""
LEAST_EXPLAINED = 0.9
"""Share of the variance of the command's changes that a PI has to explain."""
EDGE = 1e-6
"""A command this close to 0 or 1 is saturated."""


class Fit(NamedTuple):
    """kp and kp/ti, and the share explained."""

    kp: float
    ki: float
    explained: float


class RecoveredPI(NamedTuple):
    """A PI controller, Δu = kp Δe + kp (sample_time/ti) e with e = T - T_set.

    kp: 1/K, below 0 for heating.  ti, sample_time: s.  explained: share of the variance of the command's changes.
    """

    kp: float
    ti: float
    sample_time: float
    explained: float


def recover_pi(
    command: Array, temperature: Array, T_set: Array, interval: float, good: Mask, sample_time: float | None
) -> RecoveredPI | str:
    """Find kp, ti and, if it is not given, the sample time; a sentence if the command follows no PI.

    Parameters
    ----------
    command, temperature, T_set
        (n,): fraction of stroke, °C, °C.
    interval
        Seconds from sample to sample of the log.
    good
        (n,): samples that may be used.
    """
    changes = np.flatnonzero((np.abs(np.diff(command)) > HELD) & good[1:] & good[:-1]) + 1
    if changes.size < LEAST_CHANGES:
        return f"the command changes {changes.size} times only: log a day on which the loop works"
    every = _sample_time(command, changes, interval) if sample_time is None else sample_time
    found = _recovered(command, temperature, T_set, interval, good, changes, every, sample_time)
    # many logs write the command that answers a temperature one sample after it
    before = np.maximum(np.arange(command.size) - 1, 0)
    both = good & good[before]
    both[0] = False
    later = _recovered(command, temperature[before], T_set[before], interval, both, changes, every, sample_time)
    if found is None or (later is not None and 1.0 - later.explained < LESS * (1.0 - found.explained)):
        found = later
    if found is None:
        return "too little of the log shows the controller at work: the command is saturated or hardly moves"
    if found.explained < LEAST_EXPLAINED:
        return (
            f"a PI of the logged error explains {100 * max(found.explained, 0.0):.0f} % of the command's changes "
            "only: another law runs, or an inverse, or the set-point in the log is not that of the controller"
        )
    if found.ti <= 0.0 or not np.isfinite(found.ti):
        return "the command goes on without an error and comes back with one: no PI does that"
    return found


def _recovered(
    command: Array, temperature: Array, T_set: Array, interval: float, good: Mask, changes: Index, every: float,
    given: float | None,
) -> RecoveredPI | None:  # fmt: skip
    """The PI whose command answers the temperature of the same sample."""
    error = temperature - T_set
    if every > 1.2 * interval:
        return _slower(command, error, changes, interval, every)
    between = 0.5 * (temperature[1:] + temperature[:-1]) - T_set[:-1]
    return _faster(command, error, interval * between, good, interval, given)


def _sample_time(command: Array, changes: Index, interval: float) -> float:
    """Seconds between the controller's samples, or ``interval`` if the log is coarser.

    A saturated command is held for as long as it stays so, and tells nothing.
    """
    held = command[changes[:-1]]
    gaps = np.diff(changes)[(held > EDGE) & (held < 1.0 - EDGE)]
    if gaps.size == 0:
        return interval
    busy = min(BUSY, gaps.size)
    total = np.concatenate([[0], np.cumsum(gaps)])
    found = float(np.quantile(total[busy:] - total[:-busy], 0.1)) * interval / busy
    nice = 5.0 * round(found / 5.0)
    return nice if abs(found - nice) < 0.05 * found and nice > 0.0 else found


def _slower(command: Array, error: Array, changes: Index, interval: float, every: float) -> RecoveredPI | None:
    """From a log at least as fine as the controller: a row for each few changes that are one sample apart each."""
    apart = np.diff(changes) * interval
    one = np.abs(apart - every) < max(interval, 0.5 * every) - HELD
    total = np.concatenate([[0.0], np.cumsum(every * error[changes])])

    def rows(lag: int) -> tuple[Index, Index, Array]:
        all_one = np.flatnonzero(_moving_sum(one, lag) == lag)
        return changes[all_one], changes[all_one + lag], total[all_one + lag + 1] - total[all_one + 1]

    fit = _best(command, error, rows)
    return fit and RecoveredPI(fit.kp, _ti(fit.kp, fit.ki), every, fit.explained)


def _faster(
    command: Array, error: Array, between: Array, good: Mask, interval: float, given: float | None
) -> RecoveredPI | None:
    """From a log as fine as the controller or coarser; ``between``: K s from each sample of it to the next.

    The temperature runs straight between them, and the set-point holds.
    """

    def fit_of(sums: Array) -> Fit | None:
        total = np.concatenate([[0.0], np.cumsum(np.where(good[1:] & good[:-1], sums, 0.0))])

        def rows(lag: int) -> tuple[Index, Index, Array]:
            first = np.flatnonzero(_moving_sum(good, lag + 1) == lag + 1)
            return first, first + lag, total[first + lag] - total[first]

        return _best(command, error, rows)

    fit = fit_of(interval * error[1:])
    if fit is not None and 1.0 - fit.explained < EXACT**2:
        return RecoveredPI(fit.kp, _ti(fit.kp, fit.ki), interval, fit.explained)
    fit = fit_of(between)
    if fit is None:
        return None
    # each sample adds the new error before use: half a sample more than the straight line
    every = min(0.5 * interval, USUAL) if given is None else given
    kp = fit.kp - 0.5 * every * fit.ki
    return RecoveredPI(kp, _ti(kp, fit.ki), every, fit.explained)


def _ti(kp: float, ki: float) -> float:
    return kp / ki if ki else np.inf


def _moving_sum(flags: Mask, width: int) -> Index:
    total = np.concatenate([[0], np.cumsum(flags)])
    return np.asarray(total[width:] - total[:-width])


def _best(command: Array, error: Array, rows: Callable[[int], tuple[Index, Index, Array]]) -> Fit | None:
    """The fit over the lag that explains most.

    A log whose samples fall between those of the controller sees one of these now and two then; a longer lag evens
    that out, and what a coarse resolution does too.
    """
    fits = [fit for lag in LAGS if (fit := _regressed(command, error, *rows(lag))) is not None]
    return max(fits, key=lambda fit: fit.explained, default=None)


def _regressed(command: Array, error: Array, before: Index, after: Index, integral: Array) -> Fit | None:
    """(kp, kp/ti, share explained) from changes of the command; saturated ones, and those of the integral, left out."""
    du, de = command[after] - command[before], error[after] - error[before]
    inside = np.minimum(command[before], command[after]) > EDGE
    inside &= np.maximum(command[before], command[after]) < 1.0 - EDGE
    X = np.stack([de, integral], axis=1)
    kept = inside
    for _ in range(3):
        if kept.sum() < LEAST_ROWS or not np.any(du[kept]):
            return None
        kp, ki = np.linalg.lstsq(X[kept], du[kept], rcond=None)[0]
        sums = np.stack([command[i] - kp * error[i] for i in (before, after)])
        kept = inside & (sums.min(axis=0) > EDGE) & (sums.max(axis=0) < 1.0 - EDGE)
    left = du[kept] - X[kept] @ (kp, ki)
    return Fit(float(kp), float(ki), 1.0 - float(left @ left) / float(du[kept] @ du[kept]))
