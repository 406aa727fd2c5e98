"""The command line: what a user types and reads.  Heavy modules are imported inside the commands."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fastcoil.errors import EXIT_FAILED_SCENARIOS, EXIT_INTERRUPTED, FastcoilError, InputError

if TYPE_CHECKING:
    from fastcoil.simulation import Progress
    from fastcoil.study.spec import Study

_SECONDS_BETWEEN_LINES = 10.0

STUDY = click.Path(path_type=Path)
FOLDER = click.Path(path_type=Path)


class _Commands(click.Group):
    """Ends every mistake of the user with its sentences and an exit code, not with a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with _plain_warnings():
                return super().invoke(ctx)
        except FastcoilError as error:
            for line in str(error).splitlines():
                click.echo(f"fastcoil: {line}", err=True)
            ctx.exit(error.exit_code)
        except KeyboardInterrupt:
            click.echo("fastcoil: interrupted, nothing was written", err=True)
            ctx.exit(EXIT_INTERRUPTED)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="fastcoil")
def main() -> None:
    r"""Simulate coil valves with backlash under PI and backlash-inverse control, thousands of days at once.

    \b
    A first study:
      fastcoil init study.toml         writes a commented study file
      fastcoil plan study.toml         says how large it is and how long it takes
      fastcoil run study.toml          runs it: results/study/ with NetCDF and figures
    """


@main.command()
@click.argument("study", type=STUDY)
@click.option("-o", "--out", type=FOLDER, help="Folder of the results; results/NAME by default.")
@click.option("-j", "--jobs", type=int, help="Threads; all cores by default.  Results do not depend on it.")
@click.option("--figures/--no-figures", default=True, help="Whether to draw the standard figures.")
def run(study: Path, out: Path | None, jobs: int | None, figures: bool) -> None:
    """Run a STUDY file and summarise what was found.

    A finished study run again does nothing and says so.
    """
    from fastcoil.outputs import STATUS_OK
    from fastcoil.study.runner import RESULTS, default_folder, execute
    from fastcoil.study.spec import read_study
    from fastcoil.study.summary import summary

    folder = out or default_folder(study)
    finished = execute(read_study(study), folder, n_jobs=jobs, progress=_announced)
    if not finished.ran:
        click.echo(f"{folder} holds this study, finished: nothing to do.")
    for line in summary(finished.results):
        click.echo(line)
    click.echo(f"Results: {folder / RESULTS}")
    if figures:
        for path in _figures(folder, finished.results, redraw=finished.ran):
            click.echo(f"Figure:  {path}")
    if bool((finished.results["status"] != STATUS_OK).any()):
        sys.exit(EXIT_FAILED_SCENARIOS)


@main.command()
@click.argument("study", type=STUDY)
@click.option("-j", "--jobs", type=int, help="Threads; all cores by default.")
def plan(study: Path, jobs: int | None) -> None:
    """Check a STUDY file and say how large it is and how long it will take; writes nothing."""
    from fastcoil.plan import available_memory, check_disk, gib
    from fastcoil.simulation import probe, workers
    from fastcoil.study.runner import default_folder
    from fastcoil.study.spec import read_study

    n_jobs = workers(jobs)
    planned = read_study(study).plan
    check_disk(planned, default_folder(study))
    _announce_compilation()
    seconds = planned.lane_steps * probe(planned) / n_jobs
    sizes = " × ".join(f"{size} {dim}" for dim, size in planned.layout.sizes.items()) or "a single scenario"
    click.echo(f"Scenarios:   {planned.n_scenarios:,} ({sizes})")
    click.echo(
        f"Steps:       {planned.n_steps:,} s each, {planned.lane_steps:,} in all, {len(planned.shards(n_jobs))} shards"
    )
    click.echo(f"Boundary:    {planned.layout.boundary.describe()}")
    click.echo(f"Time:        about {_duration(seconds)} on {n_jobs} threads (measured on one block of this study)")
    click.echo(
        f"Memory:      up to {gib(3 * planned.result_bytes)} for the results ({gib(available_memory())} available)"
    )
    click.echo(f"Disk:        up to {gib(planned.result_bytes)}")


