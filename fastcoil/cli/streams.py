"""Standard streams that never raise: what a full disk, a closed pipe or a closed descriptor loses is recorded."""

import errno
import io
import os
import sys
from typing import TextIO


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
    buffer = io.BufferedWriter(io.FileIO(descriptor, "wb", closefd=False))
    output = Output(buffer, stream.encoding if stream else "utf-8", "backslashreplace", line_buffering=True)
    if stream is None:
        output.lost = OSError(errno.EBADF, os.strerror(errno.EBADF))
    return output
