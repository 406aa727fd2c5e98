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
from fastcoil.base.arguments import require_choice
from fastcoil.base.errors import EXIT_FAILED_SCENARIOS, InputError, IntegrityError, missing_extra_error
from fastcoil.base.files import exists, is_folder, portable_file_name, require_output_file, write_atomically
from fastcoil.base.machine import command_line
from fastcoil.base.progress import format_duration
from fastcoil.base.text import format_count
from fastcoil.cli.arguments import PATH, parse_label_lists, parse_labels, parse_pairs, with_scenario
from fastcoil.cli.deliver import with_report, write_result
from fastcoil.cli.terminal import echo, handle_interrupts, load_user_code, print_logs

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
    from fastcoil.base.progress import ProgressDisplay
    from fastcoil.loops.plan import JobSlice
    from fastcoil.model.metric_table import STATUS_OK
    from fastcoil.study.analysis.summary import summary
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.folder.stored import RESULTS_FILE
    from fastcoil.study.run import SCENARIO_DAYS, FinishedStudy, default_folder, execute, execute_slice

    folder = out or default_folder(study)
    job_slice = JobSlice.parse(shard) if shard is not None else None
    if job_slice and extend:
        raise InputError("--shard and --extend: an extension is one run, leave one of them out", "--shard", "conflict")
    spec = read_study(study, prepare=load_user_code)
    workers: Any = {"n_jobs": jobs, "backend": backend, "scheduler": scheduler}

    def start_display(n_todo: int, n: int, items: str) -> Advance:
        if n_todo < n:
            state = "Resuming" if items == SCENARIO_DAYS else "Drawing on"
            echo(f"{state}: {n - n_todo:,} of {n:,} {items} done.", err=True)
        return display.start(n, n - n_todo, items)

    def print_results(finished: FinishedStudy) -> None:
        if not finished.is_new:
            echo(f"{folder} holds this study, finished: nothing to do.")
        echo(*summary(finished.results))
        echo(f"Results: {folder / RESULTS_FILE}")
        if figures:
            for path in draw_standard_figures(folder, finished.results):
                echo(f"Figure:  {path}")

    if job_slice:
        with ProgressDisplay() as display, handle_interrupts(display, study, folder, options=["--shard", str(shard)]):
            n_run = execute_slice(spec, folder, job_slice, **workers, progress=start_display)
        if n_run is None:
            echo(f"{folder} holds this study, finished: nothing to do.")
            return
        merge = command_line(["fastcoil", "run", str(study), "-o", str(folder)])
        echo(f"Share {shard} is finished: {n_run:,} {SCENARIO_DAYS} were run.")
        echo(f"When all shares are finished, merge them with: {merge}")
        return
    with ProgressDisplay() as display, handle_interrupts(display, study, folder):
        finished = execute(spec, folder, **workers, extend=extend, progress=start_display, present=print_results)
    if bool((finished.results["status"].values != STATUS_OK).any()):
        sys.exit(EXIT_FAILED_SCENARIOS)


