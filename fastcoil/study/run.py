"""Run a study file into a folder: see what the folder holds, run what is missing, merge it."""

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from fastcoil.base.arguments import argument_checks, require_flag, require_path, require_text
from fastcoil.base.errors import InputError
from fastcoil.base.files import convert_os_errors, is_file, write_atomically
from fastcoil.base.progress import Advance, display_for_call
from fastcoil.loops.clashes import warn_saturated
from fastcoil.loops.plan import JobSlice, check_disk, check_workers, cut_into_shards
from fastcoil.loops.simulate import number_of_threads, simulate
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.study.analysis.answer import find_answer
from fastcoil.study.analysis.learned import format_comparators, is_learning_study
from fastcoil.study.file.spec import Study, read_study
from fastcoil.study.file.user_code import load_function
from fastcoil.study.folder.folder import StudyFolder, hold_folder
from fastcoil.study.folder.merged import StudyRun, merge_metrics, publish_results, repair_results
from fastcoil.study.folder.state import FolderState
from fastcoil.study.folder.stored import study_attributes
from fastcoil.study.workers import Job, PoolOptions, check_backend, make_pool, run_shards

ANSWER_FILE = "answer.json"
SCENARIO_DAYS = "scenario-days"
ProgressStarter = Callable[[int, int, str], Advance]
"""Called with the numbers of scenarios to run and of all, and their noun; returns what to call with finished ones."""


@dataclass(frozen=True)
class FinishedStudy:
    """A finished study: where, what, how many scenarios this call ran, and whether it made these results."""

    folder: Path
    results: xr.Dataset
    n_run: int
    is_new: bool = True


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
    r"""Run a study file and return its results.

    A study that is finished in ``out`` is only opened; one that was interrupted is resumed.  Code that comes with the
    study is run: the modules that ``reduce``, ``estimator``, ``law`` and ``plant`` name.

    Parameters
    ----------
    path
        The study's TOML file.
    out
        Folder of the results; ``results/NAME`` by default, with the name of the file.
    n_jobs, progress
        As in ``simulate``.
    backend
        ``threads`` (default), ``loky`` (processes: one that crashes takes nothing else down) or ``dask``.  Results do
        not depend on it.
    scheduler
        Address of a dask scheduler, such as ``tcp://host:8786``; for the backend dask.
    extend
        Whether ``out`` may hold a smaller version of the study, all of which is kept.

    Returns
    -------
    xarray.Dataset
        Same as ``simulate``; traces stay on the disk until they are read.

    Raises
    ------
    InputError
        For any mistake in the file or the arguments, or if ``out`` holds another study; nothing is changed.
    LockedError, StorageError, IntegrityError
        If another run writes to ``out``; if it cannot be written; if a file in it is damaged.

    Examples
    --------
    >>> import pathlib, tempfile, fastcoil as fc
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> text = "[loop]\n[sweep]\nbacklash = [0.0, 0.07]\n[boundary]\nhours = 0.6\n"
    >>> _ = (folder / "gap.toml").write_text(text)
    >>> ds = fc.run_study(folder / "gap.toml", folder / "out", n_jobs=1)
    >>> dict(ds.rmse.sizes)
    {'backlash': 2}
    """
    with argument_checks() as check:
        path = check(require_path, "path", path, "give the path of a study file")
        folder = check.unless_none(require_path, "out", out, "give the path of a folder")
        n_jobs = check(number_of_threads, n_jobs)
        scheduler = check.unless_none(require_text, "scheduler", scheduler)
        check(check_backend, backend, scheduler)
        extend = check(require_flag, "extend", extend)
        progress = check.unless_none(require_flag, "progress", progress)
    study = read_study(path, prepare=load_function)
    with display_for_call(progress) as display:
        return execute(
            study, folder or default_folder(path), n_jobs=n_jobs, backend=backend, scheduler=scheduler, extend=extend,
            progress=lambda n_missing, n, what: display.start(n, n - n_missing, what),
        ).results  # fmt: skip


