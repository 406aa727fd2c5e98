"""Progress of a fit on stderr: a bar on a terminal, else a line every 10 s."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from fastcoil.base.progress import PATIENCE, SECONDS_BETWEEN_LINES, duration, is_terminal, terminal_bar
from fastcoil.cli.terminal import say

if TYPE_CHECKING:
    from rich.progress import Progress


@contextmanager
def fit_progress() -> Iterator[None]:
    """Show the progress of the fits inside."""
    from fastcoil.measured.fit.work import told

    shown = _Bar() if is_terminal() else _Lines()
    with told(shown):
        try:
            yield
        finally:
            shown.stop()


class _Part:
    """The part of a fit that goes on."""

    def __init__(self) -> None:
        self.start = self.began = time.monotonic()
        self.what, self.done, self.of = "starts", 0, 1

    def part(self, what: str, done: int, of: int) -> None:
        if what != self.what or done == 0:
            self.began = time.monotonic()
        self.what, self.done, self.of = what, done, of
        self.step()

    def step(self) -> None:
        """Show it, if it is time."""

    def stop(self) -> None:
        """Show nothing more."""


class _Lines(_Part):
    def __init__(self) -> None:
        super().__init__()
        self.last = self.start

    def step(self) -> None:
        now = time.monotonic()
        if now - self.last < SECONDS_BETWEEN_LINES:
            return
        self.last = now
        line = f"Fitting for {duration(now - self.start)}: {self.done:,} of {self.of:,} {self.what} done"
        if self.done:
            line += f", {duration((now - self.began) * (self.of - self.done) / self.done)} to go with them"
        say(line, err=True)


class _Bar(_Part):
    def __init__(self) -> None:
        super().__init__()
        self.bar: Progress | None = None

    def step(self) -> None:
        if self.bar is None and time.monotonic() - self.start >= PATIENCE:
            self.bar = terminal_bar("Fitting", transient=True)
            self.bar.start()
            self.task = self.bar.add_task("", total=self.of, what=self.what)
            self.shown = ""
        if self.bar is not None:
            if self.what != self.shown:
                self.bar.reset(self.task, total=self.of)
                self.shown = self.what
            self.bar.update(self.task, completed=self.done, total=self.of, what=self.what)

    def stop(self) -> None:
        if self.bar is not None:
            self.bar.stop()
