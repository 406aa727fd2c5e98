"""Run a study file into a folder: decide what is left to do, run it, merge it."""

import json
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import xarray as xr

from fastcoil.base.arguments import argument_checks, require_flag, require_path, require_text
from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.base.files import convert_os_errors
from fastcoil.base.progress import Advance, display_for_call
from fastcoil.loops.clashes import warn_saturated
from fastcoil.loops.plan import JobSlice, check_disk, check_workers, cut_into_shards
from fastcoil.loops.provenance import environments_of
from fastcoil.loops.scenarios import check_same_form
from fastcoil.loops.simulate import number_of_threads
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.model.user_rules import refuse_changed_code
from fastcoil.study.file.spec import Study, read_study
from fastcoil.study.file.user_code import load, load_rules
from fastcoil.study.folder.folder import StudyFolder, hold
from fastcoil.study.folder.merged import merge
from fastcoil.study.folder.results import ComputedParts, is_complete_result_of, is_result_of, study_attributes
from fastcoil.study.folder.stored import (
    DESCRIPTIVE_ATTRIBUTES,
    Environment,
    Manifest,
    Shards,
    finished_manifest,
    with_updated_title,
)
from fastcoil.study.workers import Job, check_backend, make_pool, run_shards


@dataclass(frozen=True)
class FinishedStudy:
    """A finished study: where, what, how many scenarios this call ran, and whether it made these results."""

    folder: Path
    results: xr.Dataset
    n_run: int
    is_new: bool = True


SCENARIO_DAYS = "scenario-days"
ProgressStarter = Callable[[int, int, str], Advance]
_PoolOptions = tuple[str, int, str | None]
"""Who is to run it: backend, number, address of the scheduler."""


_PendingRun = tuple[Manifest, ComputedParts, np.ndarray]
"""What is left to do: the run, what the folder has of it, flat indices of the scenarios to run."""


def run_study(
    path: str | Path,
    out: str | Path | None = None,
    *,
    n_jobs: int | None = None,
    backend: str = "threads",
    scheduler: str | None = None,
    extend: bool = False,
    progress: bool | None = None,
) -> xr.Dataset:
    """Run a study file and return its results.

    A study that is finished in ``out`` is only opened; one that was interrupted is resumed.

    Code that comes with the study, the modules that ``reduce``, ``estimator`` and ``law`` name, is run.

    Parameters
    ----------
    path
        The study's TOML file.
    out
        Folder of the results; ``results/NAME`` by default, with the name of the file.
    n_jobs
        Workers; all cores by default.  Results do not depend on it.
    backend
        ``threads`` (default), ``loky`` (processes: one that crashes takes nothing else down) or ``dask``.  Results do
        not depend on it.
    scheduler
        Address of a dask scheduler, such as ``tcp://host:8786``; for the backend dask.
    extend
        Whether ``out`` may hold a smaller version of the study, all of which is kept.
    progress
        Whether to show how many scenario-days are done, on stderr: True always, False never; None on a terminal, after
        2 s.

    Returns
    -------
    xarray.Dataset
        As of ``simulate``; traces stay on the disk until they are asked for.

    Raises
    ------
    InputError
        For any mistake in the file or the arguments, or if ``out`` holds another study; nothing is changed.
    LockedError, StorageError, IntegrityError
        If another run writes to ``out``; if it cannot be written; if a file in it is damaged.
    """
    with argument_checks() as check:
        path = check(require_path, "path", path, "give the path of a study file")
        folder = check.unless_none(require_path, "out", out, "give the path of a folder")
        n_jobs = check(number_of_threads, n_jobs)
        scheduler = check.unless_none(require_text, "scheduler", scheduler)
        check(check_backend, backend, scheduler)
        extend = check(require_flag, "extend", extend)
        progress = check.unless_none(require_flag, "progress", progress)
    study = read_study(path, prepare=load)
    with display_for_call(progress) as display:
        return execute(
            study,
            folder or default_folder(path),
            n_jobs=n_jobs,
            backend=backend,
            scheduler=scheduler,
            extend=extend,
            progress=lambda n_missing, n, what: display.start(n, n - n_missing, what),
        ).results


