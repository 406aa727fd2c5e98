"""The form of results: others rely on it, and a file with a right hash may have been written by anybody."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from numbers import Real
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.loops.netcdf import CLOCK
from fastcoil.model.metric_table import METRICS, STATUS_MEANINGS
from fastcoil.model.parameter_table import PARAMETERS

_LONGEST_TITLE = 2**20
"""Characters; that of a whole study file."""
_TEXTS = ("study_toml", "study_sha256", "model_sha256", "engine", "trace_file", "trace_sha256", "trace_layout")
_SPEED = ("wall_time_s", "n_jobs", "scenario_days_per_s")
"""Attributes that may be absent."""


def malformed(ds: xr.Dataset) -> list[str]:
    """Names of the attributes, metrics, coordinates and other variables that no result of a study has like this."""
    checks: tuple[Callable[[xr.Dataset], Iterator[str]], ...] = (_attributes, _status, _metrics, _labels, _answers)
    return [name for check in checks for name in check(ds)]


def _attributes(ds: xr.Dataset) -> Iterator[str]:
    title = ds.attrs.get("title")
    if not isinstance(title, str) or len(title) > _LONGEST_TITLE:
        yield "title"
    yield from (name for name in _TEXTS if not isinstance(ds.attrs.get(name, ""), str))
    if any(name in ds.attrs for name in _SPEED):
        yield from (name for name in _SPEED if not isinstance(ds.attrs.get(name), Real))
    if not isinstance(_parsed(ds, "parameters"), dict):
        yield "parameters"
    for name in ("rules", "own_code"):
        if name in ds.attrs and not _is_table_of_texts(_parsed(ds, name)):
            yield name
    days = _parsed(ds, "day_sha256")
    if not isinstance(days, list) or len(days) != ds["status"].sizes.get("day", 1):
        yield "day_sha256"


def _parsed(ds: xr.Dataset, name: str) -> Any:
    try:
        return json.loads(ds.attrs[name])
    except (KeyError, TypeError, ValueError, RecursionError):
        return None


def _is_table_of_texts(value: Any) -> bool:
    """Whether it is name → name → text, as what is written of a study's own rules."""
    return isinstance(value, dict) and all(
        isinstance(each, dict) and all(isinstance(text, str) for text in each.values()) for each in value.values()
    )


def _status(ds: xr.Dataset) -> Iterator[str]:
    status = ds["status"]
    if status.dtype.kind not in "iu" or not np.isin(status.values, np.arange(len(STATUS_MEANINGS))).all():
        yield "status"


def _metrics(ds: xr.Dataset) -> Iterator[str]:
    known = [name for name in METRICS if name in ds.data_vars]  # an older version wrote fewer
    yield from (name for name in known if ds[name].dims != ds["status"].dims or ds[name].dtype != float)
    if "rmse" not in known:
        yield "rmse"


def _labels(ds: xr.Dataset) -> Iterator[str]:
    """Labels of every dimension of the status; what is swept along them, and labels of further dimensions."""
    dims = ds["status"].dims
    yield from (str(dim) for dim in dims if dim not in ds.coords)
    for name, label in ds.coords.items():
        kind, parameter = _kind(label.values), PARAMETERS.get(str(name))
        expected = "d" if name in CLOCK else "nt" if parameter is None else "t" if parameter.is_word else "n"
        placed = label.dims == (name,) or set(label.dims) <= set(dims)  # a rule's own parameters are in no table
        placed |= name == "time" and label.dims == ("elapsed_time",)
        if not placed or kind not in expected or (name in dims and not _tell_apart(label.values, kind)):
            yield str(name)


def _kind(values: np.ndarray) -> str:
    """``n`` for numbers, ``t`` for text, ``d`` for dates, ``?`` for anything else."""
    if values.dtype.kind in "iufM":
        return "d" if values.dtype.kind == "M" else "n"
    is_text = values.dtype.kind == "U" or all(isinstance(value, str) for value in values.ravel())
    return "t" if is_text else "?"


def _tell_apart(labels: np.ndarray, kind: str) -> bool:
    return np.unique(labels).size == labels.size and (kind == "t" or bool(np.isfinite(labels).all()))


def _answers(ds: xr.Dataset) -> Iterator[str]:
    """Traces, and what a function of the user returned."""
    dims = ds["status"].dims
    for name, variable in ds.data_vars.items():
        if name != "status" and (variable.dims[: len(dims)] != dims or variable.dtype.kind not in "biuf"):
            yield str(name)
