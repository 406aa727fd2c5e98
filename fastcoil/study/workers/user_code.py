"""Run code that comes with a study, the only place that does, and restore what the process shares with it.

Not everything can be restored: code that replaces functions of a library, or sets its options, does so for the process.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any, NamedTuple, TextIO

import numpy as np

from fastcoil.base.errors import InputError
from fastcoil.model.user_rules import Rule
from fastcoil.study.file.own_code import Source

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


_LONGEST_MESSAGE = 300
"""Characters of an exception's text."""


def load(what: str, source: Source) -> Any:
    """The function itself, from a module of its own that is run once in each process.

    what: the word of the study file that names it.

    Raises
    ------
    InputError
        If the source does not run, or holds no such function.
    """
    return _load(what, source.name, source.source)


def load_rules(rules: Mapping[str, Rule], sources: Mapping[str, Source]) -> None:
    """Give the rules of a study, of which only the declarations were read, their code.

    Raises
    ------
    InputError
        If the source does not run, or makes another rule than it declares.
    """
    for name, rule in rules.items():
        if not rule.is_loaded:
            rule.adopt(load(rule.kind, sources[name]))


@functools.cache
def _load(what: str, name: str, source: str) -> Any:
    wanted = name.partition(":")[2]
    module = ModuleType(f"own_code_{hashlib.sha256(source.encode()).hexdigest()}")
    # decorators such as dataclass look here for the module of their class
    sys.modules[module.__name__] = module
    with its_errors(f"{what} = {name!r}: its module does not run:"), surroundings_restored():
        exec(compile(source, f"<{name}>", "exec", dont_inherit=True), module.__dict__)
        function = getattr(module, wanted, None)
        found = callable(function)
    if not found:
        raise InputError(f"{what} = {name!r}: its module has no function {wanted}")
    return function


@contextmanager
def its_errors(what: str) -> Iterator[None]:
    """Turn whatever the user's code raises into a sentence: it must end neither a worker nor the program."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise InputError(f"{what} {_describe(error)}") from error


def _describe(error: BaseException) -> str:
    """An exception in one line: type and text."""
    name = type.__dict__["__name__"].__get__(type(error))  # a metaclass may have another answer
    try:
        text = " ".join(str(error).split())
    except BaseException:  # its own text is the user's code, too
        text = ""
    text = text if len(text) <= _LONGEST_MESSAGE else text[:_LONGEST_MESSAGE] + " …"
    return f"{name}: {text}" if text else name