@click.command()
@click.argument("study", type=PATH)
@click.option("-j", "--jobs", type=int, help="Workers; all cores by default.")
def plan(study: Path, jobs: int | None) -> None:
    """Check a STUDY file and show its size and run time; writes nothing."""
    from fastcoil.base.machine import available_memory, format_bytes, private_memory
    from fastcoil.loops.labels import sizes_in_words
    from fastcoil.loops.plan import check_disk, cut_into_shards
    from fastcoil.loops.simulate import estimate_run_time, number_of_threads
    from fastcoil.model.engine.lanes import compile_kernel
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.run import default_folder

    n_jobs = number_of_threads(jobs)
    start = time.perf_counter()
    spec = read_study(study, prepare=load_user_code)
    reading_seconds = time.perf_counter() - start
    run_plan, traces_kept = spec.plan, spec.reduction is None
    check_disk(run_plan.disk_bytes(traces_kept=traces_kept)[0], default_folder(study))
    compile_kernel()
    shared_bytes, worker_bytes = run_plan.memory_of_run(n_jobs, "threads", traces_kept=traces_kept)
    library_bytes = private_memory() or 150 * 2**20  # a typical value where the system does not say it
    memory_bytes = library_bytes + shared_bytes + n_jobs * worker_bytes
    seconds, metrics_left, traces_left = estimate_run_time(run_plan, n_jobs)
    disk_bytes = run_plan.disk_bytes(traces_kept=traces_kept, metrics_left=metrics_left, traces_left=traces_left)
    echo(f"Scenarios:   {run_plan.n_scenarios:,} ({sizes_in_words(run_plan.layout.sizes) or 'a single scenario'})")
    if spec.precision:
        echo(f"Precision:   {spec.precision.describe_plan(run_plan.n_scenarios // spec.batches)}")
    n_shards = len(cut_into_shards(run_plan, n_jobs))
    n_steps = run_plan.n_scenarios * run_plan.n_steps
    echo(f"Steps:       {run_plan.n_steps:,} s each, {n_steps:,} in total, {format_count(n_shards, 'shard')}")
    echo(f"Boundary:    {run_plan.layout.boundary.describe()}")
    duration = format_duration(reading_seconds + seconds)
    threads = f"{format_count(n_jobs, 'thread')} without figures"
    echo(f"Time:        about {duration} on {threads} (measured on blocks of this study)")
    echo(f"Memory:      about {format_bytes(memory_bytes)} ({format_bytes(available_memory())} available)")
    exclusion = "" if traces_kept else ", without what reduce returns"
    bytes_during, bytes_after = map(format_bytes, disk_bytes)
    echo(f"Disk:        about {bytes_during} during the merge, {bytes_after} afterwards{exclusion}")


_STAGES: tuple[dict[str, Any], ...] = (
    {"estimator": ["learner", "hagglund", "gradient", "identify"], "learning_step": 0.01, "plant_gain": 25.0},
    {"buffer_noise": "measured", "buffer_ratio": 6.0, "buffer_swing": 0.2, "plant_gain": 25.0},
    {"compensation": "additive"}, {"compensation": "smooth"}, {"sensor_resolution": 0.1}, {"error_dead_band": 0.1},
    {"command_resolution": 0.01}, {"neutral_zone": 0.01}, {"slip_jump": 0.01}, {"wear_rate": 1e-6},
)  # fmt: skip
"""Loops with one of the parts that are compiled apart; several at once take another second when first used."""


@click.command("compile")
def compile_kernels() -> None:
    """Compile what studies need, for images and CI: later runs of this version on such a processor start at once."""
    from fastcoil.base.errors import StorageError
    from fastcoil.model.numerics.jit import fingerprint
    from fastcoil.model.numerics.kernel_cache import kernel_folder

    folder, start = kernel_folder(fingerprint()), time.perf_counter()
    if folder is None:
        raise StorageError("compiled kernels cannot be kept on this machine, see the note above")
    n_before = len(list(folder.iterdir()))
    day = fc.paper_day(hours=1, seed=1)
    for values in _STAGES:
        fc.simulate(fc.Loop(**values), day, warm_up=0, n_jobs=1, progress=False)
    fc.explain(fc.Loop.preset("lbnl"), day)
    n_kernels, seconds = len(list(folder.iterdir())), time.perf_counter() - start
    compiled = f"{n_kernels - n_before} kernels compiled in {format_duration(seconds)}"
    echo(f"{compiled if n_kernels > n_before else 'Nothing to compile'}: {n_kernels} are in {folder}")


@click.command()
@click.argument("folder", type=PATH)
def status(folder: Path) -> None:
    """Show the progress of the study in FOLDER, and how to resume it."""
    from fastcoil.study import maintenance

    echo(*maintenance.status(folder))


@click.command()
@click.argument("folder", type=PATH)
def verify(folder: Path) -> None:
    """Check all files in the FOLDER of a study against their hashes; changes nothing."""
    from fastcoil.study import maintenance

    if problems := maintenance.verify(folder):
        raise IntegrityError("\n".join(problems))
    echo(f"{folder} is sound.")


@click.command()
@click.argument("folder", type=PATH)
@with_scenario
def rerun(folder: Path, at: Sequence[str]) -> None:
    """Run one scenario of the study in FOLDER again, with all traces at every second."""
    from fastcoil.study import maintenance

    path, lines = maintenance.rerun(folder, parse_labels(at), load_user_code)
    echo(*lines)
    echo(f"Traces:  {path}")


