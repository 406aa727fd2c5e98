"""Output to the terminal, and how a command ends: one sentence per mistake, advice on how to resume."""

from __future__ import annotations

import errno
import io
import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import click

from fastcoil.base.errors import EXIT_INTERRUPTED, EXIT_STORAGE, EXIT_TERMINATED, FastcoilError, out_of_memory_error
from fastcoil.base.machine import TERMINATION_SIGNALS, command_line
from fastcoil.base.progress import ProgressDisplay, is_stderr_terminal
from fastcoil.base.text import escape_control_characters

if TYPE_CHECKING:
    from fastcoil.study.file.user_code import UserCode

_MAX_SHUTDOWN_SECONDS = 4.0  # from an interrupt to the forced end of the process


class CommandGroup(click.Group):
    """Group of commands whose user errors are sentences with an exit code, without a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with print_warnings_as_notes():
                return super().invoke(ctx)
        except FastcoilError as error:
            print_error(error)
            ctx.exit(error.exit_code)
        except MemoryError:
            print_error(out_of_memory_error("the command ended"))
            ctx.exit(EXIT_STORAGE)
        except KeyboardInterrupt as interrupt:
            echo(f"fastcoil: interrupted{interrupt}", err=True)
            ctx.exit(EXIT_TERMINATED if isinstance(interrupt, TerminationRequest) else EXIT_INTERRUPTED)

    def main(self, *args: Any, **options: Any) -> NoReturn:  # type: ignore[override]
        """Run a command and exit; usage errors are printed through ``echo``, with control characters escaped."""
        os.environ["MPLBACKEND"] = "agg"  # commands open no windows
        try:
            code = super().main(*args, **options | {"standalone_mode": False})
        except click.Abort:  # interrupted before the command began
            code = EXIT_INTERRUPTED
        except click.ClickException as error:
            code = error.exit_code
            lines = io.StringIO()
            error.show(lines)
            echo(*lines.getvalue().removesuffix("\n").split("\n"), err=True)
        sys.exit(code)


def on_data(command: click.Command) -> click.Command:
    """Change a command so that it shows compilations, and that xarray does not import dask."""
    callback: Any = command.callback

    @wraps(callback)
    def run_command(*args: Any, **options: Any) -> Any:
        from fastcoil.model.numerics.jit import compilation_observers

        compilation_observers[:] = [show_compilation]
        _delay_dask()
        return callback(*args, **options)

    command.callback = run_command
    return command


def _delay_dask() -> None:
    """Let xarray take no array for one of dask's until something else has imported dask, which takes half a second.

    The names are xarray's own: where a version has others, commands start later.
    """

    class LateDask:
        type = property(lambda self: (sys.modules["dask.array"].Array,) if "dask.array" in sys.modules else ())

    with suppress(ImportError, AttributeError):
        from xarray.namedarray import pycompat, utils

        is_dask_collection = utils.is_dask_collection
        if "dask" not in pycompat._cached_duck_array_modules:
            pycompat._cached_duck_array_modules["dask"] = LateDask()  # type: ignore[assignment]
            utils.is_dask_collection = lambda x: "dask.base" in sys.modules and is_dask_collection(x)  # type: ignore


class TerminationRequest(KeyboardInterrupt):
    """Interrupted by SIGTERM or SIGHUP, for example from a batch scheduler."""


def force_exit(code: int, advice: str = "") -> None:
    """End the process without waiting for anything, from a signal handler."""
    line_end = "\n" if show_compilation.is_running and is_stderr_terminal() else ""
    sentence = escape_control_characters(f"fastcoil: interrupted{advice}")
    with suppress(OSError):  # the stream may be in the middle of a line, and cannot be entered again
        os.write(2, f"{line_end}{sentence}\n".encode(errors="backslashreplace"))
    os._exit(code)


@contextmanager
def handle_interrupts(
    display: ProgressDisplay, study: Path, folder: Path, verb: str = "run", options: Sequence[str] = ()
) -> Iterator[None]:
    """Handle SIGTERM and SIGHUP like Ctrl-C, print what is kept and how to go on, and end within a few seconds."""
    command = command_line(["fastcoil", verb, str(study), "-o", str(folder), *options])

    def resume_advice() -> str:
        if not (folder / f"{verb}.json").exists():
            return f"; nothing is finished yet, to start again: {command}"
        return f"; {display.done_text or 'finished scenarios'} are kept, to resume: {command}"

    def end_soon(received: int, _: object) -> None:
        """Interrupt the command, and force its end if that takes too long."""
        for signal_number in signal_numbers:  # a second Ctrl-C must not interrupt the clean-up
            signal.signal(signal_number, lambda *_: None)  # SIG_IGN would not discard a signal that is already pending
        is_ctrl_c = received == signal.SIGINT
        exit_arguments = EXIT_INTERRUPTED if is_ctrl_c else EXIT_TERMINATED, resume_advice()
        if show_compilation.is_running:
            force_exit(*exit_arguments)
        # a thread in a long shard or a worker that does not answer must not delay the end
        timer = threading.Timer(_MAX_SHUTDOWN_SECONDS, force_exit, exit_arguments)
        timer.daemon = True
        timer.start()
        raise KeyboardInterrupt if is_ctrl_c else TerminationRequest

    signal_numbers = [*TERMINATION_SIGNALS]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # background jobs keep ignoring it
        signal_numbers.append(signal.SIGINT)
    previous_handlers = {signal_number: signal.signal(signal_number, end_soon) for signal_number in signal_numbers}
    try:
        yield
    except KeyboardInterrupt as interrupt:
        raise type(interrupt)(resume_advice()) from None
    finally:
        for signal_number, handler in previous_handlers.items():
            signal.signal(signal_number, handler)


@contextmanager
def print_warnings_as_notes() -> Iterator[None]:
    """Print the warnings in the block as notes, one line of text each."""

    def print_note(message: Warning | str, *_: Any, **__: Any) -> None:
        echo(f"fastcoil: note: {message}", err=True)

    with warnings.catch_warnings():
        # PYTHONWARNINGS=error must not turn a note into a crash
        warnings.filters[:] = [each for each in warnings.filters if each[0] != "error"]  # type: ignore[index]
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = print_note  # type: ignore[assignment]
        yield


_MAX_LINE_CHARACTERS = 4000  # of a printed line, the rest are counted


def echo(*lines: object, err: bool = False) -> None:
    """Print each item on one line, with control characters escaped, to stdout or with ``err`` to stderr."""
    for line in lines:
        text = str(line)
        length_note = f"… ({len(text):,} characters)" if len(text) > _MAX_LINE_CHARACTERS else ""
        click.echo(escape_control_characters(text[:_MAX_LINE_CHARACTERS]) + length_note, err=err)


class _LogFormatter(logging.Formatter):
    """Formats a log record as one line of text, and its traceback below, with control characters escaped."""

    def format(self, record: logging.LogRecord) -> str:
        record.msg, record.args = escape_control_characters(record.getMessage()), None
        return "\n".join(map(escape_control_characters, super().format(record).split("\n")))


def print_logs() -> None:
    """Print what libraries log, which may quote untrusted text, to stderr with control characters escaped."""
    handler = logging.StreamHandler()
    handler.setFormatter(_LogFormatter())
    logging.basicConfig(handlers=[handler])


def print_error(error: FastcoilError) -> None:
    """Print the sentences of an error to stderr."""
    echo(*(f"fastcoil: {sentence}" for sentence in str(error).split("\n")), err=True)


class CompilationDisplay:
    """Progress of compilations: on a terminal a line that is erased at the end, elsewhere one line for all of them."""

    is_running = is_announced = False

    def __call__(self, n_done: int, n_functions: int) -> None:
        if threading.current_thread() is not threading.main_thread():  # beside the progress of the run
            return
        line = "Compiling the simulation for this machine, once"
        self.is_running = n_done < n_functions
        if is_stderr_terminal():
            progress = f"\r{line}: {n_done} of {n_functions} …"
            click.echo(progress if self.is_running else "\r" + " " * len(progress) + "\r", nl=False, err=True)
        elif n_functions >= 20 and not self.is_announced:  # the check of a study has fewer, and may refuse it
            self.is_announced = True
            echo(f"{line}: about 12 s …", err=True)
        # the compiler would print a traceback of an interrupt, or lose it
        handlers: list[Any] = [signal.default_int_handler, _exit_on_interrupt]
        old, new = handlers if self.is_running else reversed(handlers)
        if signal.getsignal(signal.SIGINT) == old:
            signal.signal(signal.SIGINT, new)


show_compilation = CompilationDisplay()


def _exit_on_interrupt(*_: object) -> None:
    force_exit(EXIT_INTERRUPTED)


def load_user_code(what: str, source: UserCode) -> object:
    """Announce and import the module of a study's own function."""
    from fastcoil.study.file.user_code import load_function

    function = source.name.partition(":")[2]
    echo(f"This study runs its own code: {function} from {source.path.absolute()}.", err=True)
    return load_function(what, source)


