"""Times of a log as an engineer says them: clock times to the quarter of an hour, or the days of many days."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from fastcoil.measured.grid import SECONDS_PER_DAY

Span = tuple[float, float]  # start and end, s since the start of the log
_MAX_LISTED = 4  # times in a sentence
_SHORTEST_S = 900.0  # of a time that is listed
_SHORT_PAUSE_S = 1800.0  # that is not worth saying


def seconds_of_day(start: np.datetime64 | None) -> float:
    """Return the time of day at which a log starts, s; 0 of a log without a clock."""
    return 0.0 if start is None else float((start - start.astype("datetime64[D]")) / np.timedelta64(1, "s"))


def describe_times(spans: Sequence[Span], start: np.datetime64 | None, n_days: int) -> str:
    """Describe spans of a log: ``10:30–17:00`` within a day, ``on 2 of 15 days (03-31; 04-01)`` of several."""
    offset = seconds_of_day(start)
    days = sorted({day for first, last in spans for day in _days_between(first + offset, last + offset)})
    if max(len(days), n_days) > 1:
        return f"on {len(days)} of {max(n_days, len(days))} days ({describe_days(days, start)})"
    joined: list[Span] = []
    for first, last in spans:
        is_near = bool(joined) and first - joined[-1][1] <= _SHORT_PAUSE_S
        joined[-1:] = [(joined[-1][0], last)] if is_near else [*joined[-1:], (first, last)]
    longer = [span for span in joined if span[1] - span[0] >= _SHORTEST_S] or joined
    listed = [f"{_clock(first, start)}–{_clock(last, start, is_end=True)}" for first, last in longer[:_MAX_LISTED]]
    more = f" and {len(joined) - len(listed)} more times" if len(joined) > len(listed) else ""
    return f"{', '.join(listed)}{more}"


def _days_between(first: float, last: float) -> range:
    # a span that ends in the first minutes of a day is of the day before
    return range(int(first // SECONDS_PER_DAY), int(max(first, last - 600.0) // SECONDS_PER_DAY) + 1)


def describe_days(days: Sequence[int], start: np.datetime64 | None) -> str:
    """Describe numbers of days as ``03-11, 23, 25; 04-01``, or as ``day 2`` of a log without a clock."""
    if start is None:
        return ", ".join(f"day {day + 1}" for day in days)
    dates = [str(start.astype("datetime64[D]") + np.timedelta64(int(day), "D"))[5:] for day in days]
    months = [list(group) for _, group in groupby(dates, key=lambda date: date[:2])]
    return "; ".join(", ".join([month[0], *(date[3:] for date in month[1:])]) for month in months)


def _clock(seconds: float, start: np.datetime64 | None, *, is_end: bool = False) -> str:
    quarters = round((seconds + seconds_of_day(start)) % SECONDS_PER_DAY / 900.0)
    quarters = 96 if is_end and quarters == 0 else quarters  # a day ends at 24:00
    if start is None:
        return f"{round(seconds / 900.0) / 4:g} h"
    return f"{quarters // 4}:{15 * (quarters % 4):02d}"
