"""The few scenarios of a result that a figure over time shows, each in words."""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import instance_of
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.base.figures import COLOURS
from fastcoil.loops.labels import is_parameter, label_in_words, quantity_of
from fastcoil.model.metric_table import TRACES
from fastcoil.model.parameter_table import PARAMETERS

_CURE = "give a Dataset of fastcoil.simulate with traces, or one of them such as ds.T_sup"
_HOUR = 3600.0


class Scenario(NamedTuple):
    """One scenario of a result: what the legend calls it, blank if there is no other; its variables."""

    words: str
    ds: xr.Dataset


def traced(data: Any) -> xr.Dataset:
    """A result that has traces, as a Dataset.

    Raises
    ------
    InputError
        For anything else.
    """
    if isinstance(data, xr.DataArray):
        if data.name not in TRACES or "elapsed_time" not in data.dims:
            raise InputError(f"data is {shown(data.name)}, which is no trace along elapsed_time: {_CURE}")
        data = data.to_dataset()
    ds = instance_of("data", data, xr.Dataset, _CURE)
    if not isinstance(ds, xr.Dataset):  # as a type checker sees it
        raise InputError(WrongType(_CURE))
    if "elapsed_time" not in ds.coords or not any(n in ds for n in TRACES):
        raise InputError('data has no traces: simulate with traces=["T_sup", "command"], or give a result that has')
    if not ds.sizes["elapsed_time"]:
        raise InputError("data has no point along elapsed_time: give a part of the result that has some")
    return ds


def scenarios_of(ds: xr.Dataset, names: Collection[str]) -> list[Scenario]:
    """The scenarios of these traces.

    Raises
    ------
    InputError
        If a trace has volumes, or there are more scenarios than a figure shows.
    """
    sizes = {str(d): n for name in names for d, n in ds[name].sizes.items() if d != "elapsed_time"}
    if "volume" in sizes:
        raise InputError(f"the traces have {sizes['volume']} volumes: select one, such as ds.sel(volume=1)")
    n = math.prod(sizes.values())
    if n > len(COLOURS):
        example = next(d for d, size in sizes.items() if size > 1)
        few = f"such as ds.isel({example}=[0, {sizes[example] - 1}])" if n == sizes[example] else "with isel or sel"
        raise InputError(f"data has {n:,} scenarios: a figure over time shows up to {len(COLOURS)}, select some, {few}")
    found = []
    for index in np.ndindex(*sizes.values()):
        place = dict(zip(sizes, index, strict=True))
        differs = [d for d in sizes if sizes[d] > 1]
        words = ", ".join(_words(ds, d, place[d]) for d in differs)
        found.append(Scenario(words, ds.isel(place)))
    return found


def _words(ds: xr.Dataset, dim: str, k: int) -> str:
    """One label of a dim; of a dim that only numbers scenarios, the parameters that go along with it."""
    along = [str(n) for n in ds.coords if n != dim and ds[n].dims == (dim,) and is_parameter(ds, n)]
    numbered = dim not in ds.coords or (ds[dim].dtype.kind in "iu" and dim not in ("day", "replicate"))
    if numbered and along and not is_parameter(ds, dim):
        return ", ".join(_value(ds, n, ds[n].values[k]) for n in along)
    return label_in_words(ds, dim, k)


def _value(ds: xr.Dataset, name: str, value: Any) -> str:
    return str(value) if isinstance(value, str) else quantity_of(ds, name).equals(float(value))


def parameter_of(one: xr.Dataset, name: str) -> float:
    """A parameter of one scenario.

    Raises
    ------
    InputError
        If the Dataset does not hold it.
    """
    if name in one.coords and one[name].ndim == 0:
        return float(one[name])
    try:
        return float(json.loads(one.attrs["parameters"])[name])
    except (KeyError, TypeError, ValueError):
        text = PARAMETERS[name].label
        raise InputError(f"data does not say its {text}: give the whole Dataset of fastcoil.simulate") from None


def times(one: xr.Dataset) -> tuple[Any, str]:
    """Where the points of a trace lie along the x axis, and its label: dates where they are known, else hours."""
    if "time" in one.coords and one["time"].dims == ("elapsed_time",):
        zone = one["time"].attrs.get("time_zone", "")
        return one["time"].values, f"date and time{f' ({zone})' if zone else ''}"
    return one["elapsed_time"].values / _HOUR, "time from the start [h]"


def interval_of(one: xr.Dataset) -> float:
    """Seconds between the points of a trace."""
    seconds = one["elapsed_time"].values
    return float(seconds[1] - seconds[0]) if seconds.size > 1 else math.inf
