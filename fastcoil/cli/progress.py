"""Progress of a running study on stderr: a bar on a terminal, else a line every 10 s."""

from __future__ import annotations

import contextlib
import io
import sys
import time
from typing import TYPE_CHECKING

from fastcoil.cli.terminal import say

if TYPE_CHECKING:
    from fastcoil.study.file.source import Source
    from fastcoil.study.runner import Advance

SECONDS_BETWEEN_LINES = 10.0


def announce_compilation(kernel: str = "emulate") -> None:
    """Announce the wait if a kernel is not compiled yet."""
    from fastcoil.numerics.jit import is_compiled

    if not is_compiled(kernel):
        say("Compiling the kernels, once per installation: about 10 s …", err=True)


def run_own_code(what: str, source: Source) -> object:
    """Run the module of a study's own function, and say so before."""
    from fastcoil.study.workers.own_code import load

    function = source.name.partition(":")[2]
    say(f"This study runs code of its own: {function} from {source.path.absolute()}.", err=True)
    printed = {False: io.StringIO(), True: io.StringIO()}
    try:
        with contextlib.redirect_stdout(printed[False]), contextlib.redirect_stderr(printed[True]):
            return load(what, source)
    finally:
        for err, text in printed.items():
            say(*text.getvalue().splitlines(), err=err)


def report_progress(n: int, done: int = 0) -> Advance:
    """Start to report: of ``n`` scenarios ``done`` are done already.  Returns what to call with newly finished ones."""
    if done:
        say(f"Resuming: {done:,} of {n:,} scenario-days done.", err=True)
    return _bar(n, done) if sys.stderr is not None and sys.stderr.isatty() else _lines(n, done)


def duration(seconds: float) -> str:
    """Seconds in words."""
    if seconds < 100:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


def _bar(n: int, before: int) -> Advance:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(), MofNCompleteColumn(), TextColumn("scenario-days"), TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(), TextColumn("ETA"), TimeRemainingColumn(),
    )  # fmt: skip
    bar = Progress(*columns, console=Console(stderr=True))
    task = bar.add_task("", total=n, completed=before, rate="")
    bar.start()
    start, done = time.monotonic(), 0

    def advance(finished: int) -> None:
        nonlocal done
        done += finished
        bar.update(task, advance=finished, rate=f"{done / (time.monotonic() - start):,.0f}/s")
        if before + done == n:
            bar.stop()

    return advance


def _lines(n: int, before: int) -> Advance:
    start = last = time.monotonic()
    done = 0

    def advance(finished: int) -> None:
        nonlocal done, last
        done += finished
        now = time.monotonic()
        if now - last >= SECONDS_BETWEEN_LINES:
            last = now
            rate = done / (now - start)
            eta = duration((n - before - done) / rate)
            say(f"{before + done:,} of {n:,} scenario-days, {rate:,.0f}/s, {eta} to go", err=True)

    return advance
