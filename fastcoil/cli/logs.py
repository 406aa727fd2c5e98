"""``fastcoil diagnose`` and ``join``: commands that read trend logs, and the options they share."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from fastcoil.base.errors import InputError
from fastcoil.base.files import commit, exists, is_file, is_folder, require_file
from fastcoil.cli.arguments import PATH, pairs
from fastcoil.cli.deliver import with_report, write_report
from fastcoil.cli.terminal import announce_compilation, say


def _as_pairs(ctx: click.Context, param: click.Parameter, value: Sequence[str]) -> dict[str, str] | None:
    return pairs(param.opts[-1], value) or None


_TIME_FORMAT = "Format of the timestamps: '%d/%m/%Y %H:%M', excel or epoch; recognised by default."
_READING_OPTIONS = (
    click.option("--drop", is_flag=True, help="Drop bad values and count them, or bridge a single one."),
    click.option(
        "--jumps", default="refuse", show_default=True, help="If time runs backwards: refuse, or split there."
    ),
    click.option("--max-gap", type=float, help="Longest gap to bridge, s; three median steps by default."),
    click.option("--time-format", metavar="PATTERN", help=_TIME_FORMAT),
    click.option(
        "--unit",
        "units",
        multiple=True,
        callback=_as_pairs,
        metavar="NAME=UNIT",
        help="Unit of a column whose header has none.",
    ),
    click.option(
        "--column",
        "columns",
        multiple=True,
        callback=_as_pairs,
        metavar="NAME=HEADER",
        help="Header of the column for NAME, if it differs.",
    ),
    click.argument("data", type=PATH),
)


def with_reading_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the argument DATA and the options of the log reader, named as the keywords of ``fc.diagnose``."""
    for option in _READING_OPTIONS:
        command = option(command)
    return command


def require_writable(out: Path) -> None:
    """Raise, before any work, unless ``out`` can be written and is new or an earlier fit."""
    from fastcoil.measured.fit import is_fit

    require_file("-o", out, ".toml")
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
@click.option("--stroke-time", type=float, help="Seconds the motor takes from closed to open; 90 by default.")
@click.option("--sample-time", type=float, help="Sample time of the controller, s; estimated by default.")
@click.option("--lag", type=float, help="Seconds by which T_sup is logged late beside the command; found by default.")
def diagnose(
    data: Path,
    out: Path | None,
    stroke_time: float | None,
    sample_time: float | None,
    lag: float | None,
    report: Path | None,
    **reading: Any,
) -> None:
    """Find the backlash of a valve in a trend log, and why its loop hunts.

    DATA is a CSV file with the columns command and T_sup, optionally T_set, m_a, T_a_in and enabled, and with
    elapsed_time or timestamp.  It needs two hours or more, a row every 30 s or faster, and changes of the set-point.
    """
    from fastcoil.measured.diagnose import diagnose as diagnosed

    if out is not None:
        require_writable(out)
    announce_compilation("mean_openings")
    found = diagnosed(data, stroke_time, sample_time, lag=lag, **reading)
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
    help="File of the point NAME (or header, or FILE:HEADER), if neither header nor file name is NAME.",
)
@click.option("--unit", "units", multiple=True, metavar="NAME=UNIT", help="Unit of a point whose header has none.")
@click.option("--step", type=float, help="Time step of the joined log, s; that of the fastest point by default.")
@click.option("--max-gap", type=float, help="Longest gap over which a point is held or interpolated, s.")
@click.option("--time-format", metavar="PATTERN", help=_TIME_FORMAT)
@click.option("--time-zone", metavar="ZONE", help="Zone of times without a UTC offset, such as America/New_York.")
def join(
    files: Sequence[Path],
    out: Path,
    columns: Sequence[str],
    units: Sequence[str],
    step: float | None,
    max_gap: float | None,
    time_format: str | None,
    time_zone: str | None,
) -> None:
    """Join the points in FILES into one log with a common time step, for diagnose and the fits.

    A file has a column of times and one or more columns of values.  The header of a column names the point and its
    unit (command [%]); for a single column the file name may (command.csv).
    """
    from fastcoil.base.arguments import checking, number_of
    from fastcoil.logs.columns import max_gap_of
    from fastcoil.logs.join import join_points
    from fastcoil.logs.timestamps import time_format_of
    from fastcoil.loops.boundary.clock import time_zone_of

    if not files:
        raise InputError("give the files to join, such as command.csv T_sup.csv")
    with checking() as check:
        step = check.unless_none(number_of, "--step", step, "give seconds, from 1 to 86400", least=1.0, most=86400.0)
        check(max_gap_of, max_gap)
        time_format = check.unless_none(time_format_of, "--time-format", time_format)
        time_zone = check.unless_none(time_zone_of, "--time-zone", time_zone)
        check(_require_new, out)
    joined = join_points(
        files,
        columns=pairs("--column", columns),
        units=pairs("--unit", units),
        time_format=time_format,
        time_zone=time_zone,
        step=step,
        max_gap=max_gap,
    )
    _require_new(out)
    commit(out, joined.text.encode())
    say(*joined.notes)
    say(f"Joined:  {out}")


def _require_new(out: Path) -> None:
    """Raise unless ``out`` can be written and does not exist."""
    require_file("-o", out, ".csv")
    if exists(out):
        raise InputError(f"-o {out}: this file exists, choose another name or delete it")
