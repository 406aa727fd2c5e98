"""Run a user's own reduction of traces, and copy its answer: numbers, labels and words, nothing else of its objects."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import is_text
from fastcoil.base.errors import InputError
from fastcoil.loops.netcdf import CLOCK, load, netcdf_bytes
from fastcoil.model.metric_table import METRICS, PREDICTIONS, TRACES
from fastcoil.model.parameter_table import PARAMETERS, RESERVED_DIMS
from fastcoil.study.file.own_code import Source, its_errors
from fastcoil.study.file.own_code import load as load_code

SCENARIO = "scenario"
"""The dimension along which the function gets the traces of a shard."""
_TAKEN = {*PARAMETERS, *METRICS, *PREDICTIONS, *TRACES, *CLOCK, "status", SCENARIO}
_TAKEN_NAMES = _TAKEN | set(RESERVED_DIMS)
_TAKEN_DIMS = _TAKEN | {"day", "replicate", "sample"}
_FLOATS = (np.dtype(np.float32), np.dtype(np.float64))
_WORDS = ("units", "long_name", "standard_name", "description", "comment", "source", "references")
"""Attributes that are kept: words for a reader, nothing by which a decoder would change the numbers."""


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
        attributes that describe a number in words.
    """
    traces = _protect(traces)
    reduced = _call(reduction, traces)
    alone = _call(reduction, traces.isel({SCENARIO: slice(-1, None)}))
    one, other = reduced.isel({SCENARIO: slice(-1, None)}).variables, alone.variables
    differing = [str(n) for n in {**one, **other} if n not in one or n not in other or not _same(one[n], other[n])]
    if differing:
        raise InputError(
            f"reduce = {reduction.name!r} gives another {' and '.join(differing)} for a scenario alone than among "
            "others: treat each scenario alone, to the last bit"
        )
    return reduced


def _call(reduction: Source, traces: xr.Dataset) -> xr.Dataset:
    function = load_code("reduce", reduction)
    with its_errors(f"reduce = {reduction.name!r} raised"):
        found = function(traces.copy())
    problems = list(_problems(found, traces))
    if problems:
        raise InputError([f"reduce = {reduction.name!r} returned {problem}" for problem in problems])
    labels = {dim: _copy(found[dim].variable) for dim in _dims(found) if dim in found.coords}
    made = xr.Dataset({n: _copy(v.variable).transpose(SCENARIO, ...) for n, v in found.data_vars.items()}, labels)
    if not _is_storable(made):
        raise InputError(
            f"reduce = {reduction.name!r} returned names or labels that no file gives back as they are: use letters, "
            "digits and _ for names, numbers or words for labels"
        )
    return made


def _is_storable(made: xr.Dataset) -> bool:
    """Whether a file gives a Dataset back as it is."""
    try:
        back = load(bytes(netcdf_bytes(made)))
    except Exception:  # the libraries raise many things at what they cannot write
        return False
    return back.identical(made) and all(str(name).isidentifier() for name in (*made.variables, *made.dims))


def _copy(variable: xr.Variable) -> xr.Variable:
    """The numbers or labels of a variable, in this machine's byte order, and its words."""
    values = np.array(variable.values, order="C")
    attrs = {word: said for word in _WORDS if isinstance(said := variable.attrs.get(word), str) and is_text(said)}
    return xr.Variable(variable.dims, values.astype(values.dtype.newbyteorder("="), copy=False), attrs)


def _problems(found: Any, traces: xr.Dataset) -> Iterable[str]:
    """What is wrong with the answer of a reduction of ``traces``, a sentence each."""
    if not isinstance(found, xr.Dataset):
        yield f"a {type(found).__name__}: return an xarray.Dataset"
        return
    if not found.data_vars:
        yield "an empty Dataset: return at least one variable"
    # labels of the scenarios come with the traces, so that these names are taken too
    taken = {str(name) for name in traces.coords} - {"elapsed_time", "volume"}
    for name, array in found.data_vars.items():
        if name in _TAKEN_NAMES | taken:
            yield f"a variable {name}: the name is taken, choose another"
        if SCENARIO not in array.dims:
            yield f"{name} without the dim {SCENARIO!r}: give one value, or more, for each scenario"
        elif array.sizes[SCENARIO] != traces.sizes[SCENARIO]:
            yield f"{name} for {array.sizes[SCENARIO]} of {traces.sizes[SCENARIO]} scenarios: keep every one of them"
        if array.dtype.kind not in "biu" and array.dtype not in _FLOATS:
            yield f"{name} of type {array.dtype}: return numbers (float64, float32 or integers) or booleans"
    for dim in _dims(found):
        if dim in _TAKEN_DIMS | taken:
            yield f"a dim {dim}: the name is taken, choose another"


def _dims(found: xr.Dataset) -> list[Any]:
    """The dims of its variables besides the scenario."""
    return list(dict.fromkeys(dim for array in found.data_vars.values() for dim in array.dims if dim != SCENARIO))


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
    return one.dtype == other.dtype and bool(one.equals(other))  # type: ignore[no-untyped-call]
