"""Three ways to show how far a work is: a bar on a terminal, a line of its own in a notebook, lines of text."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from rich.progress import Progress

SECONDS_BETWEEN_LINES = 10.0
_BETWEEN_UPDATES = 0.5
"""Of a notebook, s: each is sent to the browser."""


def duration(seconds: float) -> str:
    """Seconds in words."""
    if seconds < 100:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


def is_terminal() -> bool:
    """Whether stderr is a terminal."""
    return sys.stderr is not None and sys.stderr.isatty()


def terminal_bar(*columns: str, rate: str = "", transient: bool = False) -> Progress:
    """A bar on stderr: these texts before it, ``rate`` after how much is done."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    before, after = map(TextColumn, columns), [TextColumn(text) for text in ("{task.fields[what]}", rate) if text]
    times = TimeElapsedColumn(), TextColumn("ETA"), TimeRemainingColumn()
    shown = (*before, BarColumn(), MofNCompleteColumn(), *after, *times)
    return Progress(*shown, console=Console(stderr=True), transient=transient)


@dataclass
class State:
    """How far the work is: scenario-days done, ``before`` of them by an earlier run; seconds since this one began."""

    of: int
    before: int = 0
    done: int = 0
    seconds: float = 0.0

    @property
    def rate(self) -> float:
        """Scenario-days per second of this run."""
        return (self.done - self.before) / max(self.seconds, 1e-9)

    def words(self) -> str:
        """All of it on a line."""
        if self.done >= self.of:
            return f"{self.of:,} scenario-days in {duration(self.seconds)}"
        line = f"{self.done:,} of {self.of:,} scenario-days"
        if self.done > self.before:
            line += f", {self.rate:,.0f}/s, {duration((self.of - self.done) / self.rate)} to go"
        return line


class View(Protocol):
    """Shows a state."""

    def open(self, state: State) -> None: ...

    def draw(self, state: State) -> None: ...

    def close(self, state: State) -> None: ...


class Bar:
    """On a terminal."""

    def open(self, state: State) -> None:
        self.bar = terminal_bar(rate="{task.fields[rate]}")
        self.task = self.bar.add_task("", total=state.of, what="scenario-days", rate="")
        self.bar.tasks[0].start_time = time.monotonic() - state.seconds
        self.bar.start()
        self.draw(state)

    def draw(self, state: State) -> None:
        rate = f"{state.rate:,.0f}/s" if state.done > state.before else ""
        self.bar.update(self.task, completed=state.done, rate=rate)

    def close(self, state: State) -> None:
        self.bar.stop()


class Cell:
    """In a notebook, without its widgets: they may not be installed, and a stored notebook does not keep them."""

    def open(self, state: State) -> None:
        from IPython.display import display  # type: ignore[import-not-found,unused-ignore]

        self.last = time.monotonic()
        self.shown: Any = display(  # type: ignore[no-untyped-call,unused-ignore]
            _of_notebook(state), raw=True, display_id=True
        )

    def draw(self, state: State) -> None:
        now = time.monotonic()
        if now - self.last >= _BETWEEN_UPDATES:
            self.last = now
            self.shown.update(_of_notebook(state), raw=True)

    def close(self, state: State) -> None:
        self.shown.update(_of_notebook(state, ended=True), raw=True)


def _of_notebook(state: State, *, ended: bool = False) -> dict[str, str]:
    """What a notebook shows, and keeps."""
    words = state.words()
    if ended and state.done < state.of:
        words = f"stopped at {state.done:,} of {state.of:,} scenario-days"
    bar = f'<progress value="{state.done}" max="{state.of}"></progress> ' * (not ended)
    return {"text/plain": words, "text/html": f"{bar}{words}"}


class Lines:
    """A line every 10 s, with ``closing`` one at the end too."""

    def __init__(self, closing: bool) -> None:
        self.closing = closing
        self.last = time.monotonic()

    def open(self, state: State) -> None:
        """Nothing has been done that a line could tell."""

    def draw(self, state: State) -> None:
        now = time.monotonic()
        if now - self.last >= SECONDS_BETWEEN_LINES and state.done < state.of:
            self.last = now
            _write(state.words())

    def close(self, state: State) -> None:
        if self.closing and state.done >= state.of:
            _write(state.words())


def _write(line: str) -> None:
    with suppress(OSError, ValueError):  # nobody reads it any more
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()