@main.command()
@click.argument("folder", type=FOLDER)
@click.option("--metric", "metrics", multiple=True, help="Metric to draw; may be repeated.  rmse, … by default.")
@click.option("-x", help="Swept parameter along the x axis.")
@click.option("-y", help="Second swept parameter: a map instead of a band.")
@click.option("--by", help="Second swept parameter: a curve for some of its values.")
def plot(folder: Path, metrics: tuple[str, ...], x: str | None, y: str | None, by: str | None) -> None:
    """Draw the figures of the finished study in FOLDER, or, with -x, one of your choice."""
    from fastcoil import plots
    from fastcoil.study.runner import open_study

    ds = open_study(folder)
    if x is None:
        if metrics or y or by:
            raise InputError("--metric, -y and --by need -x: name the swept parameter along the x axis")
        figures = plots.standard_figures(ds)
    else:
        wanted = metrics or plots.STANDARD_METRICS
        name = "_".join([*metrics, *(n for n in (y, by) if n), x])
        figures = {name: plots.maps(ds, x, y, wanted) if y else plots.bands(ds, x, by, wanted)}
    if not figures:
        click.echo("Nothing is swept in this study: there is nothing to draw.")
    for path in plots.write(figures, folder / "figures"):
        click.echo(path)


@main.command()
@click.argument("study", type=STUDY, default="study.toml")
def init(study: Path) -> None:
    """Write a commented STUDY file to start from."""
    from fastcoil.study.template import TEMPLATE

    try:
        with study.open("x", encoding="utf-8") as file:
            file.write(TEMPLATE)
    except FileExistsError:
        raise InputError(f"{study} exists: choose another name, or delete it") from None
    except OSError as error:
        raise InputError(f"{study} cannot be written: {error.strerror}") from None
    click.echo(f"{study} written.  Edit it, then: fastcoil plan {study}, fastcoil run {study}")


@main.command()
@click.argument("names", nargs=-1)
def parameters(names: tuple[str, ...]) -> None:
    """List the parameters of a loop (or only NAMES): default, unit, admissible values, meaning."""
    from fastcoil.parameter_table import PARAMETERS, check_name

    group = ""
    for p in [PARAMETERS[check_name(n)] for n in names] or PARAMETERS.values():
        if p.group != group:
            group = p.group
            click.echo(f"{group}")
        default = "-" if p.default is None else f"{p.default}"
        unit = "" if p.unit == "1" else p.unit
        click.echo(f"  {p.name:<22}{default:>10} {unit:<12} {p.text} ({p.bounds})")


@main.command()
def schema() -> None:
    """Print the JSON Schema of study files, for editors that complete and check TOML."""
    import json

    from fastcoil.study.schema import study_schema

    click.echo(json.dumps(study_schema(), indent=2, ensure_ascii=False))


def _figures(folder: Path, ds: Any, *, redraw: bool) -> list[Path]:
    """The standard figures of a study: drawn, or those that lie there already."""
    there = sorted((folder / "figures").glob("*.png"))
    if there and not redraw:
        return there
    from fastcoil import plots

    return plots.write(plots.standard_figures(ds), folder / "figures")


def _announce_compilation() -> None:
    from fastcoil.numerics.jit import is_compiled

    if not is_compiled("emulate"):
        click.echo("Compiling the kernels, once per installation: about 10 s …", err=True)


def _announced(study: Study) -> Progress:
    """Compile what is not compiled, then tell of finished scenarios: a bar, or a line every 10 s off a terminal."""
    from fastcoil.engine.run import compile_kernel

    _announce_compilation()
    compile_kernel()
    n = study.plan.n_scenarios
    return _bar(n) if sys.stderr.isatty() else _lines(n)


def _bar(n: int) -> Progress:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(), MofNCompleteColumn(), TextColumn("scenario-days"), TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(), TextColumn("ETA"), TimeRemainingColumn(),
    )  # fmt: skip
    bar = Progress(*columns, console=Console(stderr=True))
    task = bar.add_task("", total=n, rate="")
    bar.start()
    start, done = time.monotonic(), 0

    def advance(finished: int) -> None:
        nonlocal done
        done += finished
        bar.update(task, advance=finished, rate=f"{done / (time.monotonic() - start):,.0f}/s")
        if done == n:
            bar.stop()

    return advance


def _lines(n: int) -> Progress:
    start = last = time.monotonic()
    done = 0

    def advance(finished: int) -> None:
        nonlocal done, last
        done += finished
        now = time.monotonic()
        if now - last >= _SECONDS_BETWEEN_LINES:
            last = now
            rate = done / (now - start)
            eta = _duration((n - done) / rate)
            click.echo(f"{done:,} of {n:,} scenario-days, {rate:,.0f}/s, {eta} to go", err=True)

    return advance


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Show a warning as one line of text."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        click.echo(f"fastcoil: note: {message}", err=True)

    with warnings.catch_warnings():
        warnings.showwarning = show  # type: ignore[assignment]
        yield
