"""Progress of long work: a bar on a terminal, a line in a notebook, lines of text elsewhere.

Not shown for work of less than 2 s, in workers, or in unattended runs.
"""

import builtins
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

SECONDS_BETWEEN_LINES = 10.0
_BETWEEN_UPDATES = 0.5  # seconds between updates in a notebook; each one is sent to the browser


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


class Text:
    """Lines of text for ``put``, ``every`` so many seconds; with ``closing`` also the first and the last one."""

    def __init__(self, put: Callable[[str], object], every: float, *, opening: bool, closing: bool) -> None:
        self.put, self.every, self.opening, self.closing = put, every, opening, closing
        self.last = time.monotonic()

    def open(self, state: State) -> None:
        if self.opening:
            self.last = time.monotonic()
            self.put(state.words())

    def draw(self, state: State) -> None:
        now = time.monotonic()
        if now - self.last >= self.every and state.done < state.of:
            self.last = now
            self.put(state.words())

    def close(self, state: State) -> None:
        if self.closing and state.done >= state.of:
            self.put(state.words())
        elif self.opening:
            self.put(f"stopped at {state.done:,} of {state.of:,} {state.what}")


def _write(line: str) -> None:
    with suppress(OSError, ValueError):  # stderr is closed
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()


def _cell() -> Callable[[str], object]:
    """Returns a function that shows a line in a notebook cell in place of the one before.

    No widgets: they may not be installed, and saved notebooks lose them.
    """
    from IPython.display import display  # type: ignore[import-not-found,unused-ignore]

    shown: list[Any] = []

    def put(words: str) -> None:
        data = {"text/plain": words, "text/html": words}
        if shown:
            shown[0].update(data, raw=True)
        else:
            shown.append(display(data, raw=True, display_id=True))  # type: ignore[no-untyped-call,unused-ignore]

    return put


PATIENCE = 2.0
"""Seconds before progress is shown."""
_IN_TESTS = ("PYTEST_VERSION", "PYTEST_CURRENT_TEST")

Advance = Callable[[int], None]
"""Receives the number of scenario-days finished since the last call."""


class Shown:
    """Shows progress in a view; call ``start`` when the total is known."""

    def __init__(self, view: Bar | Text | None, patience: float) -> None:
        self._view, self._patience = view, patience
        self._lock = threading.RLock()
        self._timer: threading.Timer | None = None
        self._state = State(0)
        self._first: float | None = None
        self._is_open = False

    def start(self, of: int, before: int = 0, what: str = "scenario-days") -> Advance:
        """Begin with ``before`` of ``of`` of ``what`` done; returns the function that advances the count."""
        self.stop()
        self._state, self._began = State(of, before, before, what=what), time.monotonic()
        if self._view is None:
            return _ignore
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


def _ignore(_: int) -> None:
    pass


@contextmanager
def progress_of_call(progress: bool | None) -> Iterator[Shown]:
    """Progress of a Python call; with None only on a terminal or in a notebook, after 2 s."""
    shown = Shown(_view_of(progress), 0.0 if progress else PATIENCE)
    try:
        yield shown
    finally:
        shown.stop()


@contextmanager
def progress_of_command() -> Iterator[Shown]:
    """Progress of a command on stderr."""
    shown = Shown(Bar() if is_terminal() else _lines(closing=False), PATIENCE)
    try:
        yield shown
    finally:
        shown.stop()


def _view_of(progress: bool | None) -> Bar | Text | None:
    if progress is False or (progress is None and not _is_interactive()):
        return None
    if _in_notebook():
        return Text(_cell(), _BETWEEN_UPDATES, opening=True, closing=True)
    if is_terminal():
        return Bar()
    return _lines(closing=True) if progress else None


def _lines(*, closing: bool) -> Text:
    return Text(_write, SECONDS_BETWEEN_LINES, opening=False, closing=closing)


def _is_interactive() -> bool:
    """Whether this is neither a test nor a worker."""
    return (
        not any(name in os.environ for name in _IN_TESTS)
        and multiprocessing.current_process().name == "MainProcess"
        and threading.current_thread() is threading.main_thread()
    )


def _in_notebook() -> bool:
    """Whether output is displayed by a Jupyter front end."""
    if not hasattr(builtins, "get_ipython"):  # rich is slow to import
        return False
    from rich.console import Console

    return Console(stderr=True).is_jupyter
