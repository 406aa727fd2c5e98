"""How a command ends: mistakes in a sentence, interruptions with how to go on, warnings in a line."""

from __future__ import annotations

import shlex
import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from fastcoil.errors import EXIT_INTERRUPTED, EXIT_TERMINATED, FastcoilError


class Commands(click.Group):
    """Ends every mistake of the user with its sentences and an exit code, not with a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with plain_warnings():
                return super().invoke(ctx)
        except FastcoilError as error:
            for line in str(error).splitlines():
                click.echo(f"fastcoil: {line}", err=True)
            ctx.exit(error.exit_code)
        except KeyboardInterrupt as interrupt:
            click.echo(f"fastcoil: interrupted{interrupt}", err=True)
            ctx.exit(EXIT_TERMINATED if isinstance(interrupt, Terminated) else EXIT_INTERRUPTED)


class Terminated(KeyboardInterrupt):
    """Interrupted by the system, as a batch scheduler does, and not by the user."""


@contextmanager
def interruptible(study: Path, folder: Path) -> Iterator[None]:
    """End on SIGTERM and SIGHUP as on Ctrl-C, and say how to go on."""

    def terminate(*_: object) -> None:
        raise Terminated

    before = {number: signal.signal(number, terminate) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    except KeyboardInterrupt as interrupt:
        command = shlex.join(["fastcoil", "run", str(study), "-o", str(folder)])
        advice = f"; what was finished is kept, to go on: {command}" if folder.exists() else ""
        raise type(interrupt)(advice) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def plain_warnings() -> Iterator[None]:
    """Show a warning as one line of text."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        click.echo(f"fastcoil: note: {message}", err=True)

    with warnings.catch_warnings():
        warnings.showwarning = show  # type: ignore[assignment]
        yield
