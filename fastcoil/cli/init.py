"""``fastcoil init``: a study file to start from."""

from __future__ import annotations

from pathlib import Path

import click

from fastcoil.base.errors import InputError
from fastcoil.cli.announcements import compile_meanwhile
from fastcoil.cli.paths import PATH
from fastcoil.cli.terminal import say


@click.command()
@click.argument("study", type=PATH, required=False)
@click.option("--from", "name", metavar="NAME", help="Start from a study that comes with fastcoil.")
@click.option("--list", "only_list", is_flag=True, help="List the studies that come with fastcoil; write nothing.")
def init(study: Path | None, name: str | None, only_list: bool) -> None:
    """Write a commented STUDY file to start from: study.toml by default, NAME.toml with --from NAME."""
    from fastcoil.study.examples import shipped_studies, shipped_study

    if only_list:
        for each in shipped_studies():
            say(f"{each.name:<20}{each.title}")
        return
    if name is None:
        from fastcoil.study.file.template import TEMPLATE

        path, text, analysis = study or Path("study.toml"), TEMPLATE, ""
    else:
        chosen = shipped_study(name)
        path, text, analysis = study or Path(f"{name}.toml"), chosen.text, chosen.analysis
    _write_new(path, text)
    say(f"{path} written.  Edit it, then: fastcoil plan {path}, fastcoil run {path}")
    if analysis:
        say(f"Analysis: {analysis}")
    compile_meanwhile()


def _write_new(path: Path, text: str) -> None:
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise InputError(f"{path} exists: choose another name, or delete it") from None
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
