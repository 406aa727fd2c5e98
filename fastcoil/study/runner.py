"""Run a study file into a folder, and open what lies there.

The folder holds ``study.toml`` (the text that was run), ``results.nc`` and ``figures/``.  Until the study is
finished nothing but a lock is written.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import xarray as xr
from filelock import FileLock, Timeout

from fastcoil.engine.run import compile_kernel
from fastcoil.errors import InputError, LockedError, StorageError
from fastcoil.numerics.jit import model_sha256
from fastcoil.plan import check_disk
from fastcoil.results import content_sha256, load, save
from fastcoil.simulation import Progress, run, workers
from fastcoil.study.spec import Study, read_study

RESULTS = "results.nc"
STUDY = "study.toml"
_LOCK = ".lock"


@dataclass(frozen=True)
class Finished:
    """A finished study: where, what, and whether this call ran it."""

    folder: Path
    results: xr.Dataset
    ran: bool


def run_study(path: str | Path, out: str | Path | None = None, *, n_jobs: int | None = None) -> xr.Dataset:
    """Run a study file and return its results; a study that is finished in ``out`` is only opened.

    Parameters
    ----------
    path
        The study's TOML file.
    out
        Folder of the results; ``results/NAME`` by default, with the name of the file.
    n_jobs
        Threads; all cores by default.

    Raises
    ------
    InputError
        For any mistake in the file; nothing is written.
    LockedError, StorageError
        If another run writes to the folder, or it cannot be written.
    """
    path = Path(path)
    return execute(read_study(path), default_folder(path) if out is None else Path(out), n_jobs=n_jobs).results


def default_folder(path: Path) -> Path:
    """Folder of a study's results where none is given."""
    return Path("results") / path.stem


def open_study(folder: str | Path) -> xr.Dataset:
    """Open the results of a study by its folder, in memory, checked against their hash."""
    return load(Path(folder) / RESULTS)


def execute(
    study: Study, folder: Path, *, n_jobs: int | None = None, progress: Callable[[Study], Progress] | None = None
) -> Finished:
    """Run a study into ``folder``, or find it finished there.

    ``progress`` is called when there is work to do, with the study, and returns what is told of finished scenarios.
    """
    n_jobs = workers(n_jobs)
    with _locked(folder):
        done = _finished(study, folder)
        if done is not None:
            return Finished(folder, done, ran=False)
        check_disk(study.plan, folder)
        tell = progress(study) if progress else None
        compile_kernel()
        start = time.monotonic()
        ds = run(study.plan, n_jobs, tell)
        seconds = time.monotonic() - start
        ds.attrs |= {
            "title": study.title,
            "summary": study.question,
            "study_toml": study.text,
            "study_sha256": study.sha256,
            "model_sha256": model_sha256(),
            "wall_time_s": round(seconds, 3),
            "n_jobs": n_jobs,
            "scenario_days_per_s": round(study.plan.n_scenarios / seconds, 1),
        }
        ds.attrs["content_sha256"] = content_sha256(ds)
        save(ds, folder / RESULTS)
        (folder / STUDY).write_text(study.text, encoding="utf-8")
    return Finished(folder, ds, ran=True)


def _finished(study: Study, folder: Path) -> xr.Dataset | None:
    """The results in ``folder`` if they are this study's; ``None`` if it is to be run (again)."""
    if not (folder / RESULTS).exists():
        return None
    ds = load(folder / RESULTS)
    if ds.attrs.get("study_sha256") != study.sha256:
        raise InputError(
            f"{folder} holds the results of another study, or of another version of this one: choose another folder "
            "with -o, or delete this one"
        )
    # results of other physics are no answer to this study
    return ds if ds.attrs.get("model_sha256") == model_sha256() else None


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder for this run; one that was made for a run that failed is removed again."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file: choose another folder with -o")
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{folder} cannot be made: {error.strerror}; choose another folder with -o") from error
    lock = FileLock(folder / _LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise LockedError(f"{folder} is in use by another run: wait for it, or choose another folder with -o") from None
    except OSError as error:
        raise StorageError(f"{folder} cannot be written: {error.strerror}; choose another folder with -o") from error
    try:
        yield
    finally:
        lock.release()
        (folder / _LOCK).unlink(missing_ok=True)
        for path in made:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()
