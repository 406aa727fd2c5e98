"""``fastcoil join``: points that were logged each at its own times, as one log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from fastcoil.base.errors import InputError
from fastcoil.base.files import commit, exists, may_be_file
from fastcoil.cli.log_options import pairs
from fastcoil.cli.paths import PATH
from fastcoil.cli.terminal import say


@click.command()
@click.argument("files", type=PATH, nargs=-1)
@click.option("-o", "--out", type=PATH, default="log.csv", show_default=True, help="CSV file to write; a new one.")
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="NAME=FILE",
    help="Which file is the point NAME (or which header, or FILE:HEADER), if neither header nor file name says so.",
)
@click.option("--unit", "units", multiple=True, metavar="NAME=UNIT", help="Unit of a point whose header has none.")
@click.option("--step", type=float, help="Step of the common clock, s; that of the fastest point by default.")
@click.option("--max-gap", type=float, help="Longest time without a sample over which a point is held or bridged, s.")
@click.option("--time-format", metavar="PATTERN", help="How times are written: '%d/%m/%Y %H:%M', excel or epoch.")
def join(
    files: Sequence[Path],
    out: Path,
    columns: Sequence[str],
    units: Sequence[str],
    step: float | None,
    max_gap: float | None,
    time_format: str | None,
) -> None:
    """Put points from FILES, a point or several in each, on one clock: one log for the fits.

    A file has a column of times and a column of values, whose header names the point and its unit (command [%]), or
    else the file's name does (command.csv).
    """
    from fastcoil.base.arguments import checking, number_of
    from fastcoil.logs.arguments import max_gap_of
    from fastcoil.logs.join import join_points
    from fastcoil.logs.timestamps import time_format_of

    if not files:
        raise InputError("give the files to join, such as command.csv T_sup.csv")
    with checking() as check:
        step = check.unless_none(number_of, "--step", step, "give seconds, from 1 to 86400", least=1.0, most=86400.0)
        check(max_gap_of, max_gap)
        time_format = check.unless_none(time_format_of, "--time-format", time_format)
        check(_require_new, out)
    joined = join_points(
        files,
        columns=pairs("--column", columns) or {},
        units=pairs("--unit", units) or {},
        time_format=time_format,
        step=step,
        max_gap=max_gap,
    )
    _require_new(out)
    commit(out, joined.text.encode())
    say(*joined.notes)
    say(f"Joined:  {out}")


def _require_new(out: Path) -> None:
    """Refuse a path that cannot be written, or that holds anything."""
    if out.suffix != ".csv" or not may_be_file(out):
        raise InputError(f"-o {out}: give a file NAME.csv in a folder that exists")
    if exists(out):
        raise InputError(f"-o {out}: this file exists, choose another name or delete it")