def default_folder(path: Path) -> Path:
    """Folder of a study's results where none is given."""
    return Path("results") / path.stem


def execute(
    study: Study,
    folder: Path,
    *,
    n_jobs: int | None = None,
    backend: str = "threads",
    scheduler: str | None = None,
    extend: bool = False,
    progress: ProgressStarter | None = None,
    present: Callable[[FinishedStudy], None] = lambda finished: None,
) -> FinishedStudy:
    """Run a study into ``folder``, resume it, or find it finished there; see ``run_study``.

    ``progress`` is called when there is work to do, with the number of scenarios to run and of all, and with what they
    are, and returns what to call with finished ones; with ``precision`` there is work again for more batches.
    ``present`` gets the finished study while its folder is still held, to write figures there.
    """
    n_jobs = number_of_threads(n_jobs)
    check_backend(backend, scheduler)
    with convert_os_errors(folder, "found"):
        store = StudyFolder(folder.absolute())  # a study's own code may change the current folder meanwhile
    with hold(store.path):
        load_rules(study.plan.layout.loop.rules, study.rules)
        larger_study: Study | None = _match_stored_batches(study, store, extend)
        n_run, scope = 0, SCENARIO_DAYS
        while larger_study is not None:
            study = larger_study
            pending = _find_pending_run(study, store, extend)
            if isinstance(pending, tuple):
                result = _run_and_merge(study, store, pending, (backend, n_jobs, scheduler), progress, scope)
            else:
                result = FinishedStudy(store.path, pending, 0, is_new=False)
            n_run += result.n_run
            larger_study, extend = study.with_more_batches(result.results), True
            if larger_study and study.precision:
                scope = f"{SCENARIO_DAYS}, {study.precision.describe_progress(result.results)}"
        result = replace(result, n_run=n_run)
        present(result)
    return result


def execute_slice(
    study: Study, folder: Path, job_slice: JobSlice, n_jobs: int | None = None, backend: str = "threads",
    scheduler: str | None = None, progress: ProgressStarter | None = None,
) -> int | None:  # fmt: skip
    """Run a share of a study into ``folder``, where others run the rest; ``execute`` merges them.

    Returns the number of scenarios that it ran, ``None`` if the study is finished there.
    """
    n_jobs = number_of_threads(n_jobs)
    check_backend(backend, scheduler)
    if study.precision is not None:
        raise InputError(
            "--shard: how many samples a study with [run] precision draws depends on all results: run it without"
        )
    plan, slice_index = study.plan, job_slice.index(study.plan)
    slice_progress = progress and (lambda n_missing, n, what: progress(n_missing, slice_index.size, what))
    with convert_os_errors(folder, "found"):
        store = StudyFolder(folder.absolute())
    with hold(store.path, str(job_slice)):
        load_rules(plan.layout.loop.rules, study.rules)
        work = _find_pending_run(study, store, extend=False, slice_index=slice_index)
        if isinstance(work, tuple) and work[2].size:
            needed_bytes = plan.disk_bytes(traces_kept=study.reduction is None)[0] * work[2].size // plan.n_scenarios
            check_disk(needed_bytes, store.path)
            _run_missing_scenarios(study, store, work, (backend, n_jobs, scheduler), slice_progress, SCENARIO_DAYS)
        return work[2].size if isinstance(work, tuple) else None


def _match_stored_batches(study: Study, store: StudyFolder, extend: bool) -> Study:
    """The study with as many batches of samples as its folder has; with the fewest if it has none of them.

    An extension of another study has at least as many.
    """
    stored = Manifest.read(store.path)
    if stored is None or study.precision is None:
        return study
    matching = study.find_by_hash(stored.study_sha256)
    if matching is None and extend and store.has_results:
        n = store.open_results().sizes.get("sample", 0)
        sufficient_counts = [count for count in study.precision.counts if count * study.precision.size >= n]
        matching = study.with_batches(sufficient_counts[0]) if sufficient_counts else None
    return matching or study


