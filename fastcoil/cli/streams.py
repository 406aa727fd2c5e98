"""Standard streams that never raise: a full disk, a closed pipe or a closed descriptor is recorded instead."""

import errno
import fcntl
import io
import os
import select
import sys
from typing import Any, NamedTuple, TextIO

_FIRST_OF_OURS = 10  # lower descriptors are left to programs that rely on them


class Output(io.RawIOBase):
    """Writes to a descriptor that stays open.  ``lost``: the first error; everything after it is discarded."""

    def __init__(self, descriptor: int, lost: OSError | None = None) -> None:
        self._descriptor = descriptor
        self.lost = lost

    def close(self) -> None:
        pass

    def write(self, data: Any) -> int:
        while self.lost is None:
            try:
                return os.write(self._descriptor, data)
            except BlockingIOError:  # the reader is slow
                select.select([], [self._descriptor], [])
            except OSError as error:
                self.lost = error
        return memoryview(data).nbytes

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._descriptor

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)


class Streams(NamedTuple):
    """Standard output and standard error."""

    stdout: Output
    stderr: Output

    def loss(self) -> str | None:
        """Why part of stdout was lost; None if nothing was lost, or only because the reader closed the pipe."""
        sys.stdout.flush()
        sys.stderr.flush()
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
    streams = Streams(*(_output(stream, k) for k, stream in ((1, sys.stdout), (2, sys.stderr))))
    sys.stdout, sys.stderr = _text(streams.stdout, sys.stdout), _text(streams.stderr, sys.stderr)
    return streams


def _output(stream: TextIO | None, descriptor: int) -> Output:
    if stream is None:  # the descriptor was closed when the interpreter started
        return Output(descriptor, OSError(errno.EBADF, os.strerror(errno.EBADF)))
    # a duplicate: if a study's code closes the original, a result file could get its number
    try:
        return Output(fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, _FIRST_OF_OURS))
    except OSError:  # fewer files may be open than that
        return Output(descriptor)


def _text(output: Output, before: TextIO | None) -> TextIO:
    encoding = "utf-8" if before is None else before.encoding
    return io.TextIOWrapper(
        io.BufferedWriter(output), encoding=encoding, errors="backslashreplace", line_buffering=True
    )
