"""The value of one parameter: a number, a word, or a sweep over named dimensions, checked and in its own type."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import is_text, plain
from fastcoil.base.arrays import MOST_VALUES, array_of
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.model.metric_table import METRICS, PREDICTIONS, TRACES
from fastcoil.model.parameter_table import COUNTS, LARGEST, PARAMETERS, Parameter, Scalar

FORBIDDEN_DIMS = {"day", "replicate", "volume", "elapsed_time", "status", *METRICS, *PREDICTIONS, *TRACES}
"""Names that a swept dimension cannot have: dimensions and variables of a result."""
SHORTEST_SERIES = 3600
"""Values, an hour of seconds: a list of that many may be a time series by mistake."""
SERIES_HINT = (
    "did you mean a series?  A parameter does not change during a run: a series goes into fc.Boundary(…), an open-loop "
    "command into simulate(…, command=…)"
)


def checked_value(parameter: Parameter, value: Any) -> Scalar | xr.DataArray:
    """Return a scalar in the parameter's type, or a DataArray of admissible values.

    value: a number, a word, a list (its own dimension), ``(dim, values)`` or a DataArray.

    Raises
    ------
    InputError
        For a wrong type, a value out of bounds, an empty or duplicated axis, or a dimension that cannot be swept.
    """
    if isinstance(value, xr.DataArray):
        return _checked_array(parameter, value) if value.ndim else checked_value(parameter, value.values)
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], str) and not isinstance(value[1], str):
        return _checked_array(parameter, xr.DataArray(_vector(parameter, value[1]), dims=value[0]))
    if isinstance(value, (list, tuple, range)) or (isinstance(value, np.ndarray) and value.ndim):
        return _checked_array(parameter, xr.DataArray(_vector(parameter, value), dims=parameter.name))
    value = plain(value)
    problem = parameter.problem(value)
    if problem:
        raise InputError(problem)
    return value if parameter.is_word else int(value) if parameter.name in COUNTS else float(value)


def _vector(parameter: Parameter, values: Any) -> np.ndarray:
    if not isinstance(values, (list, tuple, range)):
        values = array_of(parameter.name, values, "give a list of values", "iufUbOM")
    if isinstance(values, np.ndarray) and values.ndim != 1:
        raise InputError(
            f"{parameter.name}: a sweep is a list of values; give a DataArray with named dims for more dimensions"
        )
    if len(values) > MOST_VALUES:
        raise InputError(f"{parameter.name} has {len(values):,} values: give at most {MOST_VALUES:,}")
    for given in _doubtful(values) if isinstance(values, np.ndarray) and not parameter.is_word else values:
        value = given if type(given) in (float, int, str) else plain(given)
        if isinstance(value, (np.ndarray, list, tuple)):
            raise InputError(
                f"{parameter.name} = {shown(value)} in a list: give a DataArray with named dims for more dimensions"
            )
        fits = isinstance(value, str) if parameter.is_word else type(value) in (int, float) and abs(value) <= LARGEST
        problem = None if fits else parameter.problem(value)
        if problem:
            raise InputError(problem)
    return np.asarray(values)


def _doubtful(values: np.ndarray) -> np.ndarray:
    """Those that have to be looked at one by one; a million good numbers cost nothing."""
    if values.dtype.kind not in "iuf":
        return values
    with np.errstate(over="ignore"):
        fine = np.abs(values.astype(float)) <= LARGEST
    return np.asarray(values[~fine])


def _checked_array(parameter: Parameter, array: xr.DataArray) -> xr.DataArray:
    name = parameter.name
    if array.size == 0:
        raise InputError(f"{name} = []: a sweep needs at least one value")
    for dim in array.dims:
        _check_dim(name, dim, array.ndim)
        if dim in array.coords:
            _check_labels(name, str(dim), array.coords[dim].values)
    if not parameter.is_word:
        if array.dtype.kind not in "iuf":
            raise InputError(WrongType(f"{name} has values of type {array.dtype}: give numbers"))
        kind = int if name in COUNTS and array.dtype.kind in "iu" else float
        array = array.copy(data=array.values.astype(kind))
    flat = array.values.ravel()
    bad = [p for p in (parameter.problem(v) for v in _suspects(parameter, flat)) if p]
    if bad:
        raise InputError(bad[0] if len(bad) == 1 else f"{bad[0]} (and {len(bad) - 1} more of its values)")
    if name in COUNTS:
        array = array.astype(int)
    if array.dims == (name,):
        # a label such as 0.07 must be found on an axis made by linspace
        values = flat if parameter.is_word else np.array([float(f"{v:.12g}") for v in flat], dtype=array.dtype)
        unique, counts = np.unique(values, return_counts=True)
        if unique.size < values.size:
            hint = f"; {SERIES_HINT}" if values.size >= SHORTEST_SERIES else ""
            raise InputError(f"{name}: {unique[counts > 1][0]} appears twice on its axis: leave one out{hint}")
        array = xr.DataArray(values, dims=name)
    return array


def _suspects(parameter: Parameter, flat: np.ndarray) -> list[Any]:
    """Return the values that may be inadmissible; so a million good ones cost nothing."""
    if parameter.is_word:
        return [v for v in flat.tolist() if not (isinstance(v, str) and v in parameter.choices)]
    fine = np.isfinite(flat) & (flat > parameter.lower) & (flat < parameter.upper)
    if parameter.whole:
        fine &= flat == np.floor(flat)
    return [v for v in flat[~fine].tolist()]


def _check_dim(name: str, dim: Hashable, ndim: int) -> None:
    if not isinstance(dim, str) or dim in FORBIDDEN_DIMS:
        raise InputError(f"{name}: {shown(dim)} cannot be the name of a swept dimension: it is taken, choose another")
    if not dim.isidentifier() or dim in ("method", "tolerance", "drop", "indexers", "missing_dims"):
        raise InputError(f"{name}: {shown(dim)} cannot be the name of a dimension; use letters, digits and _")
    if dim in PARAMETERS and dim == name and ndim > 1:
        raise InputError(f"{name}: its own name can only be the dimension of a plain list of its values")


def _check_labels(name: str, dim: str, labels: np.ndarray) -> None:
    """Refuse labels along a dimension that no file can hold."""
    if labels.dtype.kind in "biuf" or all(isinstance(label, str) and is_text(label) for label in labels.ravel()):
        return
    raise InputError(f"{name}: the labels along {dim!r} are of type {labels.dtype}: give numbers or text")
