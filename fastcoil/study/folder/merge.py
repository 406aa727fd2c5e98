"""From the parts of a study, its shards and earlier results, to ``results.nc`` and the file of traces."""

import json
import math
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.errors import IntegrityError
from fastcoil.base.files import storage_errors
from fastcoil.loops.netcdf import layout_of, write
from fastcoil.loops.plan import Plan, simulation_attributes
from fastcoil.loops.provenance import combined_sha256, provenance, variable_sha256
from fastcoil.loops.scenarios import attributes, columns_of, join_flat, unflatten
from fastcoil.model.metric_table import METRICS, PREDICTIONS, STATUS_NOT_RUN, TRACES
from fastcoil.study.file.spec import Study
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.manifest import Manifest
from fastcoil.study.folder.result_files import add_traces, finished_manifest, publish

Parts = Callable[[Collection[str]], Iterable[xr.Dataset]]
"""Reads the flat parts of the study without the named variables, afresh at every call: they need not fit in memory
together."""
_LARGE = 2**24  # bytes
_AT_ONCE = 2048  # scenarios; their responses take up to 60 MB
_DIGITS = "%.6g"  # theory is not more accurate, and the last bits depend on the machine's libraries


def merge(
    folder: StudyFolder,
    study: Study,
    manifest: Manifest,
    parts: Parts,
    attrs: dict[str, Any] | None = None,
    *,
    complete: bool = True,
) -> xr.Dataset:
    """Write all parts as one labelled result, its traces in a file of their own, and remove the shards.

    Parameters
    ----------
    folder, study, manifest
        Where, what, and the run to which the parts belong.
    parts
        Reads the parts.
    attrs
        Further attributes of the result.
    complete
        Whether all scenarios of the study must be in the parts.

    Returns
    -------
    xarray.Dataset
        As of ``StudyFolder.open_results``.

    Raises
    ------
    IntegrityError
        If parts were lost since they were written; unless ``complete``, only if they are lost during the merge.
    """

    def counted(leave_out: Collection[str], n: int) -> Iterator[xr.Dataset]:
        for part in parts(leave_out):
            n -= part.sizes["scenario"]
            yield part
        if n > 0:
            raise IntegrityError(
                f"{folder.path}: {n:,} scenarios were lost after they had been run: run the study again"
            )

    plan = study.plan
    untraced = (p.drop_vars(_trace_coordinates(p)) for p in counted(TRACES, plan.n_scenarios if complete else 0))
    with storage_errors(folder.results, "written"):
        whole = join_flat(plan.n_scenarios, untraced, allocate=_allocator(folder.path))
    ds = unflatten(whole, plan.layout)
    n_run = int((ds["status"].values != STATUS_NOT_RUN).sum())
    ds = ds[[n for n in dict.fromkeys((*METRICS, "status", *ds.data_vars)) if n in ds]]
    predicted = predictions(plan) if study.predict and complete else xr.Dataset()
    ds = ds.assign(predicted.data_vars)
    ds.attrs = study_attributes(study, manifest) | predicted.attrs | (attrs or {})
    ds.attrs["computed_on"] = json.dumps(list(manifest.computed_on))
    if study.kept_traces:
        # a part of the traces is another file than all of them: results and traces are not replaced together
        file = folder.path / f"traces-{manifest.key[:8]}{'' if complete else f'-{n_run}'}.nc"
        manifest, traces = _merge_traces(file, study, lambda leave_out: counted(leave_out, n_run), ds.attrs, manifest)
        ds = ds.assign_coords(traces.coords).assign_attrs(traces.attrs)
    ds.attrs["content_sha256"] = combined_sha256(ds)
    manifest = publish(folder.results, lambda unfinished: write(ds, unfinished, mode="w"), manifest)
    result = add_traces(ds, folder.path, manifest)
    folder.remove_superseded(result, manifest)
    if complete:
        finished_manifest(result, folder.path, manifest).write(folder.path)
    return result


def study_attributes(study: Study, manifest: Manifest) -> dict[str, Any]:
    """The attributes of the results of a study: provenance, settings, and which study it is."""
    attrs = {
        "title": study.title,
        **provenance(),
        **simulation_attributes(study.plan),
        "summary": study.question,
        "study_toml": study.text,
        "study_sha256": study.sha256,
        "model_sha256": manifest.model_sha256,
    }
    traces = study.plan.traces
    if traces.names:
        attrs["traces"] = f"{', '.join(traces.names)} every {traces.interval} s"
    if study.reduction:
        attrs |= {"reduction": study.reduction.name, "reduction_sha256": study.reduction.sha256}
    if study.rules:
        attrs["rules"] = json.dumps({n: {"code": s.name, "sha256": s.sha256} for n, s in sorted(study.rules.items())})
    if manifest.own_code:
        attrs["own_code"] = json.dumps(manifest.own_code)
    return attrs


