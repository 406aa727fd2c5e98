"""``fastcoil export``: what others take home, on the command line: the code of a controller."""

from __future__ import annotations

from pathlib import Path

import click

from fastcoil.base.errors import InputError
from fastcoil.base.files import is_folder
from fastcoil.cli.announcements import announce_compilation
from fastcoil.cli.paths import PATH
from fastcoil.cli.terminal import say


@click.command()
@click.argument("path", type=PATH)
@click.option("--language", help="Of a controller's code: c, st or python.  [default: c]")
@click.option("--csv", "formats", flag_value="csv", multiple=True, help="A row for each scenario-day.")
@click.option("--parquet", "formats", flag_value="parquet", multiple=True, help="The same as Parquet; needs pyarrow.")
@click.option("--latex", "formats", flag_value="latex", multiple=True, help="A row for each label, with medians.")
@click.option("--metric", "metrics", multiple=True, help="Metric to have in the table; may be repeated.")
@click.option("--at", multiple=True, metavar="NAME=LABEL", help="Only scenarios with this label; may be repeated.")
@click.option("--by", multiple=True, metavar="NAME", help="Drawn parameter whose groups are rows of a LaTeX table.")
@click.option("-o", "--out", type=PATH, metavar="FILE", help="File to write; NAME with its suffix here by default.")
def export(
    path: Path,
    language: str | None,
    formats: tuple[str, ...],
    metrics: tuple[str, ...],
    at: tuple[str, ...],
    by: tuple[str, ...],
    out: Path | None,
) -> None:
    """Export PATH: results as a table, or the controller of a TOML file as code for the field.

    Results are the folder of a study or a NetCDF file.  A controller comes with vectors that prove a port of it.

    \b
      fastcoil export controller.toml --language c      controller.c, controller_vectors.csv
      fastcoil export controller.toml --language st     a function block of IEC 61131-3
      fastcoil export results/study --csv               study.csv, a row for each scenario-day
      fastcoil export results/study --latex --at day=1  study.tex, a table of medians
    """  # noqa: D301 — click reads the backspace
    if path.suffix == ".toml" and not is_folder(path):
        tables = [f"--{each}" for each in formats]
        tables += [option for option, given in (("--metric", metrics), ("--at", at), ("--by", by)) if given]
        if tables:
            raise InputError(
                f"{', '.join(tables)}: for tables of results, and {path} is a TOML file: give the folder of a study"
            )
        export_code(path, language, out)
    else:
        from fastcoil.cli.export_table import export_table

        if language:
            raise InputError(
                f"--language: for the controller of a TOML file, and {path} is none: leave it out, or give one"
            )
        export_table(path, formats, metrics, at, by, out)


def export_code(path: Path, language: str | None, out: Path | None) -> None:
    """Write the code of the controller in a study file; its sweep, boundary and run play no part."""
    from fastcoil.deliver.export.export import SUFFIXES, export_controller, language_of
    from fastcoil.study.file.spec import read_study

    word = language_of(language or "c")
    loop = read_study(path).plan.layout.loop
    announce_compilation()
    for written in export_controller(loop, out or Path(path.stem + SUFFIXES[word]), language=word):
        say(f"Written: {written}")
