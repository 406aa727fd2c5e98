"""``fastcoil fit``: a valve or a coil from measured data, on the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fastcoil.cli.progress import announce_compilation
from fastcoil.errors import InputError

if TYPE_CHECKING:
    from fastcoil.calibrate.result import Fit

DATA = click.Path(path_type=Path)


@click.group()
def fit() -> None:
    """Fit a valve or a coil to measured data (a CSV file); writes TOML to include in a study, and a figure."""


def _common(command: Callable[..., None]) -> Callable[..., None]:
    """The options of both fits."""
    for option in (
        click.option(
            "--drop", is_flag=True, help="Leave rows with bad values out, and count them, instead of refusing."
        ),
        click.option(
            "--fit-until", type=float, help="Last second that is fitted; the rest is held back for validation."
        ),
        click.option(
            "--split",
            type=float,
            help="Share of the log that is fitted, in whole batches or pieces if it has four or more; 0.7 by default, "
            "all of it with --validate.",
        ),
        click.option("--validate", "validation", type=DATA, help="Another CSV file, to validate the fit with."),
        click.option(
            "--jumps", default="refuse", show_default=True, help="Time that goes back: refuse or split there."
        ),
        click.option("--max-gap", type=float, help="Longest step to be bridged, s; three median steps by default."),
        click.option(
            "--unit", "units", multiple=True, metavar="NAME=UNIT", help="Unit of a header that declares none."
        ),
        click.option(
            "--column", "columns", multiple=True, metavar="NAME=HEADER", help="Header of NAME, if it differs."
        ),
        click.argument("data", type=DATA),
    ):
        command = option(command)
    return command


@fit.command()
@_common
@click.option("-o", "--out", type=DATA, default="valve.toml", show_default=True, help="TOML file to write.")
@click.option("--m-max", type=float, help="Asymptotic flow, kg/s, if it is known; fitted by default.")
@click.option("--floor", type=float, help="Lowest reading of the flow meter, kg/s; found by default.")
@click.option("--settle", type=float, help="Seconds after a change of the command that are not compared.")
@click.option("--initial", default="unknown", show_default=True, help="Start in the gap: unknown, rising or falling.")
def valve(data: Path, out: Path, columns: Sequence[str], units: Sequence[str], **options: Any) -> None:
    """Fit backlash and flow curve to the columns command and m_w of DATA.

    Time is elapsed_time or timestamp; experiments in a row are told apart by a column batch, times without pump
    by a column enabled.
    """
    from fastcoil.calibrate.valve import fit_valve

    _written(out)
    announce_compilation("valve_flows")
    _tell(fit_valve(data, columns=_pairs("--column", columns), units=_pairs("--unit", units), **options), out)


@fit.command()
@_common
@click.option("-o", "--out", type=DATA, default="coil.toml", show_default=True, help="TOML file to write.")
@click.option("--constant", "constants", multiple=True, metavar="NAME=NUMBER", help="A series that the log lacks.")
@click.option("--both", is_flag=True, help="Minimise the error of the leaving water too, not of the supply air alone.")
@click.option("--warm-up", type=float, default=1800.0, show_default=True, help="Seconds left out at each start.")
@click.option("--t-initial", "T_initial", type=float, default=20.0, show_default=True, help="Start of all states, °C.")
@click.option("--volumes", "n_volumes", type=int, default=8, show_default=True, help="Number of control volumes.")
@click.option("--air-march", default="lagged", show_default=True, help="lagged or quasistatic.")
@click.option("--pressure", type=float, default=101325.0, show_default=True, help="Barometric pressure, Pa.")
@click.option("--hold", "holds", multiple=True, metavar="NAME", help="An input that holds between samples.")
def coil(
    data: Path,
    out: Path,
    columns: Sequence[str],
    units: Sequence[str],
    constants: Sequence[str],
    both: bool,
    **options: Any,
) -> None:
    """Fit the coil to m_w, m_a, T_w_in, T_a_in, W_a_in (or RH_a_in, T_dp_in) and T_sup of DATA.

    T_w_out is compared if it is there.  Time is elapsed_time or timestamp.  After a gap, and after a time
    without air flow (or with enabled = 0, if there is such a column), the record begins anew.
    """
    from fastcoil.calibrate.coil import fit_coil

    _written(out)
    announce_compilation("march_coil")
    numbers = {}
    for name, text in (_pairs("--constant", constants) or {}).items():
        try:
            numbers[name] = float(text)
        except ValueError:
            raise InputError(f"--constant {name}={text}: give a number") from None
    _tell(
        fit_coil(
            data,
            columns=_pairs("--column", columns),
            units=_pairs("--unit", units),
            constants=numbers,
            minimise_on="both" if both else "T_sup",
            **options,
        ),
        out,
    )


def _pairs(option: str, given: Sequence[str]) -> dict[str, str] | None:
    """``NAME=VALUE`` … as a mapping; None without any, which means the file's own names."""
    pairs = [one.partition("=") for one in given]
    wrong = [f"{option} {one}: give NAME=VALUE" for one, (_, sign, _) in zip(given, pairs, strict=True) if not sign]
    if wrong:
        raise InputError(wrong)
    return {name.strip(): value.strip() for name, _, value in pairs} or None


def _written(out: Path) -> None:
    """Refuse, before any work, where nothing can be written, or something else than an earlier fit lies."""
    from fastcoil.calibrate.result import is_fit

    if out.is_dir() or not out.absolute().parent.is_dir() or out.suffix != ".toml":
        raise InputError(f"-o {out}: give a file NAME.toml in a folder that exists")
    if out.exists() and not is_fit(out):
        raise InputError(f"-o {out}: it is there and is no fit, choose another name or delete it")


def _tell(found: Fit, out: Path) -> None:
    from fastcoil.plots.files import write

    found.to_toml(out)
    figures = write({out.stem: found.plot()}, out.parent)
    for line in found.summary():
        click.echo(line)
    click.echo(f'Fitted:  {out} (in a study: [loop] include = ["{out.name}"])')
    for path in figures:
        click.echo(f"Figure:  {path}")
