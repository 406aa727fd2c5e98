"""The command ``fastcoil``: the group, and the commands in it.  They import heavy modules when they run."""

import click

from fastcoil.base.machine import VERSION
from fastcoil.cli.deliver import archive, cite, export, report
from fastcoil.cli.logs import diagnose, fit, join, valve_test
from fastcoil.cli.study import explain, explore, init, parameters, plan, plot, presets, rerun, run, status, tune, verify
from fastcoil.cli.terminal import Commands


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(VERSION, package_name="fastcoil")
def main() -> None:
    """Simulate coil valves with backlash under PI and backlash-inverse control, thousands of days at once.

    \b
    A first study:
      fastcoil init study.toml         writes a commented study file
      fastcoil plan study.toml         shows its size and how long it takes
      fastcoil run study.toml          runs it: results/study/ with NetCDF and figures
    """  # noqa: D301 — click reads the backspace


for command in (
    *(archive, cite, diagnose, explain, explore, export, fit, init, join, parameters),
    *(plan, plot, presets, report, rerun, run, status, tune, valve_test, verify),
):
    main.add_command(command)
