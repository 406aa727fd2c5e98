"""``fastcoil report``: a page for a client; and the option ``--report`` of the commands that have a result."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from fastcoil.cli.paths import PATH
from fastcoil.cli.terminal import say

OPTION = "--report"


@click.command()
@click.argument("folder", type=PATH)
@click.option("-o", "--out", type=PATH, metavar="FILE.html", help="File to write; FOLDER/report.html by default.")
def report(folder: Path, out: Path | None) -> None:
    """Write one HTML file on the finished study, or the figures of the paper, in FOLDER.

    It needs no other file and no network.  diagnose, explain, fit and tune have an option --report instead.
    """
    from fastcoil.deliver.report.page import require_page
    from fastcoil.deliver.report.report import REPORT, page_of_folder, require_folder

    require_folder(folder)
    path = out or folder / REPORT
    require_page(path, "-o")
    say(f"Report:  {page_of_folder(folder).write(path)}")


def with_report(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option ``--report``, which is checked before the command does anything."""
    return click.option(
        OPTION, "report", type=PATH, metavar="FILE.html", callback=_checked, help="HTML file for a client, all in one."
    )(command)


def write_report(result: Any, path: Path | None) -> None:
    """Write the page of a result, if one was asked for, and say so."""
    if path is not None:
        from fastcoil.deliver.report.report import page_of_result

        say(f"Report:  {page_of_result(result).write(path)}")


def _checked(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    from fastcoil.deliver.report.page import require_page

    if value is not None:
        require_page(value, OPTION)
    return value