class SafeStream(io.TextIOWrapper):
    """A text stream that never raises: after its ``first_error`` it writes to /dev/null."""

    first_error: OSError | None = None

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError as error:
            self._redirect_to_null(error)
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            self._redirect_to_null(error)

    def loss_reason(self) -> str | None:
        """Return why output was lost; None if none was, or only because the reader closed the pipe."""
        self.flush()
        error = self.first_error
        return None if error is None or error.errno == errno.EPIPE else os.strerror(error.errno or 0)

    def _redirect_to_null(self, error: OSError) -> None:
        self.first_error = self.first_error or error
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), self.fileno())


def guard_streams() -> SafeStream:
    """Replace ``sys.stdout``, which is returned, and ``sys.stderr`` by streams that never raise.

    Closed descriptors 0 to 2 are opened on /dev/null, so that no library prints into a data file.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # gets the lowest free number, this one
    sys.stdout, sys.stderr = stdout, _ = _make_safe_stream(sys.stdout, 1), _make_safe_stream(sys.stderr, 2)
    return stdout


def _make_safe_stream(stream: TextIO | None, descriptor: int) -> SafeStream:
    """Wrap a standard stream; None: its descriptor was closed when Python started."""
    buffer = open(descriptor, "wb", closefd=False)  # noqa: SIM115
    safe_stream = SafeStream(buffer, stream.encoding if stream else "utf-8", "backslashreplace", line_buffering=True)
    if stream is None:
        safe_stream.first_error = OSError(errno.EBADF, os.strerror(errno.EBADF))
    return safe_stream
