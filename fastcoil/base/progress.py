"""Progress of long work: a bar on a terminal, lines of text elsewhere; and for programs the logger ``fastcoil``.

Not shown for work of less than 2 s, in workers, or in unattended runs.  Logged, as INFO, whether it is shown or not.
"""

import logging
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import Any

LOG = logging.getLogger("fastcoil")
SECONDS_BETWEEN_LINES = 10.0
PATIENCE = 2.0
"""Seconds before progress is shown."""
_IN_TESTS = ("PYTEST_VERSION", "PYTEST_CURRENT_TEST")

Advance = Callable[[int], None]
"""Receives the number of scenario-days finished since the last call."""


def duration(seconds: float) -> str:
    """Format a duration in seconds."""
    if seconds < 100:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


def is_terminal() -> bool:
    """Whether stderr is a terminal."""
    return sys.stderr is not None and sys.stderr.isatty()


class Shown(AbstractContextManager["Shown"]):
    """Shows progress, unless it is silent; call ``start`` when the total is known.

    On a terminal a bar appears after some seconds of patience and ends with the context.  Elsewhere there are lines of
    text, some seconds apart; with ``closing`` also a last one.
    """

    def __init__(self, *, silent: bool = False, patience: float = PATIENCE, closing: bool = False) -> None:
        self.silent, self._patience, self._closing = silent, patience, closing
        self._lock = threading.RLock()
        self._timer: threading.Timer | None = None
        self._first: float | None = None
        self._bar: Any = None
        self._is_open = False

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, of: int, before: int = 0, what: str = "scenario-days") -> Advance:
        """Begin with ``before`` of ``of`` of ``what`` done; returns the function that advances the count."""
        self.stop()
        self._of, self._before, self._done, self._what = of, before, before, what
        self._began = self._last = time.monotonic()
        if self.silent:
            return self._advance
        # work in several parts is shown once all of them have taken that long
        self._first = self._began if self._first is None else self._first
        left = max(0.0, self._patience - (self._began - self._first))
        # a timer, since the first shard may take minutes
        self._timer = threading.Timer(left, self._open)
        self._timer.daemon = True
        if left:
            self._timer.start()
        else:
            self._open()
        return self._advance

    def stop(self) -> None:
        """End the bar with a complete line."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            self._timer = None
            if self._is_open and self._bar is not None:
                self._bar.stop()
            elif self._is_open and self._closing and self._done >= self._of:
                self._write_line()
            self._is_open, self._bar = False, None

    def _open(self) -> None:
        with self._lock:
            if self._timer is None:
                return
            self._is_open = True
            if is_terminal():
                self._open_bar()

    def _open_bar(self) -> None:
        from rich import progress
        from rich.console import Console

        columns = (
            progress.BarColumn(),
            progress.MofNCompleteColumn(),
            progress.TextColumn("{task.description}"),
            progress.TextColumn("{task.fields[rate]}"),
            progress.TimeElapsedColumn(),
            progress.TextColumn("ETA"),
            progress.TimeRemainingColumn(),
        )
        self._bar = progress.Progress(*columns, console=Console(stderr=True))
        self._task = self._bar.add_task(self._what, total=self._of, completed=self._done, rate=self._rate)
        self._bar.tasks[0].start_time = self._began
        self._bar.start()

    def _advance(self, finished: int) -> None:
        with self._lock:
            self._done += finished
            if self._is_open and self._bar is not None:
                self._bar.update(self._task, completed=self._done, rate=self._rate)
            now = time.monotonic()
            if now - self._last >= SECONDS_BETWEEN_LINES and self._done < self._of:
                self._last = now
                LOG.info(self._line)
                if self._is_open and self._bar is None:
                    self._write_line()
            if self._done >= self._of:
                if now - self._began >= PATIENCE:
                    LOG.info(self._line)
                self.stop()

    @property
    def _per_second(self) -> float:
        return (self._done - self._before) / max(time.monotonic() - self._began, 1e-9)

    @property
    def _rate(self) -> str:
        return f"{self._per_second:,.0f}/s" if self._per_second >= 0.5 else ""

    @property
    def _line(self) -> str:
        if self._done >= self._of:
            words = [f"{self._of:,} {self._what} in {duration(time.monotonic() - self._began)}"]
        else:
            words = [f"{self._done:,} of {self._of:,} {self._what}", *([self._rate] if self._rate else [])]
            if self._done > self._before:
                words.append(f"{duration((self._of - self._done) / self._per_second)} to go")
        return ", ".join(words)

    def _write_line(self) -> None:
        with suppress(OSError, ValueError):  # stderr is closed
            print(self._line, file=sys.stderr, flush=True)


def progress_of_call(progress: bool | None) -> Shown:
    """Progress of a Python call; with None only on a terminal, after 2 s."""
    silent = progress is False or (progress is None and not (is_terminal() and _is_interactive()))
    return Shown(silent=silent, patience=0.0 if progress else PATIENCE, closing=True)


def _is_interactive() -> bool:
    """Whether this is neither a test nor a worker."""
    return (
        not any(name in os.environ for name in _IN_TESTS)
        and multiprocessing.current_process().name == "MainProcess"
        and threading.current_thread() is threading.main_thread()
    )
