"""Run a user's own reduction of traces."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.study.file.source import Source
from fastcoil.study.workers.answer import SCENARIO, take_answer
from fastcoil.study.workers.load_user_module import its_errors, load
from fastcoil.study.workers.process_state import surroundings_restored


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
