"""Run a user's own reduction of traces, and copy its answer into plain arrays and words.

Nothing of the user's objects is kept: they run the user's code again when they are used, which may raise, change its
answer later, or carry attributes by which a reader of NetCDF would turn the stored numbers into others.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import is_text
from fastcoil.base.errors import InputError, shown
from fastcoil.loops.netcdf import CLOCK
from fastcoil.model.metric_table import METRICS, PREDICTIONS, TRACES
from fastcoil.model.parameter_table import PARAMETERS, RESERVED_DIMS
from fastcoil.study.file.own_code import Source
from fastcoil.study.workers.user_code import its_errors, load, surroundings_restored

SCENARIO = "scenario"
"""The dimension along which the function gets the traces of a shard."""
_TAKEN = {*PARAMETERS, *METRICS, *PREDICTIONS, *TRACES, *CLOCK, "status", SCENARIO}
_TAKEN_NAMES = _TAKEN | set(RESERVED_DIMS)
_TAKEN_DIMS = _TAKEN | {"day", "replicate", "sample"}
_FLOATS = (np.dtype(np.float32), np.dtype(np.float64))
_WORDS = ("units", "long_name", "standard_name", "description", "comment", "source", "references")
"""Attributes that are kept: words for whoever reads a file; nothing that a decoder of numbers obeys."""
_LONGEST_NAME = 200
"""Bytes; the NetCDF library takes 256."""


def take_answer(found: object, traces: xr.Dataset) -> tuple[xr.Dataset, list[str]]:
    """Copy what a reduction of ``traces`` returned, which may raise anything.

    Returns
    -------
    tuple
        A Dataset over (scenario, …) that shares nothing with ``found``, and what is wrong with ``found``, a sentence
        each; if there is anything, the Dataset is empty.
    """
    nothing = xr.Dataset()
    if not isinstance(found, xr.Dataset):
        return nothing, [f"a {type(found).__name__}: return an xarray.Dataset"]
    variables = {_name(name): _variable(array) for name, array in found.data_vars.items()}
    if not variables:
        return nothing, ["an empty Dataset: return at least one variable"]
    dims = list(dict.fromkeys(dim for variable in variables.values() for dim in variable.dims if dim != SCENARIO))
    given = {_name(name): array for name, array in found.coords.items()}
    labels = {dim: _variable(given[dim]) for dim in dims if dim in given}
    # labels of the scenarios come with the traces, so that these names are taken too
    taken = {str(name) for name in traces.coords} - {"elapsed_time", "volume"}
    problems = [
        *_twice([*found.data_vars, *found.dims]),
        *(p for name, variable in variables.items() for p in _wrong_variable(name, variable, traces, taken)),
        *(p for dim in dims for p in _wrong_dim(dim, labels.get(dim), taken)),
    ]
    if problems:
        return nothing, problems
    return xr.Dataset({n: v.transpose(SCENARIO, ...) for n, v in variables.items()}, coords=labels), []


def _variable(array: xr.DataArray) -> xr.Variable:
    values = np.array(array.values, order="C", subok=False)
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    if values.dtype.kind == "O":
        values = np.asarray(np.frompyfunc(_plain, 1, 1)(values), dtype=object)
    attrs = {word: _plain(array.attrs[word]) for word in _WORDS if word in array.attrs}
    return xr.Variable([_name(d) for d in array.dims], values, {k: v for k, v in attrs.items() if _is_word(k, v)})


def _is_word(name: str, text: object) -> bool:
    """Whether an attribute is a text that a file can hold, and no unit that counts from a date."""
    return type(text) is str and is_text(text) and not (name == "units" and " since " in text)


def _plain(value: Any) -> Any:
    """A text without the methods of the user's class."""
    return str.__str__(value) if isinstance(value, str) else value


def _name(value: Any) -> Any:
    """A name as the NetCDF library writes it; others that look the same are one to it."""
    return unicodedata.normalize("NFC", _plain(value)) if isinstance(value, str) else value


def _twice(names: Iterable[object]) -> Iterable[str]:
    """Names that NetCDF cannot tell apart."""
    seen: set[object] = set()
    for name in names:
        if _name(name) in seen:
            yield f"two things named {shown(_name(name))}: rename one of them"
        seen.add(_name(name))


def _wrong_variable(name: Any, variable: xr.Variable, traces: xr.Dataset, taken: set[str]) -> Iterable[str]:
    if not _is_name(name):
        yield f"a variable {shown(name)}: name it with letters, digits and _"
    elif name in _TAKEN_NAMES | taken:
        yield f"a variable {name}: the name is taken, choose another"
    name = shown(name).strip("'\"")
    if SCENARIO not in variable.dims:
        yield f"{name} without the dim {SCENARIO!r}: give one value, or more, for each scenario"
    elif variable.sizes[SCENARIO] != traces.sizes[SCENARIO]:
        yield f"{name} for {variable.sizes[SCENARIO]} of {traces.sizes[SCENARIO]} scenarios: keep every one of them"
    if variable.dtype.kind not in "biu" and variable.dtype not in _FLOATS:
        yield f"{name} of type {variable.dtype}: return numbers (float64, float32 or integers) or booleans"


def _wrong_dim(dim: Any, labels: xr.Variable | None, taken: set[str]) -> Iterable[str]:
    if dim in _TAKEN_DIMS | taken:
        yield f"a dim {dim}: the name is taken, choose another"
    elif not _is_name(dim):
        yield f"a dim {shown(dim)}: name it with letters, digits and _"
    elif labels is not None and labels.dims != (dim,):
        yield f"two things named {shown(dim)}: rename one of them"
    elif labels is not None and not _are_labels(labels.values):
        yield f"labels of {dim} that are neither numbers nor words: give it others, or drop them"


def _is_name(name: object) -> bool:
    return type(name) is str and name.isidentifier() and len(name.encode()) <= _LONGEST_NAME


def _are_labels(labels: np.ndarray) -> bool:
    if labels.dtype.kind in "UO":
        return all(type(label) is str and is_text(label) for label in labels.tolist())
    return labels.dtype.kind in "iu" or labels.dtype in _FLOATS


def reduce(reduction: Source, traces: xr.Dataset) -> xr.Dataset:
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


def _call(reduction: Source, traces: xr.Dataset) -> xr.Dataset:
    function = load("reduce", reduction)
    with its_errors(f"reduce = {reduction.name!r} raised"), surroundings_restored():
        found = function(traces.copy())
    with its_errors(f"reduce = {reduction.name!r} returned something that cannot be read:"), surroundings_restored():
        reduced, problems = take_answer(found, traces)
    if problems:
        raise InputError([f"reduce = {reduction.name!r} returned {problem}" for problem in problems])
    return reduced


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
