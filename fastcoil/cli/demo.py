"""``fastcoil demo``: a diagnosis, an explanation and a sweep, on a log that is simulated first."""

import shlex
import tempfile
from contextlib import ExitStack, chdir
from pathlib import Path

import click

import fastcoil as fc
from fastcoil.base.errors import InputError
from fastcoil.base.files import convert_os_errors, list_folder, make_folder, write_atomically
from fastcoil.base.machine import command_line
from fastcoil.cli.arguments import PATH
from fastcoil.cli.terminal import echo

_DEMO_COMMANDS = (  # each with the question that it answers
    ("A loop hunts.  Is it the valve?", "fastcoil diagnose log.csv --stroke-time 90"),
    (
        "Why does it hunt, and what would cure it?",
        "fastcoil explain lbnl --set backlash=0.09 --set kp=0.03 --set ti=12",
    ),
    ("What does an inverse gain?  20 loops on 5 days, in sweep.toml", "fastcoil run sweep.toml -o sweep -j 2"),
)


@click.command()
@click.argument("folder", type=PATH, required=False)
@click.pass_context
def demo(context: click.Context, folder: Path | None) -> None:
    """Show a diagnosis, an explanation and a sweep in about a minute.

    The log, the study file and the results stay in FOLDER, if it is given.
    """
    if folder is not None and list_folder(folder):
        raise InputError(f"{folder} has files in it: give the name of a new folder", "FOLDER", "path")
    with ExitStack() as stack:
        working_folder = folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fastcoil-")))
        with convert_os_errors(working_folder, "made"):
            make_folder(working_folder, parents=True)
            stack.enter_context(chdir(working_folder))
        write_atomically(Path("log.csv"), _simulate_log().encode())
        write_atomically(Path("sweep.toml"), Path(__file__).with_name("demo.toml").read_bytes())
        main = context.find_root().command
        if folder:
            echo(f"$ {command_line(['cd', str(folder)])}")  # so that the paths below are right
        for question, command in _DEMO_COMMANDS:
            echo("", f"# {question}", f"$ {command}")
            with main.make_context("fastcoil", shlex.split(command)[1:]) as command_context:
                main.invoke(command_context)
    files_note = f"The files are in {folder}." if folder else "These files are gone; to keep them: fastcoil demo FOLDER"
    echo("", f"Next, with a log of your own: fastcoil diagnose LOG.csv.  {files_note}")


def _simulate_log() -> str:
    """Return a CSV log of six hours of a loop that hunts, as a building writes it."""
    day = fc.paper_day(hours=6, seed=2)
    loop = fc.Loop.preset("lbnl").assign(backlash=0.09, kp=0.03, ti=13.0, noise_std=0.01)
    ds = fc.simulate(loop, day, traces=["command", "T_measured"], trace_interval=10, progress=False)
    T_set = day.to_dataset().T_set.sel(elapsed_time=ds.elapsed_time)
    rows = zip(ds.elapsed_time.values, ds.command.values, ds.T_measured.values, T_set.values, strict=True)
    lines = [f"{t:.0f},{command:.3f},{T_sup:.3f},{set_point:.3f}" for t, command, T_sup, set_point in rows]
    return "\n".join(["elapsed_time [s],command [1],T_sup [degC],T_set [degC]", *lines, ""])
