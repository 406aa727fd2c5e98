"""The time of a log: jumps, gaps, the unbroken pieces between, and its samples on 1-s steps."""

from collections.abc import Collection, Mapping

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.logs.columns import ReadingOptions
from fastcoil.logs.series import format_count
from fastcoil.logs.table import REVERSED_ROWS_NOTE, Table
from fastcoil.logs.timestamps import SECOND_US, Timestamps, apply_time_zone, read_timestamps

MAX_RECORD_SECONDS = 50_000_000  # length of a record on 1-s steps, 19 months: a few GB with its series
GAP_MEDIAN_STEPS = 3.0  # steps longer than this many median steps are gaps, but in a log of changes


def require_whole_seconds(name: str, step: float) -> None:
    """Refuse a log whose median ``step`` is less than a second; ``name``: of the log, for the message."""
    if step < 0.999:  # round-off of times in hours
        cure = "thin or average the log to 1 s or more"
        raise InputError(f"{name}: the rows are {step:g} s apart: {cure}", name, "time")


def require_span_in_limits(name: str, seconds: float, cure: str = "cut the log") -> None:
    """Refuse a record whose length, ``seconds``, would fill the memory on 1-s steps."""
    if seconds > MAX_RECORD_SECONDS:
        cure = f"at most {MAX_RECORD_SECONDS:,} s can be read, check the unit of the time, or {cure}"
        raise InputError(f"{name} lasts {seconds:,.0f} s from the first row to the last: {cure}", name, "size")


def resample_at_seconds(
    time: Array, values: Mapping[str, Array], seconds: Array, hold: Collection[str], slack: float = 0.0
) -> dict[str, Array]:
    """Resample each series of a log at these ``seconds`` within it, (n_seconds,).

    time: of the samples [s], ascending, (n,).  hold: names of the series that hold until the next sample; others run
    straight.  slack: by which a sample may be late for its second, with round-off [s].
    """
    latest = np.searchsorted(time, seconds + slack, side="right") - 1
    return {name: x[latest] if name in hold else np.interp(seconds, time, x) for name, x in values.items()}


def longest_step_between_changes(time: Array, is_same_batch: Mask, values: Mapping[str, Array]) -> float | None:
    """Return the longest step of a log of changes that is no gap, s; None for any other log.

    In such a log steps are uneven, some value changes in nearly every row, and one series stays as it was in many.  An
    outage is a gap in it as well.  is_same_batch: where a row follows one of its batch, (n - 1,).
    """
    steps = np.diff(time)[is_same_batch]
    if steps.size < 20 or not has_uneven_steps(steps) or np.mean(steps > GAP_MEDIAN_STEPS * np.median(steps)) < 0.05:
        return None
    row_pairs = [(series[1:], series[:-1]) for name, series in values.items() if name != "batch"]
    is_changed = [~((new == old) | (np.isnan(new) & np.isnan(old)))[is_same_batch] for new, old in row_pairs]
    has_repeats = any(has_changed.sum() > 2 and np.mean(~has_changed) >= 0.2 for has_changed in is_changed)
    if not has_repeats or np.mean(np.any(is_changed, axis=0)) < 0.9:
        return None
    return float(10.0 * np.quantile(steps, 0.95))


def has_uneven_steps(steps: Array) -> bool:
    """Whether steps differ by more than lost rows of a regular log explain; without any step they do."""
    if not steps.size:
        return True
    median = float(np.median(steps))
    is_regular = np.mean(np.abs(steps - median) <= 0.2 * median) > 0.6
    short, long = np.quantile(steps, (0.1, 0.9))
    return bool(not is_regular and long >= 4.0 * short)


def read_times(table: Table, column: int, options: ReadingOptions) -> Timestamps:
    """Read the timestamps of the rows; reverse the rows of a table whose newest is first."""
    cure = options.cure("time_format='{format}'", "--time-format '{format}'")
    cells, month_first = [row[column] for row in table.rows], options.month_first
    stamps = read_timestamps(cells, table.row_numbers, options.time_format, cure, month_first=month_first)
    table.notes += stamps.notes
    if not (stamps.good.all() or options.drop):
        k = int(np.argmin(stamps.good))
        cell, number = table.rows[k][column], table.row_numbers[k]
        raise InputError(f"timestamp = {short_repr(cell)} in row {number} {stamps.problem}", "timestamp", "time")
    steps = np.diff(stamps.microseconds[stamps.good]) / SECOND_US
    n_back, is_forward = np.sum(steps < 0.0), steps > 0.0
    # where clocks were set back, one step goes forward in such a log as well
    if n_back and 4 * is_forward.sum() <= n_back and (steps[is_forward] <= 3600.0).all():
        table.keep_rows(range(len(table.rows))[::-1])
        table.notes.append(REVERSED_ROWS_NOTE)
        stamps = stamps._replace(microseconds=stamps.microseconds[::-1], good=stamps.good[::-1])
    if options.time_zone and not stamps.absolute:
        return apply_time_zone(stamps, options.time_zone, table.row_numbers)
    return stamps


