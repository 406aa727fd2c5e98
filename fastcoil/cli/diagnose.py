"""``fastcoil diagnose``: whether it is the valve, from a trend log, on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from fastcoil.cli.announcements import announce_compilation
from fastcoil.cli.log_options import pairs, require_writable, with_reading_options
from fastcoil.cli.paths import PATH
from fastcoil.cli.report import with_report, write_report
from fastcoil.cli.terminal import say


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
