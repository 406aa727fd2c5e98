"""``fastcoil export``: what others take home, on the command line: the code of a controller."""

from __future__ import annotations

from pathlib import Path

import click

from fastcoil.cli.announcements import announce_compilation
from fastcoil.cli.paths import PATH
from fastcoil.cli.terminal import say
from fastcoil.errors import InputError
from fastcoil.look import is_folder


@click.command()
@click.argument("path", type=PATH)
@click.option("--language", help="Of a controller's code: c, st or python.  [default: c]")
@click.option("-o", "--out", type=PATH, metavar="FILE", help="File to write; NAME.c, NAME.st or NAME.py by default.")
def export(path: Path, language: str | None, out: Path | None) -> None:
    """Export PATH: the controller of a TOML file as code for the field, with vectors that prove a port of it.

    \b
      fastcoil export controller.toml --language c      controller.c, controller_vectors.csv
      fastcoil export controller.toml --language st     a function block of IEC 61131-3
    """  # noqa: D301 — click reads the backspace
    if path.suffix == ".toml" and not is_folder(path):
        export_code(path, language, out)
    else:
        raise InputError(f"{path}: give a TOML file with the loop whose controller is to be exported")


def export_code(path: Path, language: str | None, out: Path | None) -> None:
    """Write the code of the controller in a study file; its sweep, boundary and run play no part."""
    from fastcoil.handover.export import SUFFIXES, export_controller, language_of
    from fastcoil.study.file.spec import read_study

    word = language_of(language or "c")
    loop = read_study(path).plan.layout.loop
    announce_compilation()
    for written in export_controller(loop, out or Path(path.stem + SUFFIXES[word]), language=word):
        say(f"Written: {written}")
