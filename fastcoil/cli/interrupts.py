"""How a command ends: one sentence per mistake, advice on how to resume, warnings on one line."""

import io
import os
import shlex
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import click

from fastcoil.base.errors import EXIT_INTERRUPTED, EXIT_STORAGE, EXIT_TERMINATED, FastcoilError, out_of_memory
from fastcoil.cli.terminal import complain, say

_PATIENCE = 4.0  # seconds from an interrupt to the forced end of the process


class Commands(click.Group):
    """Reports user errors as sentences with an exit code, without a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with plain_warnings():
                return super().invoke(ctx)
        except FastcoilError as error:
            complain(error)
            ctx.exit(error.exit_code)
        except MemoryError:
            complain(out_of_memory("the command ended"))
            ctx.exit(EXIT_STORAGE)
        except KeyboardInterrupt as interrupt:
            say(f"fastcoil: interrupted{interrupt}", err=True)
            ctx.exit(EXIT_TERMINATED if isinstance(interrupt, Terminated) else EXIT_INTERRUPTED)

    def main(self, *args: Any, **options: Any) -> NoReturn:  # type: ignore[override]
        """Run a command and exit; usage errors are printed through ``say``, with control characters escaped."""
        os.environ["MPLBACKEND"] = "agg"  # commands open no windows
        try:
            code = super().main(*args, **options | {"standalone_mode": False})
        except click.Abort:  # interrupted before the command began
            code = EXIT_INTERRUPTED
        except click.ClickException as error:
            code = error.exit_code
            lines = io.StringIO()
            error.show(lines)
            say(*lines.getvalue().removesuffix("\n").split("\n"), err=True)
        sys.exit(code)


class Terminated(KeyboardInterrupt):
    """Interrupted by SIGTERM or SIGHUP, for example from a batch scheduler."""


@contextmanager
def interruptible(study: Path, folder: Path, verb: str = "run") -> Iterator[None]:
    """Handle SIGTERM and SIGHUP like Ctrl-C, print how to resume, and end within a few seconds."""
    command = shlex.join(["fastcoil", verb, str(study), "-o", str(folder)])

    def advice() -> str:
        return f"; finished scenarios are kept, to resume: {command}" if (folder / f"{verb}.json").exists() else ""

    def give_up(code: int) -> None:
        say(f"fastcoil: interrupted{advice()}", err=True)
        os._exit(code)

    def stop(number: int, _: object) -> None:
        for each in numbers:  # a second Ctrl-C must not interrupt the clean-up
            signal.signal(each, lambda *_: None)  # SIG_IGN would not discard a signal that is already pending
        # a thread in a long shard or a worker that does not answer must not delay the end
        interrupted = number == signal.SIGINT
        timer = threading.Timer(_PATIENCE, give_up, [EXIT_INTERRUPTED if interrupted else EXIT_TERMINATED])
        timer.daemon = True
        timer.start()
        raise KeyboardInterrupt if interrupted else Terminated

    numbers = [signal.SIGTERM, signal.SIGHUP]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # background jobs keep ignoring it
        numbers.append(signal.SIGINT)
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield
    except KeyboardInterrupt as interrupt:
        raise type(interrupt)(advice()) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def plain_warnings() -> Iterator[None]:
    """Print warnings as one line of text."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        say(f"fastcoil: note: {message}", err=True)

    with warnings.catch_warnings():
        # PYTHONWARNINGS=error must not turn a note into a crash
        warnings.filters[:] = [each for each in warnings.filters if each[0] != "error"]  # type: ignore[index]
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = show  # type: ignore[assignment]
        yield
