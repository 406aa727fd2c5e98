"""Run code that comes with a study: the only place that does.  It runs as freely as any module that is imported."""

import functools
import hashlib
import linecache
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np

from fastcoil.base.errors import InputError
from fastcoil.model.user_rules import Rule
from fastcoil.study.file.own_code import Source

_LONGEST_MESSAGE = 300  # characters of an exception's text


def load(what: str, source: Source) -> Any:
    """The function itself, from a module of its own that is run once in each process.

    what: the word of the study file that names it.  ``InputError`` if the source does not run, or has no such function.
    """
    return _load(what, source.name, source.source)


def load_rules(rules: Mapping[str, Rule], sources: Mapping[str, Source]) -> None:
    """Give the rules of a study, of which only the declarations were read, their code.

    ``InputError`` if a source does not run, or makes another rule than it declares.
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
    with its_errors(f"{what} = {name!r}: its module does not run:"):
        exec(compile(source, f"<{name}>", "exec", dont_inherit=True), module.__dict__)
        # tracebacks, and the export of a controller, read the source from here
        linecache.cache[f"<{name}>"] = (len(source), None, source.splitlines(keepends=True), f"<{name}>")
    function = getattr(module, wanted, None)
    if not callable(function):
        raise InputError(f"{what} = {name!r}: its module has no function {wanted}")
    return function


@contextmanager
def its_errors(what: str) -> Iterator[None]:
    """Turn whatever the user's code raises, even SystemExit, into a sentence; numpy's error handling is restored."""
    try:
        with np.errstate():
            yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise InputError(f"{what} {_describe(error)}") from error


def _describe(error: BaseException) -> str:
    """An exception in one line: type and text."""
    text = " ".join(str(error).split())
    text = text if len(text) <= _LONGEST_MESSAGE else text[:_LONGEST_MESSAGE] + " …"
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
