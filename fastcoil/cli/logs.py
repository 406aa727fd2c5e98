"""``fastcoil diagnose`` and ``join``: commands that read trend logs, and the options they share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import click

from fastcoil.base.errors import InputError
from fastcoil.base.files import commit, exists, is_file, is_folder, may_be_file
from fastcoil.cli.announcements import announce_compilation
from fastcoil.cli.arguments import PATH
from fastcoil.cli.deliver import with_report, write_report
from fastcoil.cli.terminal import say


def with_reading_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the log and the options that say how it is read."""
    for option in (
        click.option(
            "--drop", is_flag=True, help="Leave out and count bad values, or bridge a single one, instead of refusing."
        ),
        click.option(
            "--jumps",
            default="refuse",
            show_default=True,
            help="Where time goes back: refuse the log, or split it there.",
        ),
        click.option("--max-gap", type=float, help="Longest step to bridge, s; three median steps by default."),
        click.option(
            "--time-format",
            metavar="PATTERN",
            help="How timestamp is written: '%d/%m/%Y %H:%M', excel or epoch; recognised by default.",
        ),
        click.option(
            "--unit", "units", multiple=True, metavar="NAME=UNIT", help="Unit of a column whose header has none."
        ),
        click.option(
            "--column", "columns", multiple=True, metavar="NAME=HEADER", help="Header of NAME, if it differs."
        ),
        click.argument("data", type=PATH),
    ):
        command = option(command)
    return command


def pairs(option: str, given: Sequence[str]) -> dict[str, str] | None:
    """``NAME=VALUE`` … as a mapping; None without any, which means the file's own names."""
    pairs = [one.partition("=") for one in given]
    wrong = [f"{option} {one}: give NAME=VALUE" for one, (_, sign, _) in zip(given, pairs, strict=True) if not sign]
    if wrong:
        raise InputError(wrong)
    return {name.strip(): value.strip() for name, _, value in pairs} or None


def require_writable(out: Path) -> None:
    """Refuse, before any work, a path that cannot be written, or that holds anything but an earlier fit."""
    from fastcoil.measured.fit.result import is_fit

    if out.suffix != ".toml" or not may_be_file(out):
        raise InputError(f"-o {out}: give a file NAME.toml in a folder that exists")
    if exists(out) and not is_fit(out):
        raise InputError(f"-o {out}: this file exists and is no fit, choose another name or delete it")
    figure = out.with_suffix(".png")
    if is_folder(figure):
        raise InputError(f"-o {out}: {figure}, the name of its figure, is a folder: choose another name")
    if is_file(figure) and not exists(out):
        raise InputError(f"-o {out}: {figure} exists and would be replaced, choose another name or delete it")


@click.command()
@with_reading_options
@with_report
@click.option("-o", "--out", type=PATH, help="TOML file to write, and a figure beside it; none by default.")
@click.option("--stroke-time", type=float, help="Seconds of the motor from closed to open; 90 by default.")
@click.option("--sample-time", type=float, help="Seconds between samples of the controller; found by default.")
def diagnose(
    data: Path,
    out: Path | None,
    columns: Sequence[str],
    units: Sequence[str],
    stroke_time: float | None,
    sample_time: float | None,
    report: Path | None,
    drop: bool,
    jumps: str,
    max_gap: float | None,
    time_format: str | None,
) -> None:
    """Find the backlash of a valve in a trend log, and why its loop hunts.

    DATA is a CSV file with the columns command and T_sup, and T_set, m_a, T_a_in, enabled if it has them.  Time is
    elapsed_time or timestamp.  Two hours or more, a row every 30 s or faster, with changes of the set-point.
    """
    from fastcoil.measured.diagnosis.diagnose import diagnose as diagnosed

    if out is not None:
        require_writable(out)
    announce_compilation("mean_openings")
    found = diagnosed(
        data,
        stroke_time,
        sample_time,
        columns=pairs("--column", columns),
        units=pairs("--unit", units),
        drop=drop,
        jumps=jumps,
        max_gap=max_gap,
        time_format=time_format,
    )
    say(*found.summary())
    if out is not None:
        from fastcoil.base.figures import write

        found.to_toml(out)
        say(f'Written: {out} (in a study: [loop] include = ["{out.name}"])')
        for path in write({out.stem: found.plot()}, out.parent):
            say(f"Figure:  {path}")
    write_report(found, report)


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
