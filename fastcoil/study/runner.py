"""Run a study file into a folder: begin, go on, extend, or find it finished."""

from __future__ import annotations

import difflib
import time
import warnings
from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from fastcoil.engine.host import compile_kernel
from fastcoil.errors import InputError, IntegrityError
from fastcoil.numerics.jit import model_sha256
from fastcoil.simulation.resources import check_disk
from fastcoil.simulation.simulate import workers
from fastcoil.study.file.spec import Study, read_study
from fastcoil.study.folder.extend import reusable
from fastcoil.study.folder.merge import merge, opened, tidied
from fastcoil.study.folder.results import Earlier, attributes, begun_study, is_current, open_study
from fastcoil.study.folder.store import RESULTS, Begun, begin, begun, begun_text, commit_shard, committed, locked
from fastcoil.study.workers.dispatch import Rounds
from fastcoil.study.workers.pools import engine_problems, make_pool
from fastcoil.study.workers.worker import Job

Progress = Callable[[int], None]
"""Called with the number of scenarios finished since the last call."""


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
    engine: str = "threads",
    scheduler: str | None = None,
    extend: bool = False,
) -> xr.Dataset:
    """Run a study file and return its results.

    A study that is finished in ``out`` is only opened; one that was interrupted goes on where it was.

    Parameters
    ----------
    path
        The study's TOML file.
    out
        Folder of the results; ``results/NAME`` by default, with the name of the file.
    n_jobs
        Workers; all cores by default.  Results do not depend on it.
    engine
        ``threads``, ``loky`` (processes: one that crashes takes nothing else down) or ``dask``.  Nor on this.
    scheduler
        Address of a dask scheduler, such as ``tcp://host:8786``; a cluster on this machine by default.
    extend
        Whether ``out`` may hold a smaller version of the study, of which everything is kept.

    Returns
    -------
    xarray.Dataset
        As of ``simulate``; traces stay on the disk until they are asked for.

    Raises
    ------
    InputError
        For any mistake in the file, or if ``out`` holds another study; nothing is changed.
    LockedError, StorageError, IntegrityError
        If another run writes to ``out``; if it cannot be written; if what lies there is damaged.
    """
    path = Path(path)
    folder = default_folder(path) if out is None else Path(out)
    options = {"n_jobs": n_jobs, "engine": engine, "scheduler": scheduler, "extend": extend}
    return execute(read_study(path), folder, **options).results  # type: ignore[arg-type]


def default_folder(path: Path) -> Path:
    """Folder of a study's results where none is given."""
    return Path("results") / path.stem


def execute(
    study: Study,
    folder: Path,
    *,
    n_jobs: int | None = None,
    engine: str = "threads",
    scheduler: str | None = None,
    extend: bool = False,
    progress: Callable[[int], Progress] | None = None,
) -> Finished:
    """Run a study into ``folder``, go on with it, or find it finished there; see ``run_study``.

    ``progress`` is called when there is work to do, with the number of scenarios to run, and returns what is told of
    finished ones.
    """
    n_jobs = workers(n_jobs)
    problems = engine_problems(engine, scheduler)
    if problems:
        raise InputError(problems)
    plan = study.plan
    run = Begun(study.sha256, plan.layout.boundary.sha256, model_sha256(), str(study.folder.absolute()))
    with locked(folder):
        there = begun(folder)
        begins = there != run or begun_text(folder) != study.text
        if there is not None and there.study_sha256 != run.study_sha256:
            _check_may_change(folder, study, there, run, extend)
        elif (folder / RESULTS).exists():
            ds = opened(folder)
            if is_current(ds, run):
                if begins:  # what was begun was lost
                    begin(folder, run, study.text)
                return Finished(folder, tidied(folder, ds), 0)
        if there is not None and there.model_sha256 != run.model_sha256:
            warnings.warn(f"{folder} was computed with other sources of the model: all is computed again", stacklevel=2)
        earlier = Earlier.of(folder, study, run)
        done = np.zeros(plan.n_scenarios, dtype=bool)
        if earlier.new is not None:
            done[earlier.new] = True
        for part in committed(folder, run.key):
            done[part["scenario"].values] = True
        todo = np.flatnonzero(~done)
        check_disk(plan.disk_bytes(traces_kept=study.reduction is None), folder)
        start = time.monotonic()
        if todo.size:
            tell = progress(todo.size) if progress else None
            compile_kernel()
            job = Job(run.key, plan, study.reduction)
            with closing(make_pool(engine, job, n_jobs, scheduler)) as pool:
                for part in Rounds(pool, job).results(plan.shards(pool.n_workers, todo)):
                    if begins:
                        begin(folder, run, study.text)
                        begins = False
                    commit_shard(folder, part, run.key)
                    if tell:
                        tell(part.sizes["scenario"])
        elif begins:
            begin(folder, run, study.text)
        seconds = time.monotonic() - start
        speed = {"wall_time_s": round(seconds, 3), "scenario_days_per_s": round(todo.size / max(seconds, 1e-9), 1)}
        attrs = attributes(study, run.model_sha256) | speed | {"n_jobs": n_jobs, "engine": engine}
        ds = merge(
            folder,
            plan,
            lambda traces: earlier.parts(committed(folder, run.key), traces),
            study.kept_traces,
            attrs,
            run.key,
        )
    return Finished(folder, ds, todo.size)


def _check_may_change(folder: Path, study: Study, there: Begun, run: Begun, extend: bool) -> None:
    """Refuse another study than the one that lies in the folder, unless it is extended."""
    if not extend:
        text = begun_text(folder)
        if text is None:
            raise IntegrityError(
                f"{folder}: study.toml is missing or damaged, and another study was begun than this one: bring it "
                "back, or choose another folder with -o"
            )
        changes = [
            line
            for line in difflib.unified_diff(text.splitlines(), study.text.splitlines(), "there", "given", lineterm="")
            if line[:1] in "+-" and line[:3] not in ("+++", "---")
        ]
        differs = changes[:10] + ["…"] * (len(changes) > 10)
        if not changes:
            raise IntegrityError(
                f"{folder}: a file that the study reads changed since the run was begun: bring it back, or choose "
                "another folder with -o"
            )
        raise InputError(
            "\n".join(
                [
                    f"{folder} holds another study, or another version of this one; give --extend if values were only "
                    "added, else choose another folder with -o.  It differs in:",
                    *differs,
                ]
            )
        )
    if (folder / RESULTS).exists() and is_current(opened(folder), there):
        return
    before = begun_study(folder, there)
    if there.model_sha256 != run.model_sha256:
        return
    # what an unfinished run has becomes a result with scenarios that were not run, to be extended like any other
    earlier = Earlier.of(folder, before, there)

    def parts(traces: Collection[str]) -> Iterator[xr.Dataset]:
        return earlier.parts(committed(folder, there.key), traces)

    # all of them, so that what is damaged is set aside before it is opened
    if sum(part.sizes["scenario"] for part in parts([])):
        reusable(study.plan, attributes(study, run.model_sha256), open_study(folder))
        attrs = attributes(before, there.model_sha256)
        merge(folder, before.plan, parts, before.kept_traces, attrs, there.key, complete=False)
