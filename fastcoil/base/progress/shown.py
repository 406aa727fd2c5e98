"""Whether progress is shown, when, and how it ends: never of work done at once, never where nobody looks."""

from __future__ import annotations

import builtins
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from fastcoil.base.progress.views import Bar, Cell, Lines, State, View, is_terminal

PATIENCE = 2.0
"""Work that takes no longer is done at once, s."""
_IN_TESTS = ("PYTEST_VERSION", "PYTEST_CURRENT_TEST")

Advance = Callable[[int], None]
"""Called with the number of scenario-days finished since the last call."""


class Shown:
    """Progress as it is shown; ``start`` it when it is known how much there is to do."""

    def __init__(self, view: View | None, patience: float) -> None:
        self._view, self._patience = view, patience
        self._lock = threading.RLock()
        self._timer: threading.Timer | None = None
        self._state = State(0)
        self._is_open = False

    def start(self, of: int, before: int = 0) -> Advance:
        """Begin: ``before`` of ``of`` scenario-days are done already.  Returns what to call with more."""
        self._state, self._began = State(of, before, before), time.monotonic()
        if self._view is None:
            return _ignore
        # not at the first finished one: that may take minutes
        self._timer = threading.Timer(self._patience, self._open)
        self._timer.daemon = True
        if self._patience:
            self._timer.start()
        else:
            self._open()
        return self._advance

    def stop(self) -> None:
        """Show nothing more; what is shown ends with a whole line."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            timer, self._timer = self._timer, None
            if self._view is not None and timer is not None and self._is_open:
                self._view.close(self._now())

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
    """What a call from Python shows of its work: with None only on a terminal or in a notebook, and not at once."""
    shown = Shown(_view_of(progress), 0.0 if progress else PATIENCE)
    try:
        yield shown
    finally:
        shown.stop()


@contextmanager
def progress_of_command() -> Iterator[Shown]:
    """What a command shows of its work, on whatever its stderr is."""
    shown = Shown(Bar() if is_terminal() else Lines(closing=False), PATIENCE)
    try:
        yield shown
    finally:
        shown.stop()


def _view_of(progress: bool | None) -> View | None:
    if progress is False or (progress is None and not _someone_looks()):
        return None
    if _in_notebook():
        return Cell()
    if is_terminal():
        return Bar()
    return Lines(closing=True) if progress else None


def _someone_looks() -> bool:
    """Whether this is neither a test nor a worker; that stderr is a terminal is asked later."""
    return (
        not any(name in os.environ for name in _IN_TESTS)
        and multiprocessing.current_process().name == "MainProcess"
        and threading.current_thread() is threading.main_thread()
    )


def _in_notebook() -> bool:
    """Whether a front end of Jupyter shows what is displayed."""
    if not hasattr(builtins, "get_ipython"):  # what follows loads much for a short call
        return False
    from rich.console import Console

    return Console(stderr=True).is_jupyter
