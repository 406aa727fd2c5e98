"""``fastcoil fit``: a valve or a coil from measured data, on the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fastcoil.base.errors import InputError
from fastcoil.cli.announcements import announce_compilation
from fastcoil.cli.fit_progress import fit_progress
from fastcoil.cli.log_options import pairs, require_writable, with_reading_options
from fastcoil.cli.paths import PATH
from fastcoil.cli.report import with_report, write_report
from fastcoil.cli.terminal import say

if TYPE_CHECKING:
    from fastcoil.measured.fit.result import Fit


@click.group()
def fit() -> None:
    """Fit a valve or a coil to measured data (a CSV file); writes TOML to include in a study, and a figure."""


def with_common_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that both fits have."""
    for option in (
        click.option("--fit-until", type=float, help="Last second to fit; the rest is held back for validation."),
        click.option(
            "--split",
            type=float,
            help="Share of the log to fit, in whole batches or pieces if it has four or more; 0.7 by default, all of "
            "it with --validate.",
        ),
        click.option("--validate", "validation", type=PATH, help="Another CSV file to validate the fit with."),
    ):
        command = option(command)
    return with_reading_options(with_report(command))


@fit.command("valve")
@with_common_options
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
    report: Path | None,
    drop: bool,
    jumps: str,
    max_gap: float | None,
    time_format: str | None,
) -> None:
    """Fit backlash and flow curve to the columns command and m_w of DATA.

    Time is elapsed_time or timestamp.  An optional column batch numbers the experiments of a log; an optional
    column enabled is 0 while the pump is off.
    """
    from fastcoil.measured.fit.valve import fit_valve

    require_writable(out)
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
    write_and_print(found, out, report)


@fit.command("coil")
@with_common_options
@click.option("-o", "--out", type=PATH, default="coil.toml", show_default=True, help="TOML file to write.")
@click.option("--constant", "constants", multiple=True, metavar="NAME=NUMBER", help="A series that the log lacks.")
@click.option("--both", is_flag=True, help="Minimise the error of the leaving water too, not only of the supply air.")
@click.option("--warm-up", type=float, default=1800.0, show_default=True, help="Seconds left out at each start.")
@click.option("--t-initial", type=float, default=20.0, show_default=True, help="All temperatures at each start, °C.")
@click.option("--volumes", type=int, default=8, show_default=True, help="Number of control volumes.")
@click.option("--air-march", default="lagged", show_default=True, help="lagged or quasistatic.")
@click.option("--substeps", type=int, default=1, show_default=True, help="Steps of the model a second.")
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
    substeps: int,
    pressure: float,
    holds: Sequence[str],
    split: float | None,
    fit_until: float | None,
    validation: Path | None,
    report: Path | None,
    drop: bool,
    jumps: str,
    max_gap: float | None,
    time_format: str | None,
) -> None:
    """Fit the coil to m_w, m_a, T_w_in, T_a_in, W_a_in (or RH_a_in, T_dp_in) and T_sup of DATA.

    T_w_out is compared if the log has it.  Time is elapsed_time or timestamp.  After a gap, and after a time without
    air flow (or with 0 in an optional column enabled), the model starts again.
    """
    from fastcoil.measured.fit.coil import fit_coil

    require_writable(out)
    announce_compilation("march_coil")
    with fit_progress():
        found = fit_coil(
            data,
            columns=pairs("--column", columns),
            units=pairs("--unit", units),
            constants=numbers("--constant", constants),
            minimise_on="both" if both else "T_sup",
            warm_up=warm_up,
            T_initial=t_initial,
            n_volumes=volumes,
            air_march=air_march,
            substeps=substeps,
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
    write_and_print(found, out, report)


def _lag(text: str) -> float | str:
    """Seconds, or the word."""
    try:
        return float(text)
    except ValueError:
        return text


def numbers(option: str, given: Sequence[str]) -> dict[str, float]:
    """``NAME=NUMBER`` … as a mapping."""
    found, wrong = {}, []
    for name, text in (pairs(option, given) or {}).items():
        try:
            found[name] = float(text)
        except ValueError:
            wrong.append(f"{option} {name}={text}: give a number")
    if wrong:
        raise InputError(wrong)
    return found


def write_and_print(found: Fit, out: Path, report: Path | None) -> None:
    """Write the TOML of a fit, its figure and the report that was asked for, and print its summary."""
    from fastcoil.base.figures import write

    found.to_toml(out)
    figures = write({out.stem: found.plot()}, out.parent)
    say(*found.summary())
    say(f'Fitted:  {out} (in a study: [loop] include = ["{out.name}"])')
    for path in figures:
        say(f"Figure:  {path}")
    write_report(found, report)
