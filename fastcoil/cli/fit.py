"""``fastcoil fit``: a valve or a coil from measured data, on the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fastcoil.cli.fit_progress import fit_progress
from fastcoil.cli.paths import PATH
from fastcoil.cli.progress import announce_compilation
from fastcoil.cli.terminal import say
from fastcoil.errors import InputError
from fastcoil.look import exists, is_file, is_folder

if TYPE_CHECKING:
    from fastcoil.calibrate.result import Fit


@click.group()
def fit() -> None:
    """Fit a valve or a coil to measured data (a CSV file); writes TOML to include in a study, and a figure."""


def _with_common_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that both fits have."""
    for option in (
        click.option(
            "--drop", is_flag=True, help="Leave out and count bad values, or bridge a single one, instead of refusing."
        ),
        click.option("--fit-until", type=float, help="Last second to fit; the rest is held back for validation."),
        click.option(
            "--split",
            type=float,
            help="Share of the log to fit, in whole batches or pieces if it has four or more; 0.7 by default, all of "
            "it with --validate.",
        ),
        click.option("--validate", "validation", type=PATH, help="Another CSV file to validate the fit with."),
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


@fit.command("valve")
@_with_common_options
@click.option("-o", "--out", type=PATH, default="valve.toml", show_default=True, help="TOML file to write.")
@click.option("--m-max", type=float, help="Asymptotic flow, kg/s, if it is known; fitted by default.")
@click.option("--floor", type=float, help="Lowest reading of the flow meter, kg/s; found by default.")
@click.option("--settle", type=float, help="Ignore the flow for so many seconds after each change of the command.")
@click.option(
    "--initial", default="unknown", show_default=True, help="Side of the gap at the start: unknown, rising or falling."
)
@click.option(
    "--lag",
    default="auto",
    show_default=True,
    metavar="SECONDS",
    help="The flow is logged so long after the command; auto: sought, told, and taken out.",
)
@click.option(
    "--hold", metavar="command", help="The command holds from row to row; else a controller may move it between them."
)
def fit_valve_command(
    data: Path,
    out: Path,
    columns: Sequence[str],
    units: Sequence[str],
    m_max: float | None,
    floor: float | None,
    settle: float | None,
    initial: str,
    lag: str,
    hold: str | None,
    split: float | None,
    fit_until: float | None,
    validation: Path | None,
    drop: bool,
    jumps: str,
    max_gap: float | None,
    time_format: str | None,
) -> None:
    """Fit backlash and flow curve to the columns command and m_w of DATA.

    Time is elapsed_time or timestamp.  An optional column batch numbers the experiments of a log; an optional
    column enabled is 0 while the pump is off.
    """
    from fastcoil.calibrate.valve import fit_valve

    _require_writable(out)
    announce_compilation("valve_flows")
    with fit_progress():
        found = fit_valve(
            data,
            columns=pairs("--column", columns),
            units=pairs("--unit", units),
            m_max=m_max,
            floor=floor,
            settle=settle,
            initial=initial,
            lag=_lag(lag),
            holds=hold,
            split=split,
            fit_until=fit_until,
            validation=validation,
            drop=drop,
            jumps=jumps,
            max_gap=max_gap,
            time_format=time_format,
        )
    _write_and_print(found, out)


@fit.command("coil")
@_with_common_options
@click.option("-o", "--out", type=PATH, default="coil.toml", show_default=True, help="TOML file to write.")
@click.option("--constant", "constants", multiple=True, metavar="NAME=NUMBER", help="A series that the log lacks.")
@click.option("--both", is_flag=True, help="Minimise the error of the leaving water too, not only of the supply air.")
@click.option("--warm-up", type=float, default=1800.0, show_default=True, help="Seconds left out at each start.")
@click.option("--t-initial", type=float, default=20.0, show_default=True, help="All temperatures at each start, °C.")
@click.option("--volumes", type=int, default=8, show_default=True, help="Number of control volumes.")
@click.option("--air-march", default="lagged", show_default=True, help="lagged or quasistatic.")
@click.option("--pressure", type=float, default=101325.0, show_default=True, help="Barometric pressure, Pa.")
@click.option("--hold", "holds", multiple=True, metavar="NAME", help="An input that holds until the next sample.")
def fit_coil_command(
    data: Path,
    out: Path,
    columns: Sequence[str],
    units: Sequence[str],
    constants: Sequence[str],
    both: bool,
    warm_up: float,
    t_initial: float,
    volumes: int,
    air_march: str,
    pressure: float,
    holds: Sequence[str],
    split: float | None,
    fit_until: float | None,
    validation: Path | None,
    drop: bool,
    jumps: str,
    max_gap: float | None,
    time_format: str | None,
) -> None:
    """Fit the coil to m_w, m_a, T_w_in, T_a_in, W_a_in (or RH_a_in, T_dp_in) and T_sup of DATA.

    T_w_out is compared if the log has it.  Time is elapsed_time or timestamp.  After a gap, and after a time without
    air flow (or with 0 in an optional column enabled), the model starts again.
    """
    from fastcoil.calibrate.coil import fit_coil

    _require_writable(out)
    announce_compilation("march_coil")
    with fit_progress():
        found = fit_coil(
            data,
            columns=pairs("--column", columns),
            units=pairs("--unit", units),
            constants=_numbers("--constant", constants),
            minimise_on="both" if both else "T_sup",
            warm_up=warm_up,
            T_initial=t_initial,
            n_volumes=volumes,
            air_march=air_march,
            pressure=pressure,
            holds=holds,
            split=split,
            fit_until=fit_until,
            validation=validation,
            drop=drop,
            jumps=jumps,
            max_gap=max_gap,
            time_format=time_format,
        )
    _write_and_print(found, out)


def pairs(option: str, given: Sequence[str]) -> dict[str, str] | None:
    """``NAME=VALUE`` … as a mapping; None without any, which means the file's own names."""
    pairs = [one.partition("=") for one in given]
    wrong = [f"{option} {one}: give NAME=VALUE" for one, (_, sign, _) in zip(given, pairs, strict=True) if not sign]
    if wrong:
        raise InputError(wrong)
    return {name.strip(): value.strip() for name, _, value in pairs} or None


def _lag(text: str) -> float | str:
    """Seconds, or the word."""
    try:
        return float(text)
    except ValueError:
        return text


def _numbers(option: str, given: Sequence[str]) -> dict[str, float]:
    """``NAME=NUMBER`` … as a mapping."""
    numbers, wrong = {}, []
    for name, text in (pairs(option, given) or {}).items():
        try:
            numbers[name] = float(text)
        except ValueError:
            wrong.append(f"{option} {name}={text}: give a number")
    if wrong:
        raise InputError(wrong)
    return numbers


def _require_writable(out: Path) -> None:
    """Refuse, before any work, a path that cannot be written, or that holds anything but an earlier fit."""
    from fastcoil.calibrate.result import is_fit

    if is_folder(out) or not is_folder(out.absolute().parent) or out.suffix != ".toml":
        raise InputError(f"-o {out}: give a file NAME.toml in a folder that exists")
    if exists(out) and not is_fit(out):
        raise InputError(f"-o {out}: this file exists and is no fit, choose another name or delete it")
    figure = out.with_suffix(".png")
    if is_file(figure) and not exists(out):
        raise InputError(f"-o {out}: {figure} exists and would be replaced, choose another name or delete it")


def _write_and_print(found: Fit, out: Path) -> None:
    from fastcoil.plots.files import write

    found.to_toml(out)
    figures = write({out.stem: found.plot()}, out.parent)
    say(*found.summary())
    say(f'Fitted:  {out} (in a study: [loop] include = ["{out.name}"])')
    for path in figures:
        say(f"Figure:  {path}")