def predictions(plan: Plan) -> xr.Dataset:
    """Predict margin and limit cycle of every scenario of a study (``[run] predict``).

    The mean conditions and the mean set-point of each day's enabled seconds after the warm-up count, as if they were
    held for ever; noise does not, so that all replicates are alike.  All scenarios are predicted together, so that the
    numbers depend on their number alone and not on who ran them when.

    Returns
    -------
    xarray.Dataset
        ``PREDICTIONS`` over the dims of the study; the attribute ``prediction_note`` says why some are NaN, if they
        are.
    """
    from fastcoil.design.describing_function import unknown
    from fastcoil.design.limit_cycle import cycles_of
    from fastcoil.design.operating_points import mean_conditions
    from fastcoil.design.plants import plants_of

    loop, sizes = plan.layout.loop, plan.layout.sizes
    alike = {dim: n for dim, n in sizes.items() if dim != "replicate"}
    n = math.prod(alike.values())
    entering = mean_conditions(plan.layout.boundary, plan.warm_up, carry_over=plan.carry_over)
    found = {name: np.full(n, np.nan) for name in PREDICTIONS}
    reasons: Counter[str] = Counter()
    for start in range(0, n, _AT_ONCE):
        index = np.arange(start, min(start + _AT_ONCE, n))
        day = columns_of(loop, alike, index)["day"]
        seen = index[np.isfinite(entering["T_set"][day])]
        reasons["no second is enabled after the warm-up"] += index.size - seen.size
        if not seen.size:
            continue
        columns = columns_of(loop, alike, seen)
        reasons.update({reason: int(loops.sum()) for reason, loops in unknown(columns).items()})
        conditions = {name: means[columns["day"]] for name, means in entering.items()}
        cycles = cycles_of(columns, plants_of(columns, conditions))
        predicted = cycles.margin, cycles.hunts, cycles.period, 2.0 * cycles.amplitude
        for name, value in zip(found, predicted, strict=True):
            found[name][seen] = np.char.mod(_DIGITS, value).astype(float)
    ds = xr.Dataset()
    for name, flat in found.items():
        values = xr.DataArray(flat.reshape(tuple(alike.values())), dims=tuple(alike))
        whole = values.expand_dims({d: k for d, k in sizes.items() if d not in alike}).transpose(*sizes)
        ds[name] = (tuple(sizes), np.array(whole.values), attributes(PREDICTIONS[name]))
    note = "; ".join(f"{reason}: {count:,} of {n:,}" for reason, count in reasons.items() if count)
    return ds.assign_attrs({"prediction_note": f"theory says nothing: {note}"} if note else {})


def _merge_traces(
    path: Path, study: Study, parts: Parts, attrs: dict[str, Any], manifest: Manifest
) -> tuple[Manifest, xr.Dataset]:
    """Write the traces one by one.

    Returns the manifest with the hash of their file, and what the results must have of them: coordinates, and
    attributes with the hash and the description of every variable.
    """
    plan, allocate = study.plan, _allocator(path.parent)
    hashes: dict[str, str] = {}
    layout: dict[str, Any] = {}
    coordinates: dict[Any, xr.DataArray] = {}

    def write_all(unfinished: Path) -> None:
        for k, name in enumerate(study.kept_traces):
            others = {*METRICS, *TRACES} - {name}
            ds = unflatten(join_flat(plan.n_scenarios, parts(others), [name], allocate), plan.layout)
            hashes.update({n: variable_sha256(ds[n].variable) for n in (name, *_trace_coordinates(ds))})
            layout.update(layout_of([(name, ds[name].variable)]))
            coordinates.update({n: ds[n].reset_coords(drop=True) for n in _trace_coordinates(ds)})
            ds.attrs = attrs
            write(ds, unfinished, mode="a" if k else "w")

    recorded = publish(path, write_all, manifest)
    described = {"trace_sha256": json.dumps(hashes), "trace_layout": json.dumps(layout)}
    return recorded, xr.Dataset(coords=coordinates, attrs={"trace_file": path.name, **described})


def _trace_coordinates(ds: xr.Dataset) -> list[str]:
    return [n for n in ("elapsed_time", "time", "volume") if n in ds.coords]


def _allocator(folder: Path) -> Callable[[tuple[int, ...], Any, np.dtype[Any]], np.ndarray]:
    """Makes arrays; large ones are in nameless files, so that a study may be larger than the memory."""

    def allocate(shape: tuple[int, ...], value: Any, dtype: np.dtype[Any]) -> np.ndarray:
        size = dtype.itemsize * int(np.prod(shape))
        if size < _LARGE:
            return np.full(shape, value, dtype)
        with tempfile.TemporaryFile(dir=folder) as file:
            # reserved now: on a full disk, a later write to the array would kill the process
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            array: np.ndarray = np.memmap(file, dtype, "r+", shape=shape)
        if value != 0:
            array[:] = value
        return array

    return allocate
