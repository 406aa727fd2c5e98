"""Commands on studies: ``init``, ``plan``, ``run``, ``status``, ``verify``, ``rerun``; parameter lists."""

from __future__ import annotations

import sys
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fastcoil.base.arguments import choice_of
from fastcoil.base.errors import EXIT_FAILED_SCENARIOS, InputError, IntegrityError
from fastcoil.base.files import commit, exists
from fastcoil.base.progress import duration
from fastcoil.cli.arguments import PATH, labels_of, with_scenario
from fastcoil.cli.interrupts import interruptible
from fastcoil.cli.plot import draw_standard_figures
from fastcoil.cli.terminal import announce_compilation, run_own_code, say

if TYPE_CHECKING:
    from fastcoil.base.progress import Advance


@click.command()
@click.argument("study", type=PATH)
@click.option("-o", "--out", type=PATH, help="Folder of the results; results/NAME by default.")
@click.option("-j", "--jobs", type=int, help="Number of workers; all cores by default.  Does not affect results.")
@click.option("--backend", default="threads", show_default=True, help="threads, loky (processes) or dask.")
@click.option("--scheduler", help="Address of the scheduler of a dask cluster.")
@click.option("--extend", is_flag=True, help="Extend a smaller version of the study: only new scenarios are run.")
@click.option("--figures/--no-figures", default=True, help="Whether to draw the standard figures.")
def run(
    study: Path, out: Path | None, jobs: int | None, backend: str, scheduler: str | None, extend: bool, figures: bool
) -> None:
    """Run a STUDY file and summarise the results.

    An interrupted study is resumed; a finished one is not run again.
    """
    from fastcoil.base.progress import Shown
    from fastcoil.model.metric_table import STATUS_OK
    from fastcoil.study.analysis.summary import summary
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.folder.stored import RESULTS
    from fastcoil.study.run import Finished, default_folder, execute

    folder = out or default_folder(study)
    asked = read_study(study, prepare=run_own_code)

    def progress(n_todo: int) -> Advance:
        announce_compilation()
        n = asked.plan.n_scenarios
        if n_todo < n:
            say(f"Resuming: {n - n_todo:,} of {n:,} scenario-days done.", err=True)
        return shown.start(n, n - n_todo)

    def present(finished: Finished) -> None:
        if not finished.n_run:
            say(f"{folder} holds this study, finished: nothing to do.")
        say(*summary(finished.results, asked.billing))
        say(f"Results: {folder / RESULTS}")
        if figures:
            for path in draw_standard_figures(folder, finished.results):
                say(f"Figure:  {path}")

    with interruptible(study, folder), Shown() as shown:
        finished = execute(
            asked, folder, n_jobs=jobs, backend=backend, scheduler=scheduler, extend=extend, progress=progress,
            present=present,
        )  # fmt: skip
    if bool((finished.results["status"].values != STATUS_OK).any()):
        sys.exit(EXIT_FAILED_SCENARIOS)


@click.command()
@click.argument("study", type=PATH)
@click.option("-j", "--jobs", type=int, help="Workers; all cores by default.")
def plan(study: Path, jobs: int | None) -> None:
    """Check a STUDY file and show its size and run time; writes nothing."""
    from fastcoil.base.machine import available_memory, gib
    from fastcoil.loops.labels import sizes_in_words
    from fastcoil.loops.plan import check_disk, shards_of
    from fastcoil.loops.simulate import estimate_seconds, workers
    from fastcoil.model.engine.lanes import compile_kernel
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.run import default_folder

    n_jobs = workers(jobs)
    start = time.perf_counter()
    asked = read_study(study, prepare=run_own_code)
    reading = time.perf_counter() - start
    planned, traces_kept = asked.plan, asked.reduction is None
    check_disk(planned.disk_bytes(traces_kept=traces_kept), default_folder(study))
    announce_compilation()
    compile_kernel()
    seconds = reading + estimate_seconds(planned, n_jobs)
    sizes = sizes_in_words(planned.layout.sizes) or "a single scenario"
    alone, each = planned.memory_of_run(n_jobs, "threads")
    memory = alone + n_jobs * each
    say(f"Scenarios:   {planned.n_scenarios:,} ({sizes})")
    n_shards = len(shards_of(planned, n_jobs))
    n_steps = planned.n_scenarios * planned.n_steps
    say(f"Steps:       {planned.n_steps:,} s each, {n_steps:,} in total, {n_shards} shards")
    say(f"Boundary:    {planned.layout.boundary.describe()}")
    threads = f"{n_jobs} thread{'s' if n_jobs != 1 else ''}"
    say(f"Time:        about {duration(seconds)} on {threads} without figures (measured on blocks of this study)")
    say(f"Memory:      up to {gib(memory)} ({gib(available_memory())} available)")
    say(f"Disk:        up to {gib(planned.disk_bytes(traces_kept=traces_kept))} during the merge")


@click.command()
@click.argument("folder", type=PATH)
def status(folder: Path) -> None:
    """Show the progress of the study in FOLDER, and how to resume it."""
    from fastcoil.study import maintenance

    say(*maintenance.status(folder))


@click.command()
@click.argument("folder", type=PATH, metavar="FOLDER|ARCHIVE.zip")
def verify(folder: Path) -> None:
    """Check all files in the FOLDER of a study, or in an archive of one, against their hashes; changes nothing."""
    from fastcoil.study import maintenance

    problems = maintenance.verify(folder)
    if problems:
        raise IntegrityError("\n".join(problems))
    say(f"{folder} is sound.")


@click.command()
@click.argument("folder", type=PATH)
@with_scenario
def rerun(folder: Path, at: Sequence[str]) -> None:
    """Run one scenario of the study in FOLDER again, with all traces at every second."""
    from fastcoil.study import maintenance

    labels = labels_of(at)
    announce_compilation()
    path, found = maintenance.rerun(folder, labels, run_own_code)
    say(*found)
    say(f"Traces:  {path}")


@click.command()
@click.argument("study", type=PATH, required=False)
@click.option("--from", "name", metavar="NAME", help="Start from an example study.")
@click.option("--list", "only_list", is_flag=True, help="List the example studies; write nothing.")
def init(study: Path | None, name: str | None, only_list: bool) -> None:
    """Write a commented STUDY file to start from: study.toml by default, NAME.toml with --from NAME."""
    from fastcoil.study.file.starters import TEMPLATE, shipped_studies

    if only_list:
        for each, text in shipped_studies().items():
            say(f"{each:<20}{tomllib.loads(text)['title']}")
        return
    texts = {"study": TEMPLATE} if name is None else shipped_studies()
    name = choice_of("--from", name or "study", texts)
    path, text = study or Path(f"{name}.toml"), texts[name]
    if exists(path):
        raise InputError(f"{path} exists: choose another name, or delete it")
    commit(path, text.encode())
    say(f"{path} written.  Edit it, then: fastcoil plan {path}, fastcoil run {path}")
    # the script that does what `fastcoil run` does not
    say(*(line.removeprefix("# ") for line in text.splitlines() if line.startswith("# Analysis: ")))


@click.command()
@click.argument("names", nargs=-1)
def parameters(names: tuple[str, ...]) -> None:
    """List the parameters of a loop, or only NAMES: default, unit, meaning, allowed values."""
    from fastcoil.model.parameter_table import PARAMETERS, check_name, lines_of

    say(*lines_of([PARAMETERS[check_name(n)] for n in names] or PARAMETERS.values()))


@click.command()
def presets() -> None:
    """List the presets and how they differ from the defaults."""
    from fastcoil.loops.presets import PRESETS

    say(*repr(PRESETS).split("\n"))
