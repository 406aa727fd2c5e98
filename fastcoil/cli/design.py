"""``fastcoil explain``, ``tune`` and ``explore``: why one loop hunts, better settings, a page to play with."""

import asyncio
import importlib.util
import os
import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path

import click

from fastcoil.base.errors import InputError, missing_extra
from fastcoil.base.files import require_file
from fastcoil.cli.arguments import PATH, labels_of, pairs, with_scenario
from fastcoil.cli.deliver import with_report, write_figure, write_found, write_report
from fastcoil.cli.terminal import announce_compilation, interruptible, run_own_code, say


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
    from fastcoil.design.explain import explain as explained
    from fastcoil.study.maintenance import one_scenario

    if out is not None:
        require_file("-o", out, *(f".{form}" for form in FORMATS))
    scenario = one_scenario(target, labels_of(at), pairs("--set", changes))
    announce_compilation()
    found = explained(scenario.loop, scenario.boundary, warm_up=scenario.warm_up, seed=scenario.seed)
    say(scenario.title, *found.text.splitlines())
    if out is not None:
        write_figure(found, out, out.suffix.lower().removeprefix("."))
    write_report(found, report)


CHOSEN = "tuning.toml"


@click.command()
@click.argument("study", type=PATH)
@click.option("-o", "--out", type=PATH, help="Folder of the results; results/NAME by default.")
@click.option("-j", "--jobs", type=int, help="Threads; all cores by default.  Results do not depend on it.")
@with_report
def tune(study: Path, out: Path | None, jobs: int | None, report: Path | None) -> None:
    """Tune kp, ti and other settings for all valves and days of a STUDY file, and validate them on others.

    The table [tune] of the study file defines the search, the objective and the limits.
    """
    from fastcoil.base.progress import Shown
    from fastcoil.design.tune import in_scenario_days, run_tuning
    from fastcoil.loops.simulate import workers
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.folder.folder import hold
    from fastcoil.study.run import default_folder

    n_jobs, folder = workers(jobs), out or default_folder(study)
    asked = read_study(study, prepare=run_own_code).tuning
    if asked is None:
        raise InputError(
            f"{study} has no table [tune]: add one, such as search = {{ kp = [0.005, 0.1], ti = [5, 600] }}"
        )
    announce_compilation()
    with interruptible(study, folder, "tune"), hold(folder):
        with Shown() as shown:
            found = run_tuning(asked._replace(n_jobs=n_jobs), in_scenario_days(asked, shown))
        say(*found.summary(), "")
        path = folder / CHOSEN
        write_found(found, path)
        write_report(found, report)


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
        if browser:
            _open(address)

    asyncio.run(serve(model, port, ready))
    say("Ended.")


def _open(address: str) -> None:
    """Open the page in a browser, if there is a screen."""
    has_screen = sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if has_screen:
        webbrowser.open(address)
