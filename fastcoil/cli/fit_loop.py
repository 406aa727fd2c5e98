"""``fastcoil fit loop``: the backlash of a valve from commands and temperatures, on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fastcoil.cli.announcements import announce_compilation
from fastcoil.cli.fit import fit, numbers, with_common_options, write_and_print
from fastcoil.cli.log_options import pairs, require_writable
from fastcoil.cli.paths import PATH

if TYPE_CHECKING:
    from fastcoil.loops.loop import Loop


@fit.command("loop")
@with_common_options
@click.option("-o", "--out", type=PATH, default="loop.toml", show_default=True, help="TOML file to write.")
@click.option(
    "--loop",
    "parts",
    multiple=True,
    required=True,
    metavar="PRESET|FILE.toml",
    help="Valve curve, coil, motor and sensor: a preset, and files that `fastcoil fit` wrote.",
)
@click.option("--constant", "constants", multiple=True, metavar="NAME=NUMBER", help="A series that the log lacks.")
@click.option("--warm-up", type=float, default=1800.0, show_default=True, help="Seconds left out at each start.")
def fit_loop_command(
    data: Path,
    out: Path,
    parts: Sequence[str],
    columns: Sequence[str],
    units: Sequence[str],
    constants: Sequence[str],
    warm_up: float,
    report: Path | None,
    **reading: Any,
) -> None:
    """Fit the backlash to command, T_sup, m_a, T_w_in, T_a_in, W_a_in (or RH_a_in, T_dp_in) of DATA: no flow meter.

    The emulator runs behind the logged command with each candidate.  A coil and a valve curve that are not quite right
    do little harm; a log with a sample a minute or more often is needed.
    """
    from fastcoil.measured.fit.loop import fit_loop

    require_writable(out)
    loop = _loop_of(parts)
    announce_compilation()
    found = fit_loop(
        data,
        loop,
        columns=pairs("--column", columns),
        units=pairs("--unit", units),
        constants=numbers("--constant", constants),
        warm_up=warm_up,
        **reading,
    )
    write_and_print(found, out, report)


def _loop_of(parts: Sequence[str]) -> Loop:
    """The loop of a preset, with what the files have put in its place; ``paper_like`` without a preset."""
    from fastcoil.base.errors import InputError, shown
    from fastcoil.loops.loop import Loop
    from fastcoil.loops.presets import PRESETS
    from fastcoil.study.file.include import read_includes

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
