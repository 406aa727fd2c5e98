"""Progress of long work: a bar on a terminal, lines of text elsewhere; and for programs the logger ``fastcoil``."""

import logging
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import Any

LOGGER = logging.getLogger("fastcoil")  # of progress, for programs
SECONDS_BETWEEN_LINES = 10.0  # of text or of the log
SECONDS_BEFORE_DISPLAY = 2.0  # of work that is not shown
_TEST_VARIABLES = ("PYTEST_VERSION", "PYTEST_CURRENT_TEST")  # of the environment in a test

Advance = Callable[[int], None]  # receives the number of scenario-days finished since the last call


def format_duration(seconds: float) -> str:
    """Format a duration, given in seconds, in seconds, minutes or hours."""
    if seconds < 100:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


def is_stderr_terminal() -> bool:
    """Whether stderr is a terminal."""
    return sys.stderr is not None and sys.stderr.isatty()


class ProgressDisplay(AbstractContextManager["ProgressDisplay"]):
    """Display of the progress of work, unless it is silent; call ``start`` when the total is known.

    On a terminal a bar appears after ``delay`` seconds and ends with the context.  Elsewhere there are lines of text,
    some seconds apart, and with ``last_line`` one at the end.
    """

    def __init__(self, *, silent: bool = False, delay: float = SECONDS_BEFORE_DISPLAY, last_line: bool = False) -> None:
        self.silent, self._delay, self._has_last_line = silent, delay, last_line
        self._lock = threading.RLock()
        self._timer: threading.Timer | None = None
        self._first_started_at: float | None = None
        self._bar: Any = None
        self._is_visible = False
        self._n_done = self._total = 0

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, total: int, n_done: int = 0, items: str = "scenario-days") -> Advance:
        """Begin with ``n_done`` of ``total`` ``items`` done; return the function that advances the count."""
        self.stop()
        self._total, self._n_before, self._n_done, self._items = total, n_done, n_done, items
        self._started_at = self._last_line_at = time.monotonic()
        if self.silent:
            return self._advance
        # work in several parts is shown once all of them have taken that long
        self._first_started_at = self._first_started_at or self._started_at
        delay = max(0.0, self._delay - (self._started_at - self._first_started_at))
        # a timer, since the first shard may take minutes
        self._timer = threading.Timer(delay, self._show_if_working)
        self._timer.daemon = True
        if delay:
            self._timer.start()
        else:
            self._show_if_working()
        return self._advance

    def stop(self) -> None:
        """End the display: stop the bar, or write the last line of text."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            self._timer = None
            if self._is_visible and self._bar is not None:
                self._bar.stop()
            elif self._is_visible and self._has_last_line and self._n_done >= self._total:
                self._write_line()
            self._is_visible, self._bar = False, None

    def _show_if_working(self) -> None:
        with self._lock:
            if self._timer is None:
                return
            self._is_visible = True
            if is_stderr_terminal():
                self._show_bar()

    def _show_bar(self) -> None:
        from rich import progress
        from rich.console import Console

        text = progress.TextColumn
        columns = (
            progress.BarColumn(), progress.MofNCompleteColumn(), text("{task.description}"),
            text("{task.fields[rate]}"), progress.TimeElapsedColumn(), text("ETA"), progress.TimeRemainingColumn(),
        )  # fmt: skip
        self._bar = progress.Progress(*columns, console=Console(stderr=True))
        self._task = self._bar.add_task(self._items, total=self._total, completed=self._n_done, rate=self._rate_text)
        self._bar.tasks[0].start_time = self._started_at
        self._bar.start()

    def _advance(self, n_new: int) -> None:
        with self._lock:
            self._n_done += n_new
            if self._is_visible and self._bar is not None:
                self._bar.update(self._task, completed=self._n_done, rate=self._rate_text)
            seconds_now = time.monotonic()
            if seconds_now - self._last_line_at >= SECONDS_BETWEEN_LINES and self._n_done < self._total:
                self._last_line_at = seconds_now
                LOGGER.info(self._line_text)
                if self._is_visible and self._bar is None:
                    self._write_line()
            if self._n_done >= self._total:
                if seconds_now - self._started_at >= SECONDS_BEFORE_DISPLAY:
                    LOGGER.info(self._line_text)
                self.stop()

    @property
    def done_text(self) -> str:
        """How much is done, of how much; nothing where no part was counted yet."""
        return f"{self._n_done:,} of {self._total:,} {self._items}" if self._n_done else ""

    @property
    def _items_per_second(self) -> float:
        return (self._n_done - self._n_before) / max(time.monotonic() - self._started_at, 1e-9)

    @property
    def _rate_text(self) -> str:
        return f"{self._items_per_second:,.0f}/s" if self._items_per_second >= 0.5 else ""

    @property
    def _line_text(self) -> str:
        if self._n_done >= self._total:
            return f"{self._total:,} {self._items} in {format_duration(time.monotonic() - self._started_at)}"
        parts = [f"{self._n_done:,} of {self._total:,} {self._items}", self._rate_text]
        if self._n_done > self._n_before:
            parts.append(f"{format_duration((self._total - self._n_done) / self._items_per_second)} to go")
        return ", ".join(filter(None, parts))

    def _write_line(self) -> None:
        with suppress(OSError, ValueError):  # stderr is closed
            print(self._line_text, file=sys.stderr, flush=True)


def display_for_call(progress: bool | None) -> ProgressDisplay:
    """Return the display for a Python call; with None only on a terminal, after 2 s."""
    silent = progress is False or (progress is None and not (is_stderr_terminal() and _is_interactive()))
    return ProgressDisplay(silent=silent, delay=0.0 if progress else SECONDS_BEFORE_DISPLAY, last_line=True)


def _is_interactive() -> bool:
    """Whether a person may be watching: no test, and the main thread of the main process."""
    return (
        not any(name in os.environ for name in _TEST_VARIABLES)
        and multiprocessing.current_process().name == "MainProcess"
        and threading.current_thread() is threading.main_thread()
    )
