"""``fastcoil fit valve``, ``fit coil`` and ``fit loop``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fastcoil.base.errors import InputError
from fastcoil.base.progress import PATIENCE, SECONDS_BETWEEN_LINES, duration, is_terminal, terminal_bar
from fastcoil.cli.announcements import announce_compilation
from fastcoil.cli.arguments import PATH
from fastcoil.cli.deliver import with_report, write_report
from fastcoil.cli.logs import pairs, require_writable, with_reading_options
from fastcoil.cli.terminal import say

if TYPE_CHECKING:
    from rich.progress import Progress

    from fastcoil.loops.loop import Loop
    from fastcoil.measured.fit.result import Fit


@contextmanager
def fit_progress() -> Iterator[None]:
    """Show the progress of the fits inside."""
    from fastcoil.measured.fit.work import told

    shown = _Bar() if is_terminal() else _Lines()
    with told(shown):
        try:
            yield
        finally:
            shown.stop()


class _Part:
    """The part of a fit that goes on."""

    def __init__(self) -> None:
        self.start = self.began = time.monotonic()
        self.what, self.done, self.of = "starts", 0, 1

    def part(self, what: str, done: int, of: int) -> None:
        if what != self.what or done == 0:
            self.began = time.monotonic()
        self.what, self.done, self.of = what, done, of
        self.step()

    def step(self) -> None:
        """Show it, if it is time."""

    def stop(self) -> None:
        """Show nothing more."""


class _Lines(_Part):
    def __init__(self) -> None:
        super().__init__()
        self.last = self.start

    def step(self) -> None:
        now = time.monotonic()
        if now - self.last < SECONDS_BETWEEN_LINES:
            return
        self.last = now
        line = f"Fitting for {duration(now - self.start)}: {self.done:,} of {self.of:,} {self.what} done"
        if self.done:
            line += f", {duration((now - self.began) * (self.of - self.done) / self.done)} to go with them"
        say(line, err=True)


class _Bar(_Part):
    def __init__(self) -> None:
        super().__init__()
        self.bar: Progress | None = None

    def step(self) -> None:
        if self.bar is None and time.monotonic() - self.start >= PATIENCE:
            self.bar = terminal_bar("Fitting", transient=True)
            self.bar.start()
            self.task = self.bar.add_task("", total=self.of, what=self.what)
            self.shown = ""
        if self.bar is not None:
            if self.what != self.shown:
                self.bar.reset(self.task, total=self.of)
                self.shown = self.what
            self.bar.update(self.task, completed=self.done, total=self.of, what=self.what)

    def stop(self) -> None:
        if self.bar is not None:
            self.bar.stop()


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
