"""A log of any rhythm as samples at equal intervals, and the positions of motor and stem at these samples.

Values are missing where the log is silent, and held where it has changes only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs import Log
from fastcoil.logs.series import counted
from fastcoil.model.engine import recorded

HELD = ("command", "T_set", "enabled")
"""Keep their values until the next sample in every log."""
LEAST_SAMPLES = 20
_REGULAR, _NEARLY = 0.8, 0.25
"""A log is regular if this share of its steps are whole multiples of the median, to this share of it."""
_FIRST_OF_TEN, _ROUNDED, _ALIKE = 0.1, 0.05, 2.0
"""Of the changes of a temperature logged at changes, half are below twice the smallest tenth."""
_LEAST, _MOST = 1.0, 10.0
"""Interval between the samples made of an irregular log, s."""
_LONGEST_SILENCE = 600.0
"""Of longer ones only so many seconds stay: nothing is looked for across them."""
MOST_SAMPLES = 200_000
"""Of the part that is diagnosed: 11 days of a log every 5 s."""


class Grid(NamedTuple):
    """The series of a log at equal intervals.

    interval: s.  time: of each sample since the first of the log, s, (n,); it jumps where a long silence was cut out.
    values: by name, (n,), NaN where missing.  on: whether the plant was on and the log there, (n,).  increment: by
    which the temperature had to change to be logged, K; 0 where it was logged anyway.
    """

    interval: float
    time: Array
    values: dict[str, Array]
    on: Mask
    increment: float


class _Rhythm(NamedTuple):
    """The interval, s, and whether samples come at every interval; else each holds until the next."""

    interval: float
    regular: bool


def on_grid(log: Log) -> tuple[Grid, list[str]]:
    """The series of a log at equal intervals, and notes on what was done to it.

    Samples at times that are nearly regular are moved to the nearest regular time.  In a log that is not regular, such
    as one of changes of value, every series holds until its next sample: the value that the building system knew.
    Steps beyond the longest that may be bridged are silences (``Log.batch`` counts the pieces between).
    """
    steps, same = np.diff(log.time), np.diff(log.batch) == 0
    forward = steps[same & (steps > 0.0)]
    if forward.size + 1 < LEAST_SAMPLES:
        raise InputError(
            f"{log.name}: {counted(forward.size + 1, 'sample')} in unbroken pieces, {LEAST_SAMPLES} are needed: "
            "give a longer log, or bridge its gaps: max_gap, --max-gap"
        )
    found = _rhythm(log, forward, same)
    notes = [] if found.regular else [
        f"the samples come at irregular times: every series holds until its next one, taken every {found.interval:g} s"
    ]  # fmt: skip
    tick = _ticks(log, found.interval)
    silent = int(np.ceil(_LONGEST_SILENCE / found.interval))
    jumps = np.diff(tick)
    cut = np.concatenate([[0], np.cumsum(np.where(same, 0, np.maximum(jumps - silent, 0)))])
    at = tick - cut
    if at[-1] >= MOST_SAMPLES:
        days = MOST_SAMPLES * found.interval / 86400
        raise InputError(
            f"{log.name}: {at[-1] + 1:,} samples of {found.interval:g} s: give the most telling {days:.0f} days or less"
        )
    return _filled(log, at, cut, found, same), notes


def _rhythm(log: Log, forward: Array, same: Mask) -> _Rhythm:
    """The interval of a log whose steps are ``forward``.

    A log of changes never repeats a row: one that misses some intervals, and repeats none, is such a log as well.
    """
    median = float(np.median(forward))
    multiples = forward / median
    whole = np.maximum(np.rint(multiples), 1.0)
    near = np.abs(multiples - whole) <= _NEARLY
    one = near & (whole == 1.0)
    repeats = np.all([np.diff(log.values[name]) == 0.0 for name in ("command", "T_sup")], axis=0) & same
    if near.mean() < _REGULAR or (one.mean() < _REGULAR and not repeats.any()):
        return _Rhythm(float(np.clip(round(median), _LEAST, _MOST)), False)
    mean = float(forward[one].mean())
    # seconds are what loggers know: a mean of 9.998 s is 10 s with a little jitter
    return _Rhythm(float(round(mean)) if abs(mean - round(mean)) < 0.01 * mean else mean, True)


def _ticks(log: Log, interval: float) -> Index:
    """Number of the interval in which each sample lies, ascending; pieces where time goes back follow each other."""
    ticks = np.empty(log.time.size, dtype=np.int64)
    last = -1
    for piece in range(log.n_batches):
        here = log.batch == piece
        start = max(int(np.rint(log.time[here][0] / interval)), last + 1)
        since = log.time[here] - log.time[here][0]
        ticks[here] = start + np.rint(since / interval).astype(np.int64)
        last = int(ticks[here][-1])
    return ticks


def _filled(log: Log, at: Index, cut: Index, found: _Rhythm, same: Mask) -> Grid:
    """Every series at 0, 1, … intervals: the latest sample in each, held where the log is of changes."""
    n = int(at[-1]) + 1
    source = np.full(n, -1)
    source[at] = np.arange(at.size)  # of samples in one interval the last counts
    held = np.maximum.accumulate(source)
    breaks = np.flatnonzero(~same)
    silent = np.zeros(n, dtype=bool)
    for k in breaks:
        silent[at[k] + 1 : at[k + 1]] = True
    index = np.arange(n)
    values: dict[str, Array] = {}
    for name, series in log.values.items():
        if name in HELD or not found.regular:
            values[name] = np.where(silent, np.nan, _last_known(series, at, n))
        else:
            values[name] = np.where(source >= 0, series[np.maximum(source, 0)], np.nan)
    on = ~silent
    if "enabled" in values:
        on &= np.nan_to_num(values["enabled"]) > 0.0
    since = np.arange(n) - at[np.searchsorted(at, index, side="right") - 1]
    time = log.time[held] + since * found.interval
    return Grid(found.interval, time, values, on, increment_of(log.values["T_sup"]))


def increment_of(temperature: Array) -> float:
    """By how much a temperature had to change to be logged, K; 0 if it was logged anyway, or rounded.

    Rounded values are whole steps apart; those logged at changes are anywhere, but never near the one before.
    """
    known = temperature[np.isfinite(temperature)]
    changes = np.abs(np.diff(known))
    changed = changes[changes > 0.0]
    if changed.size < LEAST_SAMPLES:
        return 0.0
    least = float(np.quantile(changed, _FIRST_OF_TEN))
    steps = (known - known[0]) / least
    rounded = float(np.quantile(np.abs(steps - np.rint(steps)), 1.0 - _FIRST_OF_TEN)) < _ROUNDED
    alike = float(np.median(changed)) < _ALIKE * least
    return least if alike and not rounded else 0.0


def _last_known(series: Array, at: Index, n: int) -> Array:
    """The last value that is not missing, up to each interval."""
    known = np.flatnonzero(np.isfinite(series))
    found = np.full(n, np.nan)
    if known.size:
        latest = np.full(n, -1)
        latest[at[known]] = known
        latest = np.maximum.accumulate(latest)
        found = np.where(latest >= 0, series[np.maximum(latest, 0)], np.nan)
    return found


def motor_positions(command: Array, most_travel: float) -> Array:
    """Motor position at each sample, just before the command of that sample acts, and one sample after the last.

    command: fraction of stroke, held from sample to sample; most_travel: fraction of stroke between two samples.  The
    motor stands at the first command when the log begins.
    """
    positions = np.empty(command.size + 1)
    recorded.motor_positions(np.ascontiguousarray(command, float), most_travel, positions)
    return positions


def openings(positions: Array, backlash: Array) -> Array:
    """Opening behind each candidate backlash, Eq (1), at each position: (positions, candidates).

    The stem starts in the middle of its play: where it stood when the log began is unknown.
    """
    least = positions[:, np.newaxis] - backlash
    q = np.clip(positions[0] - backlash / 2.0, 0.0, 1.0 - backlash)
    found = np.empty_like(least)
    for k, position in enumerate(positions):
        np.maximum(q, least[k], out=q)
        np.minimum(q, position, out=q)
        found[k] = q
    return found / (1.0 - backlash)


def mean_openings(positions: Array, backlash: Array, width: int) -> tuple[Array, Array]:
    """Mean opening behind each candidate backlash and the mean of its square: (pieces, candidates) each.

    A piece is ``width`` intervals between positions; the last that is not complete is left out.
    """
    openings = np.empty(((positions.size - 1) // width, backlash.size))
    squares = np.empty_like(openings)
    recorded.mean_openings(positions, np.ascontiguousarray(backlash, float), width, openings, squares)
    return openings, squares


def turns(positions: Array, least: float) -> int:
    """How often the motor turns and then comes back by more than ``least`` (fraction of stroke)."""
    count, direction, extreme = 0, 0, float(positions[0])
    for position in positions.tolist():
        back = (position - extreme) * (direction or 1)
        if (direction == 0 and abs(back) > least) or (direction != 0 and back < -least):
            count += direction != 0
            direction = 1 if position > extreme else -1
            extreme = position
        elif direction != 0 and back > 0.0:
            extreme = position
    return count