def _find_pending_run(
    study: Study, store: StudyFolder, extend: bool, slice_index: np.ndarray | None = None
) -> _PendingRun | xr.Dataset:
    """What is left to do of a study in its folder, which is held; its results, if nothing is.

    own: the scenarios of a share, which alone is held.
    """
    requested, stored = Manifest.of(study), Manifest.read(store.path)
    if stored is not None and stored.study_sha256 != requested.study_sha256:
        has_shards = Shards(store.path, stored.key).any()
        if not store.has_results and not has_shards:
            stored = None  # it was killed before its first scenario
        elif not extend:
            _refuse_other_study(store, study)
        elif has_shards and not (store.has_results and is_complete_result_of(store.open_results(), stored)):
            raise InputError(
                f"--extend: the study in {store.path} is unfinished: finish it with the file that it was started from, "
                "then extend it"
            )
    else:
        ds = store.open_results() if store.has_results else None
        if ds is not None and is_complete_result_of(ds, requested):
            refuse_changed_code(requested.user_code, json.loads(ds.attrs.get("user_code", "{}")))
            return _repair_folder(study, store, ds, requested.with_files_of(stored)) if slice_index is None else ds
        if stored is None and ds is not None and not is_result_of(ds, requested):
            raise store.missing_manifest_error()
    if stored is not None and stored.model_sha256 != requested.model_sha256:
        warnings.warn(
            f"{store.path} was computed with other sources of the model: everything is computed again", stacklevel=2
        )
    elif stored is not None and stored.study_sha256 == requested.study_sha256:
        refuse_changed_code(requested.user_code, stored.user_code)
    manifest = requested.with_files_of(stored)
    computed = ComputedParts.find(store, study, manifest)
    missing, environments = computed.survey(slice_index)
    if slice_index is not None and stored is not None:  # of the other shares
        environments += [dict(each) for each in stored.computed_on if each not in environments]
    return replace(manifest, computed_on=environments, finished=False), computed, missing


def _repair_folder(study: Study, store: StudyFolder, ds: xr.Dataset, manifest: Manifest) -> xr.Dataset:
    """Complete the folder of a finished study: other words about it, files that were lost, files it no longer needs."""
    complete_manifest = finished_manifest(ds, store.path, manifest)
    descriptive_attributes = {
        name: value for name, value in study_attributes(study, manifest).items() if name in DESCRIPTIVE_ATTRIBUTES
    }
    if any(ds.attrs.get(name) != value for name, value in descriptive_attributes.items()):
        ds, complete_manifest = with_updated_title(ds, descriptive_attributes, store.path, complete_manifest)
    if not store.records(complete_manifest, study.text):
        store.write_manifest(complete_manifest, study.text)
    store.remove_superseded(ds, complete_manifest)
    return ds


def _run_and_merge(
    study: Study,
    store: StudyFolder,
    work: _PendingRun,
    pool_options: _PoolOptions,
    progress: ProgressStarter | None,
    scope: str,
) -> FinishedStudy:
    """Run what is missing, shard by shard, and merge all of it."""
    plan, start, (backend, n_jobs, _), (manifest, computed, missing) = study.plan, time.monotonic(), pool_options, work
    check_disk(plan.disk_bytes(traces_kept=study.reduction is None)[0], store.path)
    n_run = 0
    if missing.size:
        n_run, n_jobs, manifest = _run_missing_scenarios(study, store, work, pool_options, progress, scope)
    elif not store.records(manifest, study.text):
        store.write_manifest(manifest, study.text)
    seconds = time.monotonic() - start
    # stored results call the backend ``engine``
    speed = {
        "wall_time_s": round(seconds, 3),
        "scenario_days_per_s": round(n_run / max(seconds, 1e-9), 1),
        "n_jobs": n_jobs,
        "engine": backend,
    }
    ds = merge(store, study, manifest, computed.parts, speed)
    warn_saturated(plan.layout.loop, ds)
    return FinishedStudy(store.path, ds, n_run)


