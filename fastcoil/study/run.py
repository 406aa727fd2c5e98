"""Run a study file into a folder: decide what is left to do, run it, merge it."""

from __future__ import annotations

import difflib
import json
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import xarray as xr

from fastcoil.base.arguments import checking, choice_of, flag_of, path_of, text_of
from fastcoil.base.errors import InputError, IntegrityError, StorageError
from fastcoil.base.files import storage_errors
from fastcoil.base.progress import Advance, progress_of_call
from fastcoil.loops.dataset import check_same_form
from fastcoil.loops.plan import check_disk, check_workers
from fastcoil.loops.provenance import environments_of
from fastcoil.loops.shards import END_STATE, first_shards
from fastcoil.loops.simulate import workers
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.model.numerics.jit import same_model
from fastcoil.model.user_rules import refuse_other_code
from fastcoil.study.file.spec import Study, read_study
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.manifest import Environment, Manifest
from fastcoil.study.folder.merge import merge, study_attributes
from fastcoil.study.folder.result_files import WORDS, finished_manifest, reworded
from fastcoil.study.folder.results import Computed, is_current, is_of, match_scenarios, open_study
from fastcoil.study.workers.dispatch import Dispatcher
from fastcoil.study.workers.pools import BACKENDS, backend_problems, make_pool, resolve_backend
from fastcoil.study.workers.user_code import load, load_rules
from fastcoil.study.workers.worker import Job


@dataclass(frozen=True)
class Finished:
    """A finished study: where, what, and how many scenarios this call ran."""

    folder: Path
    results: xr.Dataset
    n_run: int


