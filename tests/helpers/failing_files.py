"""File operations that fail, or kill the process, at a chosen call."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def intercept_operations(folder: Path, before: Callable[[str], None]) -> Iterator[None]:
    """Call ``before`` with the name of each operation on files in ``folder``, before it is done.

    A write counts as two, of a half each.  Where ``before`` raises, the operation fails.
    """
    inside = os.fspath(folder.resolve())

    def counted(name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(target: Any, *args: Any, **options: Any) -> Any:
            if isinstance(target, int) or os.path.realpath(os.fspath(target)).startswith(inside):
                before(name)
            return real(target, *args, **options)

        return call

    class Halving:
        def __init__(self, file: Any) -> None:
            self._file = file

        def __enter__(self) -> Halving:
            return self

        def __exit__(self, *_: object) -> None:
            self._file.close()

        def __getattr__(self, name: str) -> Any:
            return getattr(self._file, name)

        def write(self, data: Any) -> int:
            for half in (data[: len(data) // 2], data[len(data) // 2 :]):
                before("write")
                self._file.write(half)
                self._file.flush()
            return len(data)

    real_open = Path.open

    def opened(self: Path, mode: str = "r", *args: Any, **options: Any) -> Any:
        if not os.path.realpath(self).startswith(inside):
            return real_open(self, mode, *args, **options)
        before(f"open for {'reading' if mode in ('r', 'rb') else 'writing'}")
        file = real_open(self, mode, *args, **options)
        return file if mode in ("r", "rb") else Halving(file)

    names = [n for n in ("open", "fsync", "replace", "unlink", "mkdir", "rmdir", "posix_fallocate") if hasattr(os, n)]
    before_all = {name: getattr(os, name) for name in names}
    try:
        for name, real in before_all.items():
            setattr(os, name, counted(name, real))
        Path.open = opened  # type: ignore[method-assign, assignment]
        yield
    finally:
        for name, real in before_all.items():
            setattr(os, name, real)
        Path.open = real_open  # type: ignore[method-assign]


class NthOperation:
    """Act at the n-th operation, and at every later one if ``lasting``."""

    def __init__(self, n: int, act: Callable[[], None], *, lasting: bool = False) -> None:
        self.n, self.act, self.lasting = n, act, lasting
        self.done: list[str] = []

    def __call__(self, name: str) -> None:
        self.done.append(name)
        if len(self.done) == self.n or (self.lasting and len(self.done) > self.n):
            self.act()
