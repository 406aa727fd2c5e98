"""Run a user's own reduction of traces."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fastcoil.errors import InputError
from fastcoil.outputs import METRICS, TRACES
from fastcoil.parameter_table import PARAMETERS, RESERVED_DIMS
from fastcoil.study.file.source import Source
from fastcoil.study.workers.own_code import its_errors, load
from fastcoil.study.workers.surroundings import surroundings_restored

SCENARIO = "scenario"
"""The dimension along which the function gets the traces of a shard."""
_TAKEN = {*PARAMETERS, *METRICS, *TRACES, "status", SCENARIO}
_TAKEN_NAMES = _TAKEN | set(RESERVED_DIMS)
_TAKEN_DIMS = _TAKEN | {"day", "replicate", "sample"}
_FLOATS = (np.dtype(np.float32), np.dtype(np.float64))


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
        attributes that are text or numbers.

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
    problems = _problems(found, traces)
    if problems:
        raise InputError([f"reduce = {reduction.name!r} returned {problem}" for problem in problems])
    further = [d for d in found.dims if d != SCENARIO]
    labels = {d: found.coords[d].variable for d in further if d in found.coords}
    variables = {n: v.transpose(SCENARIO, ...).variable for n, v in found.data_vars.items()}
    reduced = xr.Dataset(variables, coords=labels)
    for variable in reduced.variables.values():
        variable.attrs = {k: v for k, v in variable.attrs.items() if type(v) in (str, int, float)}
    return reduced


def _problems(found: object, traces: xr.Dataset) -> list[str]:
    """What is wrong with the answer of a function, a sentence each."""
    if not isinstance(found, xr.Dataset):
        return [f"a {type(found).__name__}: return an xarray.Dataset"]
    if not found.data_vars:
        return ["an empty Dataset: return at least one variable"]
    problems = []
    # labels of the scenarios come with the traces, so that these names are taken too
    labels = set(traces.coords) - {"elapsed_time", "volume"}
    for name, variable in found.data_vars.items():
        if not isinstance(name, str) or not name.isidentifier():
            problems.append(f"a variable {name!r}: name it with letters, digits and _")
        elif name in _TAKEN_NAMES | labels:
            problems.append(f"a variable {name}: the name is taken, choose another")
        if SCENARIO not in variable.dims:
            problems.append(f"{name} without the dim {SCENARIO!r}: give one value, or more, for each scenario")
        elif variable.sizes[SCENARIO] != traces.sizes[SCENARIO]:
            problems.append(
                f"{name} for {variable.sizes[SCENARIO]} of {traces.sizes[SCENARIO]} scenarios: keep every one of them"
            )
        if variable.dtype.kind not in "biu" and variable.dtype not in _FLOATS:
            problems.append(
                f"{name} of type {variable.dtype}: return numbers (float64, float32 or integers) or booleans"
            )
    for dim in found.dims:
        if dim != SCENARIO and dim in _TAKEN_DIMS | labels:
            problems.append(f"a dim {dim}: the name is taken, choose another")
        elif not isinstance(dim, str) or not dim.isidentifier():
            problems.append(f"a dim {dim!r}: name it with letters, digits and _")
        elif dim in found.coords and not _storable(found.coords[dim].values):
            problems.append(f"labels of {dim} that are neither numbers nor words: give it others, or drop them")
    return problems


def _storable(labels: np.ndarray) -> bool:
    return labels.dtype.kind in "iufU" or all(isinstance(label, str) for label in labels.tolist())


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
