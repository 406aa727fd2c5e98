"""What may never end, in a thread of its own: the thread that waits for it still hears Ctrl-C."""

from __future__ import annotations

import concurrent.futures as cf
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from fastcoil.engine.emulator import Day
from fastcoil.engine.host import TraceRequest, run_block
from fastcoil.engine.lanes import Block, WorkSpace

T = TypeVar("T")
_PIECE = 0.5
"""Of a wait without end, s."""


def within(seconds: float | None, call: Callable[[], T]) -> T:
    """Make a call, or raise TimeoutError if it takes longer; ``None``: wait for ever.

    A call that is left goes on, in a thread that does not keep the program from ending.
    """
    found: cf.Future[T] = cf.Future()

    def run() -> None:
        try:
            found.set_result(call())
        except BaseException as error:
            found.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    if seconds is None:
        # in pieces: a Ctrl-C that comes just before a wait begins is heard after it
        while not cf.wait([found], timeout=_PIECE).done:
            pass
    return found.result(seconds)


def run_interruptibly(
    block: Block, day: Day, wanted: TraceRequest, work: WorkSpace | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """As ``run_block``: Ctrl-C ends the wait for a rule of the user that loops for ever."""
    of_user = block.law is not None or (block.estimator is not None and block.estimator.identity)
    if of_user and threading.current_thread() is threading.main_thread():
        return within(None, lambda: run_block(block, day, wanted, work))
    return run_block(block, day, wanted, work)
