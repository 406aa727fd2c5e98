"""A log of any rhythm as samples at equal intervals, and the positions of motor and stem at these samples.

Values are missing where the log is silent, and held where it has changes only.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs import Log
from fastcoil.logs.series import counted
from fastcoil.model.engine import recorded

HELD = ("command", "T_set", "enabled", "test")  # keep their values until the next sample in every log
LEAST_SAMPLES = 20
_REGULAR, _NEARLY = 0.8, 0.25
"""A log is regular if this share of its steps are whole multiples of the median, to this share of it."""
_FIRST_OF_TEN, _ROUNDED, _ALIKE = 0.1, 0.05, 2.0
"""Of the changes of a temperature logged at changes, half are below twice the smallest tenth."""
_LEAST, _MOST = 1.0, 10.0  # interval between the samples made of an irregular log, s
DAY = 86400.0  # s
_SLOWEST = 3600.0  # s between samples; a log that is slower shows nothing of a loop
_LONGEST_SILENCE = 600.0  # of longer ones only so many seconds stay: nothing is looked for across them
_FINE, _USUAL_STEPS = 30.0, (10, 15, 20, 30, 60, 120, 180, 300, 600, 900, 1800)
"""Filled-in values matter where logged ones are farther apart than so many s; steps of a clock that are looked for."""
_MISSED, _MISSED_ELSEWHERE, _ROUND_OFF = 0.02, 0.1, 1e-6
"""Share of the samples that own samples may fail to give back, and that samples at other places do fail to."""
MOST_SAMPLES = 200_000  # of the part that is diagnosed: 11 days of a log every 5 s


class Grid(NamedTuple):
    """The series of a log at equal intervals."""

    interval: float  # s
    time: Array  # since the first sample of the log, s, (n,); it jumps where a long silence was cut out
    values: dict[str, Array]  # by name, (n,), NaN where missing
    on: Mask  # whether the plant was on and the log there, (n,)
    increment: float  # by which the temperature had to change to be logged, K; 0 where it was logged anyway
    starts: tuple[int, ...] = (0,)  # first sample of each log that was joined

    def part(self, at: slice) -> "Grid":
        """Some samples of one log."""
        values = {name: series[at] for name, series in self.values.items()}
        return Grid(self.interval * (at.step or 1), self.time[at], values, self.on[at], self.increment)

    def days(self) -> list[slice]:
        """The samples of each day, of 24 h at most from the start of a log; shorter rests belong to the day before."""
        ends = (*self.starts[1:], self.on.size)
        a_day, days = round(DAY / self.interval), []
        for first, end in zip(self.starts, ends, strict=True):
            cuts = [*range(first, max(end - a_day // 2, first + 1), a_day), end]
            days += [slice(*pair) for pair in pairwise(cuts)]
        return days


def on_grid(log: Log) -> tuple[Grid, list[str]]:
    """The series of a log at equal intervals, and notes on what was done to it.

    Samples at times that are nearly regular are moved to the nearest regular time.  In a log that is not regular, such
    as one of changes of value, every series holds until its next sample: the value that the building system knew.
    Steps beyond the longest that may be bridged are silences (``Log.batch`` counts the pieces between).
    """
    steps, same = np.diff(log.time), np.diff(log.batch) == 0
    forward = steps[same & (steps > 0.0)]
    left_out = "; ".join(log.notes) or "nothing was left out"
    if forward.size + 1 < LEAST_SAMPLES:
        raise InputError(
            f"{log.name}: {counted(forward.size + 1, 'sample')} in unbroken pieces, {LEAST_SAMPLES} are needed: "
            f"give a longer log, or bridge its gaps: max_gap, --max-gap ({left_out})"
        )
    interval, is_regular = _rhythm(log, forward, same)
    if interval > _SLOWEST:
        raise InputError(f"{log.name}: a sample every {interval:,.0f} s is left: log every minute ({left_out})")
    tick = _ticks(log, interval)
    silent = int(np.ceil(_LONGEST_SILENCE / interval))
    cut = np.concatenate([[0], np.cumsum(np.where(same, 0, np.maximum(np.diff(tick) - silent, 0)))])
    at = tick - cut
    if at[-1] >= MOST_SAMPLES:
        days = MOST_SAMPLES * interval / DAY
        raise InputError(f"{log.name}: {at[-1] + 1:,} samples of {interval:.4g} s: give {days:.0f} days or less")
    grid = _filled(log, at, interval, is_regular, same)
    if is_regular:
        return _thinned(grid)
    changes = "the samples come at irregular times: every series holds until its next one"
    return grid, [f"{changes}, taken every {interval:.4g} s"]


def _thinned(grid: Grid) -> tuple[Grid, list[str]]:
    """Only the samples that were logged, where those between them were filled in; and a note of it."""
    every = {name: logged_every(grid.values[name], grid.interval) for name in ("command", "T_sup")}
    width = max(step for step, _ in every.values())
    if width == 1 or width * grid.interval <= _FINE:
        return grid, []
    name = "T_sup" if every["T_sup"][0] > 1 else "command"
    own = grid.part(slice(every[name][1], None, width))
    often = f"only every {own.interval:.4g} s"
    return own, [f"{name} has a value of its own {often}, those between are filled in: only its own count"]


def in_a_row(grids: Sequence[Grid]) -> Grid:
    """The logs of several days one after the other, with a silence between them."""
    if len({round(grid.interval, 3) for grid in grids}) > 1:
        found = ", ".join(f"{interval:.4g} s" for interval in sorted({grid.interval for grid in grids}))
        raise InputError(f"the logs have a sample every {found}: give logs of one interval")
    interval = grids[0].interval
    silence = int(np.ceil(_LONGEST_SILENCE / interval))
    sizes = [grid.on.size + silence for grid in grids]

    def joined(parts: Iterable[NDArray[Any]], between: Any) -> NDArray[Any]:
        return np.concatenate([np.pad(part, (0, silence), constant_values=between) for part in parts])[:-silence]

    names = [name for name in grids[0].values if all(name in grid.values for grid in grids)]
    return Grid(
        interval,
        interval * np.arange(float(sum(sizes) - silence)),
        {name: joined([grid.values[name] for grid in grids], np.nan) for name in names},
        joined([grid.on for grid in grids], False),
        max(grid.increment for grid in grids),
        tuple(np.cumsum([0, *sizes[:-1]]).tolist()),
    )


def logged_every(series: Array, interval: float) -> tuple[int, int]:
    """At which samples a series has values of its own: every how many, and the first of them; (1, 0) for all.

    Those between are filled in if own samples, held or joined by straight lines, give all of them back to within the
    resolution, and samples at other places do not: a slow temperature of a coarse sensor is given back by any.
    """
    known = np.where(np.isfinite(series), series, 0.0)
    apart = np.diff(np.unique(known))
    resolution = float(apart.min()) if apart.size else 0.0
    every = np.arange(known.size)

    def missed(at: Index, straight: bool) -> float:
        last = np.searchsorted(at, every, side="right") - 1
        given = np.interp(every, at, known[at]) if straight else known[at[np.maximum(last, 0)]]
        within = (last >= 0) & (every <= at[-1])
        return float(np.mean(np.abs(given - known)[within] > (1.0 + _ROUND_OFF) * resolution + _ROUND_OFF))

    for seconds in reversed(_USUAL_STEPS):
        width = round(seconds / interval)
        if width < 2 or abs(width * interval - seconds) > _NEARLY or known.size < LEAST_SAMPLES * width:
            continue
        for straight in (True, False):
            found = np.array([missed(every[first::width], straight) for first in range(width)])
            if found.min() <= _MISSED and np.median(found) >= _MISSED_ELSEWHERE:
                return width, int(found.argmin())
    return 1, 0


def _rhythm(log: Log, forward: Array, same: Mask) -> tuple[float, bool]:
    """The interval of a log whose steps are ``forward``, s, and whether samples come at every interval.

    A log of changes never repeats a row: one that misses some intervals, and repeats none, is such a log as well.
    """
    median = float(np.median(forward))
    multiples = forward / median
    whole = np.maximum(np.rint(multiples), 1.0)
    near = np.abs(multiples - whole) <= _NEARLY
    one = near & (whole == 1.0)
    repeats = np.all([np.diff(log.values[name]) == 0.0 for name in ("command", "T_sup")], axis=0) & same
    if near.mean() < _REGULAR or (one.mean() < _REGULAR and not repeats.any()):
        return float(np.clip(round(median), _LEAST, _MOST)), False
    mean = float(forward[one].mean())
    # seconds are what loggers know: a mean of 9.998 s is 10 s with a little jitter
    return float(round(mean)) if abs(mean - round(mean)) < 0.01 * mean else mean, True


def _ticks(log: Log, interval: float) -> Index:
    """Number of the interval in which each sample lies, ascending; pieces where time goes back follow each other."""
    ticks = np.empty(log.time.size, dtype=np.int64)
    last = -1
    for piece in range(log.n_batches):
        here = log.batch == piece
        time = log.time[here]
        start = max(int(np.rint(time[0] / interval)), last + 1)
        ticks[here] = start + np.rint((time - time[0]) / interval).astype(np.int64)
        last = int(ticks[here][-1])
    return ticks


def _filled(log: Log, at: Index, interval: float, is_regular: bool, same: Mask) -> Grid:
    """Every series at 0, 1, … intervals: the latest sample in each, held where the log is of changes."""
    n = int(at[-1]) + 1
    silent = np.zeros(n, dtype=bool)
    for k in np.flatnonzero(~same):
        silent[at[k] + 1 : at[k + 1]] = True
    latest = _last(np.ones(at.size, dtype=bool), at, n)
    values: dict[str, Array] = {}
    for name, series in log.values.items():
        if name in HELD or not is_regular:
            last = _last(np.isfinite(series), at, n)
            values[name] = np.where(silent | (last < 0), np.nan, series[last])
        else:
            values[name] = np.full(n, np.nan)
            values[name][at] = series  # of samples in one interval the last counts
    on = ~silent
    if "enabled" in values:
        on &= np.nan_to_num(values["enabled"]) > 0.0
    time = log.time[latest] + (np.arange(n) - at[latest]) * interval
    return Grid(interval, time, values, on, increment_of(log.values["T_sup"]))


def _last(known: Mask, at: Index, n: int) -> Index:
    """The last sample that is known up to each of n intervals; -1 before the first.  at: interval of each sample."""
    found = np.full(n, -1)
    found[at[known]] = np.flatnonzero(known)
    return np.asarray(np.maximum.accumulate(found))


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


def held(series: Array) -> Array:
    """Missing values replaced by the last before them, those at the beginning by the first there is."""
    return np.array(pd.Series(series).ffill().bfill())


def all_good(good: Mask, first: Index, last: Index) -> Mask:
    """Whether all samples from each ``first`` to its ``last`` are good."""
    bad_before = np.concatenate([[0], np.cumsum(~good)])
    return np.asarray(bad_before[last + 1] == bad_before[first])


def motor_positions(command: Array, interval: float, stroke_time: float) -> Array:
    """Motor position before the command of each sample acts, and after the last; ``stroke_time``: s, 0 if immediate."""
    positions = np.empty(command.size + 1)
    travel = interval / stroke_time if stroke_time > 0.0 else 1.0
    recorded.motor_positions(np.ascontiguousarray(command, float), travel, positions)
    return positions


def openings(positions: Array, backlash: float) -> Array:
    """Opening behind a backlash, Eq (1), at each position; the stem starts in the middle of its play."""
    q = min(max(float(positions[0]) - backlash / 2.0, 0.0), 1.0 - backlash)
    found = np.empty_like(positions)
    for k, position in enumerate(positions.tolist()):
        q = min(max(q, position - backlash), position)
        found[k] = q
    return found / (1.0 - backlash)


def mean_openings(positions: Array, backlash: Array, width: int) -> tuple[Array, Array]:
    """Mean opening behind each backlash and of its square, (pieces, candidates), in whole pieces of ``width`` steps."""
    openings, squares = np.empty((2, (positions.size - 1) // width, backlash.size))
    recorded.mean_openings(positions, np.ascontiguousarray(backlash, float), width, openings, squares)
    return openings, squares
