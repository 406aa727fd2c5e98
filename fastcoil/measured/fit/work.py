"""How far a fit has come: whoever listens is told of each part and of each step; nobody has to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol


class Listener(Protocol):
    """Is told of the work of a fit."""

    def part(self, what: str, done: int, of: int) -> None:
        """A part begins: ``done`` of ``of`` such parts are done."""

    def step(self) -> None:
        """The model was run once."""


_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def told(listener: Listener) -> Iterator[None]:
    """Tell ``listener`` of the fits inside."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def part(what: str, done: int, of: int) -> None:
    """Tell of a part."""
    if listener := _listener.get():
        listener.part(what, done, of)


def step() -> None:
    """Tell of a step."""
    if listener := _listener.get():
        listener.step()