@click.command()
@click.argument("study", type=PATH, required=False)
@click.option("--from", "name", metavar="NAME", help="Start from an example study.")
@click.option("--list", "only_list", is_flag=True, help="List the example studies; write nothing.")
def init(study: Path | None, name: str | None, only_list: bool) -> None:
    """Write a commented STUDY file to start from: study.toml by default, NAME.toml with --from NAME."""
    if only_list:
        for study_name, text in shipped_studies().items():
            echo(f"{study_name:<20}{tomllib.loads(text)['title']}")
        return
    template = files("fastcoil.study.file").joinpath("template.toml").read_text(encoding="utf-8")
    texts = {"study": template} if name is None else shipped_studies()
    name = require_choice("--from", name or "study", texts)
    path, text = study or Path(f"{name}.toml"), texts[name]
    if exists(path):
        raise InputError(f"{path} exists: choose another name", "STUDY", "path")
    write_atomically(path, text.encode())
    next_commands = ", ".join(command_line(["fastcoil", verb, str(path)]) for verb in ("plan", "run"))
    echo(f"{path} written.  Edit it, then: {next_commands}")
    # the script that does what `fastcoil run` does not
    echo(*(line.removeprefix("# ") for line in text.splitlines() if line.startswith("# Analysis: ")))


def shipped_studies() -> dict[str, str]:
    """Read the studies that come with fastcoil: name → text, by name."""
    shipped, package = files("fastcoil") / "studies", Path(str(files("fastcoil")))
    home: Traversable = shipped if shipped.is_dir() else package.parent / "studies"  # of the repository
    paths = [file for folder in home.iterdir() if folder.is_dir() for file in folder.iterdir()]
    paths = sorted((file for file in paths if file.name.endswith(".toml")), key=lambda file: file.name)
    return {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in paths}


@click.command()
@click.argument("names", nargs=-1)
def parameters(names: tuple[str, ...]) -> None:
    """List the parameters of a loop, or only NAMES: default, unit, meaning, allowed values."""
    from fastcoil.model.parameter_table import PARAMETERS, parameter_lines, require_parameter_name

    echo(*parameter_lines([PARAMETERS[require_parameter_name(n)] for n in names] or PARAMETERS.values()))


@click.command()
def presets() -> None:
    """List the presets and how they differ from the defaults."""
    echo(*repr(fc.presets()).split("\n"))


@click.command()
@click.argument("folder", type=PATH)
@click.option("--metric", "metrics", multiple=True, help="Metric to draw; may be repeated.  rmse, … by default.")
@click.option("-x", help="Swept or sampled parameter along the x axis; a sampled one in bins of equal counts.")
@click.option("-y", help="Second parameter: a map instead of a curve.")
@click.option("--by", help="Further dimension: a curve for each of some of its values; of maps, a row of panels.")
@click.option("--at", multiple=True, metavar="NAME=LABEL", help="Only scenarios with this label; may be repeated.")
@click.option("-o", "--out", type=PATH, help="File or folder to write; the figures of FOLDER by default.")
@click.option("--format", help="png, pdf or svg.  [default: png, or that of the file]")
@click.option("--dpi", default="200", show_default=True, help="Dots per inch, 50 to 1200.")
@click.option("--width", metavar="LENGTH", help="Width of the figure, such as 84mm; letters keep their size.")
def plot(
    folder: Path, out: Path | None, format: str | None, dpi: str, metrics: tuple[str, ...], x: str | None,
    y: str | None, by: str | None, at: tuple[str, ...], width: str | None,
) -> None:  # fmt: skip
    """Draw the standard figures of the finished study in FOLDER, or a custom one with -x."""
    from fastcoil.base.figures import FIGURES_FOLDER, check_format, write_figures
    from fastcoil.deliver.figures.swept import standard_figures
    from fastcoil.study.folder.folder import StudyFolder, hold_folder
    from fastcoil.study.folder.results import open_study

    suffix = out.suffix.removeprefix(".").lower() if out and not is_folder(out) else ""
    if suffix and format and format.lower() != suffix:
        raise InputError(f"-o {out} and --format {format}: they differ, give one of them", "--format", "conflict")
    file_format, dots_per_inch = format or suffix or "png", int(dpi) if dpi.isdecimal() else dpi
    check_format(file_format, dots_per_inch)
    StudyFolder(folder).require_manifest()
    if x is None and (metrics or y or by):
        raise InputError("--metric, -y and --by need -x: name the swept parameter along the x axis", "-x", "missing")
    inches, labels_at = _width_in_inches(width), parse_label_lists("--at", at)
    ds = open_study(folder)
    name_parts = [*metrics, *filter(None, (y, by, x))]
    name_parts += [f"{name}={'+'.join(labels)}" for name, labels in labels_at.items()]
    part = _select_results(ds, [name for name in (x, y, by) if name], labels_at)
    drawers = standard_figures(part, inches) if x is None else {"": _figure_drawer(part, metrics, x, y, by, inches)}
    figures = {portable_file_name("_".join(filter(None, [n, *name_parts]))): draw() for n, draw in drawers.items()}
    if not figures:
        echo("Nothing is swept in this study, so there is nothing to draw.")
        return
    options: Any = {"format": file_format, "dpi": dots_per_inch, "drawn_from": ds.attrs.get("content_sha256")}
    if out is None:
        with hold_folder(folder):
            paths = write_figures(figures, folder / FIGURES_FOLDER, **options)
    elif suffix:
        first_name, *other_names = figures
        paths = write_figures({out.stem: figures[first_name]}, out.parent, **options)
        if other_names:
            echo(f"{out} shows {first_name}; to write {', '.join(other_names)} as well, give a folder.", err=True)
    else:
        paths = write_figures(figures, out, **options)
    echo(*paths)


