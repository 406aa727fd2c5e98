"""``fastcoil fit valve``, ``fit coil`` and ``fit loop``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fastcoil.base.errors import InputError, shown
from fastcoil.cli.arguments import PATH, pairs
from fastcoil.cli.deliver import with_report, write_figure, write_report
from fastcoil.cli.logs import require_writable, with_reading_options
from fastcoil.cli.terminal import announce_compilation, say

if TYPE_CHECKING:
    from fastcoil.loops.loop import Loop
    from fastcoil.measured.fit import Fit


@click.group()
def fit() -> None:
    """Fit a valve, a coil or a loop to a trend log (CSV); write TOML to include in a study, and a figure."""


def with_common_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that all fits have."""
    for option in (
        click.option(
            "--split",
            type=float,
            help="Share of the log to fit, in whole batches or pieces if there are four or more; 0.7 by default, 1 "
            "with --validate.",
        ),
        click.option("--validate", "validation", type=PATH, help="Another CSV file for validation."),
    ):
        command = option(command)
    return with_reading_options(with_report(command))


def _lag(text: str) -> float | str:
    """Seconds as a number, or the word auto."""
    try:
        return float(text)
    except ValueError:
        return text


def _as_numbers(ctx: click.Context, param: click.Parameter, value: Sequence[str]) -> dict[str, float]:
    found = {}
    for name, text in pairs("--constant", value).items():
        try:
            found[name] = float(text)
        except ValueError:
            raise InputError(f"--constant {name}={text}: give a number") from None
    return found


with_constants = click.option(
    "--constant", "constants", multiple=True, metavar="NAME=NUMBER", callback=_as_numbers,
    help="Constant value of a series not in the log.",
)  # fmt: skip


@fit.command("valve")
@with_common_options
@click.option("-o", "--out", type=PATH, default="valve.toml", show_default=True, help="TOML file to write.")
@click.option("--m-max", type=float, help="Asymptotic flow, kg/s; fitted by default.")
@click.option(
    "--lag",
    type=_lag,
    default="auto",
    show_default=True,
    metavar="SECONDS",
    help="Delay of the logged flow behind the command; auto: estimated per segment, reported, removed.",
)
@click.option(
    "--hold",
    "holds",
    metavar="command",
    help="The command is constant between rows; by default it may move between them.",
)
def fit_valve_command(data: Path, out: Path, report: Path | None, **options: Any) -> None:
    """Fit backlash and flow curve to the columns command and m_w of DATA.

    Time is elapsed_time or timestamp.  The optional column batch numbers the experiments in the log; the optional
    column enabled is 0 while the pump is off.
    """
    from fastcoil.measured.fit_valve import fit_valve

    require_writable(out)
    announce_compilation("valve_flows")
    found = fit_valve(data, **options)
    write_and_print(found, out, report)


@fit.command("coil")
@with_common_options
@click.option("-o", "--out", type=PATH, default="coil.toml", show_default=True, help="TOML file to write.")
@with_constants
@click.option("--both", is_flag=True, help="Minimise the error of the leaving water as well as that of the supply air.")
@click.option("--warm-up", type=float, default=1800.0, show_default=True, help="Seconds excluded after each start.")
@click.option("--pressure", type=float, default=101325.0, show_default=True, help="Barometric pressure, Pa.")
@click.option("--hold", "holds", multiple=True, metavar="NAME", help="An input that is constant until the next sample.")
def fit_coil_command(data: Path, out: Path, both: bool, report: Path | None, **options: Any) -> None:
    """Fit the coil to m_w, m_a, T_w_in, T_a_in, W_a_in (or RH_a_in, T_dp_in) and T_sup of DATA.

    T_w_out is compared if present.  Time is elapsed_time or timestamp.  The model restarts after a gap, and after a
    time without air flow (or with 0 in the optional column enabled).
    """
    from fastcoil.measured.fit_coil import fit_coil

    require_writable(out)
    announce_compilation("march_coil")
    found = fit_coil(data, minimise_on="both" if both else "T_sup", **options)
    write_and_print(found, out, report)


def write_and_print(found: Fit, out: Path, report: Path | None) -> None:
    """Write the TOML, figure and requested report of a fit, and print its summary."""
    found.to_toml(out)
    say(*found.summary())
    say(f'Fitted:  {out} (in a study: [loop] include = ["{out.name}"])')
    write_figure(found, out)
    write_report(found, report)


@fit.command("loop")
@with_common_options
@click.option("-o", "--out", type=PATH, default="loop.toml", show_default=True, help="TOML file to write.")
@click.option(
    "--loop",
    "parts",
    multiple=True,
    required=True,
    metavar="PRESET|FILE.toml",
    help="Valve curve, coil, motor and sensor: a preset, and files written by `fastcoil fit`.",
)
@with_constants
@click.option("--warm-up", type=float, default=1800.0, show_default=True, help="Seconds excluded after each start.")
def fit_loop_command(data: Path, out: Path, parts: Sequence[str], report: Path | None, **options: Any) -> None:
    """Fit the backlash without a flow meter, to command, T_sup, m_a, T_w_in, T_a_in, W_a_in (or RH_a_in, T_dp_in).

    Each candidate is simulated with the logged command.  Small errors of the coil and the valve curve do little harm;
    the log needs a sample every minute or more often.
    """
    from fastcoil.measured.fit_loop import fit_loop

    require_writable(out)
    loop = _loop_of(parts)
    announce_compilation()
    found = fit_loop(data, loop, **options)
    write_and_print(found, out, report)


def _loop_of(parts: Sequence[str]) -> Loop:
    """The preset, ``paper_like`` by default, with the parameters from the files."""
    from fastcoil.loops.loop import Loop
    from fastcoil.loops.presets import PRESETS
    from fastcoil.study.file.loop import read_includes

    names = [part for part in parts if part in PRESETS]
    files = [part for part in parts if part not in PRESETS]
    wrong = [part for part in files if not part.endswith(".toml")]
    if wrong:
        raise InputError(
            [f"--loop {shown(part)}: give one of {', '.join(PRESETS)}, or a file NAME.toml" for part in wrong]
        )
    if len(names) > 1:
        raise InputError(f"--loop {' --loop '.join(names)}: give one preset")
    included = read_includes({"include": files}, Path())
    return Loop.preset(*names or ["paper_like"]).assign(**included)
