"""``fastcoil export``, ``report`` and ``cite``: files for others."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

import fastcoil as fc
from fastcoil.base.arguments import argument_checks, require_choice
from fastcoil.base.errors import InputError
from fastcoil.base.files import exists, has_mark, is_folder, require_output_file
from fastcoil.cli.arguments import PATH, parse_label_lists
from fastcoil.cli.terminal import echo
from fastcoil.model.metric_table import STATUS_NOT_RUN

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
            use = use if "loop" in tables else f"for the next unit: --answers {out.name}"
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
@click.option("--csv", is_flag=True, help="A row for each scenario-day.")
@click.option("--metric", "metrics", multiple=True, help="Metric to have in the table; may be repeated.")
@click.option("--at", multiple=True, metavar="NAME=LABEL", help="Only scenarios with this label; may be repeated.")
@click.option("-o", "--out", type=PATH, metavar="FILE",
              help="File to write; by default NAME with the matching suffix in the current folder.")  # fmt: skip
def export(
    path: Path, language: str | None, has_test: bool, csv: bool, metrics: tuple[str, ...], at: tuple[str, ...],
    out: Path | None,
) -> None:  # fmt: skip
    """Export results as a table, or the controller of a TOML file as source code.

    PATH is the folder of a study, a NetCDF file, or a TOML file.  A controller comes with test vectors for its port.

    \b
      fastcoil export controller.toml --language c      controller.c, controller_vectors.csv
      fastcoil export controller.toml --language st     a function block of IEC 61131-3
      fastcoil export controller.toml -o controller.fmu    for co-simulation, FMI 2.0
      fastcoil export results/study --csv               study.csv, a row for each scenario-day
    """  # noqa: D301 — click reads the backspace
    if path.suffix == ".toml" and not is_folder(path):
        options = {"--csv": csv, "--metric": metrics, "--at": at}
        if table_options := [option for option, value in options.items() if value]:
            options_work = f"{' and '.join(table_options)} work{'s' * (len(table_options) == 1)}"
            sentence = f"{options_work} only for tables of results, but {path} is a TOML file"
            raise InputError(f"{sentence}: give the folder of a study", table_options[0], "conflict")
        export_code(path, language, out, has_test)
        return
    if language or has_test:
        option = "--language" if language else "--test"
        sentence = f"{option} works only for the controller in a TOML file, and {path} is not one: leave it out"
        raise InputError(sentence, option, "conflict")
    if not csv:
        raise InputError("give --csv, or a TOML file whose controller is exported", "--csv", "missing")
    export_table(path, metrics, at, out)


def export_code(path: Path, language: str | None, out: Path | None, has_test: bool) -> None:
    """Export the controller of the loop in a study file as code, with a valve test if ``has_test``."""
    from fastcoil.deliver.export.export import SUFFIXES
    from fastcoil.study.file.spec import read_study
    from fastcoil.study.file.user_code import load_code

    by_suffix = {suffix: name for name, suffix in SUFFIXES.items()}
    default_language = by_suffix.get(out.suffix.lower(), "c") if out else "c"
    language = require_choice("language", language or default_language, SUFFIXES)
    study = read_study(path)
    loop = study.plan.layout.loop
    load_code(loop.rules, study.rules)
    make_test = fc.ValveTest.heating if loop["action"] == "heating" else fc.ValveTest
    test = make_test() if has_test and loop["test_start"] is None else None
    for path_written in fc.export_controller(loop, out or Path(path.stem + SUFFIXES[language]), language, test=test):
        echo(f"Written: {path_written}")


def export_table(path: Path, metrics: tuple[str, ...], at: Sequence[str], out: Path | None) -> None:
    """Write the results at ``path``, the folder of a study or a NetCDF file, as a table."""
    from fastcoil.deliver.tables import TidyTable, check_metrics, write_csv
    from fastcoil.study.analysis.selected import describe_labels, select_labels
    from fastcoil.study.folder.results import open_results

    labels = parse_label_lists("--at", at)
    target = _table_path(path, out)
    ds = open_results(path)
    with argument_checks() as check:
        check(check_metrics, ds, metrics)
        part = check(select_labels, ds, labels)
    if labels:
        part = part.assign_attrs(title=f"{ds.attrs.get('title', '')} at {describe_labels(part, labels)}".strip())
    if n_not_run := int((part["status"].values == STATUS_NOT_RUN).sum()):
        echo(f"Unfinished: {n_not_run:,} of {part['status'].size:,} scenarios have not run (status not_run).", err=True)
    table = TidyTable(part, metrics)
    write_csv(table, target)
    rows = f"{table.n_rows:,} scenario-day{'s' * (table.n_rows != 1)}"
    echo(f"Written: {target} ({rows}, {len(table.columns)} columns)")


def _table_path(path: Path, out: Path | None) -> Path:
    """Return the CSV file to write: ``out``, or a default name in the folder ``out`` or the current one."""
    if out is None or is_folder(out):
        target = (out or Path()) / f"{path.resolve().name.removesuffix('.nc') or 'results'}.csv"
        if exists(target) and not has_mark(target, b"fastcoil_version", 2**16):
            raise InputError(f"{target} exists, and fastcoil did not write it: name another file with -o", "-o", "path")
        return target
    require_output_file("-o", out, ".csv")
    return out
