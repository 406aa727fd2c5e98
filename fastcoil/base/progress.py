"""Progress of long work: a bar on a terminal, lines of text elsewhere.

Not shown for work of less than 2 s, in workers, or in unattended runs.
"""

import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass

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


@dataclass
class State:
    """``what`` is done, of which ``before`` in an earlier run, and seconds since this run began."""

    of: int
    before: int = 0
    done: int = 0
    seconds: float = 0.0
    what: str = "scenario-days"

    @property
    def rate(self) -> float:
        """Done per second in this run."""
        return (self.done - self.before) / max(self.seconds, 1e-9)

    @property
    def rate_words(self) -> str:
        return f"{self.rate:,.0f}/s" if self.rate >= 0.5 else ""

    def words(self) -> str:
        """The state as one line of text."""
        if self.done >= self.of:
            return f"{self.of:,} {self.what} in {duration(self.seconds)}"
        to_go = f"{duration((self.of - self.done) / self.rate)} to go" if self.done > self.before else ""
        return ", ".join(filter(None, [f"{self.done:,} of {self.of:,} {self.what}", self.rate_words, to_go]))


class Bar:
    """Progress bar on a terminal."""

    def open(self, state: State) -> None:
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
        self.bar = progress.Progress(*columns, console=Console(stderr=True))
        self.task = self.bar.add_task(state.what, total=state.of, rate="")
        self.bar.tasks[0].start_time = time.monotonic() - state.seconds
        self.bar.start()
        self.draw(state)

    def draw(self, state: State) -> None:
        self.bar.update(self.task, completed=state.done, rate=state.rate_words)

    def close(self, state: State) -> None:
        self.bar.stop()


class Lines:
    """Lines of text on stderr, some seconds apart; with ``closing`` also a last one."""

    def __init__(self, *, closing: bool) -> None:
        self.closing, self.last = closing, time.monotonic()

    def open(self, state: State) -> None:
        pass

    def draw(self, state: State) -> None:
        now = time.monotonic()
        if now - self.last >= SECONDS_BETWEEN_LINES and state.done < state.of:
            self.last = now
            self._write(state)

    def close(self, state: State) -> None:
        if self.closing and state.done >= state.of:
            self._write(state)

    def _write(self, state: State) -> None:
        with suppress(OSError, ValueError):  # stderr is closed
            print(state.words(), file=sys.stderr, flush=True)


class Shown(AbstractContextManager["Shown"]):
    """Shows progress in a view; call ``start`` when the total is known.  As a context it closes the view at its end."""

    def __init__(self, view: Bar | Lines | None, patience: float) -> None:
        self._view, self._patience = view, patience
        self._lock = threading.RLock()
        self._timer: threading.Timer | None = None
        self._state = State(0)
        self._first: float | None = None
        self._is_open = False

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, of: int, before: int = 0, what: str = "scenario-days") -> Advance:
        """Begin with ``before`` of ``of`` of ``what`` done; returns the function that advances the count."""
        self.stop()
        self._state, self._began = State(of, before, before, what=what), time.monotonic()
        if self._view is None:
            return lambda finished: None
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
        """Close the view with a complete line."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            timer, self._timer = self._timer, None
            if self._view is not None and timer is not None and self._is_open:
                self._view.close(self._now())
                self._is_open = False

    def _open(self) -> None:
        with self._lock:
            if self._view is not None and self._timer is not None:
                self._view.open(self._now())
                self._is_open = True

    def _advance(self, finished: int) -> None:
        with self._lock:
            self._state.done += finished
            if self._view is not None and self._is_open:
                self._view.draw(self._now())
            if self._state.done >= self._state.of:
                self.stop()

    def _now(self) -> State:
        self._state.seconds = time.monotonic() - self._began
        return self._state


def progress_of_call(progress: bool | None) -> Shown:
    """Progress of a Python call; with None only on a terminal, after 2 s."""
    is_silent = progress is False or (progress is None and not (is_terminal() and _is_interactive()))
    return Shown(None if is_silent else _view(closing=True), 0.0 if progress else PATIENCE)


def progress_of_command() -> Shown:
    """Progress of a command on stderr."""
    return Shown(_view(closing=False), PATIENCE)


def _view(*, closing: bool) -> Bar | Lines:
    return Bar() if is_terminal() else Lines(closing=closing)


def _is_interactive() -> bool:
    """Whether this is neither a test nor a worker."""
    return (
        not any(name in os.environ for name in _IN_TESTS)
        and multiprocessing.current_process().name == "MainProcess"
        and threading.current_thread() is threading.main_thread()
    )
