"""From shards to ``results.nc`` and ``traces.nc``, and what an unfinished study already has."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.errors import IntegrityError
from fastcoil.files import commit_written, reported
from fastcoil.outputs import METRICS, STATUS_NOT_RUN, TRACES
from fastcoil.simulation.dataset import (
    combined_sha256,
    join_flat,
    load,
    provenance,
    save,
    unflatten,
    variable_sha256,
    write,
)
from fastcoil.simulation.plan import Plan, simulation_attributes
from fastcoil.study.folder.store import RESULTS, discard_shards

Parts = Callable[[Collection[str]], Iterable[xr.Dataset]]
"""Reads the parts of the study anew at every call, the named traces and all that is no trace: they need not fit in
memory together."""
_LARGE = 2**24
"""Bytes."""


def merge(
    folder: Path,
    plan: Plan,
    parts: Parts,
    traces: Sequence[str],
    attrs: dict[str, Any],
    key: str,
    *,
    complete: bool = True,
) -> xr.Dataset:
    """Write all parts as one result, labelled; ``traces`` in a file of their own, named after ``key``.

    Returns it as ``opened`` does.

    Raises
    ------
    IntegrityError
        If parts were lost since they were written; unless ``complete``, only if they are lost in between.
    """

    def found(names: Collection[str], n: int) -> Iterator[xr.Dataset]:
        for part in parts(names):
            n -= part.sizes["scenario"]
            yield part
        if n > 0:
            raise IntegrityError(f"{folder}: {n:,} scenarios were lost after they had been run: run the study again")

    attrs = {"title": "", **provenance(), **simulation_attributes(plan), **attrs}
    everything = found([], plan.n_scenarios if complete else 0)
    with reported(folder / RESULTS, "written"):
        whole = join_flat(plan.n_scenarios, _without_traces(everything), allocate=_allocated(folder))
    ds = unflatten(whole, plan.layout)
    n_run = int((ds["status"] != STATUS_NOT_RUN).sum())
    ds = ds[[n for n in dict.fromkeys((*METRICS, "status", *ds.data_vars)) if n in ds]]
    ds.attrs = attrs
    if traces:
        file = f"traces-{key[:8]}.nc"
        hashes = _merge_traces(folder / file, plan, lambda names: found(names, n_run), traces, attrs)
        ds.attrs |= {"trace_file": file, "trace_sha256": json.dumps(hashes)}
    ds.attrs["content_sha256"] = combined_sha256(ds)
    save(ds, folder / RESULTS)
    return tidied(folder, _with_traces(folder, ds))


def tidied(folder: Path, ds: xr.Dataset) -> xr.Dataset:
    """Remove shards and traces that the results made superfluous.  Returns the results."""
    with reported(folder, "tidied"):
        for path in folder.glob("traces-*.nc"):
            if path.name != ds.attrs.get("trace_file"):
                path.unlink()
    discard_shards(folder)
    return ds


def partial(plan: Plan, parts: Iterable[xr.Dataset], attrs: dict[str, Any]) -> xr.Dataset:
    """What has been computed of a study, in memory; the rest has the status ``not_run``."""
    ds = unflatten(join_flat(plan.n_scenarios, parts), plan.layout)
    ds.attrs = {**provenance(), **simulation_attributes(plan), **attrs}
    return ds


def opened(folder: Path) -> xr.Dataset:
    """The results in a folder, checked against their hash; traces stay on the disk until they are asked for."""
    return _with_traces(folder, load(folder / RESULTS))


def trace_problems(folder: Path, ds: xr.Dataset) -> list[str]:
    """What is wrong with the traces of a result, a sentence each; reads all of them."""
    stored = json.loads(ds.attrs.get("trace_sha256", "{}"))
    wrong = []
    for name, digest in stored.items():
        try:
            same = name in ds.variables and variable_sha256(ds[name].variable) == digest
        except Exception:  # whatever the library makes of damaged bytes
            same = False
        if not same:
            wrong.append(f"{folder / ds.attrs['trace_file']}: {name} is not as it was written")
    return wrong


def _with_traces(folder: Path, ds: xr.Dataset) -> xr.Dataset:
    if "trace_file" not in ds.attrs:
        return ds
    path = folder / ds.attrs["trace_file"]
    try:
        traces = xr.open_dataset(path, engine="netcdf4", decode_times=False, decode_timedelta=False)
    except Exception as error:  # whatever the library makes of a damaged file
        raise IntegrityError(f"{path} cannot be read ({error}): delete {folder} and run the study again") from error
    return ds.assign(traces.data_vars).assign_coords(traces.coords)


def _merge_traces(path: Path, plan: Plan, parts: Parts, traces: Sequence[str], attrs: dict[str, Any]) -> dict[str, str]:
    """Write the traces one by one.  Returns the hash of everything that is only in their file."""
    found: dict[str, str] = {}

    def write_all(unfinished: Path) -> None:
        for k, name in enumerate(traces):
            ds = unflatten(join_flat(plan.n_scenarios, parts([name]), [name], _allocated(path.parent)), plan.layout)
            found.update({n: variable_sha256(ds[n].variable) for n in (name, *_own_coordinates(ds))})
            ds.attrs = attrs
            write(ds, unfinished, mode="a" if k else "w")

    commit_written(path, write_all)
    return found


def _own_coordinates(ds: xr.Dataset) -> list[str]:
    return [n for n in ("elapsed_time", "volume") if n in ds.coords]


def _without_traces(parts: Iterable[xr.Dataset]) -> Iterator[xr.Dataset]:
    for part in parts:
        yield part.drop_vars([n for n in part.data_vars if n in TRACES]).drop_vars(_own_coordinates(part))


def _allocated(folder: Path) -> Callable[[tuple[int, ...], Any, np.dtype[Any]], np.ndarray]:
    """Makes arrays; large ones lie in nameless files, so that a study may be larger than the memory."""

    def allocate(shape: tuple[int, ...], value: Any, dtype: np.dtype[Any]) -> np.ndarray:
        size = dtype.itemsize * int(np.prod(shape))
        if size < _LARGE:
            return np.full(shape, value, dtype)
        with tempfile.TemporaryFile(dir=folder) as file:
            # taken now: a full disk would kill whoever writes to the array later
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            array: np.ndarray = np.memmap(file, dtype, "r+", shape=shape)
        if value != 0:
            array[:] = value
        return array

    return allocate
