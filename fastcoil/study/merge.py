"""From shards to ``results.nc`` and ``traces.nc``, and what an unfinished study already has."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.errors import IntegrityError
from fastcoil.files import UNFINISHED, commit_written
from fastcoil.outputs import METRICS, TRACES
from fastcoil.plan import Plan, settings
from fastcoil.results import combined_sha256, gather, load, provenance, save, unflattened, variable_sha256, write
from fastcoil.study.store import RESULTS

Parts = Callable[[Collection[str]], Iterable[xr.Dataset]]
"""Reads the parts of the study anew at every call, the named traces and all that is no trace: they need not fit in
memory together."""


def merge(folder: Path, plan: Plan, parts: Parts, traces: Sequence[str], attrs: dict[str, Any], key: str) -> xr.Dataset:
    """Write all parts as one result, labelled; ``traces`` in a file of their own, named after ``key``.

    Returns it as ``opened`` does.
    """
    attrs = {"title": "", **provenance(), **settings(plan), **attrs}
    ds = unflattened(gather(plan.n_scenarios, _without_traces(parts([]))), plan.layout)
    ds = ds[[n for n in dict.fromkeys((*METRICS, "status", *ds.data_vars)) if n in ds]]
    ds.attrs = attrs
    if traces:
        file = f"traces-{key[:8]}.nc"
        hashes = _merge_traces(folder / file, plan, parts, traces, attrs)
        ds.attrs |= {"trace_file": file, "trace_sha256": json.dumps(hashes)}
    ds.attrs["content_sha256"] = combined_sha256(ds)
    save(ds, folder / RESULTS)
    for path in folder.glob("traces-*.nc"):
        if path.name != ds.attrs.get("trace_file"):
            path.unlink()
    return _with_traces(folder, ds)


def partial(plan: Plan, parts: Iterable[xr.Dataset], attrs: dict[str, Any]) -> xr.Dataset:
    """What has been computed of a study, in memory; the rest has the status ``not_run``."""
    ds = unflattened(gather(plan.n_scenarios, parts), plan.layout)
    ds.attrs = {**provenance(), **settings(plan), **attrs}
    return ds


def opened(folder: Path) -> xr.Dataset:
    """The results in a folder, checked against their hash; traces stay on the disk until they are asked for."""
    return _with_traces(folder, load(folder / RESULTS))


def _with_traces(folder: Path, ds: xr.Dataset) -> xr.Dataset:
    if "trace_file" not in ds.attrs:
        return ds
    path = folder / ds.attrs["trace_file"]
    try:
        traces = xr.open_dataset(path, engine="netcdf4", decode_times=False, decode_timedelta=False)
    except OSError as error:
        raise IntegrityError(f"{path} cannot be read ({error}): delete {folder} and run the study again") from error
    return ds.assign(traces.data_vars).assign_coords(traces.coords)


def _merge_traces(path: Path, plan: Plan, parts: Parts, traces: Sequence[str], attrs: dict[str, Any]) -> dict[str, str]:
    """Write the traces one by one.  Returns the hash of everything that is only in their file."""
    found: dict[str, str] = {}
    scratch = path.with_name(f".{path.name}.scratch{UNFINISHED}")

    def write_all(unfinished: Path) -> None:
        for k, name in enumerate(traces):
            ds = unflattened(gather(plan.n_scenarios, parts([name]), [name], _on_disk(scratch)), plan.layout)
            found.update({n: variable_sha256(ds[n].variable) for n in (name, *_own_coordinates(ds))})
            ds.attrs = attrs
            write(ds, unfinished, mode="a" if k else "w")
            scratch.unlink()

    try:
        commit_written(path, write_all)
    finally:
        scratch.unlink(missing_ok=True)
    return found


def _own_coordinates(ds: xr.Dataset) -> list[str]:
    return [n for n in ("elapsed_time", "volume") if n in ds.coords]


def _without_traces(parts: Iterable[xr.Dataset]) -> Iterator[xr.Dataset]:
    for part in parts:
        yield part.drop_vars([n for n in part.data_vars if n in TRACES]).drop_vars(_own_coordinates(part))


def _on_disk(scratch: Path) -> Callable[[tuple[int, ...], Any, np.dtype[Any]], np.ndarray]:
    """An array in a file, whose space is taken now: a full disk would kill whoever writes to the array later."""

    def allocate(shape: tuple[int, ...], value: Any, dtype: np.dtype[Any]) -> np.ndarray:
        with scratch.open("wb") as file:
            size = dtype.itemsize * int(np.prod(shape))
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
        array = np.memmap(scratch, dtype, "r+", shape=shape)
        if value != 0:
            array[:] = value
        return array

    return allocate