def run_study(
    path: str | Path,
    out: str | Path | None = None,
    *,
    n_jobs: int | None = None,
    backend: str | None = None,
    scheduler: str | None = None,
    extend: bool = False,
    engine: str | None = None,
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
        Address of a dask scheduler, such as ``tcp://host:8786``; a cluster on this machine by default.
    extend
        Whether ``out`` may hold a smaller version of the study, all of which is kept.
    engine
        Earlier name of ``backend``.
    progress
        Whether to show how many scenario-days are done, on stderr or in the notebook: True always, False never; None
        on a terminal and in a notebook, after 2 s.

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
    with checking() as check:
        path = check(path_of, "path", path, "give the path of a study file")
        folder = check.unless_none(path_of, "out", out, "give the path of a folder")
        n_jobs = check(workers, n_jobs)
        backend = check.unless_none(choice_of, "backend", backend, BACKENDS)
        engine = check.unless_none(choice_of, "engine", engine, BACKENDS)
        scheduler = check.unless_none(text_of, "scheduler", scheduler)
        extend = check(flag_of, "extend", extend)
        progress = check.unless_none(flag_of, "progress", progress)
    chosen = resolve_backend(backend, engine)
    study = read_study(path, prepare=load)
    folder = folder or default_folder(path)
    n = study.plan.n_scenarios
    with progress_of_call(progress) as shown:
        return execute(
            study,
            folder,
            n_jobs=n_jobs,
            backend=chosen,
            scheduler=scheduler,
            extend=extend,
            progress=lambda n_todo: shown.start(n, n - n_todo),
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
    progress: Callable[[int], Advance] | None = None,
    present: Callable[[Finished], None] = lambda finished: None,
) -> Finished:
    """Run a study into ``folder``, resume it, or find it finished there; see ``run_study``.

    ``progress`` is called when there is work to do, with the number of scenarios to run, and returns what to call
    with finished ones.  ``present`` gets the finished study while its folder is still held, to write figures there.
    """
    n_jobs = workers(n_jobs)
    problems = backend_problems(backend, scheduler)
    if problems:
        raise InputError(problems)
    with storage_errors(folder, "found"):
        # a study's own code may change the current folder meanwhile, of this thread or another
        store = StudyFolder(folder.absolute())
    with ExitStack() as held:
        try:
            held.enter_context(store.hold())
        except StorageError:
            found = _find_finished(study, store)  # which needs no writing
            if found is None:
                raise
            finished = found
        else:
            finished = _finish(study, store, n_jobs, backend, scheduler, extend, progress)
        present(finished)
    return finished


def _find_finished(study: Study, store: StudyFolder) -> Finished | None:
    """The study in a folder that cannot be written, if it is finished there."""
    asked, stored = Manifest.of(study, study.model_sha256), store.read_manifest()
    if stored is None or not stored.finished or stored.study_sha256 != asked.study_sha256 or not store.has_results:
        return None
    ds = store.open_results()
    refuse_other_code(asked.own_code, stored.own_code)
    return Finished(store.path, ds, 0) if is_current(ds, asked) else None


def _finish(
    study: Study,
    store: StudyFolder,
    n_jobs: int,
    backend: str,
    scheduler: str | None,
    extend: bool,
    progress: Callable[[int], Advance] | None,
) -> Finished:
    """Run a study in a folder that is held; see ``execute``."""
    plan, folder = study.plan, store.path
    in_the_way = store.in_the_way()
    if in_the_way:
        raise StorageError("\n".join(in_the_way))
    load_rules(plan.layout.loop.rules, study.rules)
    asked, stored = Manifest.of(study, study.model_sha256), store.read_manifest()
    if stored is not None and stored.study_sha256 != asked.study_sha256 and store.has_none_of(stored):
        stored = None  # it was killed before its first scenario
    if stored is not None and stored.study_sha256 != asked.study_sha256:
        if not extend:
            refuse_other_study(store, study)
        stored = _merge_unfinished(store, study, stored, asked)
    elif store.has_results:
        ds = store.open_results()
        if is_current(ds, asked):
            refuse_other_code(asked.own_code, json.loads(ds.attrs.get("own_code", "{}")))
            found = finished_manifest(ds, folder, asked.knowing(stored))
            words = {name: value for name, value in study_attributes(study, asked).items() if name in WORDS}
            if any(ds.attrs.get(name) != value for name, value in words.items()):
                ds, found = reworded(ds, words, folder, found)
            if not store.records(found, study.text):  # run.json or study.toml was lost, or of version 0.1
                store.write_manifest(found, study.text)
            store.remove_superseded(ds, found)
            return Finished(folder, ds, 0)
    if stored is not None and not same_model(stored.model_sha256, asked.model_sha256):
        warnings.warn(
            f"{folder} was computed with other sources of the model: everything is computed again", stacklevel=2
        )
    elif stored is not None and stored.study_sha256 == asked.study_sha256:
        refuse_other_code(asked.own_code, stored.own_code)
    manifest = asked.knowing(stored)
    computed = Computed.find(store, study, manifest)
    todo, environments, reached = computed.survey()
    manifest = replace(manifest, computed_on=environments, finished=False)
    check_disk(plan.disk_bytes(traces_kept=study.reduction is None), folder)
    if scheduler is None and todo.size:
        check_workers(*plan.memory_of_run(n_jobs, backend), n_jobs)
    start = time.monotonic()
    recorded = store.records(manifest, study.text)
    n_run = sum(shard.lost.size for shard in first_shards(plan, n_jobs, todo, reached))
    if todo.size:
        if study.reduction is not None:
            load("reduce", study.reduction)  # its mistakes before the work
        for rule in plan.layout.loop.rules.values():
            rule.check()
        advance = progress(n_run) if progress else _ignore
        compile_kernel()
        job = Job(manifest.key, plan, study.reduction, study.rules, asked.own_code)
        first: xr.Dataset | None = None
        with closing(make_pool(backend, job, n_jobs, scheduler)) as pool:
            n_jobs = pool.n_workers  # a cluster may have another number
            for part in Dispatcher(pool, job).run(first_shards(plan, pool.n_workers, todo, reached)):
                for environment in environments_of(part):
                    if environment not in manifest.computed_on:
                        warn_of_difference(folder, environment, manifest.computed_on)
                        manifest = replace(manifest, computed_on=[*manifest.computed_on, environment])
                        recorded = False
                if not recorded:
                    store.write_manifest(manifest, study.text)
                    recorded = True
                first = check_same_form(first, part.drop_vars(END_STATE, errors="ignore"))
                computed.shards.commit(part)
                advance(part.sizes["scenario"])
    elif not recorded:
        store.write_manifest(manifest, study.text)
    seconds = time.monotonic() - start
    speed = {"wall_time_s": round(seconds, 3), "scenario_days_per_s": round(n_run / max(seconds, 1e-9), 1)}
    # stored results call the backend ``engine``
    ds = merge(store, study, manifest, computed.parts, speed | {"n_jobs": n_jobs, "engine": backend})
    return Finished(folder, ds, n_run)


def _ignore(_: int) -> None:
    pass


def _merge_unfinished(store: StudyFolder, study: Study, stored: Manifest, asked: Manifest) -> Manifest | None:
    """Merge what an unfinished run of a smaller version has, so that it can be extended like any other result.

    Scenarios that were not run have the status ``not_run``.  Nothing is changed if ``study`` is no extension of it.
    Returns what ``run.json`` then says.
    """
    if store.has_results:
        found = store.open_results()
        if is_current(found, stored) or (is_of(found, stored) and not store.shards(stored).any()):
            return stored
    if not same_model(stored.model_sha256, asked.model_sha256):
        return stored
    smaller = store.read_study(stored)
    computed = Computed.find(store, smaller, stored)
    # this reads all shards, so that damaged ones are set aside before ``open_study`` looks at them
    missing, environments, _ = computed.survey()
    if missing.size < smaller.plan.n_scenarios:
        match_scenarios(study.plan, study_attributes(study, asked), open_study(store.path))
        merge(store, smaller, replace(stored, computed_on=environments), computed.parts, complete=False)
    return store.read_manifest()


_LONGEST_DIFFERENCE = 10
"""Lines."""


def warn_of_difference(folder: Path, environment: Environment, others: Sequence[Environment]) -> None:
    """Warn if other scenarios were computed where bits may differ; one that nobody recorded may be this one."""
    for other in filter(None, others):
        differs = [
            f"{name} {other.get(name, 'unknown')}, now {environment.get(name, 'unknown')}"
            for name in sorted({*other, *environment})
            if other.get(name) != environment.get(name)
        ]
        warnings.warn(
            f"a part of {folder} was computed elsewhere ({'; '.join(differs)}): the last digits of results may depend "
            "on that, in a loop that hunts also the first; to have all from one place, run the study in another folder",
            stacklevel=3,
        )


def refuse_other_study(store: StudyFolder, study: Study) -> NoReturn:
    """Refuse to replace the study in a folder by another one, and say in what they differ.

    Raises
    ------
    InputError
        If their texts differ.
    IntegrityError
        If a file that they read does, or the text in the folder is lost.
    """
    text = store.read_text()
    if text is None:
        raise IntegrityError(
            f"{store.path}: study.toml is missing or damaged, and the run in this folder was of another study: restore "
            "the file, or choose another folder with -o"
        )
    changes = [
        line
        for line in difflib.unified_diff(text.splitlines(), study.text.splitlines(), lineterm="")
        if line[:1] in "+-" and line[:3] not in ("+++", "---")
    ]
    if not changes:
        raise IntegrityError(
            f"{store.path}: a file that the study reads changed since the run was started: restore it, or choose "
            "another folder with -o; if an extension of it was killed, add --extend to go on"
        )
    shown = changes[:_LONGEST_DIFFERENCE] + ["…"] * (len(changes) > _LONGEST_DIFFERENCE)
    raise InputError(
        [
            f"{store.path} holds another study, or another version of this one: add --extend if only values were "
            "added, otherwise choose another folder with -o.  The differences:",
            *shown,
        ]
    )
