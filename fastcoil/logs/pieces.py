"""The time of a log: jumps, gaps, the unbroken pieces between, and its samples on 1-s steps.

A log of changes has a row when a value has changed; its long steps are no gaps.
"""

from collections.abc import Collection, Mapping

import numpy as np

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError, shown
from fastcoil.logs.columns import Reading
from fastcoil.logs.series import counted
from fastcoil.logs.table import TURNED, Table
from fastcoil.logs.timestamps import Stamps, read_stamps

_LEAST_STEP = 0.999
MOST_SECONDS = 50_000_000  # of a record on 1-s steps, 19 months: a few GB with its series


def require_whole_seconds(name: str, step: float) -> None:
    """Refuse a log whose samples are less than a second apart; ``step``: its median step, s."""
    if step < _LEAST_STEP:
        raise InputError(f"{name}: the rows are {step:g} s apart: thin or average the log to 1 s or more")


def require_span(name: str, seconds: float, cure: str = "cut the log") -> None:
    """Refuse a record that would fill the memory on 1-s steps; ``seconds``: from its first to its last."""
    if seconds > MOST_SECONDS:
        most = f"at most {MOST_SECONDS:,} s can be read, check the unit of the time, or {cure}"
        raise InputError(f"{name} lasts {seconds:,.0f} s from the first row to the last: {most}")


def at_seconds(
    time: Array, values: Mapping[str, Array], seconds: Array, hold: Collection[str], slack: float = 0.0
) -> dict[str, Array]:
    """Each series at the ``seconds`` asked for, (n_seconds,), within the log.

    time, values: of the samples [s], ascending, and their values by name, each (n,).  hold: names of the series that
    hold until the next sample; the others run straight.  slack: by which a sample may be late for its second, with
    round-off [s].
    """
    latest = np.searchsorted(time, seconds + slack, side="right") - 1
    return {
        name: series[latest] if name in hold else np.interp(seconds, time, series) for name, series in values.items()
    }


LONG_STEP = 3.0  # steps longer than this many median steps are gaps, but in a log of changes
_REGULAR, _ABOUT = 0.6, 0.2  # steps are regular where more than this share of them is within so much of the median
_SHORT_AND_LONG, _SPREAD = (0.1, 0.9), 4.0
"""They are uneven where they are not regular and these quantiles are so far apart: further than lost rows make them."""
_LONG = 0.05  # share of steps that would be gaps, at least
_CHANGES, _REPEATS = 0.9, 0.2
"""In so many of the rows something changes, while one series stays as it was in so many of them."""
_FEWEST = 20  # steps
_USUAL, _LONGER = 0.95, 10.0  # A step so many times longer than this share of all steps is a gap even in such a log


def longest_step(time: Array, within: Mask, values: Mapping[str, Array]) -> float | None:
    """Longest step of a log of changes that is no gap, s; else None.  within: where a row follows one, (n - 1,)."""
    steps = np.diff(time)[within]
    if steps.size < _FEWEST or not may_be_of_changes(steps) or np.mean(steps > LONG_STEP * np.median(steps)) < _LONG:
        return None
    pairs = [(series[1:], series[:-1]) for name, series in values.items() if name != "batch"]
    changed = [~((now == before) | (np.isnan(now) & np.isnan(before)))[within] for now, before in pairs]
    repeats = any(change.sum() > 2 and np.mean(~change) >= _REPEATS for change in changed)
    if not repeats or np.mean(np.any(changed, axis=0)) < _CHANGES:
        return None
    return float(_LONGER * np.quantile(steps, _USUAL))


def may_be_of_changes(steps: Array) -> bool:
    """Whether steps are uneven; a single sample has none and may be of changes."""
    if not steps.size:
        return True
    median = float(np.median(steps))
    regular = np.mean(np.abs(steps - median) <= _ABOUT * median) > _REGULAR
    short, long = np.quantile(steps, _SHORT_AND_LONG)
    return bool(not regular and long >= _SPREAD * short)


_FEW, _MOST_BACK = 5, 1 / 3  # if more steps than both go back in time, no part of the log is in order


