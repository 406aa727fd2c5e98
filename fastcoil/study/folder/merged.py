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

from fastcoil.base.arrays import on_disk
from fastcoil.base.errors import IntegrityError
from fastcoil.base.files import storage_errors
from fastcoil.design.prediction import predictions
from fastcoil.loops.netcdf import Slabs, append_slabs, layout_of, slabs_of, write
from fastcoil.loops.provenance import VariableHash, combined_sha256, variable_sha256
from fastcoil.loops.scenarios import check_same_form, join_flat, unflatten
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.study.file.spec import Study
from fastcoil.study.folder import stored
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.results import study_attributes
from fastcoil.study.folder.stored import Manifest

Parts = Callable[[Collection[str]], Iterable[xr.Dataset]]
"""Reads the flat parts of the study without the named variables, afresh at every call: they need not fit in memory
together."""


def merge(folder: StudyFolder, study: Study, manifest: Manifest, parts: Parts, attrs: dict[str, Any]) -> xr.Dataset:
    """Write all parts as one labelled result, its traces in a file of their own, and remove the shards.

    folder, study, manifest: where, what, and the run to which the parts belong.  parts: reads the parts.  attrs:
    further attributes of the result.  Returns what ``StudyFolder.open_results`` does.  ``IntegrityError`` if parts were
    lost since they were written.
    """
    plan = study.plan

    def counted(leave_out: Collection[str]) -> Iterator[xr.Dataset]:
        left = plan.n_scenarios
        for part in parts(leave_out):
            left -= part.sizes["scenario"]
            yield part
        if left > 0:
            raise IntegrityError(
                f"{folder.path}: {left:,} scenarios were lost after they had been run: run the study again"
            )

    untraced = (part.drop_vars(_trace_coordinates(part)) for part in counted(TRACES))
    with storage_errors(folder.results, "written"):
        whole = join_flat(plan.n_scenarios, untraced, allocate=partial(on_disk, folder=folder.path))
    ds = unflatten(whole, plan.layout)
    ds = ds[[n for n in dict.fromkeys((*METRICS, "status", *ds.data_vars)) if n in ds]]
    predicted = predictions(plan) if study.predict else xr.Dataset()
    ds = ds.assign(predicted.data_vars)
    ds.attrs = study_attributes(study, manifest) | predicted.attrs | attrs
    ds.attrs |= study.precision.attributes(ds) if study.precision else {}
    ds.attrs["computed_on"] = json.dumps(list(manifest.computed_on))
    if plan.traces.names and not study.reduction:
        file = folder.path / f"traces-{manifest.key[:8]}.nc"
        manifest, traces = _merge_traces(file, study, counted, ds.attrs, manifest)
        ds = ds.assign_coords(traces.coords).assign_attrs(traces.attrs)
    ds.attrs["content_sha256"] = combined_sha256(ds)
    manifest = stored.publish(folder.results, lambda unfinished: write(ds, unfinished, mode="w"), manifest)
    result = stored.add_traces(ds, folder.path, manifest)
    folder.remove_superseded(result, manifest)
    stored.finished_manifest(result, folder.path, manifest).write(folder.path)
    return result


def _merge_traces(
    path: Path, study: Study, parts: Parts, attrs: dict[str, Any], manifest: Manifest
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
            found = iter(parts({*METRICS, *TRACES} - {name}))
            first = next(found)
            of_first = first.variables[name]
            along = {d: first.variables[d] for d in of_first.dims[1:]}
            ds = unflatten(xr.Dataset(coords=along), plan.layout).assign_attrs(attrs)
            shape = (*plan.layout.sizes.values(), *of_first.shape[1:])
            nothing = np.broadcast_to(np.zeros((), of_first.dtype), shape)
            like = xr.Variable((*plan.layout.sizes, *along), nothing, of_first.attrs)
            places, chunk = slabs_of(shape, n_dims)
            edges = np.cumsum([0, *(math.prod(part.stop - part.start for part in place) for place in places)])
            digest = VariableHash(like.dims, shape)
            values = in_flat_order(chain([first], found), name, edges, path.parent)
            slabs = _hashed(digest, ((p, v.reshape(nothing[p].shape)) for p, v in zip(places, values, strict=True)))
            append = partial(append_slabs, name=name, like=like, chunk=chunk, slabs=slabs)
            write(ds, unfinished, mode="a" if k else "w", then=append)
            hashes[name] = digest.hexdigest(like.attrs)
            hashes.update({n: variable_sha256(ds[n].variable) for n in _trace_coordinates(ds)})
            layout.update(layout_of([(name, like)]))
            coordinates.update({n: ds[n].reset_coords(drop=True) for n in _trace_coordinates(ds)})

    recorded = stored.publish(path, write_all, manifest)
    described = {"trace_sha256": json.dumps(hashes), "trace_layout": json.dumps(layout)}
    return recorded, xr.Dataset(coords=coordinates, attrs={"trace_file": path.name, **described})


def _hashed(digest: VariableHash, slabs: Slabs) -> Slabs:
    for place, values in slabs:
        digest.update(values)
        yield place, values


def in_flat_order(parts: Iterable[xr.Dataset], name: str, edges: np.ndarray, folder: Path) -> Iterator[np.ndarray]:
    """Yield the values of a variable of flat parts, of the scenarios between each two ``edges``.

    Shards come in flat order, but for days in sequence and extended studies: values that come early wait in a nameless
    file in ``folder``.
    """
    waits = np.zeros(edges[-1], dtype=bool)
    slabs, slab, form = pairwise(edges.tolist()), np.empty(0), None
    start = end = missing = 0
    with tempfile.TemporaryFile(dir=folder) as file:
        for part in parts:
            form = check_same_form(form, part)
            index, values = part["scenario"].values, part[name].values
            while True:
                if missing:
                    here = (index >= start) & (index < end)
                    slab[index[here] - start] = values[here]
                    missing -= int(here.sum())
                if missing:
                    break
                if end:
                    yield slab
                if end == waits.size:
                    return
                start, end = next(slabs)
                slab = np.empty((end - start, *values.shape[1:]), values.dtype)
                early = int(waits[start:end].sum())
                if early:
                    file.seek(start * slab[0].nbytes)
                    file.readinto(slab.data)  # type: ignore[attr-defined]
                missing = end - start - early
            later = np.flatnonzero(index >= end)
            waits[index[later]] = True
            for run in np.split(later, np.flatnonzero(np.diff(index[later]) != 1) + 1) if later.size else ():
                file.seek(index[run[0]] * slab[0].nbytes)
                file.write(values[run].data)


def _trace_coordinates(ds: xr.Dataset) -> list[str]:
    return [n for n in ("elapsed_time", "time", "volume") if n in ds.coords]
