"""A log resampled at equal intervals, and the positions of motor and stem at these samples.

Values are missing where the log is silent, and held where it has changes only.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError
from fastcoil.logs import CheckedLog
from fastcoil.logs.own_values import OwnValues, find_own_values
from fastcoil.logs.series import format_count
from fastcoil.model.engine import recorded

HELD_COLUMNS = (
    "command", "T_set", "enabled", "test", "cooling_command", "heating_command", "preheat_command", "T_set_cooling",
    "T_set_heating", "occupied",
)  # fmt: skip  # hold until the next sample in every log
LEAST_SAMPLES = 20  # of a log that can be diagnosed
MOST_SAMPLES = 200_000  # of a resampled log: 11 days every 5 s
SECONDS_PER_DAY = 86400.0
_LONGEST_SILENCE_S = 600.0  # of a longer silence only this much stays
_REGULAR_SHARE = 0.8  # of the steps that are whole multiples of the median, in a regular log
_STEP_TOLERANCE = 0.25  # of the median, by which a step may differ from a whole multiple
_SMALL_CHANGE_QUANTILE = 0.1  # of the changes of a temperature, at which one counts as small
_SHORT_POLL_S = 30.0  # between values of its own, that does not matter


class Grid(NamedTuple):
    """A log at equal intervals."""

    interval: float  # s
    time: Array  # since the first sample of the log, s, (n,); it jumps where a long silence was cut out
    values: dict[str, Array]  # by name, (n,), NaN where missing
    on: Mask  # whether the plant was on and the log there, (n,)
    increment: float  # by which the temperature had to change to be logged, K; 0 where it was logged anyway
    starts: tuple[int, ...] = (0,)  # first sample of each log that was joined

    def part(self, rows: slice) -> "Grid":
        """Return the samples of a slice within one log, every so many if the slice has a step."""
        values = {name: series[rows] for name, series in self.values.items()}
        return Grid(self.interval * (rows.step or 1), self.time[rows], values, self.on[rows], self.increment)

    def at_lag(self, lag: float) -> "Grid":
        """Return the grid with T_sup and T_set ``lag`` s earlier, NaN where a log ends."""
        logs, shift = np.searchsorted(self.starts, np.arange(self.on.size), side="right"), round(lag / self.interval)
        logged = {name: pd.Series(self.values[name]) for name in ("T_sup", "T_set") if name in self.values}
        moved = {name: series.groupby(logs).shift(-shift).to_numpy() for name, series in logged.items()}
        return self._replace(values=self.values | moved)

    def day_slices(self) -> list[slice]:
        """Return a slice for each day from the start of each log; a rest of less than half a day joins the last."""
        samples_per_day, days = round(SECONDS_PER_DAY / self.interval), []
        for first, end in zip(self.starts, (*self.starts[1:], self.on.size), strict=True):
            cuts = [*range(first, max(end - samples_per_day // 2, first + 1), samples_per_day), end]
            days += [slice(*pair) for pair in pairwise(cuts)]
        return days


def resample_log(log: CheckedLog) -> tuple[Grid, list[str]]:
    """Resample a log at equal intervals; also return notes on what was changed.

    Samples at nearly regular times are moved to the nearest regular time.  In any other log, such as one of changes of
    value, every series holds until its next sample: the value that the building system knew.  Steps beyond the longest
    that may be bridged are silences (``CheckedLog.batch`` numbers the pieces between).
    """
    steps, is_same_piece = np.diff(log.time), np.diff(log.batch) == 0
    steps_forward = steps[is_same_piece & (steps > 0.0)]
    left_out = "; ".join(log.notes) or "nothing was left out"
    if steps_forward.size + 1 < LEAST_SAMPLES:
        count = f"{format_count(steps_forward.size + 1, 'sample')} in unbroken pieces, {LEAST_SAMPLES} are needed"
        cure = f"give a longer log, or bridge its gaps: fc.read_log(..., max_gap=SECONDS), --max-gap ({left_out})"
        raise InputError(f"{log.name}: {count}: {cure}", "log", "data")
    interval, is_regular = _find_rhythm(log, steps_forward, is_same_piece)
    if interval > 3600.0:  # a slower log shows nothing of a loop
        sentence = f"{log.name}: a sample every {interval:,.0f} s is left: log every minute ({left_out})"
        raise InputError(sentence, "log", "time")
    ticks = _number_intervals(log, interval)
    longest_silence = int(np.ceil(_LONGEST_SILENCE_S / interval))
    excess = np.where(is_same_piece, 0, np.maximum(np.diff(ticks) - longest_silence, 0))
    slots = ticks - np.concatenate([[0], np.cumsum(excess)])
    if slots[-1] >= MOST_SAMPLES:
        days = MOST_SAMPLES * interval / SECONDS_PER_DAY
        sentence = f"{log.name}: {slots[-1] + 1:,} samples of {interval:.4g} s: give {days:.0f} days or less"
        raise InputError(sentence, "log", "size")
    grid = _fill_grid(log, slots, interval, is_regular, is_same_piece)
    if is_regular:
        return grid, []
    explanation = "the samples come at irregular times: every series holds until its next one"
    return grid, [f"{explanation}, taken every {interval:.4g} s"]


def keep_own_values(grid: Grid) -> tuple[Grid, list[str]]:
    """Keep the samples at which the slower of command and temperature got a value of its own; also return notes."""
    T_sup, command = (grid.values[name] for name in ("T_sup", "command"))
    is_between_ends = (command > 0.0) & (command < 1.0)  # at its ends a command rests
    found = {
        "T_sup": find_own_values(T_sup, grid.on & np.isfinite(T_sup), holds=False),
        "command": find_own_values(command, grid.on & is_between_ends, holds=True),
    }
    own_values = {name: own for name, own in found.items() if own}
    slowest = max(own_values.values(), key=lambda own: own.spacing, default=None)
    if slowest is None or slowest.spacing * grid.interval <= _SHORT_POLL_S:
        return grid, []
    ends = (*grid.starts[1:], grid.on.size)
    pieces = [_own_rows(slowest, first, end) for first, end in zip(grid.starts, ends, strict=True)]
    rows, starts = np.concatenate(pieces), np.cumsum([0, *map(len, pieces[:-1])])
    values = {name: series[rows] for name, series in grid.values.items()}
    interval = _whole_seconds(slowest.spacing * grid.interval)
    thinned = Grid(interval, grid.time[rows], values, grid.on[rows], grid.increment, tuple(starts.tolist()))
    cure = "the rows between repeat them or lie on straight lines and do not count"
    return thinned, [f"{name} has {own.describe(grid.interval)}: {cure}" for name, own in own_values.items()]


def _own_rows(own: OwnValues, first: int, end: int) -> Index:
    """Return rows from ``first`` to before ``end``: those of ``own``, and one a spacing where a value came twice."""
    own_rows = own.rows[(own.rows >= first) & (own.rows < end)]
    kept = [int(own_rows[0]) if own_rows.size else first]
    while (expected := kept[-1] + own.spacing) < end:
        after = np.searchsorted(own_rows, expected)
        nearest = min(own_rows[max(after - 1, 0) : after + 1].tolist(), key=lambda row: abs(row - expected), default=0)
        kept.append(nearest if abs(nearest - expected) < 0.5 * own.spacing else round(expected))
    return np.array([row for row in kept if row < end])


def common_start(starts: Sequence[np.datetime64 | None]) -> np.datetime64 | None:
    """Return the time at which the first of several logs starts, if all of them have a clock."""
    return None if any(start is None for start in starts) else starts[0]


def join_grids(grids: Sequence[Grid], starts: Sequence[np.datetime64 | None] = (None,)) -> Grid:
    """Join the resampled logs of several days, with a silence between them; of one, return it.

    starts: time of the first sample of each.  Times are since the first of them; without a clock each log begins a day.
    """
    if len(grids) == 1:
        return grids[0]
    if len({round(grid.interval, 3) for grid in grids}) > 1:
        intervals = ", ".join(f"{interval:.4g} s" for interval in sorted({grid.interval for grid in grids}))
        raise InputError(f"the logs have a sample every {intervals}: give logs of one interval", "log", "time")
    interval = grids[0].interval
    silence = int(np.ceil(_LONGEST_SILENCE_S / interval))
    sizes = [grid.on.size + silence for grid in grids]

    def join_parts(parts: Iterable[NDArray[Any]], filler: Any) -> NDArray[Any]:
        return np.concatenate([np.pad(part, (0, silence), constant_values=filler) for part in parts])[:-silence]

    names = [name for name in grids[0].values if all(name in grid.values for grid in grids)]
    values = {name: join_parts([grid.values[name] for grid in grids], np.nan) for name in names}
    is_on, firsts = join_parts([grid.on for grid in grids], False), tuple(np.cumsum([0, *sizes[:-1]]).tolist())
    times, offset = [], 0.0
    for k, grid in enumerate(grids):
        if (start := common_start(starts)) is not None:
            offset = float((starts[k] - start) / np.timedelta64(1, "s"))
        times.append(offset + np.append(grid.time, grid.time[-1] + interval * np.arange(1.0, silence + 1.0)))
        offset = SECONDS_PER_DAY * math.ceil(times[-1][-1] / SECONDS_PER_DAY)
    time = np.concatenate(times)[:-silence]
    return Grid(interval, time, values, is_on, max(grid.increment for grid in grids), firsts)


def _find_rhythm(log: CheckedLog, forward: Array, is_same_piece: Mask) -> tuple[float, bool]:
    """Find the interval of a log with steps ``forward``, s, and whether samples come at every interval.

    A log of changes never repeats a row: one that misses intervals and repeats none is such a log.
    """
    median = float(np.median(forward))
    multiples = forward / median
    nearest_multiples = np.maximum(np.rint(multiples), 1.0)
    is_whole = np.abs(multiples - nearest_multiples) <= _STEP_TOLERANCE
    is_single_step = is_whole & (nearest_multiples == 1.0)
    series = [values for name, values in log.values.items() if name == "T_sup" or name.endswith("command")]
    is_repeated = np.all([np.diff(values) == 0.0 for values in series], axis=0) & is_same_piece
    if is_whole.mean() < _REGULAR_SHARE or (is_single_step.mean() < _REGULAR_SHARE and not is_repeated.any()):
        return float(np.clip(round(median), 1.0, 10.0)), False  # s
    mean = float(forward[is_single_step].mean())
    return _whole_seconds(mean), True


def _whole_seconds(mean: float) -> float:
    """Round a mean of steps to what loggers know, whole seconds: 9.998 s is 10 s with a little jitter."""
    return float(round(mean)) if abs(mean - round(mean)) < 0.01 * mean else mean


def _number_intervals(log: CheckedLog, interval: float) -> Index:
    """Return the number of the interval of each sample, ascending also where the time of the log goes back."""
    ticks = np.empty(log.time.size, dtype=np.int64)
    last = -1
    for piece in range(log.n_batches):
        is_in_piece = log.batch == piece
        time = log.time[is_in_piece]
        start = max(int(np.rint(time[0] / interval)), last + 1)
        ticks[is_in_piece] = start + np.rint((time - time[0]) / interval).astype(np.int64)
        last = int(ticks[is_in_piece][-1])
    return ticks


def _fill_grid(log: CheckedLog, intervals: Index, interval: float, is_regular: bool, is_same_piece: Mask) -> Grid:
    """Fill the intervals 0, 1, … with the latest sample of every series; intervals: of each sample, (n,)."""
    n = int(intervals[-1]) + 1
    is_silent = np.zeros(n, dtype=bool)
    for k in np.flatnonzero(~is_same_piece):
        is_silent[intervals[k] + 1 : intervals[k + 1]] = True
    latest = _last_known(np.ones(intervals.size, dtype=bool), intervals, n)
    values: dict[str, Array] = {}
    for name, series in log.values.items():
        if name in HELD_COLUMNS or not is_regular:
            last_known = _last_known(np.isfinite(series), intervals, n)
            values[name] = np.where(is_silent | (last_known < 0), np.nan, series[last_known])
        else:
            values[name] = np.full(n, np.nan)
            values[name][intervals] = series  # of samples in one interval the last counts
    is_on = ~is_silent
    if "enabled" in values:
        is_on &= np.nan_to_num(values["enabled"]) > 0.0
    time = log.time[latest] + (np.arange(n) - intervals[latest]) * interval
    return Grid(interval, time, values, is_on, logging_increment(log.values["T_sup"]))


def _last_known(is_known: Mask, intervals: Index, n: int) -> Index:
    """Return the index of the last known sample up to each of n intervals, -1 before; intervals: of each sample."""
    last_sample = np.full(n, -1)
    last_sample[intervals[is_known]] = np.flatnonzero(is_known)
    return np.asarray(np.maximum.accumulate(last_sample))


def logging_increment(temperature: Array) -> float:
    """Return the least change at which a temperature is logged, K; 0 if it is logged at fixed times, or rounded.

    Rounded values are whole steps apart; those logged at changes are never close to the one before.
    """
    known = temperature[np.isfinite(temperature)]
    changes = np.abs(np.diff(known))
    nonzero_changes = changes[changes > 0.0]
    if nonzero_changes.size < LEAST_SAMPLES:
        return 0.0
    small_change = float(np.quantile(nonzero_changes, _SMALL_CHANGE_QUANTILE))
    steps = (known - known[0]) / small_change
    is_rounded = float(np.quantile(np.abs(steps - np.rint(steps)), 1.0 - _SMALL_CHANGE_QUANTILE)) < 0.05
    return small_change if float(np.median(nonzero_changes)) < 2.0 * small_change and not is_rounded else 0.0


def forward_fill(series: Array) -> Array:
    """Replace missing values by the last before them, those at the beginning by the first."""
    return np.array(pd.Series(series).ffill().bfill())


def running_mean(series: Array, good: Mask, width: int) -> Array:
    """Return the running mean of a series over ``width`` samples, of the good ones among them."""

    def window_sum(values: Array) -> Array:
        sums_before = np.concatenate([[0.0], np.cumsum(values)])
        index = np.arange(values.size)
        low, high = np.maximum(index - width // 2, 0), np.minimum(index + (width + 1) // 2, values.size)
        return np.asarray(sums_before[high] - sums_before[low])

    return np.asarray(window_sum(np.where(good, series, 0.0)) / np.maximum(window_sum(good.astype(float)), 1.0))


def is_range_good(good: Mask, first: Index, last: Index) -> Mask:
    """Whether all samples from each ``first`` to its ``last`` are good; both (ranges,)."""
    bad_before = np.concatenate([[0], np.cumsum(~good)])
    return np.asarray(bad_before[last + 1] == bad_before[first])


def motor_positions(command: Array, interval: float, stroke_time: float) -> Array:
    """Simulate the motor: its position when each command begins to act, and after the last, (n + 1,); times in s."""
    positions = np.empty(command.size + 1)
    travel = interval / stroke_time if stroke_time > 0.0 else 1.0
    recorded.motor_positions(np.ascontiguousarray(command, float), travel, positions)
    return positions


def openings(positions: Array, backlash: float) -> Array:
    """Return the opening behind a backlash, Eq (1), at each motor position; the stem starts mid-gap."""
    q = min(max(float(positions[0]) - backlash / 2.0, 0.0), 1.0 - backlash)
    stem_places = np.empty_like(positions)
    for k, position in enumerate(positions.tolist()):
        q = min(max(q, position - backlash), position)
        stem_places[k] = q
    return stem_places / (1.0 - backlash)


def mean_openings(positions: Array, backlash: Array, width: int) -> tuple[Array, Array]:
    """Return the means of opening and squared opening over blocks of ``width`` steps, (blocks, candidates)."""
    openings, squares = np.empty((2, (positions.size - 1) // width, backlash.size))
    recorded.mean_openings(positions, np.ascontiguousarray(backlash, float), width, openings, squares)
    return openings, squares
