"""Work in threads of its own, which may never end: the thread that waits for it still hears Ctrl-C."""

from __future__ import annotations

import concurrent.futures as cf
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np

from fastcoil.model.engine.emulator import Day
from fastcoil.model.engine.host import TraceRequest, run_block
from fastcoil.model.engine.lanes import Block, WorkSpace

S = TypeVar("S")
T = TypeVar("T")
_PIECE = 0.5
"""Of a wait without end, s."""


def within(seconds: float | None, call: Callable[[], T]) -> T:
    """Make a call, or raise TimeoutError if it takes longer; ``None``: wait for ever.

    A call that is left goes on, in a thread that does not keep the program from ending.
    """
    found = _started(call)
    if seconds is None:
        _await([found])
    return found.result(seconds)


@contextmanager
def on_threads(n_threads: int, call: Callable[[S], None], items: Sequence[S]) -> Iterator[None]:
    """Make a call with each item, on threads, while this one does what is in the context; at its end, wait for all.

    With the first error, or Ctrl-C, no more calls begin; those that run go on, as in ``within``.
    """
    todo = deque(items)

    def work() -> None:
        while True:
            try:
                item = todo.popleft()
            except IndexError:
                return
            call(item)

    try:
        threads = [_started(work) for _ in range(min(n_threads, len(items)))]
        yield
        for thread in _await(threads):
            thread.result()
    finally:
        todo.clear()


def _started(call: Callable[[], T]) -> cf.Future[T]:
    """What a thread that does not keep the program from ending is about to find."""
    found: cf.Future[T] = cf.Future()

    def run() -> None:
        try:
            found.set_result(call())
        except BaseException as error:
            found.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return found


def _await(futures: Sequence[cf.Future[T]]) -> Collection[cf.Future[T]]:
    """Wait for all of them, or for the first error; returns those that are done."""
    while True:
        # in pieces: a Ctrl-C that comes just before a wait begins is heard after it
        done, running = cf.wait(futures, timeout=_PIECE, return_when=cf.FIRST_EXCEPTION)
        if not running or any(future.exception() for future in done):
            return done


def run_interruptibly(
    block: Block, day: Day, wanted: TraceRequest, work: WorkSpace | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """As ``run_block``: Ctrl-C ends the wait for a rule of the user that loops for ever."""
    of_user = block.law is not None or (block.estimator is not None and block.estimator.identity)
    if of_user and threading.current_thread() is threading.main_thread():
        return within(None, lambda: run_block(block, day, wanted, work))
    return run_block(block, day, wanted, work)
