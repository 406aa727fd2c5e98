"""Standard streams that never raise: what a full disk, a closed pipe or a closed descriptor loses is recorded."""

import errno
import io
import os
import sys
from typing import Any, NamedTuple, TextIO, cast


class Output:
    """A text stream; from its first error on, ``lost``, it leads to /dev/null."""

    def __init__(self, stream: TextIO | None, descriptor: int) -> None:
        self.lost: OSError | None = None
        if stream is None:  # the descriptor was closed when the interpreter started
            self.lost = OSError(errno.EBADF, os.strerror(errno.EBADF))
            stream = os.fdopen(descriptor, "w", encoding="utf-8", closefd=False)
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace", line_buffering=True)
        self._stream = stream

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except OSError as error:
            self._give_up(error)
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._give_up(error)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _give_up(self, error: OSError) -> None:
        self.lost = self.lost or error
        with open(os.devnull, "w", encoding="utf-8") as nowhere:
            os.dup2(nowhere.fileno(), self._stream.fileno())


class Streams(NamedTuple):
    """Standard output and standard error."""

    stdout: Output
    stderr: Output

    def loss(self) -> str | None:
        """Why part of stdout was lost; None if nothing was lost, or only because the reader closed the pipe."""
        self.stdout.flush()
        self.stderr.flush()
        lost = self.stdout.lost
        return None if lost is None or lost.errno == errno.EPIPE else os.strerror(lost.errno or 0)


def guard_streams() -> Streams:
    """Replace ``sys.stdout`` and ``sys.stderr`` by streams that never raise.

    Closed descriptors 0 to 2 are opened on /dev/null, so that no data file gets one of them and receives what a library
    prints.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # gets the lowest free number, this one
    streams = Streams(Output(sys.stdout, 1), Output(sys.stderr, 2))
    sys.stdout, sys.stderr = cast("TextIO", streams.stdout), cast("TextIO", streams.stderr)
    return streams
