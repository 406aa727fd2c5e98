"""A run of a study: its shards, and how they become one result, which may be larger than the memory."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arrays import allocate_on_disk
from fastcoil.base.errors import IntegrityError
from fastcoil.base.files import replace_atomically
from fastcoil.loops.netcdf import append_trace, cut_into_pieces, describe_variables, file_sha256, write
from fastcoil.loops.provenance import combined_sha256, environments_of, variable_sha256
from fastcoil.loops.scenarios import check_same_form, join_flat, unflatten
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.study.file.spec import Study
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.stored import RESULTS_FILE, Manifest, Shards, with_traces

_VALUES_AT_ONCE = 2**22  # read of earlier results
_TRACE_COORDINATES = ("elapsed_time", "time", "volume")
_no_scenarios = partial(np.empty, 0, dtype=np.int64)


@dataclass
class StudyRun:
    """A study in its folder: what is computed of it and what is missing."""

    store: StudyFolder
    study: Study
    manifest: Manifest
    results: xr.Dataset | None = None  # of a finished study
    earlier: xr.Dataset | None = None  # results in the folder of which scenarios are kept
    earlier_index: np.ndarray = field(default_factory=_no_scenarios)  # of these, there
    study_index: np.ndarray = field(default_factory=_no_scenarios)  # and in the study
    missing: np.ndarray = field(default_factory=_no_scenarios)  # flat indices to compute
    _first_scenario: xr.Dataset | None = None

    @property
    def shards(self) -> Shards:
        return Shards(self.store.path, self.manifest.key)

    def commit(self, part: xr.Dataset) -> None:
        """Write the results of a shard, and before them a manifest that names the environment that computed them."""
        # a copy: the shard itself need not be kept
        self._first_scenario = check_same_form(self._first_scenario, part).isel(scenario=[0])
        for environment in environments_of(part):
            if environment not in self.manifest.computed_on:
                self._warn_other_environment(environment)
                self.manifest = replace(self.manifest, computed_on=[*self.manifest.computed_on, environment])
        self.store.write_manifest(self.manifest, self.study.text)
        self.shards.commit(part)

    def _warn_other_environment(self, environment: Mapping[str, str]) -> None:
        for recorded in self.manifest.computed_on:
            values = {name: (recorded.get(name, "unknown"), environment.get(name, "unknown"))
                      for name in sorted({*recorded, *environment})}  # fmt: skip
            differences = [f"{name} {was}, now {is_now}" for name, (was, is_now) in values.items() if was != is_now]
            sentence = f"a part of {self.store.path} was computed elsewhere ({'; '.join(differences)})"
            effect = "the last digits of results may depend on that, in a loop that hunts also the first"
            cure = "to have all from one place, run the study in another folder"
            warnings.warn(f"{sentence}: {effect}; {cure}", stacklevel=4)

    def parts(self, leave_out: Collection[str] = (), *, quarantine: bool = True) -> Iterator[xr.Dataset]:
        """Read all parts, each scenario once, without the variables ``leave_out``: earlier results and shards."""
        parts = self.shards.read(quarantine=quarantine, leave_out=leave_out)
        if self.earlier is not None:
            parts = chain(self._earlier_parts(self.earlier, leave_out), parts)
        seen = np.zeros(self.study.plan.n_scenarios, dtype=bool)
        for part in parts:
            index = part["scenario"].values
            yield part.isel(scenario=~seen[index]) if seen[index].any() else part
            seen[index] = True

    def _earlier_parts(self, earlier: xr.Dataset, leave_out: Collection[str]) -> Iterator[xr.Dataset]:
        """The matched scenarios as flat parts."""
        dims, shape = earlier["status"].dims, earlier["status"].shape
        kept = earlier[[n for n in earlier.data_vars if n not in leave_out]]
        for name in kept.data_vars.keys() - {*TRACES}:  # each once, and not for every piece
            kept[name].load()
        values_per_scenario = max(1, sum(v.size for v in kept.data_vars.values()) // earlier["status"].size)
        end = 0
        for piece in cut_into_pieces(shape, max(1, _VALUES_AT_ONCE // values_per_scenario)):
            block = kept.isel(dict(zip(dims, piece, strict=True)))
            start, end = end, end + math.prod(block.sizes[d] for d in dims)
            in_block = slice(*np.searchsorted(self.earlier_index, [start, end]))
            part = xr.Dataset(coords={"scenario": self.study_index[in_block]})
            for name, variable in block.data_vars.items():
                values = variable.values.reshape(-1, *variable.shape[len(dims) :])
                values = values[self.earlier_index[in_block] - start]
                part[name] = (("scenario", *variable.dims[len(dims) :]), values, variable.attrs)
            part = part.assign_coords({n: c for n, c in earlier.coords.items() if n in part.dims and n != "scenario"})
            n_volumes = self.study.plan.n_volumes  # the earlier result may have had only smaller coils
            if "volume" in part.dims and part.sizes["volume"] < n_volumes:
                part = part.reindex(volume=np.arange(1, n_volumes + 1))
            if part.sizes["scenario"]:
                yield part


def merge_metrics(run: StudyRun) -> xr.Dataset:
    """Join the metrics of all parts of a study over its dims; ``IntegrityError`` if parts were lost meanwhile."""
    ds = _join_parts(run, {*TRACES, *_TRACE_COORDINATES})
    return ds[[n for n in dict.fromkeys((*METRICS, "status", *ds.data_vars)) if n in ds]]


def publish_results(run: StudyRun, ds: xr.Dataset) -> xr.Dataset:
    """Write the metrics ``ds`` and the traces as the results of a study, remove the shards; return the results."""
    if run.study.plan.traces.names and not run.study.reduction:
        traces = _merge_traces(run, ds.attrs)
        ds = ds.assign_coords(traces.coords).assign_attrs(traces.attrs)
    return _write_results(run, ds)


def repair_results(run: StudyRun, ds: xr.Dataset) -> xr.Dataset:
    """Complete the folder of a finished study: a changed title, files that were lost, files it no longer needs."""
    title = {"title": run.study.title, "summary": run.study.question, "study_toml": run.study.text}
    if any(ds.attrs.get(name) != value for name, value in title.items()):
        metrics = ds.drop_vars([name for name in ds.data_vars if name in TRACES]).compute()
        return _write_results(run, metrics.assign_attrs(title))
    run.store.remove_superseded(ds, run.manifest)
    run.store.write_manifest(run.manifest, run.study.text)
    return ds


def _write_results(run: StudyRun, ds: xr.Dataset) -> xr.Dataset:
    """Write results.nc and what says that it is complete; remove what it replaces."""
    ds.attrs["content_sha256"] = combined_sha256(ds)
    _publish_file(run, RESULTS_FILE, lambda unfinished: write(ds, unfinished, mode="w"))
    run.store.remove_superseded(ds, run.manifest)
    trace_file = ds.attrs.get("trace_file")
    outputs = {name: run.manifest.outputs[name][:1] for name in (RESULTS_FILE, trace_file) if name}
    run.manifest = replace(run.manifest, outputs=outputs, finished=True)
    run.store.write_manifest(run.manifest, run.study.text)
    return ds if trace_file is None else with_traces(ds, run.store.path / trace_file, outputs[trace_file])


def _publish_file(run: StudyRun, name: str, write: Callable[[Path], object]) -> None:
    """Write a final file, or replace it; ``write`` gets the name to use.  Its hash comes into the manifest before."""
    path = run.store.path / name

    def record(unfinished: Path) -> None:
        current = file_sha256(path) if path.exists() else ""
        new, recorded = file_sha256(unfinished), run.manifest.outputs
        hashes = [new, *(digest for digest in recorded.get(name, ()) if digest == current != new)]
        run.manifest = replace(run.manifest, outputs={**recorded, name: hashes}, finished=False)
        run.store.write_manifest(run.manifest, run.study.text)

    replace_atomically(path, write, record)


def _join_parts(run: StudyRun, leave_out: Collection[str]) -> xr.Dataset:
    """Join all parts over the dims of the study, without the variables ``leave_out``; large arrays are on the disk."""
    plan, parts = run.study.plan, _read_parts(run, leave_out)
    flat = join_flat(plan.n_scenarios, parts, partial(allocate_on_disk, folder=run.store.path))
    return unflatten(flat, plan.layout)


def _read_parts(run: StudyRun, leave_out: Collection[str]) -> Iterator[xr.Dataset]:
    """Read the parts one by one, since they need not fit in memory together, and miss none."""
    n_left = run.study.plan.n_scenarios
    for part in run.parts(leave_out):
        n_left -= part.sizes["scenario"]
        yield part.drop_vars(leave_out, errors="ignore")
    if n_left > 0:
        sentence = f"{run.store.path}: {n_left:,} scenarios were lost after they had been run"
        raise IntegrityError(f"{sentence}: run the study again")


def _merge_traces(run: StudyRun, attrs: dict[str, Any]) -> xr.Dataset:
    """Write the traces one by one; return the coordinates and attributes that the results must have of them."""
    file_name, n_dims = f"traces-{run.manifest.key[:8]}.nc", len(run.study.plan.layout.sizes)
    hashes: dict[str, str] = {}
    layout: dict[str, Any] = {}
    coordinates: dict[Any, xr.DataArray] = {}

    def write_all(unfinished: Path) -> None:
        for k, name in enumerate(run.study.plan.traces.names):
            ds = _join_parts(run, {*METRICS, *TRACES} - {name})
            trace, ds = ds[name].variable, ds.drop_vars([name, "status"]).assign_attrs(attrs)
            append = partial(append_trace, name=name, trace=trace, n_dims=n_dims)
            write(ds, unfinished, mode="a" if k else "w", append_rest=append)
            hashes[name] = variable_sha256(trace)
            layout.update(describe_variables([(name, trace)]))
            coordinates.update({n: ds[n].reset_coords(drop=True) for n in _TRACE_COORDINATES if n in ds.coords})

    _publish_file(run, file_name, write_all)
    hashes.update({n: variable_sha256(coordinate.variable) for n, coordinate in coordinates.items()})
    descriptions = {"trace_sha256": json.dumps(hashes), "trace_layout": json.dumps(layout)}
    return xr.Dataset(coords=coordinates, attrs={"trace_file": file_name, **descriptions})
