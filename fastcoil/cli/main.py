"""The command line: what a user types and reads.  Heavy modules are imported inside the commands."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fastcoil.base.errors import EXIT_FAILED_SCENARIOS, IntegrityError
from fastcoil.base.progress import duration
from fastcoil.cli.announcements import announce_compilation, run_own_code
from fastcoil.cli.archive import archive
from fastcoil.cli.cite import cite
from fastcoil.cli.diagnose import diagnose
from fastcoil.cli.explain import explain
from fastcoil.cli.explore import explore
from fastcoil.cli.export import export
from fastcoil.cli.fit import fit
from fastcoil.cli.fit_loop import fit_loop_command  # noqa: F401 — adds itself to the group fit
from fastcoil.cli.init import init
from fastcoil.cli.interrupts import Commands, interruptible
from fastcoil.cli.join import join
from fastcoil.cli.labels import labels_of
from fastcoil.cli.paths import PATH
from fastcoil.cli.plot import draw_standard_figures, plot
from fastcoil.cli.quick_start import quick_start
from fastcoil.cli.reference import parameters, presets, schema
from fastcoil.cli.report import report
from fastcoil.cli.terminal import say
from fastcoil.cli.tune import tune

if TYPE_CHECKING:
    from fastcoil.base.progress import Advance


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="fastcoil")
def main() -> None:
    """Simulate coil valves with backlash under PI and backlash-inverse control, thousands of days at once.

    \b
    A first study:
      fastcoil init study.toml         writes a commented study file
      fastcoil plan study.toml         shows its size and how long it takes
      fastcoil run study.toml          runs it: results/study/ with NetCDF and figures
    """  # noqa: D301 — click reads the backspace


@main.command()
@click.argument("study", type=PATH)
@click.option("-o", "--out", type=PATH, help="Folder of the results; results/NAME by default.")
@click.option("-j", "--jobs", type=int, help="Workers; all cores by default.  Results do not depend on it.")
@click.option("--backend", help="threads, loky (processes) or dask.  [default: threads]")
@click.option("--engine", hidden=True, help="Earlier name of --backend.")
@click.option("--scheduler", help="Address of a dask scheduler; a cluster on this machine by default.")
@click.option("--extend", is_flag=True, help="Add to a smaller version of the study: only new scenarios are run.")
@click.option("--figures/--no-figures", default=True, help="Whether to draw the standard figures.")
def run(
    study: Path,
    out: Path | None,
    jobs: int | None,
    backend: str | None,
    engine: str | None,
    scheduler: str | None,
    extend: bool,
    figures: bool,
) -> None:
    """Run a STUDY file and summarise the results.

    An interrupted study is resumed; a finished one is not run again.
    """
    with quick_start():
        from fastcoil.base.progress import progress_of_command
        from fastcoil.model.metric_table import STATUS_OK
        from fastcoil.study.analysis.summary import summary
        from fastcoil.study.file.spec import read_study
        from fastcoil.study.folder.result_files import RESULTS
        from fastcoil.study.runner import Finished, default_folder, execute
        from fastcoil.study.workers.pools import resolve_backend

    folder = out or default_folder(study)
    chosen = resolve_backend(backend, engine)
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

    with interruptible(study, folder), progress_of_command() as shown:
        finished = execute(
            asked,
            folder,
            n_jobs=jobs,
            backend=chosen,
            scheduler=scheduler,
            extend=extend,
            progress=progress,
            present=present,
        )
    if bool((finished.results["status"].values != STATUS_OK).any()):
        sys.exit(EXIT_FAILED_SCENARIOS)


@main.command()
@click.argument("study", type=PATH)
@click.option("-j", "--jobs", type=int, help="Workers; all cores by default.")
def plan(study: Path, jobs: int | None) -> None:
    """Check a STUDY file and show its size and how long it will take; writes nothing."""
    with quick_start():
        from fastcoil.base.machine import available_memory, gib
        from fastcoil.loops.cut import first_shards
        from fastcoil.loops.duration import count_shards, estimate_seconds
        from fastcoil.loops.resources import check_disk
        from fastcoil.loops.simulate import workers
        from fastcoil.model.engine.host import compile_kernel
        from fastcoil.study.file.spec import read_study
        from fastcoil.study.runner import default_folder

    n_jobs = workers(jobs)
    start = time.perf_counter()
    asked = read_study(study, prepare=run_own_code)
    reading = time.perf_counter() - start
    planned, traces_kept = asked.plan, asked.reduction is None
    check_disk(planned.disk_bytes(traces_kept=traces_kept), default_folder(study))
    announce_compilation()
    compile_kernel()
    seconds = reading + estimate_seconds(planned, n_jobs)
    sizes = " × ".join(f"{size} {dim}" for dim, size in planned.layout.sizes.items()) or "a single scenario"
    alone, each = planned.memory_of_run(n_jobs, "threads")
    memory = alone + n_jobs * each
    say(f"Scenarios:   {planned.n_scenarios:,} ({sizes})")
    n_shards = count_shards(first_shards(planned, n_jobs))
    say(f"Steps:       {planned.n_steps:,} s each, {planned.lane_steps:,} in total, {n_shards} shards")
    say(f"Boundary:    {planned.layout.boundary.describe()}")
    threads = f"{n_jobs} thread{'s' if n_jobs != 1 else ''}"
    say(f"Time:        about {duration(seconds)} on {threads} without figures (measured on blocks of this study)")
    say(f"Memory:      up to {gib(memory)} ({gib(available_memory())} available)")
    say(f"Disk:        up to {gib(planned.disk_bytes(traces_kept=traces_kept))} during the merge")


for command in (
    *(archive, cite, diagnose, explain, explore, export, fit, init, join),
    *(parameters, plot, presets, report, schema, tune),
):
    main.add_command(command)


@main.command()
@click.argument("folder", type=PATH)
def status(folder: Path) -> None:
    """Show the progress of the study in FOLDER, and how to resume it."""
    with quick_start():
        from fastcoil.study import maintenance

    say(*maintenance.status(folder))


@main.command()
@click.argument("folder", type=PATH, metavar="FOLDER|ARCHIVE.zip")
def verify(folder: Path) -> None:
    """Check everything in the FOLDER of a study, or in an archive of one, against its hashes; changes nothing."""
    with quick_start():
        from fastcoil.study import maintenance

    problems = maintenance.verify(folder)
    if problems:
        raise IntegrityError("\n".join(problems))
    say(f"{folder} is sound.")


@main.command()
@click.argument("folder", type=PATH)
@click.option(
    "--at",
    multiple=True,
    metavar="NAME=LABEL",
    help="The scenario, such as backlash=0.07,tuning=fast: a label for every dimension.",
)
def rerun(folder: Path, at: Sequence[str]) -> None:
    """Run one scenario of the study in FOLDER again, with all traces at every second."""
    with quick_start():
        from fastcoil.study import maintenance

    labels = labels_of(",".join(at))
    announce_compilation()
    path, found = maintenance.rerun(folder, labels, run_own_code)
    say(*found)
    say(f"Traces:  {path}")


@main.command()
@click.option("-o", "--out", type=PATH, default="results/paper", show_default=True, help="Folder of the results.")
@click.option("-j", "--jobs", type=int, help="Threads; all cores by default.")
@click.option("--quick", is_flag=True, help="A few tunings and days only: to try it out, not to quote.")
def paper(out: Path, jobs: int | None, quick: bool) -> None:
    """Regenerate the paper's simulated figures, and a scorecard of where its claims hold."""
    from fastcoil.study.paper.regenerate import regenerate

    announce_compilation()
    verdicts, written = regenerate(out, quick=quick, n_jobs=jobs, report=lambda line: say(line, err=True))
    say(*verdicts)
    say(f"Scorecard: {out / 'scorecard.md'}, .json; figures and data: {len(written)} files in {out}")