def read_times(table: Table, column: int, how: Reading) -> Stamps:
    """The timestamps of the rows; the rows of a table whose newest is first are turned round."""
    cure = how.cure("time_format='{format}'", "--time-format '{format}'")
    stamps = read_stamps([row[column] for row in table.rows], table.row_numbers, how.time_format, cure)
    table.notes += stamps.notes
    if not (stamps.good.all() or how.drop):
        k = int(np.argmin(stamps.good))
        cell, number = table.rows[k][column], table.row_numbers[k]
        raise InputError(f"timestamp = {shown(cell)} in row {number} {stamps.wrong}")
    steps = np.diff(stamps.microseconds[stamps.good])
    if (steps < 0).any() and (steps <= 0).all():
        table.take(range(len(table.rows))[::-1])
        table.notes.append(TURNED)
        stamps = stamps._replace(microseconds=stamps.microseconds[::-1], good=stamps.good[::-1])
    return stamps


def longest_bridged(time: Array, max_gap: float | None) -> float:
    """Longest step that is no gap of a log of regular steps, s."""
    steps = np.diff(time[np.isfinite(time)])
    forward = steps[steps > 0.0]
    return max_gap or LONG_STEP * (float(np.median(forward)) if forward.size else 0.0)


def number_pieces(
    table: Table, time: Array, values: Mapping[str, Array], how: Reading, notes: list[str], *, stamped: bool
) -> tuple[Index, bool]:
    """Number of the unbroken piece of each row, (n,): a new one at ``batch``, gap or jump; whether rows are changes."""
    steps, rows, batch = np.diff(time), table.row_numbers, values.get("batch")
    new = np.zeros(steps.size, dtype=bool) if batch is None else np.diff(batch) != 0.0
    back = (steps <= 0.0) & ~new
    shuffled = back.sum() > _FEW and back.mean() > _MOST_BACK
    if back.any() and (how.jumps != "split" or shuffled):
        table.problems.append(_backward(time, back, rows, how, stamped))
        return np.zeros(time.size, dtype=np.int64), False
    if back.any():
        notes.append(f"time goes back or does not advance {counted(back, 'time')}: the record starts again there")
    forward = steps[~new & ~back]
    median = float(np.median(forward)) if forward.size else np.inf
    of_changes = longest_step(time, ~new & ~back, values)
    if of_changes and not how.max_gap:
        table.notes.append(
            f"rows are {forward.min():g} to {forward.max():g} s apart, and each has a change: a log of changes, "
            f"values hold between rows; steps of up to {of_changes:g} s are no gaps "
            f"(another limit: {how.cure('max_gap', '--max-gap')})"
        )
    gaps = ~new & ~back & (steps > (how.max_gap or of_changes or LONG_STEP * median))
    if how.unbroken and (new | gaps).any():
        table.problems.append(_broken(steps, new, gaps, median, rows))
    elif gaps.any():
        k = int(np.argmax(gaps))
        notes.append(
            f"{counted(gaps, 'gap')} in time (first: {steps[k]:g} s between rows {rows[k]} and {rows[k + 1]}): "
            "the record starts again after each"
        )
    return np.concatenate([[0], np.cumsum(new | back | gaps)]), bool(of_changes)


def _backward(time: Array, back: Mask, rows: list[int], how: Reading, stamped: bool) -> str:
    k, times = int(np.argmax(back)), int(back.sum())
    cure = "give every row a time of its own, to the second, and sort the rows, oldest first"
    if stamped:
        cure += "; where clocks were set back log UTC or the UTC offset"
    if how.jumps is not None:
        cure += "; or let the record start again there: " + how.cure("jumps='split'", "--jumps split")
    what = "is at the same time as" if time[k + 1] == time[k] else "is earlier than"
    more = f" ({times} such rows)" if times > 1 else ""
    return f"{'timestamp' if stamped else 'elapsed_time'}: row {rows[k + 1]} {what} row {rows[k]}{more}: {cure}"


def _broken(steps: Array, new: Mask, gaps: Mask, median: float, rows: list[int]) -> str:
    k = int(np.argmax(new)) if new.any() else int(np.argmax(np.where(gaps, steps, 0.0)))
    ends, gap = f"rows {rows[k]} and {rows[k + 1]}", f"{steps[k]:g}"
    if new[k]:
        return f"{ends} are of two batches: give the rows of one"
    return f"{ends} are {gap} s apart, others {median:g} s: fill the gap, cut the log, or bridge it with max_gap={gap}"
