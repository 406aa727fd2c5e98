"""Shards become one result: metrics in one go, traces slab by slab, so that a study may be larger than the memory."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import partial
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import allocate_on_disk
from fastcoil.base.errors import IntegrityError
from fastcoil.base.files import convert_os_errors
from fastcoil.design.prediction import predict_study
from fastcoil.loops.netcdf import Slabs, append_slabs, describe_variables, trace_slabs, write
from fastcoil.loops.provenance import VariableHash, combined_sha256, variable_sha256
from fastcoil.loops.scenarios import check_same_form, join_flat, unflatten
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.study.file.spec import Study
from fastcoil.study.folder import stored
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.results import study_attributes
from fastcoil.study.folder.stored import Manifest

PartReader = Callable[[Collection[str]], Iterable[xr.Dataset]]
"""Reads the flat parts of the study without the named variables, afresh at every call: they need not fit in memory
together."""


def merge(
    folder: StudyFolder, study: Study, manifest: Manifest, parts: PartReader, attrs: dict[str, Any]
) -> xr.Dataset:
    """Write all parts as one labelled result, its traces in a file of their own, and remove the shards.

    folder, study, manifest: where, what, and the run to which the parts belong.  parts: reads the parts.  attrs:
    further attributes of the result.  Returns what ``StudyFolder.open_results`` does.  ``IntegrityError`` if parts were
    lost since they were written.
    """
    plan = study.plan

    def read_all_parts(leave_out: Collection[str]) -> Iterator[xr.Dataset]:
        n_left = plan.n_scenarios
        for part in parts(leave_out):
            n_left -= part.sizes["scenario"]
            yield part
        if n_left > 0:
            raise IntegrityError(
                f"{folder.path}: {n_left:,} scenarios were lost after they had been run: run the study again"
            )

    untraced = (part.drop_vars(_find_trace_coordinates(part)) for part in read_all_parts(TRACES))
    with convert_os_errors(folder.results, "written"):
        flat_metrics = join_flat(plan.n_scenarios, untraced, allocate=partial(allocate_on_disk, folder=folder.path))
    ds = unflatten(flat_metrics, plan.layout)
    ds = ds[[n for n in dict.fromkeys((*METRICS, "status", *ds.data_vars)) if n in ds]]
    predicted = predict_study(plan) if study.predict else xr.Dataset()
    ds = ds.assign(predicted.data_vars)
    ds.attrs = study_attributes(study, manifest) | predicted.attrs | attrs
    ds.attrs |= study.precision.result_attributes(ds) if study.precision else {}
    ds.attrs["computed_on"] = json.dumps(list(manifest.computed_on))
    if plan.traces.names and not study.reduction:
        file = folder.path / f"traces-{manifest.key[:8]}.nc"
        manifest, traces = _merge_traces(file, study, read_all_parts, ds.attrs, manifest)
        ds = ds.assign_coords(traces.coords).assign_attrs(traces.attrs)
    ds.attrs["content_sha256"] = combined_sha256(ds)
    manifest = stored.publish_file(folder.results, lambda unfinished: write(ds, unfinished, mode="w"), manifest)
    result = stored.add_traces(ds, folder.path, manifest)
    folder.remove_superseded(result, manifest)
    stored.finished_manifest(result, folder.path, manifest).write(folder.path)
    return result


def _merge_traces(
    path: Path, study: Study, parts: PartReader, attrs: dict[str, Any], manifest: Manifest
) -> tuple[Manifest, xr.Dataset]:
    """Write the traces one by one.

    Returns the manifest with the hash of their file, and what the results must have of them: coordinates, and
    attributes with the hash and the description of every variable.
    """
    plan, n_dims = study.plan, len(study.plan.layout.sizes)
    hashes: dict[str, str] = {}
    layout: dict[str, Any] = {}
    coordinates: dict[Any, xr.DataArray] = {}

    def write_all(unfinished: Path) -> None:
        for k, name in enumerate(plan.traces.names):
            part_iterator = iter(parts({*METRICS, *TRACES} - {name}))
            first = next(part_iterator)
            of_first = first.variables[name]
            along = {d: first.variables[d] for d in of_first.dims[1:]}
            ds = unflatten(xr.Dataset(coords=along), plan.layout).assign_attrs(attrs)
            shape = (*plan.layout.sizes.values(), *of_first.shape[1:])
            shape_only = np.broadcast_to(np.zeros((), of_first.dtype), shape)
            like = xr.Variable((*plan.layout.sizes, *along), shape_only, of_first.attrs)
            places, chunk = trace_slabs(shape, n_dims)
            edges = np.cumsum([0, *(math.prod(part.stop - part.start for part in place) for place in places)])
            digest = VariableHash(like.dims, shape)
            values = iter_flat_order(chain([first], part_iterator), name, edges, path.parent)
            slabs = _hash_slabs(
                digest, ((p, v.reshape(shape_only[p].shape)) for p, v in zip(places, values, strict=True))
            )
            append = partial(append_slabs, name=name, template=like, chunk=chunk, slabs=slabs)
            write(ds, unfinished, mode="a" if k else "w", append_rest=append)
            hashes[name] = digest.hexdigest(like.attrs)
            hashes.update({n: variable_sha256(ds[n].variable) for n in _find_trace_coordinates(ds)})
            layout.update(describe_variables([(name, like)]))
            coordinates.update({n: ds[n].reset_coords(drop=True) for n in _find_trace_coordinates(ds)})

    recorded = stored.publish_file(path, write_all, manifest)
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
            for run in (
                np.split(later_places, np.flatnonzero(np.diff(index[later_places]) != 1) + 1)
                if later_places.size
                else ()
            ):
                file.seek(index[run[0]] * slab[0].nbytes)
                file.write(values[run].data)


def _find_trace_coordinates(ds: xr.Dataset) -> list[str]:
    return [n for n in ("elapsed_time", "time", "volume") if n in ds.coords]
