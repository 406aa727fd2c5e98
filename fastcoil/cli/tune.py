"""``fastcoil tune``: settings of a controller for the valves and days of a study, on the command line."""

from __future__ import annotations

from pathlib import Path

import click

from fastcoil.base.errors import InputError
from fastcoil.cli.announcements import announce_compilation, run_own_code
from fastcoil.cli.interrupts import interruptible
from fastcoil.cli.paths import PATH
from fastcoil.cli.report import with_report, write_report
from fastcoil.cli.terminal import say

CHOSEN, FIGURE = "tuning.toml", "tuning"


@click.command()
@click.argument("study", type=PATH)
@click.option("-o", "--out", type=PATH, help="Folder of the results; results/NAME by default.")
@click.option("-j", "--jobs", type=int, help="Threads; all cores by default.  Results do not depend on it.")
@with_report
def tune(study: Path, out: Path | None, jobs: int | None, report: Path | None) -> None:
    """Choose kp, ti and other settings for all valves and days of a STUDY file, and try them on others.

    The table [tune] of the study says what may be chosen, for what and within which limits.  An interrupted search is
    resumed.
    """
    from fastcoil.base.figures import write
    from fastcoil.base.files import exists
    from fastcoil.base.progress import progress_of_command
    from fastcoil.design.tuning.archive import KEPT
    from fastcoil.design.tuning.tune import in_scenario_days, run_tuning
    from fastcoil.loops.simulate import workers
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.folder.lock import hold
    from fastcoil.study.runner import default_folder

    n_jobs, folder = workers(jobs), out or default_folder(study)
    asked = read_study(study, prepare=run_own_code).tuning
    if asked is None:
        raise InputError(
            f"{study} has no table [tune]: add one, such as search = {{ kp = [0.005, 0.1], ti = [5, 600] }}"
        )
    announce_compilation()
    with interruptible(study, folder, "tune"), hold(folder):
        if exists(folder / KEPT):
            say(f"{folder / KEPT} keeps what was tried before: those tunings are not run again.", err=True)
        with progress_of_command() as shown:
            found = run_tuning(asked, n_jobs, folder / KEPT, in_scenario_days(asked, shown))
        say(*found.summary(), "")
        path = folder / CHOSEN
        found.to_toml(path)
        say(f'Written: {path} (in a study: [loop] include = ["{path.name}"])')
        for figure in write({FIGURE: found.plot()}, folder):
            say(f"Figure:  {figure}")
        write_report(found, report)
