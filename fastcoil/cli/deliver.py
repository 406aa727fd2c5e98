"""``fastcoil export``, ``report`` and ``cite``: files for others."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import click

import fastcoil as fc
from fastcoil.base.arguments import require_choice
from fastcoil.cli.arguments import PATH
from fastcoil.cli.terminal import echo, load_user_code

REPORT_OPTION = "--report"


@click.command()
@click.argument("folder", type=PATH)
@click.option("-o", "--out", type=PATH, metavar="FILE.html", help="File to write; FOLDER/report.html by default.")
def report(folder: Path, out: Path | None) -> None:
    """Write a self-contained HTML report of the finished study in FOLDER.

    diagnose, explain and tune have an option --report instead.
    """
    echo(f"Report:  {fc.report(folder, out)}")


def write_result(result: Any, out: Path | None, report: Path | None = None, *, label: str = "Written") -> None:
    """Write a result to ``out``, as TOML with a figure beside it, or as a figure, and to ``report`` as a page."""
    if out is not None:
        from fastcoil.base.figures import write_figures

        if out.suffix.lower() == ".toml":
            tables = tomllib.loads(result.to_toml(out))
            parameters = ", ".join(tables.get("loop", ())) or "no parameter"
            use = f'in a study: [loop] include = ["{out.name}"]; it has {parameters}'
            use = use if "loop" in tables else f"for the next unit: --answers {out}"
            if getattr(result, "leaves_settings", False):  # of a tuning
                use = f"the advice is to leave the settings as they are; it has {parameters}"
            echo(f"{label + ':':<9}{out} ({use})")
        figure_format = out.suffix.lower().removeprefix(".").replace("toml", "png")
        paths = write_figures({out.stem: result.plot()}, out.parent, format=figure_format)
        echo(*(f"Figure:  {path}" for path in paths))
    if report is not None:
        echo(f"Report:  {fc.report(result, report)}")


def _check_report_path(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    from fastcoil.deliver.report.page import require_page

    if value is not None:
        require_page(value, REPORT_OPTION)
    return value


with_report = click.option(
    REPORT_OPTION, "report", type=PATH, metavar="FILE.html", callback=_check_report_path,
    help="Self-contained HTML report to write.",
)  # fmt: skip
"""Option ``--report``; its path is checked before the command runs."""


@click.command()
@click.argument("folder", type=PATH, required=False)
def cite(folder: Path | None) -> None:
    """Print how to cite fastcoil and the paper, and with FOLDER its results and the version that made them."""
    from fastcoil.deliver.report.page import citation

    results = None
    if folder is not None:
        from fastcoil.study.folder.results import open_finished

        results = open_finished(folder).attrs
    echo(*citation(results))


@click.command()
@click.argument("path", type=PATH)
@click.option("--language", help="Controller as c, st, python, fmu or plcopen.  [default: by -o, else c]")
@click.option("--test", "has_test", is_flag=True, help="Include a valve test, which the input start_test starts.")
@click.option("-o", "--out", type=PATH, metavar="FILE",
              help="File to write; by default NAME with the matching suffix in the current folder.")  # fmt: skip
def export(path: Path, language: str | None, has_test: bool, out: Path | None) -> None:
    """Export the controller of a TOML file as source code, with test vectors for its port.

    \b
      fastcoil export controller.toml --language c      controller.c, controller_vectors.csv
      fastcoil export controller.toml --language st     a function block of IEC 61131-3
      fastcoil export controller.toml -o controller.fmu    for co-simulation, FMI 2.0
    """  # noqa: D301 — click reads the backspace
    from fastcoil.deliver.export.export import SUFFIXES
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.file.user_code import load_code

    by_suffix = {suffix: name for name, suffix in SUFFIXES.items()}
    default_language = by_suffix.get(out.suffix.lower(), "c") if out else "c"
    language = require_choice("language", language or default_language, SUFFIXES)
    study = read_study(path)
    loop = study.plan.layout.loop
    load_code(loop.rules, study.rules, load_user_code)
    make_test = fc.ValveTest.heating if loop["action"] == "heating" else fc.ValveTest
    test = make_test() if has_test and loop["test_start"] is None else None
    for path_written in fc.export_controller(loop, out or Path(path.stem + SUFFIXES[language]), language, test=test):
        echo(f"Written: {path_written}")
