"""A Dataset as the table of a CSV file, so that one reader checks both."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from fastcoil.base.errors import InputError
from fastcoil.logs.table import Table

if TYPE_CHECKING:
    import xarray as xr

_TIMES = ("elapsed_time", "timestamp", "time")


def table_of(ds: xr.Dataset, columns: Mapping[str, str] | None, names: Collection[str]) -> Table:
    """The variables of ``ds`` with one of our ``names``, and those that ``columns`` (our name: its name) asks for.

    They lie along one coordinate: ``elapsed_time``, or one of datetime64 called so, ``timestamp`` or ``time``.  Rows
    count from 0, as in ``isel``.
    """
    if not hasattr(ds, "data_vars"):
        raise InputError(f"log is a {type(ds).__name__}: give the path of a CSV file or an xarray.Dataset")
    asked = dict(columns or {})
    dims = [d for d in (*(asked.get(n, n) for n in _TIMES), *_TIMES) if d in ds.coords and ds[d].dims == (d,)]
    if not dims:
        raise InputError(
            "the Dataset has no coordinate elapsed_time, nor timestamp: give every variable one of them as dimension"
        )
    time = dims[0]
    wanted = [str(n) for n in ds.data_vars if n in names or n in asked.values()]
    wrong = [
        f"{name} has dims {ds[name].dims}: choose one loop, so that only {time} is left"
        for name in wanted
        if ds[name].dims != (time,)
    ]
    if wrong:
        raise InputError(wrong)
    if ds.sizes[time] < 2:
        raise InputError("the Dataset has fewer than two samples: give a longer log")
    header, cells = _time(ds[time], asked)
    for name in wanted:
        header.append(f"{name} [{ds[name].attrs['units']}]" if "units" in ds[name].attrs else name)
        cells.append(_cells(ds[name].values))
    rows = [list(row) for row in zip(*cells, strict=True)]
    return Table("Dataset", header, rows, list(range(len(rows))), unit_cure="give it attrs['units'] = '{unit}'")


def _time(time: xr.DataArray, asked: Mapping[str, str]) -> tuple[list[str], list[list[str]]]:
    """Header and cells of the time: timestamps stay timestamps, unless ``asked`` wants them as seconds."""
    name, values = str(time.name), time.values
    label = name if name in asked.values() else "elapsed_time"
    if values.dtype.kind == "M" and asked.get("elapsed_time") != name:
        stamps = values.astype("datetime64[us]")
        return [name if asked.get("timestamp") == name else "timestamp"], [[str(v) for v in stamps]]
    if values.dtype.kind in "mM":
        seconds = (values - values[0]) / np.timedelta64(1, "s")
        return [f"{label} [s]"], [_cells(seconds)]
    return [f"{label} [{time.attrs['units']}]" if "units" in time.attrs else label], [_cells(values)]


def _cells(values: Any) -> list[str]:
    """Numbers as text that reads back to the bit."""
    return [repr(float(v)) for v in values] if values.dtype.kind in "biuf" else [str(v) for v in values]
