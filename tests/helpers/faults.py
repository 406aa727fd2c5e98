"""Small studies in their folders, and file operations that fail or kill the process at a chosen call."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from fastcoil.study import maintenance, runner
from fastcoil.study.file.spec import Study, read_study

# a shard never holds scenarios of two days: as many shards as days
DAYS = 3
PLAIN = f"""
title = "small"
[loop]
noise_std = 0.02
[sweep]
backlash = [0.02, 0.07]
estimate_ratio = [0.0, 0.9]
[boundary]
hours = 0.25
seed = {list(range(1, DAYS + 1))}
[run]
warm_up = 100
"""
TRACED = PLAIN + 'traces = ["T_sup", "mode"]\ntrace_interval = 50\n'


def larger(text: str) -> str:
    """The study with a value more."""
    return text.replace("[0.02, 0.07]", "[0.02, 0.07, 0.1]")


def studied(text: str, folder: Path) -> Study:
    """The study of a text, from a file beside the folder of its results."""
    path = folder.with_name("study.toml")
    path.write_text(text, encoding="utf-8")
    return read_study(path)


def ran(text: str, folder: Path, **options: Any) -> str:
    """Run a study into a folder, one worker by default.  Returns the hash of what was found."""
    options = {"n_jobs": 1} | options
    finished = runner.execute(studied(text, folder), folder, **options)
    return str(finished.results.attrs["content_sha256"])


@cache
def golden(text: str) -> str:
    """The hash that a run finds which nothing disturbed."""
    with tempfile.TemporaryDirectory() as folder:
        return ran(text, Path(folder) / "golden")


def stopped(study: Study, folder: Path, after: int, **options: Any) -> int:
    """Run a study until some shards are committed, then interrupt it as Ctrl-C does.  Returns how much was run."""
    done: list[int] = []

    def advance(n_scenarios: int) -> None:
        done.append(n_scenarios)
        if len(done) == after:
            raise KeyboardInterrupt

    try:
        runner.execute(study, folder, n_jobs=1, progress=lambda _: advance, **options)
    except KeyboardInterrupt:
        return sum(done)
    raise AssertionError("the study was finished before it was interrupted")


def interrupted(text: str, folder: Path, after: int, **options: Any) -> None:
    """Run the study of a text until some shards are committed, then interrupt it."""
    stopped(studied(text, folder), folder, after, **options)


def shards(folder: Path) -> list[Path]:
    """The files among the shards, those that begin with a dot too."""
    return sorted((folder / "shards").glob("*"))


def contents(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Bytes and time of change of every file; of a folder, its time."""
    return {
        str(p.relative_to(folder)): (p.read_bytes() if p.is_file() else b"", p.stat().st_mtime_ns)
        for p in sorted(folder.rglob("*"))
    }


def unfinished(folder: Path) -> list[Path]:
    """What a writer left behind half-written."""
    return [p for p in folder.rglob("*") if p.name.endswith(".tmp")]


def quarantined(folder: Path) -> list[str]:
    """The names of what was set aside."""
    return sorted(p.name for p in (folder / "quarantine").glob("*"))


def verified(folder: Path) -> list[str]:
    """What ``verify`` finds; it changes nothing."""
    before = contents(folder)
    problems = maintenance.verify(folder)
    assert contents(folder) == before
    return problems


def resumed(folder: Path, text: str = PLAIN, **options: Any) -> list[str]:
    """Go on with a study, to the end, and find what an undisturbed run finds.  Returns the warnings."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert ran(text, folder, **options) == golden(text)
    assert verified(folder) == []
    assert unfinished(folder) == []
    assert shards(folder) == []
    return [str(w.message) for w in told]


SITUATIONS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "plain": (PLAIN, lambda folder: None),
    "traced": (TRACED, lambda folder: None),
    "extended": (larger(TRACED), lambda folder: ran(TRACED, folder)),
    "extended, unfinished": (larger(TRACED), lambda folder: interrupted(TRACED, folder, DAYS - 1)),
}
"""What is run, and in what state of its folder."""


@contextmanager
def operations(folder: Path, before: Callable[[str], None]) -> Iterator[None]:
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


class Nth:
    """Does something at the n-th operation, and at every one from there on if ``lasting``."""

    def __init__(self, n: int, act: Callable[[], None], *, lasting: bool = False) -> None:
        self.n, self.act, self.lasting = n, act, lasting
        self.done: list[str] = []

    def __call__(self, name: str) -> None:
        self.done.append(name)
        if len(self.done) == self.n or (self.lasting and len(self.done) > self.n):
            self.act()