def default_folder(path: Path) -> Path:
    """Return the folder of a study's results where none is given."""
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

    ``read_study`` has loaded its code.  ``progress`` is called when there is work to do, with ``precision`` for more
    batches again.  ``present`` gets the finished study while its folder is still held, to write figures there.
    """
    options = PoolOptions(backend, number_of_threads(n_jobs), scheduler)
    check_backend(backend, scheduler)
    n_run, scope = 0, SCENARIO_DAYS
    with convert_os_errors(folder, "found"):
        store = StudyFolder(folder.absolute())  # the user's code may change the current folder meanwhile
    with hold_folder(store.path):
        while True:
            run = FolderState.read(store).start_run(study, extend)
            is_new = run.results is None
            if run.results is None:
                n_computed, ds = _run_and_merge(run, options, progress, scope)
                n_run += n_computed
            else:
                ds = repair_results(run, run.results)
            precision = run.study.precision
            if precision is None or precision.is_enough(ds):
                break
            study = run.study.with_batches(next(n for n in precision.batch_counts if n > run.study.batches))
            extend, scope = True, f"{SCENARIO_DAYS}, {precision.describe_progress(ds)}"
        finished = FinishedStudy(store.path, ds, n_run, is_new)
        text, path = find_answer(ds).to_json().encode(), store.path / ANSWER_FILE
        if not is_file(path) or path.read_bytes() != text:
            write_atomically(path, text)
        present(finished)
    return finished


def execute_slice(
    study: Study, folder: Path, job_slice: JobSlice, n_jobs: int | None = None, backend: str = "threads",
    scheduler: str | None = None, progress: ProgressStarter | None = None,
) -> int | None:  # fmt: skip
    """Run a share of a study into ``folder``; return the number of scenarios run, None if it is finished there."""
    options = PoolOptions(backend, number_of_threads(n_jobs), scheduler)
    check_backend(backend, scheduler)
    if study.precision is not None:
        reason = "how many samples a study with [run] precision draws depends on all results: run it without"
        raise InputError(f"--shard: {reason}", "--shard", "unsupported")
    with convert_os_errors(folder, "found"):
        store = StudyFolder(folder.absolute())
    with hold_folder(store.path, str(job_slice)):
        scenarios = job_slice.index(study.plan)
        run = FolderState.read(store).start_run(study, extend=False, scenarios=scenarios)
        if run.results is not None:
            return None
        _run_missing(run, options, progress, SCENARIO_DAYS, scenarios.size)
        return run.missing.size


def _run_and_merge(
    run: StudyRun, options: PoolOptions, progress: ProgressStarter | None, scope: str
) -> tuple[int, xr.Dataset]:
    """Run what is missing, merge all of it; return the number of scenarios run, and the results."""
    study, plan, start = run.study, run.study.plan, time.monotonic()
    n_run, n_workers = _run_missing(run, options, progress, scope, plan.n_scenarios)
    seconds = time.monotonic() - start
    ds = merge_metrics(run)
    measured = {
        "wall_time_s": round(seconds, 3),
        "scenario_days_per_s": round(n_run / max(seconds, 1e-9), 1),
        "n_jobs": n_workers,
        "engine": options.backend,  # the name in stored results
    }
    if study.precision:
        measured |= study.precision.result_attributes(ds)
    loop, boundary = plan.layout.loop, plan.layout.boundary
    if is_learning_study(loop):
        run_options: Any = {"warm_up": plan.warm_up, "seed": plan.seed, "carry_over": plan.carry_over}
        run_options |= {"replicates": plan.layout.sizes.get("replicate", 1), "n_jobs": n_workers}
        measured["comparators"] = format_comparators(
            lambda other: simulate(other, boundary, progress=False, **run_options), loop
        )
    ds = publish_results(run, ds.assign_attrs(study_attributes(study, run.manifest, measured)))
    warn_saturated(plan.layout.loop, ds)
    return n_run, ds


def _run_missing(
    run: StudyRun, options: PoolOptions, progress: ProgressStarter | None, scope: str, n_all: int
) -> tuple[int, int]:
    """Run what is missing of ``n_all`` scenarios, commit shards; return the numbers of scenarios and workers."""
    study, plan, missing, n_workers = run.study, run.study.plan, run.missing, options.n_workers
    traces_kept = study.reduction is None
    disk_bytes, _ = plan.disk_bytes(traces_kept=traces_kept)
    is_slice = n_all < plan.n_scenarios
    if missing.size and options.scheduler is None:
        check_workers(*plan.memory_of_run(n_workers, options.backend, traces_kept=traces_kept), n_workers)
    check_disk(disk_bytes * missing.size // plan.n_scenarios if is_slice else disk_bytes, run.store.path)
    if not missing.size:
        return 0, n_workers
    n_run = sum(shard.size for shard in cut_into_shards(plan, n_workers, missing))
    compile_kernel()  # before the clock of the progress starts
    advance = progress(n_run, n_all, scope) if progress else lambda n: None
    job = Job(plan, study.reduction, study.rules, run.manifest.user_code)
    with closing(make_pool(job, options)) as pool:
        # a cluster may have another number of workers
        for part in run_shards(pool, job, cut_into_shards(plan, pool.n_workers, missing)):
            run.commit(part)
            advance(part.sizes["scenario"])
        return n_run, pool.n_workers
