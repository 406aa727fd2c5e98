"""Shards become one result: metrics in one go, traces slab by slab, so that a study may be larger than the memory."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import partial
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import allocate_on_disk
from fastcoil.base.errors import IntegrityError
from fastcoil.base.files import convert_os_errors
from fastcoil.loops.netcdf import Slabs, append_slabs, describe_variables, trace_slabs, write
from fastcoil.loops.provenance import VariableHash, combined_sha256, variable_sha256
from fastcoil.loops.scenarios import check_same_form, join_flat, unflatten
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.study.folder.state import StudyRun
from fastcoil.study.folder.stored import (
    DESCRIPTIVE_ATTRIBUTES,
    Manifest,
    add_traces,
    finished_manifest,
    publish_file,
    study_attributes,
)


def merge_metrics(run: StudyRun) -> xr.Dataset:
    """Join the metrics of all parts of a study over its dims; ``IntegrityError`` if parts were lost meanwhile."""
    plan = run.study.plan
    untraced = (part.drop_vars(_find_trace_coordinates(part)) for part in _read_parts(run, TRACES))
    with convert_os_errors(run.store.results_path, "written"):
        flat = join_flat(plan.n_scenarios, untraced, allocate=partial(allocate_on_disk, folder=run.store.path))
    ds = unflatten(flat, plan.layout)
    return ds[[n for n in dict.fromkeys((*METRICS, "status", *ds.data_vars)) if n in ds]]


def publish_results(run: StudyRun, ds: xr.Dataset, measured: Mapping[str, Any]) -> xr.Dataset:
    """Write the metrics ``ds`` as the results of a study, its traces in a file of their own, and remove the shards.

    measured: attributes that say how the run went.  Returns the results as they are opened.
    """
    study, manifest = run.study, run.manifest
    if study.precision:
        measured = {**measured, **study.precision.result_attributes(ds)}
    ds = ds.assign_attrs(study_attributes(study, manifest, measured))
    if study.plan.traces.names and not study.reduction:
        manifest, traces = _merge_traces(run, ds.attrs)
        ds = ds.assign_coords(traces.coords).assign_attrs(traces.attrs)
    return _write_results(run, ds, manifest)


def repair_results(run: StudyRun, ds: xr.Dataset) -> xr.Dataset:
    """Complete the folder of a finished study: a changed title, files that were lost, files it no longer needs."""
    attrs = study_attributes(run.study, run.manifest)
    title = {name: attrs[name] for name in DESCRIPTIVE_ATTRIBUTES}
    if any(ds.attrs.get(name) != value for name, value in title.items()):
        metrics = ds.drop_vars([name for name in ds.data_vars if name in TRACES]).load()
        return _write_results(run, metrics.assign_attrs(title), run.manifest)
    run.manifest = finished_manifest(ds, run.store.path, run.manifest)
    run.record()
    run.store.remove_superseded(ds, run.manifest)
    return ds


def _write_results(run: StudyRun, ds: xr.Dataset, manifest: Manifest) -> xr.Dataset:
    """Write results.nc and what says that it is complete; remove what it replaces."""
    store = run.store
    ds.attrs["content_sha256"] = combined_sha256(ds)
    manifest = publish_file(store.results_path, lambda unfinished: write(ds, unfinished, mode="w"), manifest)
    result = add_traces(ds, store.path, manifest)
    store.remove_superseded(result, manifest)
    store.write_manifest(finished_manifest(result, store.path, manifest), run.study.text)
    return result


def _read_parts(run: StudyRun, leave_out: Collection[str]) -> Iterator[xr.Dataset]:
    """Read the parts one by one, since they need not fit in memory together, and miss none."""
    n_left = run.study.plan.n_scenarios
    for part in run.parts(leave_out):
        n_left -= part.sizes["scenario"]
        yield part
    if n_left > 0:
        raise IntegrityError(
            f"{run.store.path}: {n_left:,} scenarios were lost after they had been run: run the study again"
        )


def _merge_traces(run: StudyRun, attrs: dict[str, Any]) -> tuple[Manifest, xr.Dataset]:
    """Write the traces one by one.

    Returns the manifest with the hash of their file, and what the results must have of them: coordinates, and
    attributes with the hash and the description of every variable.
    """
    plan, path = run.study.plan, run.store.path / f"traces-{run.manifest.key[:8]}.nc"
    hashes: dict[str, str] = {}
    layout: dict[str, Any] = {}
    coordinates: dict[Any, xr.DataArray] = {}

    def write_all(unfinished: Path) -> None:
        for k, name in enumerate(plan.traces.names):
            parts = _read_parts(run, {*METRICS, *TRACES} - {name})
            first = next(parts)
            of_first = first.variables[name]
            along = {d: first.variables[d] for d in of_first.dims[1:]}
            ds = unflatten(xr.Dataset(coords=along), plan.layout).assign_attrs(attrs)
            shape = (*plan.layout.sizes.values(), *of_first.shape[1:])
            shape_only = np.broadcast_to(np.zeros((), of_first.dtype), shape)
            like = xr.Variable((*plan.layout.sizes, *along), shape_only, of_first.attrs)
            places, chunk = trace_slabs(shape, len(plan.layout.sizes))
            edges = np.cumsum([0, *(math.prod(part.stop - part.start for part in place) for place in places)])
            digest = VariableHash(like.dims, shape)
            values = iter_flat_order(chain([first], parts), name, edges, path.parent)
            slabs = ((p, v.reshape(shape_only[p].shape)) for p, v in zip(places, values, strict=True))
            append = partial(append_slabs, name=name, template=like, chunk=chunk, slabs=_hash_slabs(digest, slabs))
            write(ds, unfinished, mode="a" if k else "w", append_rest=append)
            hashes[name] = digest.hexdigest(like.attrs)
            hashes.update({n: variable_sha256(ds[n].variable) for n in _find_trace_coordinates(ds)})
            layout.update(describe_variables([(name, like)]))
            coordinates.update({n: ds[n].reset_coords(drop=True) for n in _find_trace_coordinates(ds)})

    recorded = publish_file(path, write_all, run.manifest)
    descriptions = {"trace_sha256": json.dumps(hashes), "trace_layout": json.dumps(layout)}
    return recorded, xr.Dataset(coords=coordinates, attrs={"trace_file": path.name, **descriptions})


def _hash_slabs(digest: VariableHash, slabs: Slabs) -> Slabs:
    for place, values in slabs:
        digest.update(values)
        yield place, values


def iter_flat_order(parts: Iterable[xr.Dataset], name: str, edges: np.ndarray, folder: Path) -> Iterator[np.ndarray]:
    """Yield the values of a variable of flat parts, of the scenarios between each two ``edges``.

    Shards come in flat order, but for days in sequence and extended studies: values that come early wait in a nameless
    file in ``folder``.
    """
    is_waiting = np.zeros(edges[-1], dtype=bool)
    slabs, slab, form = pairwise(edges.tolist()), np.empty(0), None
    start = end = n_missing = 0
    with tempfile.TemporaryFile(dir=folder) as file:
        for part in parts:
            form = check_same_form(form, part)
            index, values = part["scenario"].values, part[name].values
            while True:
                if n_missing:
                    is_in_slab = (index >= start) & (index < end)
                    slab[index[is_in_slab] - start] = values[is_in_slab]
                    n_missing -= int(is_in_slab.sum())
                if n_missing:
                    break
                if end:
                    yield slab
                if end == is_waiting.size:
                    return
                start, end = next(slabs)
                slab = np.empty((end - start, *values.shape[1:]), values.dtype)
                n_early = int(is_waiting[start:end].sum())
                if n_early:
                    file.seek(start * slab[0].nbytes)
                    file.readinto(slab.data)  # type: ignore[attr-defined]
                n_missing = end - start - n_early
            later_places = np.flatnonzero(index >= end)
            is_waiting[index[later_places]] = True
            gaps = np.flatnonzero(np.diff(index[later_places]) != 1) + 1
            for run in np.split(later_places, gaps) if later_places.size else ():
                file.seek(index[run[0]] * slab[0].nbytes)
                file.write(values[run].data)


def _find_trace_coordinates(ds: xr.Dataset) -> list[str]:
    return [n for n in ("elapsed_time", "time", "volume") if n in ds.coords]