def _run_missing_scenarios(
    study: Study,
    store: StudyFolder,
    work: _PendingRun,
    pool_options: _PoolOptions,
    progress: ProgressStarter | None,
    scope: str,
) -> tuple[int, int, Manifest]:
    """Run what is missing: the numbers of scenarios and of workers, and the manifest."""
    plan, (backend, n_jobs, scheduler), (*_, missing) = study.plan, pool_options, work
    if scheduler is None:
        check_workers(*plan.memory_of_run(n_jobs, backend, traces_kept=study.reduction is None), n_jobs)
    n_run = sum(shard.size for shard in cut_into_shards(plan, n_jobs, missing))
    advance = progress(n_run, plan.n_scenarios, scope) if progress else lambda n: None
    return n_run, *_commit_shards(study, store, work, pool_options, advance)


def _commit_shards(
    study: Study, store: StudyFolder, work: _PendingRun, pool_options: _PoolOptions, advance: Callable[[int], object]
) -> tuple[int, Manifest]:
    """Run the missing scenarios and commit their shards; returns the number of workers and the manifest with theirs."""
    plan, (manifest, computed, missing) = study.plan, work
    if study.reduction is not None:
        load("reduce", study.reduction)  # its mistakes before the work
    for rule in plan.layout.loop.rules.values():
        rule.check()
    compile_kernel()
    job = Job(plan, study.reduction, study.rules, Manifest.of(study).user_code)
    is_recorded, first = store.records(manifest, study.text), None
    backend, n_jobs, scheduler = pool_options
    with closing(make_pool(backend, job, n_jobs, scheduler)) as pool:
        n_jobs = pool.n_workers  # a cluster may have another number
        for part in run_shards(pool, job, cut_into_shards(plan, n_jobs, missing)):
            for environment in environments_of(part):
                if environment not in manifest.computed_on:
                    _warn_other_environment(store.path, environment, manifest.computed_on)
                    manifest = replace(manifest, computed_on=[*manifest.computed_on, environment])
                    is_recorded = False
            if not is_recorded:
                store.write_manifest(manifest, study.text)
                is_recorded = True
            first = check_same_form(first, part).isel(scenario=[0])  # a copy: the shard itself need not be kept
            computed.shards.commit(part)
            advance(part.sizes["scenario"])
    return n_jobs, manifest


def _warn_other_environment(
    folder: Path, environment: Environment, recorded_environments: Sequence[Environment]
) -> None:
    """Warn if other scenarios were computed where bits may differ."""
    for recorded in recorded_environments:
        names = sorted({*recorded, *environment})
        pairs = [(name, *(each.get(name, "unknown") for each in (recorded, environment))) for name in names]
        differences = [
            f"{name} {recorded_value}, now {value}" for name, recorded_value, value in pairs if recorded_value != value
        ]
        warnings.warn(
            f"a part of {folder} was computed elsewhere ({'; '.join(differences)}): the last digits of results may depend "
            "on that, in a loop that hunts also the first; to have all from one place, run the study in another folder",
            stacklevel=3,
        )


def _refuse_other_study(store: StudyFolder, study: Study) -> NoReturn:
    text = store.read_text()
    if text is None:
        raise IntegrityError(
            f"{store.path}: study.toml is missing or damaged, and the run in this folder was of another study: restore "
            "the file, or choose another folder with -o"
        )
    if text.splitlines() == study.text.splitlines():
        raise IntegrityError(
            f"{store.path}: a file that the study reads changed since the run was started: restore it, or choose "
            "another folder with -o; if an extension of it was killed, add --extend to go on"
        )
    raise InputError(
        f"{store.path} holds another study, or another version of this one (compare {store.study}): add --extend if "
        "only values were added, otherwise choose another folder with -o"
    )