def _figure_drawer(
    part: xr.Dataset, metrics: Sequence[str], x: str, y: str | None, by: str | None, width: float | None
) -> Callable[[], Figure]:
    """Return a function that draws a figure of these results over the chosen axes."""
    from fastcoil.deliver.figures import swept as plots

    plots.panel_rows(part, by)  # refused if there is no such dimension
    unpooled_dims = [dim for dim in plots.control_dims(part) if dim not in (x, y, by)]
    if by is None and unpooled_dims:
        by, *unpooled_dims = unpooled_dims
    if unpooled_dims:
        dim = unpooled_dims[0]
        cure = f"select one with --at {dim}={part[dim].values[0]}, or give --by {dim}"
        sentence = f"{dim}: a plain PI would be pooled with other controllers in one median: {cure}"
        raise InputError(sentence, "--by", "conflict")
    drawn_metrics = metrics or plots.STANDARD_METRICS[: plots.panels_per_row(width) if by else None]
    return partial(plots.draw_panels, part, x, y, by, drawn_metrics, width, overlays=True)


def _select_results(ds: xr.Dataset, axes: Sequence[str], at: Mapping[str, Sequence[str]]) -> xr.Dataset:
    """Select the part of the results to draw, with a title that describes it."""
    from fastcoil.study.analysis import selected

    part, title_parts = selected.select_labels(ds, at), [str(ds.attrs.get("title", ""))]
    if at:
        title_parts.append(f"at {selected.describe_labels(part, at)}")
    if len(set(axes)) < len(axes):
        raise InputError(f"{axes[0]} is named twice: choose two different axes", axes[0], "duplicate")
    if sampled_axes := [name for name in axes if name in selected.drawn_parameters(part)]:
        part = selected.group_by_parameters(part, sampled_axes)
    return part.assign_attrs(title=", ".join(filter(None, title_parts)))


def _width_in_inches(width: str | None) -> float | None:
    if width is None:
        return None
    match = re.fullmatch(r"(\d+\.?\d*)\s*mm", width.strip())
    if match is None or not 40.0 <= float(match[1]) <= 500.0:
        raise InputError(f"--width {width}: give 40 to 500 mm with the unit, such as 84mm", "--width", "value")
    return float(match[1]) / 25.4


