"""Run a user's own reduction of traces.  The only place that runs code that comes with a study."""

from __future__ import annotations

import functools
import hashlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.errors import InputError
from fastcoil.study.file.reduction import Reduction
from fastcoil.study.workers.answer import SCENARIO, take_answer
from fastcoil.study.workers.surroundings import surroundings_restored

_LONGEST_MESSAGE = 300
"""Characters of an exception's text."""


def load_function(reduction: Reduction) -> Callable[[xr.Dataset], Any]:
    """The function itself, from a module of its own that is run once in each process.

    Raises
    ------
    InputError
        If the source does not run, or holds no such function.
    """
    return _load(reduction.name, reduction.source)


def reduce(reduction: Reduction, traces: xr.Dataset) -> xr.Dataset:
    """Reduce the traces of some scenarios.

    Parameters
    ----------
    reduction
        The function.
    traces
        Traces over (scenario, [volume,] elapsed_time), the swept parameters as coordinates along ``scenario``.
        The function gets them read-only.

    Returns
    -------
    xarray.Dataset
        What the function returns: numbers over (scenario, …), with the labels of the further dimensions and those
        attributes that describe a number in words, see ``take_answer``.

    Raises
    ------
    InputError
        If the function raises, if it does not return such a Dataset, or if its answer for the last scenario depends on
        the others.
    """
    traces = _protect(traces)
    reduced = _call(reduction, traces)
    alone = _call(reduction, traces.isel({SCENARIO: slice(-1, None)}))
    among = reduced.isel({SCENARIO: slice(-1, None)})
    one, other = among.variables, alone.variables
    differing = [str(n) for n in {**one, **other} if n not in one or n not in other or not _same(one[n], other[n])]
    if differing:
        raise InputError(
            f"reduce = {reduction.name!r} gives another {' and '.join(differing)} for a scenario alone than among "
            "others: treat each scenario by itself, to the last bit"
        )
    return reduced


def _call(reduction: Reduction, traces: xr.Dataset) -> xr.Dataset:
    function = load_function(reduction)
    with _its_errors(f"reduce = {reduction.name!r} raised"), surroundings_restored():
        found = function(traces.copy())
    with _its_errors(f"reduce = {reduction.name!r} returned something that cannot be read:"), surroundings_restored():
        reduced, problems = take_answer(found, traces)
    if problems:
        raise InputError([f"reduce = {reduction.name!r} returned {problem}" for problem in problems])
    return reduced


@functools.cache
def _load(name: str, source: str) -> Callable[[xr.Dataset], Any]:
    wanted = name.partition(":")[2]
    module = ModuleType(f"reduction_{hashlib.sha256(source.encode()).hexdigest()}")
    # decorators such as dataclass look here for the module of their class
    sys.modules[module.__name__] = module
    with _its_errors(f"reduce = {name!r}: its module does not run:"), surroundings_restored():
        exec(compile(source, f"<{name}>", "exec", dont_inherit=True), module.__dict__)
        function: Callable[[xr.Dataset], Any] | None = getattr(module, wanted, None)
        found = callable(function)
    if not found or function is None:
        raise InputError(f"reduce = {name!r}: its module has no function {wanted}")
    return function


@contextmanager
def _its_errors(what: str) -> Iterator[None]:
    """Turn whatever the user's code raises into a sentence: it must end neither a worker nor the program."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise InputError(f"{what} {_describe(error)}") from error


def _protect(traces: xr.Dataset) -> xr.Dataset:
    """The same values, read-only: a function that changed them would change the input of the next call."""
    protected = traces.copy()
    for name, variable in protected.variables.items():
        if name not in protected.indexes:
            values = variable.values.view()
            values.flags.writeable = False
            variable.data = values
    return protected


def _same(one: xr.Variable, other: xr.Variable) -> bool:
    if one.dims != other.dims or one.dtype != other.dtype or one.shape != other.shape:
        return False
    return np.array_equal(one.values, other.values, equal_nan=one.dtype.kind == "f")


def _describe(error: BaseException) -> str:
    """An exception in one line: type and text."""
    name = type.__dict__["__name__"].__get__(type(error))  # a metaclass may have another answer
    try:
        text = " ".join(str(error).split())
    except BaseException:  # its own text is the user's code, too
        text = ""
    text = text if len(text) <= _LONGEST_MESSAGE else text[:_LONGEST_MESSAGE] + " …"
    return f"{name}: {text}" if text else name