def longest_regular_step(time: Array, max_gap: float | None) -> float:
    """Return the longest step, s, that is no gap in a log of regular steps: ``max_gap``, or three usual ones."""
    steps = np.diff(time[np.isfinite(time)])
    forward_steps = steps[steps > 0.0]
    return max_gap or GAP_MEDIAN_STEPS * (float(np.median(forward_steps)) if forward_steps.size else 0.0)


def number_pieces(
    table: Table, time: Array, values: Mapping[str, Array], options: ReadingOptions, notes: list[str], time_name: str,
    is_set_back: bool = False,
) -> tuple[Index, bool]:  # fmt: skip
    """Number the unbroken pieces of a log, (n,) by row; also return whether its rows were written at changes."""
    steps, rows, batch = np.diff(time), table.row_numbers, values.get("batch")
    is_new_batch = np.zeros(steps.size, dtype=bool) if batch is None else np.diff(batch) != 0.0
    is_backward = (steps <= 0.0) & ~is_new_batch
    is_shuffled = is_backward.sum() > 5 and is_backward.mean() > 1 / 3  # no part of the log is in order
    if is_backward.any() and (options.jumps != "split" or is_shuffled):
        table.problems.append(_describe_backward_time(time, is_backward, rows, options, time_name, is_set_back))
        return np.zeros(time.size, dtype=np.int64), False
    if is_backward.any():
        count_text = format_count(is_backward, "time")
        notes.append(f"time goes back or does not advance {count_text}: the record starts again there")
    forward = steps[~is_new_batch & ~is_backward]
    median = float(np.median(forward)) if forward.size else np.inf
    longest_change_step = longest_step_between_changes(time, ~is_new_batch & ~is_backward, values)
    if longest_change_step and not options.max_gap:
        spacing = f"rows are {forward.min():g} to {forward.max():g} s apart, and each has a change: a log of changes"
        limit_text = f"steps of up to {longest_change_step:g} s are no gaps"
        cure = options.cure("max_gap=...", "--max-gap")
        table.notes.append(f"{spacing}, values hold between rows; {limit_text} (another limit: {cure})")
    longest_bridged = options.max_gap or longest_change_step or GAP_MEDIAN_STEPS * median
    is_gap = ~is_new_batch & ~is_backward & (steps > longest_bridged)
    if options.refuse_gaps and (is_new_batch | is_gap).any():
        table.problems.append(_describe_gap(steps, is_new_batch, is_gap, median, rows, time_name))
    elif is_gap.any():
        k = int(np.argmax(is_gap))
        first_text = f"first: {steps[k]:g} s between rows {rows[k]} and {rows[k + 1]}"
        notes.append(f"{format_count(is_gap, 'gap')} in time ({first_text}): the record starts again after each")
    return np.concatenate([[0], np.cumsum(is_new_batch | is_backward | is_gap)]), bool(longest_change_step)


def _describe_backward_time(
    time: Array, is_backward: Mask, rows: list[int], options: ReadingOptions, time_name: str, is_set_back: bool
) -> Problem:
    """Return the problem that time goes back or stands still in a row, with the cure."""
    k, n_backward = int(np.argmax(is_backward)), int(is_backward.sum())
    cure = "give every row a time of its own, to the second, and sort the rows, oldest first"
    if is_set_back:
        cure = options.set_back_cure()
    elif time_name == "timestamp":
        cure += "; where clocks were set back log UTC or the UTC offset"
    if options.jumps is not None and not options.refuse_gaps:
        cure += "; or let the record start again there: " + options.cure("jumps='split'", "--jumps split")
    relation = "is at the same time as" if time[k + 1] == time[k] else "is earlier than"
    count_text = f" ({n_backward} such rows)" if n_backward > 1 else ""
    return Problem(f"{time_name}: row {rows[k + 1]} {relation} row {rows[k]}{count_text}: {cure}", time_name, "time")


def _describe_gap(steps: Array, is_new_batch: Mask, is_gap: Mask, median: float, rows: list[int], time: str) -> Problem:
    k = int(np.argmax(is_new_batch)) if is_new_batch.any() else int(np.argmax(np.where(is_gap, steps, 0.0)))
    rows_text, gap = f"rows {rows[k]} and {rows[k + 1]}", f"{steps[k]:g}"
    if is_new_batch[k]:
        return Problem(f"{rows_text} are of two batches: give the rows of one", "batch", "time")
    cure = f"fill the gap, cut the log, or bridge it with max_gap={gap}"
    return Problem(f"{rows_text} are {gap} s apart, others {median:g} s: {cure}", time, "time")