def draw_standard_figures(folder: Path, ds: xr.Dataset) -> list[Path]:
    """Draw the standard figures of ``ds`` that a locked folder lacks; return all PNG figures of these results."""
    from fastcoil.base.figures import FIGURES_FOLDER, current_figures, write_figures
    from fastcoil.deliver.figures import swept as plots

    drawn_from = ds.attrs["content_sha256"]
    existing_names = {path.name for path in current_figures(folder, drawn_from)}
    for name, draw in plots.standard_figures(ds).items():
        if f"{name}.png" not in existing_names:
            write_figures({name: draw()}, folder / FIGURES_FOLDER, drawn_from=drawn_from)
    return [path for path in current_figures(folder, drawn_from) if path.suffix == ".png"]


_STEP_TEST = """\
1. Put the controller in manual at the smallest opening at which the valve works.  Make the last move in the direction
   of the step, so that the gap is taken up.
2. Step the command by a few per cent and log T_sup until it settles.
3. K is the change of T_sup over the step, K per full stroke.  With t1 and t2, the times to 35.3 and 85.3 % of the
   change: T = 0.67 (t2 - t1), and theta = 1.3 t1 - 0.29 t2, plus half of the controller's sample time.
4. The loop stays calm with Ti of at least (kp K)^0.7 (T + 2 theta) / 4, kp in 1/K; Ti = T calms nearly every loop."""


def _print_step_test(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value:
        echo(*_STEP_TEST.splitlines())
        ctx.exit()


@click.command()
@click.argument("target", type=PATH)
@click.option(
    "--step-test", is_flag=True, is_eager=True, expose_value=False, callback=_print_step_test,
    help="Print how to measure gain, time constant and dead time of a real loop, and exit.",
)  # fmt: skip
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
    from fastcoil.base.figures import FIGURE_FORMATS
    from fastcoil.study.maintenance import pick_scenario

    if out is not None:
        require_output_file("-o", out, *(f".{form}" for form in FIGURE_FORMATS))
    scenario = pick_scenario(target, parse_labels(at), parse_pairs("--set", changes), load_user_code)
    explanation = fc.explain(scenario.loop, scenario.boundary, warm_up=scenario.warm_up, seed=scenario.seed)
    echo(scenario.title, *explanation.text.splitlines())
    write_result(explanation, out, report)


@click.command()
@click.argument("study", type=PATH)
@with_folder
@click.option("-j", "--jobs", type=int, help="Threads; all cores by default.  Results do not depend on it.")
@with_report
def tune(study: Path, out: Path | None, jobs: int | None, report: Path | None) -> None:
    """Tune kp, ti and other settings for all valves and days of a STUDY file, and validate them on others.

    The table [tune] of the study file defines the search, the objective and the limits.
    """
    from fastcoil.base.progress import ProgressDisplay
    from fastcoil.design.tune import run_tuning
    from fastcoil.loops.simulate import number_of_threads
    from fastcoil.study.file.spec import read_tuning
    from fastcoil.study.folder.folder import hold_folder
    from fastcoil.study.run import default_folder

    n_jobs, folder = number_of_threads(jobs), out or default_folder(study)
    request = read_tuning(study, prepare=load_user_code)
    display = ProgressDisplay()
    with handle_interrupts(display, study, folder, "tune"), hold_folder(folder):
        with display:
            tuning = run_tuning(request._replace(n_jobs=n_jobs), display)
        echo(*tuning.summary(), "")
        write_result(tuning, folder / "tuning.toml", report)


@click.command()
@click.argument("target", type=PATH, default="paper_like")
@with_scenario
@click.option("--port", type=click.IntRange(0, 65535), default=5010, show_default=True, help="0: any free port.")
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
        raise missing_extra_error("explore", "bokeh", "explore")
    print_logs()  # before bokeh is imported, which else prints its own
    import asyncio

    from fastcoil.deliver.explore.loop import Model
    from fastcoil.deliver.explore.page import serve
    from fastcoil.loops.presets import PRESETS
    from fastcoil.study.maintenance import pick_scenario

    name, labels = str(target), parse_labels(at)
    model = Model(None if name in PRESETS and not labels else pick_scenario(target, labels, {}, load_user_code), name)

    def open_page(address: str) -> None:
        echo(f"Page: {address}  (this machine only; Ctrl-C ends it)")
        has_screen = sys.platform in ("win32", "darwin") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
        if browser and has_screen:
            webbrowser.open(address)

    asyncio.run(serve(model, port, open_page))
    echo("Ended.")
