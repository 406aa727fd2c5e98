"""The results of a study: opened, also before it is finished, and checked."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from pathlib import Path

import xarray as xr

from fastcoil.base.arguments import require_path
from fastcoil.base.arrays import allocate_on_disk
from fastcoil.base.errors import FastcoilError, InputError, IntegrityError, StorageError
from fastcoil.base.figures import stale_figures
from fastcoil.base.machine import available_memory, command_line, format_bytes
from fastcoil.loops.scenarios import check_same_form, join_flat, unflatten
from fastcoil.model.metric_table import STATUS_NOT_RUN, TRACES
from fastcoil.study.folder import stored
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.state import FolderState, is_complete_result_of, is_result_of

# --- opened -----------------------------------------------------------------------------------------------------------


def open_study(folder: str | Path) -> xr.Dataset:
    """Open the results of a study by its folder, checked against their hash.

    An unfinished study opens as well: scenarios that are not computed yet have the status ``not_run``.  Traces of a
    finished one stay on the disk until they are read.

    Parameters
    ----------
    folder
        What ``fastcoil run`` wrote, such as ``results/robustness``.

    Returns
    -------
    xarray.Dataset
        Metrics and ``status`` over the dims of the study, and its traces.

    Raises
    ------
    InputError
        If the folder holds no study, or no scenario is finished yet.
    StorageError, IntegrityError
        If a file cannot be read; if a file is damaged.
    """
    store = StudyFolder(require_path("folder", folder, "give the folder of a study"))
    return store.read_consistently(lambda: _open_folder(store))


def open_metrics(folder: Path, leave_out: Collection[str] = TRACES) -> xr.Dataset:
    """Open the results of a study without traces, which of an unfinished one would be loaded; raises as it does."""
    store = StudyFolder(folder)
    return store.read_consistently(lambda: _open_folder(store, leave_out)).drop_vars(leave_out, errors="ignore")


def open_finished(folder: Path) -> xr.Dataset:
    """Open the results of a finished study; ``InputError`` if scenarios are missing, the rest as ``open_study``."""
    ds = open_study(folder)
    n, n_missing = ds["status"].size, int((ds["status"].values == STATUS_NOT_RUN).sum())
    if n_missing or "content_sha256" not in ds.attrs:
        command = command_line(["fastcoil", "run", StudyFolder(folder).find_source(), "-o", str(folder)])
        sentence = f"{folder} is unfinished: {n - n_missing:,} of {n:,} scenarios are done; finish it with `{command}`"
        raise InputError(sentence, str(folder), "data")
    return ds


def _open_folder(store: StudyFolder, leave_out: Collection[str] = ()) -> xr.Dataset:
    """Open the results of a merge, else join what is computed so far."""
    manifest, state = store.require_manifest(), FolderState.read(store)
    if state.results is not None and state.is_merged and is_result_of(state.results, manifest):
        return state.results
    if state.results is None and manifest.finished:
        raise IntegrityError(f"{store.results_path} is missing: run the study again")
    study = store.read_study(manifest) if state.results is not None or state.has_shards else None
    if study is not None:
        if study.plan.trace_bytes > available_memory() and not leave_out:
            size = format_bytes(study.plan.trace_bytes)
            sentence = f"{store.path} is unfinished, and its traces, {size}, do not fit into memory: they are left out"
            warnings.warn(sentence, stacklevel=4)
            leave_out = TRACES
        parts = state.keep_scenarios(study, manifest).parts(leave_out, quarantine=False)
        ds = unflatten(join_flat(study.plan.n_scenarios, parts, allocate=allocate_on_disk), study.plan.layout)
        if ds.data_vars:
            return ds.assign_attrs(stored.study_attributes(study, manifest))
    sentence = f"{store.path} has no finished scenario yet: wait, or run the study"
    raise InputError(sentence, str(store.path), "data")


# --- checked ----------------------------------------------------------------------------------------------------------


def find_folder_problems(store: StudyFolder) -> list[str]:
    """Check every file in a folder, a sentence for each problem; raises as ``require_manifest``."""
    manifest = store.require_manifest()
    problems: list[str] = []
    try:
        store.read_study(manifest)
    except IntegrityError as error:
        problems = str(error).splitlines()
    problems += find_result_problems(store, manifest)
    return [*problems, *_find_shard_problems(stored.Shards(store.path, manifest.key))]


def find_result_problems(store: StudyFolder, manifest: stored.Manifest) -> Iterator[str]:
    """Check the final files of a folder, whether or not its study can still be read."""
    if not store.has_results:
        if manifest.finished:
            yield f"{store.results_path} is missing: run the study again"
        return
    try:
        ds = stored.open_final_results(store.path, manifest)
        yield from stored.find_problems(ds, store.path, manifest)
    except StorageError:
        raise
    except FastcoilError as error:
        yield str(error)
        return
    if not manifest.finished:
        return
    cure = f"run the study again, with -o {store.path}, which puts it right"
    if not is_complete_result_of(ds, manifest):
        yield f"{store.results_path} is of another study, or incomplete: {cure}"
    elif (store.read_text() or "").replace("\r\n", "\n") != ds.attrs.get("study_toml"):
        yield f"{store.study_path} is not the text of the study that was run: {cure}"
    for path in store.trace_files():
        if path.name != ds.attrs.get("trace_file"):
            yield f"{path} is not of this run: {cure}"
    for path in stale_figures(store.path, ds.attrs["content_sha256"]):
        yield f"{path} was drawn from other results: run `fastcoil plot {store.path}`, or delete it"


def _find_shard_problems(shards: stored.Shards) -> Iterator[str]:
    first = None
    for path, part, problem in shards.inspect():
        if part is None:
            yield f"{path} {problem}"
            continue
        try:
            first = check_same_form(first, part)
        except FastcoilError as error:
            yield f"{path}: {error}"
