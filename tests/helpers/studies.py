"""Small studies, run, interrupted and resumed in their folders."""

import atexit
import shutil
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from fastcoil.loops import netcdf
from fastcoil.study import maintenance
from fastcoil.study import run as runner
from fastcoil.study.file.spec import Study, read_study
from fastcoil.study.folder.stored import Manifest

# fewer scenarios a day than a block has lanes: as many shards as days
DAYS = 3
PLAIN_STUDY = f"""
title = "small"
[loop]
noise_std = 0.02
[sweep]
backlash = [0.02, 0.07]
estimate_ratio = [0.0, 0.9]
[boundary]
hours = 0.25
seed = {list(range(1, DAYS + 1))}
[run]
warm_up = 100
"""
TRACED_STUDY = PLAIN_STUDY + 'traces = ["T_sup", "mode"]\ntrace_interval = 50\n'


def with_larger_sweep(text: str) -> str:
    """Add a value to the study."""
    return text.replace("[0.02, 0.07]", "[0.02, 0.07, 0.1]")


def write_study(text: str, folder: Path) -> Study:
    """Write the text to a file next to the folder of its results, and read the study."""
    path = folder.with_name("study.toml")
    path.write_text(text, encoding="utf-8")
    return read_study(path)


def run(text: str, folder: Path, **options: Any) -> str:
    """Run a study into a folder, one worker by default; return the hash of its results."""
    options = {"n_jobs": 1} | options
    finished = runner.execute(write_study(text, folder), folder, **options)
    return str(finished.results.attrs["content_sha256"])


@cache
def _run_once(text: str, n_shards: int | None = None) -> Path:
    """Return a folder, not to be changed, with the study run to its end or interrupted after some shards."""
    place = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    folder = place / "out"
    if n_shards is None:
        run(text, folder)
    else:
        run_until_interrupted(text, folder, n_shards)
    return folder


def copy_run(text: str, folder: Path, n_shards: int | None = None) -> None:
    """Copy the folder of a run to the end, or interrupted after some shards; each study is run only once for all."""
    original = _run_once(text, n_shards)
    write_study(text, folder)
    shutil.copytree(original, folder, dirs_exist_ok=True)
    manifest = Manifest.read(folder)
    assert manifest is not None
    assert manifest.relative_to == str(original.parent)
    replace(manifest, relative_to=str(folder.parent)).write(folder)


@cache
def undisturbed_hash(text: str) -> str:
    """Return the hash of an undisturbed run."""
    return str(netcdf.load(str(_run_once(text) / "results.nc")).attrs["content_sha256"])


def run_until_stopped(study: Study, folder: Path, n_shards: int, **options: Any) -> int:
    """Run a study until some shards are committed, then interrupt it as Ctrl-C does; return the scenarios run."""
    sizes: list[int] = []

    def advance(n_scenarios: int) -> None:
        sizes.append(n_scenarios)
        if len(sizes) == n_shards:
            raise KeyboardInterrupt

    try:
        runner.execute(study, folder, n_jobs=1, progress=lambda *_: advance, **options)
    except KeyboardInterrupt:
        return sum(sizes)
    raise AssertionError("the study was finished before it was interrupted")


def run_until_interrupted(text: str, folder: Path, n_shards: int, **options: Any) -> None:
    """Run the study of a text until some shards are committed, then interrupt it."""
    run_until_stopped(write_study(text, folder), folder, n_shards, **options)


def shard_files(folder: Path) -> list[Path]:
    """Return all files among the shards, also hidden ones."""
    return sorted((folder / "shards").glob("*"))


def folder_contents(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Return bytes and time of change of every file but locks; of a folder, its time."""
    return {
        str(p.relative_to(folder)): (p.read_bytes() if p.is_file() else b"", p.stat().st_mtime_ns)
        for p in sorted(folder.rglob("*")) if not p.name.startswith(".lock")
    }  # fmt: skip


def unfinished_files(folder: Path) -> list[Path]:
    """Return half-written files."""
    return [p for p in folder.rglob("*") if p.name.endswith(".tmp")]


def quarantined_names(folder: Path) -> list[str]:
    """Return the names of the files in quarantine."""
    return sorted(p.name for p in (folder / "quarantine").glob("*"))


def verify_unchanged(folder: Path) -> list[str]:
    """Verify a folder, and check that this changes nothing."""
    before = folder_contents(folder)
    problems = maintenance.verify(folder)
    assert folder_contents(folder) == before
    return problems


def resume_to_end(folder: Path, text: str = PLAIN_STUDY, **options: Any) -> list[str]:
    """Resume a study to its end, with the result of an undisturbed run; return the warnings."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        assert run(text, folder, **options) == undisturbed_hash(text)
    assert verify_unchanged(folder) == []
    assert unfinished_files(folder) == []
    assert shard_files(folder) == []
    return [str(w.message) for w in warned]


SITUATIONS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "plain": (PLAIN_STUDY, lambda folder: None),
    "traced": (TRACED_STUDY, lambda folder: None),
    "extended": (with_larger_sweep(TRACED_STUDY), lambda folder: copy_run(TRACED_STUDY, folder)),
    "resumed": (TRACED_STUDY, lambda folder: copy_run(TRACED_STUDY, folder, 1)),
}
"""The study to run, and the preparation of its folder."""
