"""The command ``fastcoil``: the group, and the commands in it.  They import heavy modules when they run."""

import click

from fastcoil.base.machine import VERSION
from fastcoil.cli import deliver, demo, logs, study
from fastcoil.cli.terminal import CommandGroup, echo, on_data

_FIRST_STEPS = """\
fastcoil finds out why the valve of a heating or cooling coil hunts, and what helps.  What do you have?
  a trend log        fastcoil diagnose LOG.csv
  a loop to tune     fastcoil explain lbnl --set kp=0.03 --set ti=10
  a question         fastcoil init study.toml, then fastcoil run study.toml
  nothing yet        fastcoil demo
All commands: fastcoil --help"""


@click.group(
    cls=CommandGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(VERSION, package_name="fastcoil")
@click.pass_context
def main(context: click.Context) -> None:
    """Simulate coil valves with backlash under PI and backlash-inverse control, thousands of days at once.

    \b
    A first study:
      fastcoil init study.toml         writes a commented study file
      fastcoil plan study.toml         shows its size and how long it takes
      fastcoil run study.toml          runs it: results/study/ with NetCDF and figures
    """  # noqa: D301 — click reads the backspace
    if context.invoked_subcommand is None:
        echo(*_FIRST_STEPS.split("\n"))


for command in (deliver.cite, study.init, study.parameters):
    main.add_command(command)
for command in (
    *(deliver.export, deliver.report, demo.demo, logs.diagnose, logs.fit, logs.join, logs.valve_test),
    *(study.compile_kernels, study.explain, study.explore, study.plan, study.plot, study.presets, study.rerun),
    *(study.run, study.status, study.tune, study.verify),
):
    main.add_command(on_data(command))
