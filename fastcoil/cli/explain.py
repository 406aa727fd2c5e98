"""``fastcoil explain``: whether one loop will hunt, why, and what to do, on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from fastcoil.base.errors import InputError, shown
from fastcoil.base.files import may_be_file
from fastcoil.cli.announcements import announce_compilation
from fastcoil.cli.labels import labels_of
from fastcoil.cli.log_options import pairs
from fastcoil.cli.paths import PATH
from fastcoil.cli.report import with_report, write_report
from fastcoil.cli.terminal import say


@click.command()
@click.argument("target", type=PATH)
@click.option(
    "--at", multiple=True, metavar="NAME=LABEL", help="The scenario of a sweep: a label for every dimension, day too."
)
@click.option(
    "--set", "changes", multiple=True, metavar="NAME=VALUE", help="Another value for a parameter, such as kp=0.03."
)
@click.option("-o", "--out", type=PATH, metavar="FIGURE", help="Figure to write: .png, .pdf or .svg; none by default.")
@with_report
def explain(target: Path, at: Sequence[str], changes: Sequence[str], out: Path | None, report: Path | None) -> None:
    """Explain why one loop hunts, or does not, what would cure it, and what that costs.

    TARGET is a preset, such as lbnl, which runs on the generic day; a study file; or the folder of a study.

    \b
      fastcoil explain lbnl --set kp=0.03 --set ti=5
      fastcoil explain results/study --at backlash=0.07 --at day=3 -o explain.png
    """  # noqa: D301 — click reads the backspace
    from fastcoil.design.explanation.explain import explain as explained
    from fastcoil.study.one_scenario import one_scenario

    form = _form_of(out)
    scenario = one_scenario(target, labels_of(",".join(at)), _changes(changes))
    announce_compilation()
    found = explained(scenario.loop, scenario.boundary, warm_up=scenario.warm_up, seed=scenario.seed)
    say(scenario.title, *found.text.splitlines())
    if out is not None:
        from fastcoil.base.figures import write

        for path in write({out.stem: found.plot()}, out.parent, format=form):
            say(f"Figure:  {path}")
    write_report(found, report)


def _changes(given: Sequence[str]) -> dict[str, str]:
    names = [one.partition("=")[0].strip() for one in given]
    twice = [f"--set: {shown(name)} is given twice: give it once" for k, name in enumerate(names) if name in names[:k]]
    if twice:
        raise InputError(twice)
    return pairs("--set", given) or {}


def _form_of(out: Path | None) -> str:
    """The format of a figure, by its name."""
    from fastcoil.base.figures import FORMATS

    if out is None:
        return FORMATS[0]
    form = out.suffix.removeprefix(".")
    if form not in FORMATS or not may_be_file(out):
        raise InputError(f"-o {out}: give a file NAME.png, NAME.pdf or NAME.svg in a folder that exists")
    return form
