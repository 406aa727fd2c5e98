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

from fastcoil.base.arguments import checking, flag_of, path_of, text_of
from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.base.files import storage_errors
from fastcoil.base.progress import Advance, progress_of_call
from fastcoil.loops.clashes import tell_limited
from fastcoil.loops.plan import Share, check_disk, check_workers, shards_of
from fastcoil.loops.provenance import environments_of
from fastcoil.loops.scenarios import check_same_form
from fastcoil.loops.simulate import workers
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.model.numerics.jit import same_model
from fastcoil.model.user_rules import refuse_other_code
from fastcoil.study.file.own_code import load, load_rules
from fastcoil.study.file.spec import Study, read_study
from fastcoil.study.folder.folder import StudyFolder, hold
from fastcoil.study.folder.merged import merge
from fastcoil.study.folder.results import Computed, is_current, is_of, study_attributes
from fastcoil.study.folder.stored import WORDS, Environment, Manifest, Shards, finished_manifest, reworded
from fastcoil.study.workers import Job, check_backend, make_pool, run_shards


@dataclass(frozen=True)
class Finished:
    """A finished study: where, what, how many scenarios this call ran, and whether it made these results."""

    folder: Path
    results: xr.Dataset
    n_run: int
    is_new: bool = True


SCENARIO_DAYS = "scenario-days"
Progress = Callable[[int, int, str], Advance]
_Workers = tuple[str, int, str | None]
"""Who is to run it: backend, number, address of the scheduler."""


_Work = tuple[Manifest, Computed, np.ndarray]
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
    with checking() as check:
        path = check(path_of, "path", path, "give the path of a study file")
        folder = check.unless_none(path_of, "out", out, "give the path of a folder")
        n_jobs = check(workers, n_jobs)
        scheduler = check.unless_none(text_of, "scheduler", scheduler)
        check(check_backend, backend, scheduler)
        extend = check(flag_of, "extend", extend)
        progress = check.unless_none(flag_of, "progress", progress)
    study = read_study(path, prepare=load)
    with progress_of_call(progress) as shown:
        return execute(
            study,
            folder or default_folder(path),
            n_jobs=n_jobs,
            backend=backend,
            scheduler=scheduler,
            extend=extend,
            progress=lambda n_missing, n, what: shown.start(n, n - n_missing, what),
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
    progress: Progress | None = None,
    present: Callable[[Finished], None] = lambda finished: None,
) -> Finished:
    """Run a study into ``folder``, resume it, or find it finished there; see ``run_study``.

    ``progress`` is called when there is work to do, with the number of scenarios to run and of all, and with what they
    are, and returns what to call with finished ones; with ``precision`` there is work again for more batches.
    ``present`` gets the finished study while its folder is still held, to write figures there.
    """
    n_jobs = workers(n_jobs)
    check_backend(backend, scheduler)
    with storage_errors(folder, "found"):
        store = StudyFolder(folder.absolute())  # a study's own code may change the current folder meanwhile
    with hold(store.path):
        load_rules(study.plan.layout.loop.rules, study.rules)
        more: Study | None = _in_folder(study, store, extend)
        n_run, what = 0, SCENARIO_DAYS
        while more is not None:
            study = more
            work = _decide(study, store, extend)
            if isinstance(work, tuple):
                finished = _run_and_merge(study, store, work, (backend, n_jobs, scheduler), progress, what)
            else:
                finished = Finished(store.path, work, 0, is_new=False)
            n_run += finished.n_run
            more, extend = study.larger(finished.results), True
            if more and study.precision:
                what = f"{SCENARIO_DAYS}, {study.precision.so_far(finished.results)}"
        finished = replace(finished, n_run=n_run)
        present(finished)
    return finished


def execute_share(
    study: Study, folder: Path, share: Share, n_jobs: int | None = None, backend: str = "threads",
    scheduler: str | None = None, progress: Progress | None = None,
) -> int | None:  # fmt: skip
    """Run a share of a study into ``folder``, where others run the rest; ``execute`` merges them.

    Returns the number of scenarios that it ran, ``None`` if the study is finished there.
    """
    n_jobs = workers(n_jobs)
    check_backend(backend, scheduler)
    if study.precision is not None:
        raise InputError(
            "--shard: how many samples a study with [run] precision draws depends on all results: run it without"
        )
    plan, own = study.plan, share.index(study.plan)
    of_share = progress and (lambda n_missing, n, what: progress(n_missing, own.size, what))
    with storage_errors(folder, "found"):
        store = StudyFolder(folder.absolute())
    with hold(store.path, str(share)):
        load_rules(plan.layout.loop.rules, study.rules)
        work = _decide(study, store, extend=False, own=own)
        if isinstance(work, tuple) and work[2].size:
            needed = plan.disk_bytes(traces_kept=study.reduction is None)[0] * work[2].size // plan.n_scenarios
            check_disk(needed, store.path)
            _run_missing(study, store, work, (backend, n_jobs, scheduler), of_share, SCENARIO_DAYS)
        return work[2].size if isinstance(work, tuple) else None


def _in_folder(study: Study, store: StudyFolder, extend: bool) -> Study:
    """The study with as many batches of samples as its folder has; with the fewest if it has none of them.

    An extension of another study has at least as many.
    """
    stored = Manifest.read(store.path)
    if stored is None or study.precision is None:
        return study
    found = study.of_hash(stored.study_sha256)
    if found is None and extend and store.has_results:
        n = store.open_results().sizes.get("sample", 0)
        enough = [count for count in study.precision.counts if count * study.precision.size >= n]
        found = study.of_batches(enough[0]) if enough else None
    return found or study


