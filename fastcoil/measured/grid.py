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
from fastcoil.logs import CheckedLog
from fastcoil.logs.series import format_count
from fastcoil.model.engine import recorded

HELD_COLUMNS = ("command", "T_set", "enabled", "test")  # keep their values until the next sample in every log
LEAST_SAMPLES = 20
_REGULAR_SHARE, _STEP_TOLERANCE = 0.8, 0.25
"""A log is regular if this share of its steps are whole multiples of the median, to this share of it."""
_SMALL_CHANGE_QUANTILE, _ROUNDED_TOLERANCE, _LARGEST_MEDIAN_RATIO = 0.1, 0.05, 2.0
"""Of the changes of a temperature logged at changes, half are below twice the smallest tenth."""
_SHORTEST_INTERVAL_S, _LONGEST_FILLED_INTERVAL_S = 1.0, 10.0  # interval between the samples made of an irregular log, s
SECONDS_PER_DAY = 86400.0  # s
_LONGEST_INTERVAL_S = 3600.0  # s between samples; a log that is slower shows nothing of a loop
_LONGEST_SILENCE_S = 600.0  # of longer ones only so many seconds stay: nothing is looked for across them
_FINE_INTERVAL_S, _USUAL_STEPS_S = 30.0, (10, 15, 20, 30, 60, 120, 180, 300, 600, 900, 1800)
"""Filled-in values matter where logged ones are farther apart than so many s; steps of a clock that are looked for."""
_MOST_MISSED, _LEAST_MISSED_ELSEWHERE, _ROUND_OFF = 0.02, 0.1, 1e-6
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

    def day_slices(self) -> list[slice]:
        """The samples of each day, of 24 h at most from the start of a log; shorter rests belong to the day before."""
        ends = (*self.starts[1:], self.on.size)
        samples_per_day, days = round(SECONDS_PER_DAY / self.interval), []
        for first, end in zip(self.starts, ends, strict=True):
            cuts = [*range(first, max(end - samples_per_day // 2, first + 1), samples_per_day), end]
            days += [slice(*pair) for pair in pairwise(cuts)]
        return days


def resample_log(log: CheckedLog) -> tuple[Grid, list[str]]:
    """The series of a log at equal intervals, and notes on what was done to it.

    Samples at times that are nearly regular are moved to the nearest regular time.  In a log that is not regular, such
    as one of changes of value, every series holds until its next sample: the value that the building system knew.
    Steps beyond the longest that may be bridged are silences (``Log.batch`` counts the pieces between).
    """
    steps, is_same_piece = np.diff(log.time), np.diff(log.batch) == 0
    forward = steps[is_same_piece & (steps > 0.0)]
    left_out = "; ".join(log.notes) or "nothing was left out"
    if forward.size + 1 < LEAST_SAMPLES:
        raise InputError(
            f"{log.name}: {format_count(forward.size + 1, 'sample')} in unbroken pieces, {LEAST_SAMPLES} are needed: "
            f"give a longer log, or bridge its gaps: max_gap, --max-gap ({left_out})"
        )
    interval, is_regular = _find_rhythm(log, forward, is_same_piece)
    if interval > _LONGEST_INTERVAL_S:
        raise InputError(f"{log.name}: a sample every {interval:,.0f} s is left: log every minute ({left_out})")
    ticks = _number_intervals(log, interval)
    longest_silence = int(np.ceil(_LONGEST_SILENCE_S / interval))
    cut = np.concatenate([[0], np.cumsum(np.where(is_same_piece, 0, np.maximum(np.diff(ticks) - longest_silence, 0)))])
    at = ticks - cut
    if at[-1] >= MOST_SAMPLES:
        days = MOST_SAMPLES * interval / SECONDS_PER_DAY
        raise InputError(f"{log.name}: {at[-1] + 1:,} samples of {interval:.4g} s: give {days:.0f} days or less")
    grid = _fill_grid(log, at, interval, is_regular, is_same_piece)
    if is_regular:
        return _drop_filled_samples(grid)
    explanation = "the samples come at irregular times: every series holds until its next one"
    return grid, [f"{explanation}, taken every {interval:.4g} s"]


def _drop_filled_samples(grid: Grid) -> tuple[Grid, list[str]]:
    """Only the samples that were logged, where those between them were filled in; and a note of it."""
    logged_every_by_name = {
        name: find_logged_samples(grid.values[name], grid.interval) for name in ("command", "T_sup")
    }
    width = max(step for step, _ in logged_every_by_name.values())
    if width == 1 or width * grid.interval <= _FINE_INTERVAL_S:
        return grid, []
    name = "T_sup" if logged_every_by_name["T_sup"][0] > 1 else "command"
    thinned = grid.part(slice(logged_every_by_name[name][1], None, width))
    rhythm = f"only every {thinned.interval:.4g} s"
    return thinned, [f"{name} has a value of its own {rhythm}, those between are filled in: only its own count"]


def join_grids(grids: Sequence[Grid]) -> Grid:
    """The logs of several days one after the other, with a silence between them."""
    if len({round(grid.interval, 3) for grid in grids}) > 1:
        intervals = ", ".join(f"{interval:.4g} s" for interval in sorted({grid.interval for grid in grids}))
        raise InputError(f"the logs have a sample every {intervals}: give logs of one interval")
    interval = grids[0].interval
    silence = int(np.ceil(_LONGEST_SILENCE_S / interval))
    sizes = [grid.on.size + silence for grid in grids]

    def join_parts(parts: Iterable[NDArray[Any]], filler: Any) -> NDArray[Any]:
        return np.concatenate([np.pad(part, (0, silence), constant_values=filler) for part in parts])[:-silence]

    names = [name for name in grids[0].values if all(name in grid.values for grid in grids)]
    return Grid(
        interval,
        interval * np.arange(float(sum(sizes) - silence)),
        {name: join_parts([grid.values[name] for grid in grids], np.nan) for name in names},
        join_parts([grid.on for grid in grids], False),
        max(grid.increment for grid in grids),
        tuple(np.cumsum([0, *sizes[:-1]]).tolist()),
    )


def find_logged_samples(series: Array, interval: float) -> tuple[int, int]:
    """At which samples a series has values of its own: every how many, and the first of them; (1, 0) for all.

    Those between are filled in if own samples, held or joined by straight lines, give all of them back to within the
    resolution, and samples at other places do not: a slow temperature of a coarse sensor is given back by any.
    """
    known = np.where(np.isfinite(series), series, 0.0)
    level_differences = np.diff(np.unique(known))
    resolution = float(level_differences.min()) if level_differences.size else 0.0
    samples = np.arange(known.size)

    def missed_share(at: Index, straight: bool) -> float:
        last = np.searchsorted(at, samples, side="right") - 1
        rebuilt = np.interp(samples, at, known[at]) if straight else known[at[np.maximum(last, 0)]]
        is_covered = (last >= 0) & (samples <= at[-1])
        return float(np.mean(np.abs(rebuilt - known)[is_covered] > (1.0 + _ROUND_OFF) * resolution + _ROUND_OFF))

    for seconds in reversed(_USUAL_STEPS_S):
        width = round(seconds / interval)
        if width < 2 or abs(width * interval - seconds) > _STEP_TOLERANCE or known.size < LEAST_SAMPLES * width:
            continue
        for straight in (True, False):
            missed_shares = np.array([missed_share(samples[first::width], straight) for first in range(width)])
            if missed_shares.min() <= _MOST_MISSED and np.median(missed_shares) >= _LEAST_MISSED_ELSEWHERE:
                return width, int(missed_shares.argmin())
    return 1, 0


def _find_rhythm(log: CheckedLog, forward: Array, is_same_piece: Mask) -> tuple[float, bool]:
    """The interval of a log whose steps are ``forward``, s, and whether samples come at every interval.

    A log of changes never repeats a row: one that misses some intervals, and repeats none, is such a log as well.
    """
    median = float(np.median(forward))
    multiples = forward / median
    nearest_multiples = np.maximum(np.rint(multiples), 1.0)
    is_whole = np.abs(multiples - nearest_multiples) <= _STEP_TOLERANCE
    is_single_step = is_whole & (nearest_multiples == 1.0)
    is_repeated = np.all([np.diff(log.values[name]) == 0.0 for name in ("command", "T_sup")], axis=0) & is_same_piece
    if is_whole.mean() < _REGULAR_SHARE or (is_single_step.mean() < _REGULAR_SHARE and not is_repeated.any()):
        return float(np.clip(round(median), _SHORTEST_INTERVAL_S, _LONGEST_FILLED_INTERVAL_S)), False
    mean = float(forward[is_single_step].mean())
    # seconds are what loggers know: a mean of 9.998 s is 10 s with a little jitter
    return float(round(mean)) if abs(mean - round(mean)) < 0.01 * mean else mean, True


def _number_intervals(log: CheckedLog, interval: float) -> Index:
    """Number of the interval in which each sample lies, ascending; pieces where time goes back follow each other."""
    ticks = np.empty(log.time.size, dtype=np.int64)
    last = -1
    for piece in range(log.n_batches):
        is_in_piece = log.batch == piece
        time = log.time[is_in_piece]
        start = max(int(np.rint(time[0] / interval)), last + 1)
        ticks[is_in_piece] = start + np.rint((time - time[0]) / interval).astype(np.int64)
        last = int(ticks[is_in_piece][-1])
    return ticks


def _fill_grid(log: CheckedLog, at: Index, interval: float, is_regular: bool, is_same_piece: Mask) -> Grid:
    """Every series at 0, 1, … intervals: the latest sample in each, held where the log is of changes."""
    n = int(at[-1]) + 1
    is_silent = np.zeros(n, dtype=bool)
    for k in np.flatnonzero(~is_same_piece):
        is_silent[at[k] + 1 : at[k + 1]] = True
    latest = _last_known(np.ones(at.size, dtype=bool), at, n)
    values: dict[str, Array] = {}
    for name, series in log.values.items():
        if name in HELD_COLUMNS or not is_regular:
            last = _last_known(np.isfinite(series), at, n)
            values[name] = np.where(is_silent | (last < 0), np.nan, series[last])
        else:
            values[name] = np.full(n, np.nan)
            values[name][at] = series  # of samples in one interval the last counts
    is_on = ~is_silent
    if "enabled" in values:
        is_on &= np.nan_to_num(values["enabled"]) > 0.0
    time = log.time[latest] + (np.arange(n) - at[latest]) * interval
    return Grid(interval, time, values, is_on, logging_increment(log.values["T_sup"]))


def _last_known(is_known: Mask, at: Index, n: int) -> Index:
    """The last sample that is known up to each of n intervals; -1 before the first.  at: interval of each sample."""
    last_sample = np.full(n, -1)
    last_sample[at[is_known]] = np.flatnonzero(is_known)
    return np.asarray(np.maximum.accumulate(last_sample))


def logging_increment(temperature: Array) -> float:
    """By how much a temperature had to change to be logged, K; 0 if it was logged anyway, or rounded.

    Rounded values are whole steps apart; those logged at changes are anywhere, but never near the one before.
    """
    known = temperature[np.isfinite(temperature)]
    changes = np.abs(np.diff(known))
    changed = changes[changes > 0.0]
    if changed.size < LEAST_SAMPLES:
        return 0.0
    small_change = float(np.quantile(changed, _SMALL_CHANGE_QUANTILE))
    steps = (known - known[0]) / small_change
    is_rounded = float(np.quantile(np.abs(steps - np.rint(steps)), 1.0 - _SMALL_CHANGE_QUANTILE)) < _ROUNDED_TOLERANCE
    is_alike = float(np.median(changed)) < _LARGEST_MEDIAN_RATIO * small_change
    return small_change if is_alike and not is_rounded else 0.0


def forward_fill(series: Array) -> Array:
    """Missing values replaced by the last before them, those at the beginning by the first there is."""
    return np.array(pd.Series(series).ffill().bfill())


def is_range_good(good: Mask, first: Index, last: Index) -> Mask:
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
    stem_places = np.empty_like(positions)
    for k, position in enumerate(positions.tolist()):
        q = min(max(q, position - backlash), position)
        stem_places[k] = q
    return stem_places / (1.0 - backlash)


def mean_openings(positions: Array, backlash: Array, width: int) -> tuple[Array, Array]:
    """Mean opening behind each backlash and of its square, (pieces, candidates), in whole pieces of ``width`` steps."""
    openings, squares = np.empty((2, (positions.size - 1) // width, backlash.size))
    recorded.mean_openings(positions, np.ascontiguousarray(backlash, float), width, openings, squares)
    return openings, squares
