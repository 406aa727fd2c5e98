"""Commands on studies and their loops: to make, run, check and draw a study, to explain, tune and explore its loops."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
import time
import tomllib
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import fastcoil as fc
from fastcoil.base.arguments import choice_of
from fastcoil.base.errors import EXIT_FAILED_SCENARIOS, InputError, IntegrityError, missing_extra
from fastcoil.base.files import commit, exists, file_name, is_folder, require_file
from fastcoil.base.machine import command_line
from fastcoil.base.progress import duration
from fastcoil.cli.arguments import PATH, all_labels_of, labels_of, pairs, with_scenario
from fastcoil.cli.deliver import with_report, write_found
from fastcoil.cli.terminal import announce_compilation, interruptible, run_own_code, say

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from fastcoil.base.progress import Advance

with_folder = click.option("-o", "--out", type=PATH, help="Folder of the results; results/NAME by default.")


@click.command()
@click.argument("study", type=PATH)
@with_folder
@click.option("-j", "--jobs", type=int, help="Number of workers; all cores by default.  Does not affect results.")
@click.option("--backend", default="threads", show_default=True, help="threads, loky (processes) or dask.")
@click.option("--scheduler", help="Address of the scheduler of a dask cluster.")
@click.option("--extend", is_flag=True, help="Extend a smaller version of the study: only new scenarios are run.")
@click.option("--shard", metavar="K/N", help="Run only share K of N, for job arrays; a run without it merges them.")
@click.option("--figures/--no-figures", default=True, help="Whether to draw the standard figures.")
def run(
    study: Path, out: Path | None, jobs: int | None, backend: str, scheduler: str | None, extend: bool,
    shard: str | None, figures: bool,
) -> None:  # fmt: skip
    """Run a STUDY file and summarise the results.

    An interrupted study is resumed; a finished one is not run again.
    """
    from fastcoil.base.progress import Shown
    from fastcoil.loops.plan import Share
    from fastcoil.model.metric_table import STATUS_OK
    from fastcoil.study.analysis.summary import summary
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.folder.stored import RESULTS
    from fastcoil.study.run import SCENARIO_DAYS, Finished, default_folder, execute, execute_share

    folder = out or default_folder(study)
    share = Share.parse(shard) if shard is not None else None
    if share and extend:
        raise InputError("--shard and --extend: an extension is one run, leave one of them out")
    asked = read_study(study, prepare=run_own_code)

    def progress(n_todo: int, n: int, what: str) -> Advance:
        announce_compilation()
        if n_todo < n:
            begun = "Resuming" if what == SCENARIO_DAYS else "Drawing on"
            say(f"{begun}: {n - n_todo:,} of {n:,} {what} done.", err=True)
        return shown.start(n, n - n_todo, what)

    def present(finished: Finished) -> None:
        if not finished.is_new:
            say(f"{folder} holds this study, finished: nothing to do.")
        say(*summary(finished.results, asked.billing))
        say(f"Results: {folder / RESULTS}")
        if figures:
            for path in draw_standard_figures(folder, finished.results):
                say(f"Figure:  {path}")

    if share:
        with interruptible(study, folder, options=["--shard", str(shard)]), Shown() as shown:
            n_run = execute_share(
                asked, folder, share, n_jobs=jobs, backend=backend, scheduler=scheduler, progress=progress
            )
        if n_run is None:
            say(f"{folder} holds this study, finished: nothing to do.")
            return
        merge = command_line(["fastcoil", "run", str(study), "-o", str(folder)])
        say(f"Share {shard} is finished: {n_run:,} {SCENARIO_DAYS} were run.")
        say(f"When all shares are finished, merge them with: {merge}")
        return
    with interruptible(study, folder), Shown() as shown:
        finished = execute(
            asked, folder, n_jobs=jobs, backend=backend, scheduler=scheduler, extend=extend, progress=progress,
            present=present,
        )  # fmt: skip
    if bool((finished.results["status"].values != STATUS_OK).any()):
        sys.exit(EXIT_FAILED_SCENARIOS)


_OF_LIBRARIES = 150 * 2**20  # bytes of memory, where the system does not say what this process has


@click.command()
@click.argument("study", type=PATH)
@click.option("-j", "--jobs", type=int, help="Workers; all cores by default.")
def plan(study: Path, jobs: int | None) -> None:
    """Check a STUDY file and show its size and run time; writes nothing."""
    from fastcoil.base.machine import available_memory, gib, private_memory
    from fastcoil.loops.labels import sizes_in_words
    from fastcoil.loops.plan import check_disk, shards_of
    from fastcoil.loops.simulate import estimate, workers
    from fastcoil.model.engine.lanes import compile_kernel
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.run import default_folder

    n_jobs = workers(jobs)
    start = time.perf_counter()
    asked = read_study(study, prepare=run_own_code)
    reading = time.perf_counter() - start
    planned, traces_kept = asked.plan, asked.reduction is None
    check_disk(planned.disk_bytes(traces_kept=traces_kept)[0], default_folder(study))
    announce_compilation()
    compile_kernel()
    alone, each = planned.memory_of_run(n_jobs, "threads", traces_kept=traces_kept)
    memory = (private_memory() or _OF_LIBRARIES) + alone + n_jobs * each
    seconds, metrics_left, traces_left = estimate(planned, n_jobs)
    room = planned.disk_bytes(traces_kept=traces_kept, metrics_left=metrics_left, traces_left=traces_left)
    sizes = sizes_in_words(planned.layout.sizes) or "a single scenario"
    say(f"Scenarios:   {planned.n_scenarios:,} ({sizes})")
    if asked.precision:
        say(f"Precision:   {asked.precision.how(planned.n_scenarios // asked.batches)}")
    n_shards = len(shards_of(planned, n_jobs))
    n_steps = planned.n_scenarios * planned.n_steps
    say(f"Steps:       {planned.n_steps:,} s each, {n_steps:,} in total, {n_shards} shards")
    say(f"Boundary:    {planned.layout.boundary.describe()}")
    threads = f"{n_jobs} thread{'s' if n_jobs != 1 else ''} without figures"
    say(f"Time:        about {duration(reading + seconds)} on {threads} (measured on blocks of this study)")
    say(f"Memory:      about {gib(memory)} ({gib(available_memory())} available)")
    without = "" if traces_kept else ", without what reduce returns"
    say(f"Disk:        about {gib(room[0])} during the merge, {gib(room[1])} afterwards{without}")


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
    """Write a commented STUDY file to start from: study.toml by default, NAME.toml with --from NAME.

    Its first line names fastcoil.schema.json, written beside it, with which editors complete and check it.
    """
    if only_list:
        for each, text in shipped_studies().items():
            say(f"{each:<20}{tomllib.loads(text)['title']}")
        return
    from fastcoil.study.file.schema import DIRECTIVE, SCHEMA, schema_text

    template = files("fastcoil.study.file").joinpath("template.toml").read_text(encoding="utf-8")
    texts = {"study": template} if name is None else shipped_studies()
    name = choice_of("--from", name or "study", texts)
    path, text = study or Path(f"{name}.toml"), texts[name]
    if exists(path):
        raise InputError(f"{path} exists: choose another name, or delete it")
    commit(path.with_name(SCHEMA), schema_text().encode())
    commit(path, (DIRECTIVE + text).encode())
    then = ", ".join(command_line(["fastcoil", verb, str(path)]) for verb in ("plan", "run"))
    say(f"{path} written, and {SCHEMA} for editors.  Edit it, then: {then}")
    # the script that does what `fastcoil run` does not
    say(*(line.removeprefix("# ") for line in text.splitlines() if line.startswith("# Analysis: ")))


def shipped_studies() -> dict[str, str]:
    """Name → text of the studies that come with fastcoil, by name."""
    installed, package = files("fastcoil") / "studies", Path(str(files("fastcoil")))
    home: Traversable = installed if installed.is_dir() else package.parent / "studies"  # of the repository
    found = [file for folder in home.iterdir() if folder.is_dir() for file in folder.iterdir()]
    found = sorted((file for file in found if file.name.endswith(".toml")), key=lambda file: file.name)
    return {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in found}


@click.command()
@click.argument("names", nargs=-1)
def parameters(names: tuple[str, ...]) -> None:
    """List the parameters of a loop, or only NAMES: default, unit, meaning, allowed values."""
    from fastcoil.model.parameter_table import PARAMETERS, check_name, lines_of

    say(*lines_of([PARAMETERS[check_name(n)] for n in names] or PARAMETERS.values()))


@click.command()
def presets() -> None:
    """List the presets and how they differ from the defaults."""
    say(*repr(fc.presets()).split("\n"))


_WIDTHS = 40.0, 500.0  # allowed range in mm


@click.command()
@click.argument("folder", type=PATH)
@click.option("--metric", "metrics", multiple=True, help="Metric to draw; may be repeated.  rmse, … by default.")
@click.option("-x", help="Swept or sampled parameter along the x axis; a sampled one in bins of equal counts.")
@click.option("-y", help="Second parameter: a map instead of a curve.")
@click.option("--by", help="Further dimension: a row of panels for each of some of its values.")
@click.option("--at", multiple=True, metavar="NAME=LABEL", help="Only scenarios with this label; may be repeated.")
@click.option(
    "--relative-to", multiple=True, metavar="NAME=LABEL", help="Draw changes against this case, pair by pair, in %."
)
@click.option("-o", "--out", type=PATH, help="File or folder to write; the figures of FOLDER by default.")
@click.option("--format", help="png, pdf or svg.  [default: png, or that of the file]")
@click.option("--dpi", default="200", show_default=True, help="Dots per inch, 50 to 1200.")
@click.option("--width", metavar="LENGTH", help="Width of the figure, such as 84mm; letters keep their size.")
def plot(
    folder: Path, out: Path | None, format: str | None, dpi: str, metrics: tuple[str, ...], x: str | None,
    y: str | None, by: str | None, at: tuple[str, ...], relative_to: tuple[str, ...], width: str | None,
) -> None:  # fmt: skip
    """Draw the standard figures of the finished study in FOLDER, or a custom one with -x."""
    from fastcoil.base.figures import FIGURES, check_format, write
    from fastcoil.deliver.figures.swept import standard_figures
    from fastcoil.study.folder.folder import StudyFolder, hold
    from fastcoil.study.folder.results import open_study

    suffix = out.suffix.removeprefix(".").lower() if out and not is_folder(out) else ""
    if suffix and format and format.lower() != suffix:
        raise InputError(f"-o {out} and --format {format}: they differ, give one of them")
    chosen, dots = format or suffix or "png", int(dpi) if dpi.isdecimal() else dpi
    check_format(chosen, dots)
    StudyFolder(folder).require_manifest()
    if x is None and (metrics or y or by):
        raise InputError("--metric, -y and --by need -x: name the swept parameter along the x axis")
    inches, fixed, case = _inches(width), all_labels_of("--at", at), all_labels_of("--relative-to", relative_to)
    ds = open_study(folder)
    parts = [*metrics, *filter(None, (y, by, x))]
    parts += [f"{name}={'+'.join(labels)}" for name, labels in fixed.items()]
    parts += [f"to-{name}={'+'.join(labels)}" for name, labels in case.items()]
    part = _part(ds, [name for name in (x, y, by) if name], fixed, case)
    drawn = standard_figures(part, inches) if x is None else {"": _figure(part, metrics, x, y, by, inches)}
    figures = {file_name("_".join(filter(None, [name, *parts]))): draw() for name, draw in drawn.items()}
    if not figures:
        say("Nothing is swept in this study, so there is nothing to draw.")
        return
    options: Any = {"format": chosen, "dpi": dots, "drawn_from": ds.attrs.get("content_sha256")}
    if out is None:
        with hold(folder):
            paths = write(figures, folder / FIGURES, **options)
    elif suffix:
        first, *others = figures
        paths = write({out.stem: figures[first]}, out.parent, **options)
        if others:
            say(f"{out} shows {first}; to write {', '.join(others)} as well, give a folder.", err=True)
    else:
        paths = write(figures, out, **options)
    say(*paths)


def _figure(
    part: xr.Dataset, metrics: Sequence[str], x: str, y: str | None, by: str | None, width: float | None
) -> Callable[[], Figure]:
    """What draws the figure of chosen axes."""
    from fastcoil.deliver.figures import swept as plots

    plots.rows_of(part, by)  # refused if there is no such dimension
    unlike = [d for d in plots.control_dims(part) if d not in (x, y, by)]
    if by is None and unlike:
        by, *unlike = unlike
    if unlike:
        which = f"select one with --at {unlike[0]}={part[unlike[0]].values[0]}, or give --by {unlike[0]}"
        raise InputError(f"{unlike[0]}: a plain PI would be pooled with other controllers in one median: {which}")
    shown = metrics or plots.STANDARD_METRICS[: plots.panels_abreast(width) if by else None]
    return partial(plots.panels, part, x, y, by, shown, width)


def _part(
    ds: xr.Dataset, axes: Sequence[str], at: Mapping[str, Sequence[str]], to: Mapping[str, Sequence[str]]
) -> xr.Dataset:
    """The part of the results to draw, with a title that describes it."""
    from fastcoil.study.analysis.compare import relative_to
    from fastcoil.study.analysis.selected import binned, case_of, drawn_parameters, in_words, selected

    part, words = selected(ds, at), [str(ds.attrs.get("title", ""))]
    if at:
        words.append(f"at {in_words(part, at)}")
    if to:
        case, named = case_of(part, to)
        part = relative_to(part, case, named)
        words.append(f"against {named}")
    if len(set(axes)) < len(axes):
        raise InputError(f"{axes[0]} is named twice: choose two different axes")
    if drawn := [n for n in axes if n in drawn_parameters(part)]:
        part = binned(part, drawn)
    return part.assign_attrs(title=", ".join(filter(None, words)))


def _inches(width: str | None) -> float | None:
    if width is None:
        return None
    found = re.fullmatch(r"(\d+\.?\d*)\s*mm", width.strip())
    if found is None or not _WIDTHS[0] <= float(found[1]) <= _WIDTHS[1]:
        raise InputError(f"--width {width}: give {_WIDTHS[0]:g} to {_WIDTHS[1]:g} mm with the unit, such as 84mm")
    return float(found[1]) / 25.4


def draw_standard_figures(folder: Path, ds: xr.Dataset) -> list[Path]:
    """Draw standard figures of ``ds`` that a locked folder lacks or has of others; its PNG figures of these results."""
    from fastcoil.base.figures import FIGURES, current_figures, write
    from fastcoil.deliver.figures import swept as plots

    drawn_from = ds.attrs["content_sha256"]
    there = {path.name for path in current_figures(folder, drawn_from)}
    for name, draw in plots.standard_figures(ds).items():
        if f"{name}.png" not in there:
            write({name: draw()}, folder / FIGURES, drawn_from=drawn_from)
    return [path for path in current_figures(folder, drawn_from) if path.suffix == ".png"]


@click.command()
@click.argument("target", type=PATH)
@with_scenario
@click.option(
    "--set", "changes", multiple=True, metavar="NAME=VALUE", help="Another value for a parameter, such as kp=0.03."
)
@click.option("-o", "--out", type=PATH, metavar="FIGURE", help="Figure to write: .png, .pdf or .svg; none by default.")
@with_report
def explain(target: Path, at: Sequence[str], changes: Sequence[str], out: Path | None, report: Path | None) -> None:
    """Explain whether and why one loop hunts, what would cure it, and what that costs.

    TARGET is a preset such as lbnl (simulated on the generic day), a study file, or the folder of a study.

    \b
      fastcoil explain lbnl --set kp=0.03 --set ti=5
      fastcoil explain results/study --at backlash=0.07 --at day=3 -o explain.png
    """  # noqa: D301 — click reads the backspace
    from fastcoil.base.figures import FORMATS
    from fastcoil.study.maintenance import one_scenario

    if out is not None:
        require_file("-o", out, *(f".{form}" for form in FORMATS))
    scenario = one_scenario(target, labels_of(at), pairs("--set", changes))
    announce_compilation()
    found = fc.explain(scenario.loop, scenario.boundary, warm_up=scenario.warm_up, seed=scenario.seed)
    say(scenario.title, *found.text.splitlines())
    write_found(found, out, report)


CHOSEN = "tuning.toml"


@click.command()
@click.argument("study", type=PATH)
@with_folder
@click.option("-j", "--jobs", type=int, help="Threads; all cores by default.  Results do not depend on it.")
@with_report
def tune(study: Path, out: Path | None, jobs: int | None, report: Path | None) -> None:
    """Tune kp, ti and other settings for all valves and days of a STUDY file, and validate them on others.

    The table [tune] of the study file defines the search, the objective and the limits.
    """
    from fastcoil.base.progress import Shown
    from fastcoil.design.tune import run_tuning
    from fastcoil.loops.simulate import workers
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.folder.folder import hold
    from fastcoil.study.run import default_folder

    n_jobs, folder = workers(jobs), out or default_folder(study)
    asked = read_study(study, prepare=run_own_code).tuning
    if asked is None:
        raise InputError(f"{study} has no table [tune]: add one, such as search = {{ kp = [0.005, 0.1] }}")
    announce_compilation()
    with interruptible(study, folder, "tune"), hold(folder):
        with Shown() as shown:
            found = run_tuning(asked._replace(n_jobs=n_jobs), shown)
        say(*found.summary(), "")
        write_found(found, folder / CHOSEN, report)


PORT = 5010


@click.command()
@click.argument("target", type=PATH, default="paper_like")
@with_scenario
@click.option("--port", type=click.IntRange(0, 65535), default=PORT, show_default=True, help="0: any free port.")
@click.option("--browser/--no-browser", default=True, help="Whether to open the page.")
def explore(target: Path, at: Sequence[str], port: int, browser: bool) -> None:
    """Open an interactive page for one loop: change gap, tuning or day and see the response.

    TARGET is a preset (paper_like by default), a study file, or the folder of a study.  The page is served on this
    machine only and needs no internet.  Ctrl-C ends it.

    \b
      fastcoil explore
      fastcoil explore lbnl
      fastcoil explore results/study --at backlash=0.07 --at day=3
    """  # noqa: D301 — click reads the backspace
    if importlib.util.find_spec("bokeh") is None:
        raise missing_extra("explore", "bokeh", "explore")
    import asyncio

    from fastcoil.deliver.explore.loop import Model
    from fastcoil.deliver.explore.page import serve
    from fastcoil.loops.presets import PRESETS
    from fastcoil.study.maintenance import one_scenario

    name, labels = str(target), labels_of(at)
    given = None if name in PRESETS and not labels else one_scenario(target, labels, {})
    model = Model(given, name)
    announce_compilation()

    def ready(address: str) -> None:
        say(f"Page: {address}  (this machine only; Ctrl-C ends it)")
        has_screen = sys.platform in ("win32", "darwin") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
        if browser and has_screen:
            webbrowser.open(address)

    asyncio.run(serve(model, port, ready))
    say("Ended.")
