"""Output to the terminal, and how a command ends: one sentence per mistake, advice on how to resume.

The standard streams never raise: what a full disk, a closed pipe or a closed descriptor loses is recorded.
"""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import click

from fastcoil.base.errors import EXIT_INTERRUPTED, EXIT_STORAGE, EXIT_TERMINATED, FastcoilError, out_of_memory
from fastcoil.base.machine import INTERRUPTS, command_line
from fastcoil.base.text import printable

if TYPE_CHECKING:
    from fastcoil.study.file.own_code import Source

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
def interruptible(study: Path, folder: Path, verb: str = "run", options: Sequence[str] = ()) -> Iterator[None]:
    """Handle SIGTERM and SIGHUP like Ctrl-C, print how to resume, and end within a few seconds."""
    command = command_line(["fastcoil", verb, str(study), "-o", str(folder), *options])

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

    numbers = [*INTERRUPTS]
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


_LONGEST_LINE = 4000  # characters printed of one line


def say(*lines: object, err: bool = False) -> None:
    """Print each item on one line, with control characters escaped, to stdout or with ``err`` to stderr."""
    for line in lines:
        text = str(line)
        more = f"… ({len(text):,} characters)" if len(text) > _LONGEST_LINE else ""
        click.echo(printable(text[:_LONGEST_LINE]) + more, err=err)


def complain(error: FastcoilError) -> None:
    """Print the sentences of an error to stderr."""
    say(*(f"fastcoil: {sentence}" for sentence in str(error).split("\n")), err=True)


def announce_compilation(kernel: str = "emulate") -> None:
    """Announce the wait if a kernel has not been compiled."""
    from fastcoil.model.numerics.jit import is_compiled

    if not is_compiled(kernel):
        say("Compiling the kernels, once per installation: about 10 s …", err=True)


def run_own_code(what: str, source: Source) -> object:
    """Announce and import the module of a study's own function."""
    from fastcoil.study.file.own_code import load

    function = source.name.partition(":")[2]
    say(f"This study runs its own code: {function} from {source.path.absolute()}.", err=True)
    return load(what, source)


class Output(io.TextIOWrapper):
    """A text stream; from its first error on, ``lost``, it leads to /dev/null."""

    lost: OSError | None = None

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError as error:
            self._give_up(error)
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            self._give_up(error)

    def loss(self) -> str | None:
        """Why part of it was lost; None if nothing was lost, or only because the reader closed the pipe."""
        self.flush()
        return None if self.lost is None or self.lost.errno == errno.EPIPE else os.strerror(self.lost.errno or 0)

    def _give_up(self, error: OSError) -> None:
        self.lost = self.lost or error
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), self.fileno())


def guard_streams() -> Output:
    """Replace ``sys.stdout``, which is returned, and ``sys.stderr`` by streams that never raise.

    Closed descriptors 0 to 2 are opened on /dev/null, so that no data file gets one of them and receives what a library
    prints.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # gets the lowest free number, this one
    sys.stdout, sys.stderr = stdout, _ = _output(sys.stdout, 1), _output(sys.stderr, 2)
    return stdout


def _output(stream: TextIO | None, descriptor: int) -> Output:
    """A stream like one of Python's; that is None where the descriptor was closed when the interpreter started."""
    buffer = open(descriptor, "wb", closefd=False)  # noqa: SIM115
    output = Output(buffer, stream.encoding if stream else "utf-8", "backslashreplace", line_buffering=True)
    if stream is None:
        output.lost = OSError(errno.EBADF, os.strerror(errno.EBADF))
    return output