def _decide(study: Study, store: StudyFolder, extend: bool, own: np.ndarray | None = None) -> _Work | xr.Dataset:
    """What is left to do of a study in its folder, which is held; its results, if nothing is.

    own: the scenarios of a share, which alone is held.
    """
    asked, stored = Manifest.of(study), Manifest.read(store.path)
    if stored is not None and stored.study_sha256 != asked.study_sha256:
        has_shards = Shards(store.path, stored.key).any()
        if not store.has_results and not has_shards:
            stored = None  # it was killed before its first scenario
        elif not extend:
            _refuse_other_study(store, study)
        elif has_shards and not (store.has_results and is_current(store.open_results(), stored)):
            raise InputError(
                f"--extend: the study in {store.path} is unfinished: finish it with the file that it was started from, "
                "then extend it"
            )
    else:
        ds = store.open_results() if store.has_results else None
        if ds is not None and is_current(ds, asked):
            refuse_other_code(asked.own_code, json.loads(ds.attrs.get("own_code", "{}")))
            return _put_right(study, store, ds, asked.knowing(stored)) if own is None else ds
        if stored is None and ds is not None and not is_of(ds, asked):
            raise store.without_manifest()
    if stored is not None and not same_model(stored.model_sha256, asked.model_sha256):
        warnings.warn(
            f"{store.path} was computed with other sources of the model: everything is computed again", stacklevel=2
        )
    elif stored is not None and stored.study_sha256 == asked.study_sha256:
        refuse_other_code(asked.own_code, stored.own_code)
    manifest = asked.knowing(stored)
    computed = Computed.find(store, study, manifest)
    missing, environments = computed.survey(own)
    if own is not None and stored is not None:  # of the other shares
        environments += [dict(each) for each in stored.computed_on if each not in environments]
    return replace(manifest, computed_on=environments, finished=False), computed, missing


def _put_right(study: Study, store: StudyFolder, ds: xr.Dataset, manifest: Manifest) -> xr.Dataset:
    """Complete the folder of a finished study: other words about it, files that were lost, files it no longer needs."""
    found = finished_manifest(ds, store.path, manifest)
    words = {name: value for name, value in study_attributes(study, manifest).items() if name in WORDS}
    if any(ds.attrs.get(name) != value for name, value in words.items()):
        ds, found = reworded(ds, words, store.path, found)
    if not store.records(found, study.text):
        store.write_manifest(found, study.text)
    store.remove_superseded(ds, found)
    return ds


def _run_and_merge(
    study: Study, store: StudyFolder, work: _Work, asked: _Workers, progress: Progress | None, what: str
) -> Finished:
    """Run what is missing, shard by shard, and merge all of it."""
    plan, start, (backend, n_jobs, _), (manifest, computed, missing) = study.plan, time.monotonic(), asked, work
    check_disk(plan.disk_bytes(traces_kept=study.reduction is None)[0], store.path)
    n_run = 0
    if missing.size:
        n_run, n_jobs, manifest = _run_missing(study, store, work, asked, progress, what)
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
    tell_limited(plan.layout.loop, ds)
    return Finished(store.path, ds, n_run)


def _run_missing(
    study: Study, store: StudyFolder, work: _Work, asked: _Workers, progress: Progress | None, what: str
) -> tuple[int, int, Manifest]:
    """Run what is missing: the numbers of scenarios and of workers, and the manifest."""
    plan, (backend, n_jobs, scheduler), (*_, missing) = study.plan, asked, work
    if scheduler is None:
        check_workers(*plan.memory_of_run(n_jobs, backend, traces_kept=study.reduction is None), n_jobs)
    n_run = sum(shard.size for shard in shards_of(plan, n_jobs, missing))
    advance = progress(n_run, plan.n_scenarios, what) if progress else lambda n: None
    return n_run, *_run(study, store, work, asked, advance)


def _run(
    study: Study, store: StudyFolder, work: _Work, asked: _Workers, advance: Callable[[int], object]
) -> tuple[int, Manifest]:
    """Run the missing scenarios and commit their shards; returns the number of workers and the manifest with theirs."""
    plan, (manifest, computed, missing) = study.plan, work
    if study.reduction is not None:
        load("reduce", study.reduction)  # its mistakes before the work
    for rule in plan.layout.loop.rules.values():
        rule.check()
    compile_kernel()
    job = Job(plan, study.reduction, study.rules, Manifest.of(study).own_code)
    recorded, first = store.records(manifest, study.text), None
    backend, n_jobs, scheduler = asked
    with closing(make_pool(backend, job, n_jobs, scheduler)) as pool:
        n_jobs = pool.n_workers  # a cluster may have another number
        for part in run_shards(pool, job, shards_of(plan, n_jobs, missing)):
            for environment in environments_of(part):
                if environment not in manifest.computed_on:
                    _warn_of_difference(store.path, environment, manifest.computed_on)
                    manifest = replace(manifest, computed_on=[*manifest.computed_on, environment])
                    recorded = False
            if not recorded:
                store.write_manifest(manifest, study.text)
                recorded = True
            first = check_same_form(first, part).isel(scenario=[0])  # a copy: the shard itself need not be kept
            computed.shards.commit(part)
            advance(part.sizes["scenario"])
    return n_jobs, manifest


def _warn_of_difference(folder: Path, environment: Environment, others: Sequence[Environment]) -> None:
    """Warn if other scenarios were computed where bits may differ."""
    for other in others:
        names = sorted({*other, *environment})
        pairs = [(name, *(each.get(name, "unknown") for each in (other, environment))) for name in names]
        differs = [f"{name} {was}, now {now}" for name, was, now in pairs if was != now]
        warnings.warn(
            f"a part of {folder} was computed elsewhere ({'; '.join(differs)}): the last digits of results may depend "
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
