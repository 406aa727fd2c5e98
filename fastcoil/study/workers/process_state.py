"""What a process shares with a user's own code, given back as it was: it would change or end the rest of the run.

Not all can be: code that replaces functions of a library, or sets options of one, does so for the whole process.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TextIO

import numpy as np

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Those with which a run is interrupted."""
_FLOATING_POINT_BYTES = 256
"""More than any processor's environment of floating point."""


class _Shared(NamedTuple):
    """What all threads of a process share."""

    folder: str
    stdout: TextIO
    stderr: TextIO
    recursion_limit: int
    raising: tuple[Any, ...]
    show_warning: Callable[..., Any]

    @classmethod
    def look(cls) -> _Shared:
        return cls(
            os.getcwd(), sys.stdout, sys.stderr, sys.getrecursionlimit(), _raising_filters(), warnings.showwarning
        )

    def restore(self) -> None:
        os.chdir(self.folder)
        sys.stdout, sys.stderr = self.stdout, self.stderr
        # deeper is no harm, and may be needed by code that is called again
        sys.setrecursionlimit(max(self.recursion_limit, sys.getrecursionlimit()))
        if _raising_filters() != self.raising:  # a note of ours would end the run
            warnings.filters[:] = [  # type: ignore[index]
                each for each in warnings.filters if each[0] != "error" or each in self.raising
            ]
        warnings.showwarning = self.show_warning


_lock = threading.Lock()
_inside: list[_Shared] = []
"""For each thread inside how it was before the first of them entered: what a later one finds may be changed already."""


@contextmanager
def surroundings_restored() -> Iterator[None]:
    """Give back the current folder, the standard streams, the way of rounding and the like, however the block ends."""
    floating_point, handlers = _floating_point(), _handlers()
    with _lock:
        _inside.append(_inside[0] if _inside else _Shared.look())
    try:
        with np.errstate():
            yield
    finally:
        _restore_floating_point(floating_point)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        with _lock:
            _inside.pop().restore()


def _raising_filters() -> tuple[Any, ...]:
    return tuple(each for each in warnings.filters if each[0] == "error")


def _handlers() -> dict[int, Any]:
    """Handlers of signals; no thread but the main one can set any."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    found = {number: signal.getsignal(number) for number in _SIGNALS}
    return {number: handler for number, handler in found.items() if handler is not None}


def _floating_point() -> ctypes.Array[ctypes.c_char]:
    """How this thread rounds, and whether it flushes tiny numbers to zero: a library may set it as it is loaded."""
    found = ctypes.create_string_buffer(_FLOATING_POINT_BYTES)
    ctypes.CDLL(None).fegetenv(found)
    return found


def _restore_floating_point(before: ctypes.Array[ctypes.c_char]) -> None:
    ctypes.CDLL(None).fesetenv(before)
