"""Standard streams that stop no work: a full disk, a closed pipe and a closed descriptor are remembered, not raised."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import select
import sys
from typing import Any, NamedTuple, TextIO

_FIRST_OF_OURS = 10
"""Descriptors below are left to those who count on low ones."""


class Output(io.RawIOBase):
    """A descriptor to write to, that stays open.  ``lost``: why the first bytes were lost, and all that follows."""

    def __init__(self, descriptor: int, lost: OSError | None = None) -> None:
        self._descriptor = descriptor
        self.lost = lost

    def close(self) -> None:
        pass

    def write(self, data: Any) -> int:
        while self.lost is None:
            try:
                return os.write(self._descriptor, data)
            except BlockingIOError:  # a reader that is slow
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


class _Buffer(io.BufferedWriter):
    """Closing it, or taking it off, leaves it open to others: a study's own code may do so."""

    def close(self) -> None:
        self.flush()

    def detach(self) -> Any:
        self.flush()
        return self.raw


class _Text(io.TextIOWrapper):
    """As ``_Buffer``, for text."""

    def close(self) -> None:
        self.flush()

    def detach(self) -> Any:
        self.flush()
        return self.buffer


class Streams(NamedTuple):
    """Both of them."""

    stdout: Output
    stderr: Output

    def loss(self) -> str | None:
        """Why not all of stdout was written; ``None`` if it was, or if its reader left, which is no fault."""
        sys.stdout.flush()
        sys.stderr.flush()
        lost = self.stdout.lost
        return None if lost is None or lost.errno == errno.EPIPE else os.strerror(lost.errno or 0)


def guard_streams() -> Streams:
    """Replace ``sys.stdout`` and ``sys.stderr`` by streams that never raise.

    A closed descriptor is opened on nothing, so that no file of ours gets its number and what a library prints.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # gets the lowest free number, which is this one
    streams = Streams(*(_output(stream, k) for k, stream in ((1, sys.stdout), (2, sys.stderr))))
    sys.stdout, sys.stderr = _text(streams.stdout, sys.stdout), _text(streams.stderr, sys.stderr)
    return streams


def _output(stream: TextIO | None, descriptor: int) -> Output:
    if stream is None:  # the descriptor was closed when the interpreter started
        return Output(descriptor, OSError(errno.EBADF, os.strerror(errno.EBADF)))
    # one of our own: a study's code may close the other, and then a file of results gets its number
    return Output(fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, _FIRST_OF_OURS))


def _text(output: Output, before: TextIO | None) -> TextIO:
    encoding = "utf-8" if before is None else before.encoding
    return _Text(_Buffer(output), encoding=encoding, errors="backslashreplace", line_buffering=True)
