"""Run code that comes with a study: the only place that does."""

from __future__ import annotations

import functools
import hashlib
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from fastcoil.base.errors import InputError
from fastcoil.model.user_rules.rule import Rule
from fastcoil.study.file.source import Source
from fastcoil.study.workers.process_state import surroundings_restored

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
